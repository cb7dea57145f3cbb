"""The true motion of a recorded or simulated flight, and how far an estimate is from it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import LogError, UsageError
from mavkf.models.earth import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS

Floats = NDArray[np.float64]

PLACE = ("lat_deg", "lon_deg", "alt_amsl_m")
ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
SPEEDS = ("vn_ms", "ve_ms", "vd_ms")
COLUMNS = ("time_boot_s", *PLACE, *ANGLES, *SPEEDS)
SIGMAS = {
    "north_m": "sigma_n_m",
    "east_m": "sigma_e_m",
    "down_m": "sigma_d_m",
    **{name: f"sigma_{name}" for name in (*SPEEDS, *ANGLES)},
}
"""Where an estimate claims the standard deviation of a quantity."""
PAIRS = {"horizontal_m": ("north_m", "east_m"), "tilt_deg": ("roll_deg", "pitch_deg")}
"""Quantities of two dimensions: their error over sigma is that of the two parts, per axis."""
NORMAL_95 = 1.96  # sigmas that hold 95 % of a normal distribution


@dataclass(frozen=True)
class Truth:
    """The true motion at n rising times; NaN is unknown.

    time_boot_s:  s on the vehicle's boot clock (n).
    lat, lon:     rad (n).
    alt:          m above mean sea level (n).
    velocity:     m/s, frame n (n, 3).
    euler:        roll, pitch, yaw, body to n, ZYX, rad (n, 3).
    """

    time_boot_s: Floats
    lat: Floats
    lon: Floats
    alt: Floats
    velocity: Floats
    euler: Floats

    @property
    def quaternion(self) -> Floats:
        """q_nb (n, 4), Hamilton, scalar first."""
        return quaternions(self.euler)

    def write_csv(self, path: Path) -> None:
        """Write the columns COLUMNS, blank where unknown; yaw from 0 to 360 degrees. Raises UsageError if it cannot."""
        degrees = np.degrees(self.euler)
        degrees[:, 2] %= 360.0
        table = np.column_stack(
            [self.time_boot_s, np.degrees(self.lat), np.degrees(self.lon), self.alt, degrees, self.velocity]
        )
        line = ",".join(["%.6f", "%.9f", "%.9f", "%.4f", *["%.5f"] * 6]) + "\n"
        try:
            with Path(path).open("w", encoding="utf-8") as file:
                file.write(",".join(COLUMNS) + "\n")
                file.writelines((line % tuple(row)).replace("nan", "") for row in table)
        except OSError as error:
            raise UsageError(
                f"{path} cannot be written ({error.strerror}); name a file in an existing folder"
            ) from None


def read_truth(path: Path) -> Truth:
    """Read a truth file: CSV with a header, any of COLUMNS in any order, `time_boot_s` always; blank is unknown.

    Raises LogError if the file cannot be read, lacks the time or the rows, or has a cell that is not a number.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not text"
        raise LogError(f"{path} cannot be read ({reason}); give a CSV file of true motion.") from None
    names = [name.strip() for name in lines[0].lstrip("#").split(",")] if lines else []
    if "time_boot_s" not in names:
        raise LogError(
            f"{path} has no column time_boot_s; its first line must name columns, as in {','.join(COLUMNS)}."
        )
    wanted = [(name, names.index(name)) for name in COLUMNS if name in names]
    rows = [(number, line.split(",")) for number, line in enumerate(lines[1:], 2) if line.strip()]
    try:
        columns = {
            name: np.array([float(cell) if (cell := cells[i].strip()) else math.nan for number, cells in rows])
            for name, i in wanted
        }
    except (ValueError, IndexError):
        raise LogError(
            f"{path} line {_bad_row(rows, wanted)} is not {len(names)} numbers; repair or remove it."
        ) from None
    order = np.argsort(columns["time_boot_s"], kind="stable")
    order = order[np.isfinite(columns["time_boot_s"][order])]
    if len(order) == 0:
        raise LogError(f"{path} has no rows with a time below its header; give a file that holds a motion.")
    unknown = np.full(len(order), np.nan)
    found = {name: columns[name][order] if name in columns else unknown for name in COLUMNS}
    return Truth(
        found["time_boot_s"],
        np.radians(found["lat_deg"]),
        np.radians(found["lon_deg"]),
        found["alt_amsl_m"],
        np.column_stack([found[name] for name in SPEEDS]),
        np.radians(np.column_stack([found[name] for name in ANGLES])),
    )


