"""The history of a live run: its last events, and snapshots of the state, so that a late event is put in its place.

What follows it is folded again, from the last snapshot before it.
"""

import math
import mmap

import numpy as np

from mavkf.compiled import FLOAT, INTEGER, INTEGERS, MATRIX, VECTOR, called_with, kernel
from mavkf.navigation import layout as L
from mavkf.navigation.fold import fold
from mavkf.navigation.layout import OUT
from mavkf.navigation.pose import pose_row
from mavkf.navigation.timeline import is_full, is_lone_fix, is_sample_in_use, precedes, slot_of
from mavkf.samples import TIME
from mavkf.stack import copy

# Events between snapshots: of all the history, of its end, and of the end of that. Most late events are late by a few only, and to fold up
# to their place again is work; what is later has more of it, and the memory stays small.
COARSE, MIDDLE, FINE = 128, 16, 4
RING = 16  # snapshots of each of the two kinds that stand at the end
# The cursor: whole numbers that a live run keeps beside its arrays.
EVENTS, FOLDED, LAST_SLOT, LATE = range(4)
LOOK = 4  # how many events there may be before it is looked which are too old to be needed
DROPPED = 5  # events, in whole COARSE
TAKEN = 6  # before which event, those that were dropped counted in, each snapshot of the end was taken, -1: none
CURSOR_SIZE = TAKEN + 2 * RING
FEWEST = 128  # events between two such looks
# times (s) kept beside it: newest sample of each, and up to where the history was dropped
NEWEST_IMU, NEWEST, FORGOTTEN = range(3)
MARKS_SIZE = 3


