"""Faults that last: each is told when it begins and when it is over, with its size; and those that one sensor's values show by themselves.

The book of what is going on is in the state, so it is the same live and in batch.
"""

import math

import numpy as np

from mavkf.compiled import kernel
from mavkf.models.earth import STANDARD_GRAVITY
from mavkf.navigation import layout as L
from mavkf.navigation.codes import FAULTS, NoteCode
from mavkf.navigation.fusing import tell

FIRST = int(NoteCode.GNSS_JUMP)
APART = 1.0  # s between two beginnings of one kind: a begin that moves when a late event is folded in is not told twice
CALM = 2.0  # s without a sign of it, after which a disturbance that shows from time to time is over
CLIPPED_FORCE = 7.5 * STANDARD_GRAVITY  # no vehicle holds more; a range of 8 g or 16 g ends above
CLIPPED_AFTER = 3.0  # samples in a row with the very same extreme value
# Half the mean square of differences of successive samples is the variance of a white signal. ArduPilot's documentation calls a level
# ("VIBE") of 30 m/s^2 and more a problem, and half of it the grey zone: the level is the standard deviation above 5 Hz.
VIBRATION = 30.0  # m/s^2
MADE_UP_AFTER = 10.0  # samples in a row without noise of their own


@kernel
def begin_faults(s):
    """No fault is going on."""
    for k in range(FAULTS):
        b = L.FAULT_BOOK + 3 * k
        s[b + L.FAULT_SINCE] = np.nan
        s[b + L.FAULT_LAST] = np.nan
    for i in (
        L.SUSPECT_POSITION,
        L.SUSPECT_VELOCITY,
        L.SUSPECT_HEIGHT,
        L.HEIGHT_AGREES_SINCE,
        L.AGREES_SINCE,
        L.PRESSURE_REFUSED_SINCE,
        L.PRESSURE_HEIGHT,
        L.HEIGHTS_APART,
        L.HEIGHTS_MEAN,
    ):
        s[i] = np.nan


@kernel
def fault_book(code):
    """Where the book of a fault is, by its NoteCode."""
    return L.FAULT_BOOK + 3 * (code.value - FIRST)


@kernel
def is_on(s, code):
    """Whether a fault is going on."""
    return math.isfinite(s[fault_book(code) + L.FAULT_SINCE])


@kernel
def begin_fault(s, out, code, start, size, a, b):
    """A fault shows now: tell it if it is new, with its start (s), size and evidence; else remember the largest size."""
    k = fault_book(code)
    s[k + L.FAULT_LAST] = s[L.T]
    if math.isfinite(s[k + L.FAULT_SINCE]):
        s[k + L.FAULT_SIZE] = max(s[k + L.FAULT_SIZE], size)
        return
    s[k + L.FAULT_SINCE] = start
    s[k + L.FAULT_SIZE] = size
    tell(out, code.value, APART, s[L.T], start, np.nan, size, a, b)


@kernel
def end_fault(s, out, code):
    """A fault is over, if it was going on: tell it with its span and its largest size."""
    k = fault_book(code)
    if math.isfinite(s[k + L.FAULT_SINCE]):
        tell(out, code.value, APART, s[L.T], s[k + L.FAULT_SINCE], s[L.T], s[k + L.FAULT_SIZE], 0.0, 0.0)
        s[k + L.FAULT_SINCE] = np.nan


@kernel
def calm_fault(s, out, code):
    """End a fault that has not shown for a while."""
    k = fault_book(code)
    if math.isfinite(s[k + L.FAULT_SINCE]) and s[L.T] - s[k + L.FAULT_LAST] > CALM:
        end_fault(s, out, code)


@kernel
def watch_imu(s, out):
    """What the IMU's samples show by themselves, after one was taken: made-up values, clipping, vibration."""
    if s[L.SMOOTH] >= MADE_UP_AFTER:
        begin_fault(s, out, NoteCode.IMU_FROZEN, s[L.T] - s[L.SMOOTH] * s[L.PERIOD], s[L.SMOOTH], 0.0, 0.0)
    else:
        end_fault(s, out, NoteCode.IMU_FROZEN)
    extreme = 0.0
    for i in range(3, 6):
        if s[L.LAST_DIFFERENCE + i] == 0.0 and abs(s[L.IMU + i]) > CLIPPED_FORCE:
            extreme = max(extreme, abs(s[L.IMU + i]))
    s[L.CLIPPED] = s[L.CLIPPED] + 1.0 if extreme > 0.0 else 0.0
    if s[L.CLIPPED] >= CLIPPED_AFTER:
        begin_fault(s, out, NoteCode.IMU_CLIPPING, s[L.T] - s[L.CLIPPED] * s[L.PERIOD], extreme, 0.0, 0.0)
    else:
        calm_fault(s, out, NoteCode.IMU_CLIPPING)
    level = math.sqrt(0.5 * s[L.DIFFERENCE_ACCEL])
    if level > VIBRATION and s[L.PERIOD] < L.SLOW:
        begin_fault(s, out, NoteCode.IMU_VIBRATION, s[L.T], level, 0.0, 0.0)
    else:
        calm_fault(s, out, NoteCode.IMU_VIBRATION)