def _bad_row(rows: list[tuple[int, list[str]]], wanted: list[tuple[str, int]]) -> int:
    for number, cells in rows:
        try:
            [float(cells[i].strip() or "nan") for _, i in wanted]
        except (ValueError, IndexError):
            return number
    return 1


@dataclass(frozen=True)
class Statistics:
    """One quantity's errors in its own unit; NaN where nothing is known.

    rms, p95, max:  of the error (absolute).
    coverage:       share of the whole seconds from the truth's begin to its end in which a value was given.
    error_over_sigma: rms of error / claimed sigma: 1 is honest, above 1 overconfident.
    inside_95:      share of errors within 1.96 claimed sigma.
    """

    rms: float
    p95: float
    max: float
    coverage: float
    error_over_sigma: float
    inside_95: float


@dataclass(frozen=True)
class Errors:
    """How far an estimate is from the truth, at those of its times that the truth spans.

    time_boot_s:  s (n).
    values:       estimate minus truth (n), by quantity: north_m, east_m, down_m, horizontal_m, vn_ms, ve_ms, vd_ms,
                  roll_deg, pitch_deg, yaw_deg, tilt_deg; those that both know.
    statistics:   of each quantity that is known at all.
    """

    time_boot_s: Floats
    values: dict[str, Floats]
    statistics: dict[str, Statistics]


def errors(estimate: Mapping[str, Floats], truth: Truth, begin: float = -math.inf, end: float = math.inf) -> Errors:
    """Compare an estimate with the truth between two times (s), the truth interpolated to the estimate's times.

    estimate:  columns of equal length, NaN is unknown: time_boot_s (s) and any of lat_deg lon_deg alt_amsl_m, vn_ms
               ve_ms vd_ms, roll_deg pitch_deg yaw_deg, and of the sigmas named in SIGMAS.

    Position errors are metres in n at the true place. Yaw error is the turn about the vertical in the rotation from
    true to estimated attitude, tilt the angle between the two body-fixed verticals; tilt needs no yaw.

    Raises LogError if the estimate has no time inside the truth's.
    """
    begin, end = max(begin, float(truth.time_boot_s[0])), min(end, float(truth.time_boot_s[-1]))
    t = estimate["time_boot_s"]
    use = (t >= begin) & (t <= end)
    if not use.any():
        raise LogError(
            f"the estimate has no time from {begin:g} s to {end:g} s, which the truth spans; give its own truth."
        )
    t = t[use]
    e = {name: np.asarray(estimate[name], np.float64)[use] for name in (*COLUMNS, *SIGMAS.values()) if name in estimate}
    values = {**_place(e, truth, t), **_speed(e, truth, t), **_attitude(e, truth, t)}
    ratios = {name: values[name] / e[sigma] for name, sigma in SIGMAS.items() if name in values and sigma in e}
    for pair, parts in PAIRS.items():
        if pair in values and all(part in ratios for part in parts):
            ratios[pair] = np.concatenate([ratios[part] for part in parts])
    statistics = {
        name: _statistics(t, value, ratios.get(name, np.array([])), begin, end)
        for name, value in values.items()
        if np.isfinite(value).any()
    }
    return Errors(t, values, statistics)


