"""Which messages the fold gets of a kind of sensor: the one that is used first, one in reserve, and whatever begins later.

Only one in reserve, because each value that arrives after an IMU sample that it precedes in time costs a piece of the timeline folded
again; and of a field or a pressure the slowest that is fast enough, because in reserve it only shows that it is there.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mavkf.samples import IMU_SOURCES, KIND, SOURCE, TIME, Kind, Source

ENOUGH_HZ = 4.0  # Hz: ap01 finds yaw to 0.6 deg at 5 Hz and to 0.15 at 50, but 50 in reserve cost a third of the speed as live
BAROMETER_SOURCES = (
    Source.SCALED_PRESSURE,
    Source.HIGHRES_IMU,
    Source.HIL_SENSOR,
    Source.SCALED_PRESSURE2,
    Source.SCALED_PRESSURE3,
)


def rates_of(rows: NDArray[np.float64], kind: Kind) -> dict[Source, float]:
    """Rate (Hz) of every source of a kind in rows (n, ROW_WIDTH)."""
    mine = rows[rows[:, KIND] == kind]
    found = {}
    for source in np.unique(mine[:, SOURCE]).astype(int):
        times = mine[mine[:, SOURCE] == source, TIME]
        span = float(times.max() - times.min())
        found[Source(source)] = (times.size - 1) / span if span > 0.0 else 0.0
    return found


def with_reserve(
    rows: NDArray[np.float64], kind: Kind, first: Source | None, order: Iterable[Source]
) -> tuple[Source, ...]:
    """The sources of a field or pressure that the fold gets, by a session's first rows. order: all that there may be."""
    rates = rates_of(rows, kind)
    others = {source: rate for source, rate in rates.items() if source is not first}
    # fast enough before too slow, then the slowest of those and the fastest of these
    best = min(others, key=lambda s: (others[s] < ENOUGH_HZ, abs(others[s] - ENOUGH_HZ)), default=None)
    return tuple(source for source in order if source in (first, best) or source not in rates)


def imus_with_reserve(
    rows: NDArray[np.float64], first: Source | None, forced: bool, quality: dict[Source, float]
) -> tuple[Source, ...]:
    """The IMU messages that the fold gets. quality: of each message that is usable, at the same rate; one that is forced stays alone."""
    if first is None or forced:
        return () if first is None else (first,)
    rates = rates_of(rows, Kind.IMU)
    others = {
        source: rate * quality[source] for source, rate in rates.items() if source is not first and source in quality
    }
    best = max(others, key=lambda s: others[s], default=None)
    return tuple(source for source in IMU_SOURCES if source in (first, best) or source not in rates)
