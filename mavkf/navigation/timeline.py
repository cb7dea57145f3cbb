"""The timeline: events in the order in which they were measured, and folded in it (offline; for live runs see `history`)."""

import math

import numpy as np

from mavkf.compiled import FLOAT, INTEGER, MATRIX, VECTOR, called_with, kernel, long_kernel
from mavkf.navigation import layout as L
from mavkf.navigation.fold import fold
from mavkf.navigation.layout import OUT
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.plausible import GNSS_KIND, IMU_KIND
from mavkf.navigation.pose import pose_row
from mavkf.samples import KIND, ROW_WIDTH, SEQUENCE, SOURCE, TIME

ROOM = 512  # rows that must be left in an output buffer before an event is taken


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


@called_with(VECTOR, MATRIX, INTEGER, INTEGER, VECTOR, FLOAT, MATRIX, OUT)
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
