"""The rows of a log on the vehicle's boot clock."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mavkf.link.clocks import ClockCounts, VehicleClock
from mavkf.samples import SEQUENCE, SESSION, TIME

Array = NDArray[np.float64]


def on_boot_clock(rows: Array, window_s: float) -> tuple[Array, ClockCounts]:
    """Rows of one vehicle (n, ROW_WIDTH), in the order of arrival, with their TIME and SESSION; what has no time is left out.

    window_s: as of `mavkf.config.Timeline`.
    """
    clock = VehicleClock(window_s)
    return np.concatenate([clock.push(rows), clock.flush()]), clock.counts


def boot_times(rows: Array, window_s: float) -> Array:
    """Boot time (n), s, of each row of one vehicle (n, ROW_WIDTH), in the order of arrival; NaN for one that `on_boot_clock` leaves out."""
    numbered = rows.copy()
    numbered[:, SEQUENCE] = np.arange(rows.shape[0])  # the clock does not read it
    timed = on_boot_clock(numbered, window_s)[0]
    times = np.full(rows.shape[0], np.nan)
    times[timed[:, SEQUENCE].astype(np.int64)] = timed[:, TIME]
    return times


def by_session(timed: Array) -> Iterator[tuple[int, Array]]:
    """The rows (n, ROW_WIDTH) of each session in turn, whose number never falls."""
    session = timed[:, SESSION]
    ends = [*(np.flatnonzero(np.diff(session)) + 1).tolist(), len(timed)]
    first = 0
    for end in ends:
        if end > first:
            yield int(session[first]), timed[first:end]
        first = end