def history(capacity):
    """Arrays of a live run that holds so many events at most: events, snapshots, cursor, marks, as `run_live` takes them.

    A vehicle that sends little never touches most of them.
    """
    cursor = np.zeros(CURSOR_SIZE, dtype=np.int64)
    cursor[LAST_SLOT] = -1
    cursor[TAKEN:] = -1
    snapshots = untouched(2 * RING + capacity // COARSE + 2, L.STATE_SIZE)
    return untouched(capacity, L.EVENT_WIDTH), snapshots, cursor, np.full(MARKS_SIZE, -np.inf)


def untouched(rows, columns):
    """Zeros (rows, columns) of which only what is written takes memory, page by page; numpy's own may come in huge pages."""
    return np.frombuffer(mmap.mmap(-1, 8 * rows * columns, access=mmap.ACCESS_COPY)).reshape(rows, columns)


@kernel
def insert(events, n, e):
    """Put an event into the sorted first n rows; returns where. Equal ones keep their order of arrival."""
    i = n
    while i > 0 and precedes(e, events[i - 1]):
        i -= 1
    for k in range(n, i, -1):
        copy(events[k], events[k - 1])
    copy(events[i], e)
    return i


@kernel
def copy_state(a, b):
    """Copy state a to b (STATE_SIZE,); the second half only where it is in use, else it is zero as long as it has been used."""
    used = b[L.SECOND] != 0.0
    for i in range(L.HALF):
        b[i] = a[i]
    if a[L.SECOND] != 0.0:
        for i in range(L.HALF, L.STATE_SIZE):
            b[i] = a[i]
    elif used:
        for i in range(L.HALF, L.STATE_SIZE):
            b[i] = 0.0


@kernel
def snapshot_of(k, cursor):
    """Where a snapshot before event k of the history stands, a multiple of FINE."""
    if k % COARSE == 0:
        return 2 * RING + k // COARSE
    number = cursor[DROPPED] + k
    return RING + number // MIDDLE % RING if k % MIDDLE == 0 else number // FINE % RING


@kernel
def has_snapshot(k, cursor):
    """Whether there still is one before event k, all before which has been folded."""
    return k % COARSE == 0 or cursor[TAKEN + snapshot_of(k, cursor)] == cursor[DROPPED] + k


@kernel
def forget_old(events, snapshots, cursor, marks, window):
    """Drop what no event can be put before any more, in whole COARSE; of a full history the older half if need be.

    What is kept is small and written over again and again, so it stays in the cache.
    """
    count, drop = cursor[EVENTS], 0
    while drop + COARSE < count and events[drop + COARSE - 1, TIME] < marks[NEWEST] - window:
        drop += COARSE
    if count >= events.shape[0]:
        drop = max(drop, count // 2 // COARSE * COARSE)
    if drop > 0:
        marks[FORGOTTEN] = events[drop - 1, TIME]
        for k in range(count - drop):
            copy(events[k], events[k + drop])
        for k in range(0, cursor[FOLDED] - drop + 1, COARSE):
            copy_state(snapshots[snapshot_of(k + drop, cursor)], snapshots[snapshot_of(k, cursor)])
        cursor[EVENTS] -= drop
        cursor[FOLDED] -= drop
        cursor[DROPPED] += drop
    cursor[LOOK] = min(events.shape[0], cursor[EVENTS] + max(FEWEST, cursor[EVENTS] // 2))


@kernel
def fold_to_end(s, events, snapshots, cursor, c, out):
    """Fold what has not been folded; keep a snapshot before every FINE-th event."""
    for k in range(cursor[FOLDED], cursor[EVENTS]):
        if k % FINE == 0:
            place = snapshot_of(k, cursor)
            copy_state(s, snapshots[place])
            if k % COARSE != 0:
                cursor[TAKEN + place] = cursor[DROPPED] + k
        fold(s, events[k], c, out)
    cursor[FOLDED] = cursor[EVENTS]


@kernel
def go_back(s, snapshots, cursor, place):
    """Make the state that of the last snapshot before an event."""
    k = place // FINE * FINE
    while not has_snapshot(k, cursor):
        k -= FINE
    copy_state(snapshots[snapshot_of(k, cursor)], s)
    cursor[FOLDED] = k


@called_with(VECTOR, MATRIX, INTEGER, VECTOR, FLOAT, FLOAT, MATRIX, MATRIX, INTEGERS, VECTOR, MATRIX, OUT)
@kernel
def run_live(s, arrived, first, c, rate, window, events, snapshots, cursor, marks, poses, out):
    """Take events in the order of arrival, from index `first` on; each goes to its place and what follows is folded again.

    events, snapshots, cursor and marks: of `history`.
    Writes a pose row for each newest IMU sample of a new output interval. An event older than the newest by more than
    the window, or than what is left of the history, is counted and dropped. Returns the index to go on from and the
    number of pose rows (stops where a buffer might overflow).
    """
    count = 0
    i = first
    while i < arrived.shape[0]:
        if is_full(count, poses, out):
            break
        e = arrived[i]
        i += 1
        marks[NEWEST] = max(marks[NEWEST], e[TIME])
        if cursor[EVENTS] >= cursor[LOOK]:
            forget_old(events, snapshots, cursor, marks, window)
        if e[TIME] < marks[NEWEST] - window or e[TIME] <= marks[FORGOTTEN]:
            cursor[LATE] += 1
            continue
        newer = not e[TIME] <= marks[NEWEST_IMU]
        makes_pose = newer and is_lone_fix(e, marks[NEWEST_IMU], c)
        place = insert(events, cursor[EVENTS], e)
        cursor[EVENTS] += 1
        if place < cursor[FOLDED]:
            go_back(s, snapshots, cursor, place)
        fold_to_end(s, events, snapshots, cursor, c, out)
        if newer and is_sample_in_use(s, e):
            marks[NEWEST_IMU] = e[TIME]
            makes_pose = True
        if makes_pose and math.isfinite(s[L.T]):
            now = slot_of(s[L.T], rate)
            if rate == 0.0 or now > cursor[LAST_SLOT]:
                cursor[LAST_SLOT] = now
                pose_row(s, c, poses[count])
                count += 1
    return i, count
