"""What rows and innovations bring, counted in one compiled call: live rows come one or two at a time, and each has its cost."""

import math
from typing import Any

import numpy as np

from mavkf.compiled import kernel
from mavkf.navigation import layout as L
from mavkf.navigation.codes import SENSORS
from mavkf.samples import KIND, SESSION, TIME, Kind

KINDS = max(Kind) + 1
# Times of a session, s, that go with the counts
NEWEST, BEFORE = range(2)  # newest boot time (-inf: none), and what it was before the last row
FUSED, REFUSED = range(2)


class Tally:
    """What came in one session.

    kinds: (KINDS,) rows by kind. newest: (KINDS,) their newest times, s, -inf: none. sensors: (SENSORS, 2) innovations, fused and
    refused. times: (2,) NEWEST and BEFORE.
    """

    def __init__(self) -> None:
        """Nothing came yet."""
        self.kinds = np.zeros(KINDS, np.int64)
        self.newest = np.full(KINDS, -np.inf)
        self.sensors = np.zeros((SENSORS, 2), np.int64)
        self.times = np.full(2, -np.inf)


@kernel
def take_second(rows: Any, first: int, times: Any, kinds: Any, newest: Any) -> tuple[int, bool]:
    """Count timed rows from index `first` on, to the end of the session or to the row with which the newest time enters another second.

    rows: (n, ROW_WIDTH), those of later sessions behind. Returns the index to go on from, and whether another second was entered.
    """
    session = rows[first, SESSION]
    begun = math.floor(times[NEWEST] if math.isfinite(times[NEWEST]) else rows[first, TIME])
    for i in range(first, rows.shape[0]):
        if rows[i, SESSION] != session:
            return i, False
        t, kind = rows[i, TIME], int(rows[i, KIND])
        kinds[kind] += 1
        newest[kind] = max(newest[kind], t)
        times[BEFORE] = times[NEWEST]
        times[NEWEST] = max(times[NEWEST], t)
        if math.floor(times[NEWEST]) > begun:
            return i + 1, True
    return rows.shape[0], False


@kernel
def count_innovations(rows: Any, sensors: Any) -> None:
    """Add innovation rows (n, INNOVATION_WIDTH) to the counts of each sensor (SENSORS, 2)."""
    for i in range(rows.shape[0]):
        sensors[int(rows[i, L.I_SENSOR]), FUSED if rows[i, L.I_FUSED] else REFUSED] += 1