def _statistics(t: Floats, value: Floats, ratio: Floats, begin: float, end: float) -> Statistics:
    known = np.isfinite(value)
    size, ratio = np.abs(value[known]), np.abs(ratio[np.isfinite(ratio)])
    seconds = math.floor(end - begin)
    given = np.unique(np.floor(t[known] - begin))
    return Statistics(
        rms=_rms(size),
        p95=float(np.percentile(size, 95)),
        max=float(size.max()),
        coverage=int(np.count_nonzero(given < seconds)) / seconds if seconds else math.nan,
        error_over_sigma=_rms(ratio),
        inside_95=float(np.mean(ratio < NORMAL_95)) if ratio.size else math.nan,
    )


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.mean(values**2))) if values.size else math.nan


def _at(truth: Truth, t: Floats, values: Floats) -> Floats:
    return np.interp(t, truth.time_boot_s, values)


def _unwrapped(angles: Floats) -> Floats:
    """Angles without jumps, unknown ones left out of it."""
    result = angles.copy()
    known = np.isfinite(angles)
    result[known] = np.unwrap(angles[known])
    return result


def _wrap_degrees(angle: Floats) -> Floats:
    result: Floats = (angle + 180.0) % 360.0 - 180.0
    return result


def _place(e: Mapping[str, Floats], truth: Truth, t: Floats) -> dict[str, Floats]:
    values = {}
    if "lat_deg" in e and "lon_deg" in e:
        latitude = _at(truth, t, truth.lat)
        w = np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
        longitude = np.degrees(_at(truth, t, _unwrapped(truth.lon)))
        east = SEMI_MAJOR_AXIS / w * np.cos(latitude)
        values["north_m"] = (
            (np.radians(e["lat_deg"]) - latitude) * SEMI_MAJOR_AXIS * (1.0 - ECCENTRICITY_SQUARED) / w**3
        )
        values["east_m"] = np.radians(_wrap_degrees(e["lon_deg"] - longitude)) * east
        values["horizontal_m"] = np.hypot(values["north_m"], values["east_m"])
    if "alt_amsl_m" in e:
        values["down_m"] = _at(truth, t, truth.alt) - e["alt_amsl_m"]
    return values


def _speed(e: Mapping[str, Floats], truth: Truth, t: Floats) -> dict[str, Floats]:
    return {name: e[name] - _at(truth, t, truth.velocity[:, i]) for i, name in enumerate(SPEEDS) if name in e}


def _attitude(e: Mapping[str, Floats], truth: Truth, t: Floats) -> dict[str, Floats]:
    if not all(name in e for name in ANGLES):
        return {}
    true = np.stack([_at(truth, t, _unwrapped(truth.euler[:, i])) for i in range(3)], axis=1)
    estimated = np.radians(np.stack([e[name] for name in ANGLES], axis=1))
    difference = _wrap_degrees(np.degrees(estimated - true))
    down, true_down = _down(estimated), _down(true)
    tilt = np.arctan2(np.linalg.norm(np.cross(down, true_down), axis=1), np.sum(down * true_down, axis=1))
    # of q_est * q_true^-1 = w + z k + ...: the twist about the vertical is 2 atan(z / w)
    (a, b, c, d), (p, q, r, s) = quaternions(estimated).T, quaternions(true).T
    yaw = 2.0 * np.arctan2(d * p - a * s - b * r + c * q, a * p + b * q + c * r + d * s)
    return {
        "roll_deg": difference[:, 0],
        "pitch_deg": difference[:, 1],
        "yaw_deg": _wrap_degrees(np.degrees(yaw)),
        "tilt_deg": np.degrees(tilt),
    }


def _down(euler: Floats) -> Floats:
    """Find the direction of down in the body (n, 3)."""
    roll, pitch = euler[:, 0], euler[:, 1]
    return np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], axis=1)


def quaternions(euler: Floats) -> Floats:
    """q_nb (n, 4) of the ZYX Euler angles (n, 3), rad: `mavkf.models.rotation.quaternion_from_euler` for arrays."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * euler).T, np.sin(0.5 * euler).T
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )
