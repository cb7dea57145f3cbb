"""Which IMU message a session uses, by its first rows."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import UsageError
from mavkf.models.earth import STANDARD_GRAVITY
from mavkf.samples import ACCEL, IMU_SOURCES, KIND, SOURCE, TIME, Kind, Source

# How good an IMU message is at the same rate: resolution (mg and mrad/s against float) and stamp (ms against us).
IMU_QUALITY = {
    Source.HIGHRES_IMU: 3.0,
    Source.HIL_SENSOR: 3.0,
    Source.RAW_IMU: 1.0,
    Source.SCALED_IMU: 0.8,
    Source.SCALED_IMU2: 0.7,
    Source.SCALED_IMU3: 0.6,
}
PLAUSIBLE_FORCE = (0.4, 2.5)  # times gravity: the median of a scaled accelerometer on any vehicle


def _rate(times: NDArray[np.float64]) -> float:
    if times.size < 2 or not times.max() > times.min():
        return 0.0
    return float((times.size - 1) / (times.max() - times.min()))


def choose_imu(
    rows: NDArray[np.float64], forced: Source | None, reasons: list[str], broken: set[Source]
) -> tuple[Source | None, float]:
    """The best IMU message and its rate; those whose scale is wrong are added to `broken`."""
    rates: dict[Source, float] = {}
    imu = rows[rows[:, KIND] == Kind.IMU]
    for source in IMU_SOURCES:
        mine = imu[imu[:, SOURCE] == source]
        if not mine.shape[0]:
            continue
        with np.errstate(over="ignore", invalid="ignore"):
            sizes = np.linalg.norm(mine[:, ACCEL : ACCEL + 3], axis=1)
        sizes = sizes[np.isfinite(sizes)]
        force = float(np.median(sizes)) / STANDARD_GRAVITY if sizes.size else 0.0
        if source is not forced and not PLAUSIBLE_FORCE[0] < force < PLAUSIBLE_FORCE[1]:
            broken.add(source)
            reasons.append(
                f"{source.name} is not used: it shows {force:.2g} g, so its scale is unknown or it is broken"
            )
            continue
        rates[source] = _rate(mine[:, TIME])
    if forced is not None:
        if forced not in rates:
            raise UsageError(
                f"--imu {forced.name}: this vehicle sends {_names(rates) or 'no IMU message'}; choose one of those"
            )
        reasons.append(f"IMU {forced.name} at {rates[forced]:.3g} Hz, as asked")
        return forced, rates[forced]
    if not rates:
        reasons.append("no usable IMU message in the first seconds")
        return None, 0.0
    best = max(rates, key=lambda source: rates[source] * IMU_QUALITY[source])
    others = _names(source for source in rates if source is not best)
    reasons.append(
        f"IMU {best.name} at {rates[best]:.3g} Hz"
        + (f", best by rate, resolution and stamp of it and {others}" if others else "")
    )
    return best, rates[best]


def period(rows: NDArray[np.float64], source: Source | None) -> float:
    """The median (s) between the samples of an IMU message; 0 where there are none."""
    times = (
        np.unique(rows[(rows[:, KIND] == Kind.IMU) & (rows[:, SOURCE] == source), TIME])
        if source is not None
        else np.empty(0)
    )
    return float(np.median(np.diff(times))) if times.size > 1 else 0.0


def _names(sources: Iterable[Source]) -> str:
    return ", ".join(source.name for source in sources)
