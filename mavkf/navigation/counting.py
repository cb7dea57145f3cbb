"""What rows and innovations bring, counted in one compiled call: live rows come one or two at a time, and each has its cost."""

import math
from typing import Any

import numpy as np

from mavkf.compiled import kernel
from mavkf.navigation import layout as L
from mavkf.navigation.codes import SENSORS
from mavkf.samples import KIND, SESSION, TIME, Kind

KINDS = max(Kind) + 1
SYSTEM_TIME_KIND = int(Kind.SYSTEM_TIME)
# Times of a session, s, that go with the counts
NEWEST, BEFORE = range(2)  # newest boot time (-inf: none), and what it was before the last row
FUSED, REFUSED = range(2)
SECOND, STATUS = 1, 2


class Counts:
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
def take_part(rows: Any, first: int, phase: float, times: Any, kinds: Any, newest: Any) -> tuple[int, int]:
    """Count timed rows from index `first` on, to the end of the session or to the row with which something becomes due.

    A report of the time begins another part: what was before it is told by what was known then, however rows are cut into calls.
    rows: (n, ROW_WIDTH), those of later sessions behind. phase: s after each full second of the newest time at which a status is due.
    Returns the index to go on from, and what is due: bits SECOND, where the newest time has entered another, and STATUS.
    """
    session = rows[first, SESSION]
    for i in range(first, rows.shape[0]):
        if rows[i, SESSION] != session:
            return i, 0
        t, kind = rows[i, TIME], int(rows[i, KIND])
        if kind == SYSTEM_TIME_KIND and i > first:
            return i, 0
        kinds[kind] += 1
        newest[kind] = max(newest[kind], t)
        times[BEFORE] = times[NEWEST]
        times[NEWEST] = max(times[NEWEST], t)
        before = times[BEFORE] if math.isfinite(times[BEFORE]) else t
        due = 0
        if math.floor(times[NEWEST]) > math.floor(before):
            due |= SECOND
        if math.floor(times[NEWEST] - phase) > math.floor(before - phase):
            due |= STATUS
        if due:
            return i + 1, due
    return rows.shape[0], 0


@kernel
def count_innovations(rows: Any, sensors: Any) -> None:
    """Add innovation rows (n, INNOVATION_WIDTH) to the counts of each sensor (SENSORS, 2)."""
    for i in range(rows.shape[0]):
        sensors[int(rows[i, L.I_SENSOR]), FUSED if rows[i, L.I_FUSED] else REFUSED] += 1


@kernel
def renew(
    kept: Any, span: Any, new: Any, kind: Any, chosen: int, speed: float, oldest: float, nis: Any
) -> tuple[int, float]:
    """Put the new innovations of one kind to those kept, forget what is too many or too old, and say what was fused.

    kept: (2 n, INNOVATION_WIDTH + 1), rows and the vehicle's speed at each; those of them in use are of the indices span (2,), n at most.
    new: (m, INNOVATION_WIDTH), kind (m,) the number of each's kind, `chosen` that which is taken. speed: m/s; oldest: time, s. nis: (n,)
    is filled with that of those fused; returns how many they are, and the sum of their dimensions.
    """
    most = kept.shape[0] // 2
    for i in range(new.shape[0]):
        if kind[i] != chosen:
            continue
        if span[1] == kept.shape[0]:
            for k in range(most):
                for j in range(kept.shape[1]):
                    kept[k, j] = kept[most + k, j]
            span[0], span[1] = 0, most
        for j in range(L.INNOVATION_WIDTH):
            kept[span[1], j] = new[i, j]
        kept[span[1], L.INNOVATION_WIDTH] = speed
        span[1] += 1
        span[0] = max(span[0], span[1] - most)
    old = 0
    for k in range(span[0], span[1]):
        old += kept[k, L.I_TIME] < oldest
    span[0] += old
    fused, size = 0, 0.0
    for k in range(span[0], span[1]):
        if kept[k, L.I_FUSED] > 0.0:
            nis[fused] = kept[k, L.I_NIS]
            size += kept[k, L.I_SIZE]
            fused += 1
    return fused, size
