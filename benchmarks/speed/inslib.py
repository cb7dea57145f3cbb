"""The C filter inslib (Python binding INSLIB) on the samples that mavkf folds."""

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.speed.measure import hushed, seconds
from mavkf import samples as s
from mavkf.samples import Kind, Source

OPEN = {
    "auto_init": True,
    "auto_zupt_disable": True,
    "gnss_start_max_vertical_vel_stddev_mps": 60.0,
    "gnss_stop_max_vertical_vel_stddev_mps": 60.0,
}
"""Its defaults otherwise: a hover is no rest, and fixes of GPS_RAW_INT have no vertical velocity, without which it would not begin."""
UNKNOWN_DOWN = 2500.0  # (m/s)^2
YEAR = 2026.5
OLDEST_US = 500_000  # of a fix, which is what it keeps
Call = tuple[str, tuple[Any, ...]]


def module() -> ModuleType | None:
    """Give the module, where it is installed."""
    try:
        import INSLIB
    except ImportError:
        return None
    result: ModuleType = INSLIB
    return result


def calls(rows: NDArray[np.float64], source: int, delay_s: float) -> list[Call]:
    """Make the calls of its methods for rows (n, ROW_WIDTH) in order of arrival: name and arguments, all made before any clock runs.

    source: the IMU message; delay_s: of a fix's stamp. An epoch is an IMU sample, with what came since the one before.
    """
    result: list[Call] = []
    waiting: list[Call] = []
    last_us: int | None = None
    field = None
    fixed = np.nan
    located = False
    for row in rows:
        us = round(row[s.TIME] * 1e6)
        if row[s.KIND] == Kind.IMU and row[s.SOURCE] == source:
            if last_us is None or us > last_us:
                dt = 0.0 if last_us is None else (us - last_us) * 1e-6
                result.append(("imu", (us, dt, _three(row, s.GYRO + 3), _three(row, s.GYRO))))
                result += [_aged(name, given, us) for name, given in waiting]
                result.append(("update", ()))
                last_us, waiting = us, []
        elif row[s.SOURCE] == Source.SCALED_PRESSURE:
            waiting.append(("baro", (row[s.PRESSURE].item(),)))
        elif row[s.KIND] == Kind.MAGNETOMETER and row[s.SOURCE] == source and _three(row, s.FIELD) != field:
            field = _three(row, s.FIELD)
            waiting.append(("mag", (tuple(1e6 * value for value in field), (0.0, 0.0, 0.0))))
        elif row[s.SOURCE] == Source.GPS_RAW_INT and row[s.FIX] >= 3 and row[s.STAMP] != fixed:  # not a repeated one
            fixed = row[s.STAMP]
            place = (row[s.LATITUDE].item(), row[s.LONGITUDE].item(), row[s.HEIGHT_AMSL].item())
            if not located:
                waiting.append(("set_magnetic_model", (*place[:2], YEAR)))
                located = True
            horizontal, vertical, speed = (
                (value if np.isfinite(value) else usual) ** 2
                for value, usual in zip(_three(row, s.SIGMA_HORIZONTAL), (1.0, 2.0, 0.2), strict=True)
            )
            measured = us - round(delay_s * 1e6)
            waiting.append(("gnss_pos_llh", (place, (horizontal, horizontal, vertical), measured)))
            if np.isfinite(row[s.VELOCITY_N]):
                down = row[s.VELOCITY_D]
                seen = bool(np.isfinite(down))
                v = (row[s.VELOCITY_N].item(), row[s.VELOCITY_E].item(), down.item() if seen else 0.0)
                waiting.append(("gnss_vel", (v, (speed, speed, speed if seen else UNKNOWN_DOWN))))
    return result


def run(library: ModuleType, made: list[Call]) -> float:
    """Seconds of all calls, on a new filter."""
    with hushed():
        navigator = library.Navigator(library.Config(**OPEN))
        bound = [(getattr(navigator, name), given) for name, given in made]

        def feed() -> None:
            for method, given in bound:
                method(*given)

        took = seconds(feed)
        if not navigator.is_ready():
            raise RuntimeError("inslib has not come to a navigation solution: there is nothing to compare with")
    return took


def _three(row: NDArray[np.float64], first: int) -> tuple[float, float, float]:
    x, y, z = row[first : first + 3].tolist()
    return x, y, z


def _aged(name: str, given: tuple[Any, ...], now_us: int) -> Call:
    """Say of a position how old it is at its epoch, instead of when it was measured."""
    if name != "gnss_pos_llh":
        return name, given
    *values, measured = given
    return name, (*values, 0, min(max(now_us - measured, 0), OLDEST_US))
