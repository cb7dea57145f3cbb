"""The timeline: events in the order in which they were measured, folded offline at once or live with late ones put in their place."""

import math
import mmap

import numpy as np

from mavkf.compiled import kernel, long_kernel
from mavkf.navigation import layout as L
from mavkf.navigation.fold import fold
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.plausible import GNSS_KIND, IMU_KIND
from mavkf.navigation.pose import pose_row
from mavkf.samples import KIND, ROW_WIDTH, SEQUENCE, SOURCE, TIME
from mavkf.stack import copy

# Events between snapshots: of all the history, of its end, and of the end of that. Most late events are late by a few only, and to fold up
# to their place again is work; what is later has more of it, and the memory stays small.
COARSE, MIDDLE, FINE = 128, 16, 4
RING = 16  # snapshots of each of the two kinds that stand at the end
ROOM = 512  # rows that must be left in an output buffer before an event is taken
# The cursor: whole numbers that a live run keeps beside its arrays.
EVENTS, FOLDED, LAST_SLOT, LATE = range(4)
LOOK = 4  # how many events there may be before it is looked which are too old to be needed
DROPPED = 5  # events, in whole COARSE
TAKEN = 6  # before which event, those that were dropped counted in, each snapshot of the end was taken, -1: none
CURSOR_SIZE = TAKEN + 2 * RING
FEWEST = 128  # events between two such looks
NEWEST_IMU, NEWEST, FORGOTTEN = (
    0,
    1,
    2,
)  # times (s) kept beside it: newest sample of each, and up to where the history was dropped
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
def precedes(a, b):
    """Whether event a comes before event b: by time measured, then kind, source and sequence number, whatever came in first."""
    if a[TIME] != b[TIME]:
        return a[TIME] < b[TIME]
    if a[KIND] != b[KIND]:
        return a[KIND] < b[KIND]
    if a[SOURCE] != b[SOURCE]:
        return a[SOURCE] < b[SOURCE]
    return a[SEQUENCE] < b[SEQUENCE]


@kernel
def order_ties(index, time, kind, source, sequence):
    """Sort those of an index (n,) that are of the same time by the rest of `precedes`, by insertion: they are few, and equal ones stay."""
    for n in range(1, index.size):
        k, i = index[n], n
        while i > 0:
            other = index[i - 1]
            if time[other] != time[k]:
                break
            if kind[other] != kind[k]:
                after = kind[other] > kind[k]
            elif source[other] != source[k]:
                after = source[other] > source[k]
            else:
                after = sequence[other] > sequence[k]
            if not after:
                break
            index[i] = other
            i -= 1
        index[i] = k


def order(time: np.ndarray, kind: np.ndarray, source: np.ndarray, sequence: np.ndarray) -> np.ndarray:
    """The indices (n,) that sort events by `precedes`; equal ones keep their order."""
    index = np.argsort(time, kind="stable")  # what is nearly sorted costs little
    order_ties(index, *map(np.ascontiguousarray, (time, kind, source, sequence)))
    return index


@kernel
def place_event(row, number, delays, event):
    """Fill an event (EVENT_WIDTH,) with a row, its running number and its time of measurement.

    delays: (kinds,) s; the earth's field is left unknown.
    """
    for j in range(ROW_WIDTH):
        event[j] = row[j]
    event[TIME] -= delays[int(event[KIND])]
    for j in range(ROW_WIDTH, L.EVENT_ID):
        event[j] = np.nan
    event[L.EVENT_ID] = number


@long_kernel
def place_events(rows, index, numbers, delays, events):
    """Fill events (m, EVENT_WIDTH) with the rows at an index (m,), as of `place_event`, with these running numbers (m,)."""
    for i in range(index.size):
        place_event(rows[index[i]], numbers[i], delays, events[i])


@kernel
def choose_events(rows, wanted, delays, number, events):
    """Fill events (n, EVENT_WIDTH), as of `place_event`, with the rows (n, ROW_WIDTH) that are wanted (kinds, sources) and have a time.

    number: of the first. Returns how many they are, and how many of them are fixes.
    """
    count = fixes = 0
    for i in range(rows.shape[0]):
        kind = int(rows[i, KIND])
        if wanted[kind, int(rows[i, SOURCE])] and math.isfinite(rows[i, TIME]):
            place_event(rows[i], number + count, delays, events[count])
            count += 1
            fixes += kind == GNSS_KIND
    return count, fixes


@kernel
def is_lone_fix(e, newest_imu, c):
    """Whether an event is a fix while there is no IMU: then its arrival makes a pose."""
    return int(e[KIND]) == GNSS_KIND and not e[TIME] - newest_imu <= c[Parameter.GAP]


@kernel
def is_sample_in_use(s, e):
    """Whether an event that was folded is a sample of the IMU in use: its arrival makes a pose."""
    return int(e[KIND]) == IMU_KIND and e[SOURCE] == s[L.IMU_SOURCE]


@kernel
def slot_of(t, rate):
    """The number of the output interval that a time (s) falls into; rate in Hz, 0: every step has its own."""
    return math.floor(t * rate + 1e-6)


@kernel
def is_full(count, poses, out):
    """Whether what one event may write (a late one: records of all that is folded again) might not fit into the output buffers."""
    counts = out[2]
    return count >= poses.shape[0] or counts[0] + ROOM > out[0].shape[0] or counts[1] + ROOM > out[1].shape[0]


@long_kernel
def run_batch(s, events, first, slot, c, rate, poses, out):
    """Fold sorted events from index `first` on; write a pose row at every output interval.

    slot: the output interval of the last row, -1: none yet. Stops where an output buffer might overflow. Returns the index to go on from,
    the number of pose rows written, and the interval of the last.
    """
    count = 0
    i = first
    while i < events.shape[0]:
        if is_full(count, poses, out):
            break
        e = events[i]
        lone = is_lone_fix(e, s[L.T_IMU], c)
        fold(s, e, c, out)
        i += 1
        if (lone or is_sample_in_use(s, e)) and math.isfinite(s[L.T]):
            now = slot_of(s[L.T], rate)
            if rate == 0.0 or now > slot:
                slot = now
                pose_row(s, c, poses[count])
                count += 1
    return i, count, slot


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
