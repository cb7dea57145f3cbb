"""The boot clock of one vehicle: rows in order of arrival get their TIME and SESSION.

Only boot stamps decide anything, and each row is judged by the rows before it alone, so it does not matter in what
pieces the rows come. What a boot stamp may be, relative to the newest one of the session:

    near                          from a window before it to a minute after it: the row is taken
    far before, five in a row     the vehicle has rebooted: a new session begins with those five
    far after, five in a row      a gap of the recording: the session goes on
    far, fewer than five          late, or a bad stamp: dropped and counted
    before, by less than a window late, and taken; but where the stamps go on from there for a whole window, as dense as
                                  before, and none continues the old clock, it was a reboot: the session changes then

A far stamp is held back until the five have come or a near one has.
"""

from dataclasses import dataclass
from math import floor, isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import kernel, long_kernel
from mavkf.samples import CLOCK, KIND, ROW_WIDTH, SESSION, STAMP, TIME, UNIX_US, Clock, Kind

MS_WRAP_US = 2.0**32 * 1e3
"""A 32-bit count of milliseconds wraps after this, microseconds."""
UNROLL_US = 3600e6
"""Farther than this from the newest boot time a small count of milliseconds is a reboot, not a wrap."""
JUMP_US = 60e6
GAP_US = 1e6
LEAST_FALL_US = 1e5
"""Streams of one vehicle are this much out of step without any reboot."""
CONFIRMATIONS = 5
HELD_ROWS = 64
HISTORY = 4096

BOOT_US, BOOT_MS, UNIX = int(Clock.BOOT_US), int(Clock.BOOT_MS), int(Clock.UNIX_US)
SYSTEM_TIME = int(Kind.SYSTEM_TIME)

# Indices of the state (float64); times in microseconds of the boot clock.
(
    NEWEST,  # of the session
    BEFORE,  # of the timed row before
    NUMBER,  # of the session
    OFFSET,  # UNIX less boot time
    HELD,  # rows held back,
    HELD_TIMED,  # of them with a boot stamp,
    HELD_NEWEST,  # and the newest of those
    FALL_TOP,  # NEWEST when the clock fell by less than a window (NaN: it has not)
    FALL_START,  # first stamp after that fall
    FALL_NEWEST,  # newest stamp since that fall
    FALL_ROWS,  # rows since that fall, up to FALL_TOP
    FALL_BEFORE,  # rows from FALL_START to FALL_TOP before that fall
    WINDOW,
    WRITTEN,  # rows in the output
    ROWS,  # from here on: as in ClockCounts
    REBOOTS,
    LATE,
    BAD_STAMPS,
    UNTIMED,
    GAPS,
    LONGEST_GAP,
    TAKEN,  # boot stamps taken in the session,
    STAMPS,  # and from here on the last of them, in a ring
) = range(23)


@dataclass(frozen=True)
class ClockCounts:
    """What a vehicle's clock has met.

    rows:           rows that got a time.
    reboots:        falls of the boot clock that began a session.
    late:           rows dropped because they were older than the window.
    bad_stamps:     rows dropped because their time was far ahead and nothing confirmed it.
    untimed:        rows dropped because no boot time was known yet, or too many came while a stamp was in doubt.
    gaps:           times that the boot clock stepped by more than 1 s.
    longest_gap_s:  the largest of these steps, seconds.
    """

    rows: int
    reboots: int
    late: int
    bad_stamps: int
    untimed: int
    gaps: int
    longest_gap_s: float


@kernel
def boot_time(row: Any, newest: float) -> float:
    """Boot time of a row, microseconds, wraps of 32-bit milliseconds undone; NaN if its stamp is of no boot clock."""
    if row[CLOCK] == BOOT_US:
        return row[STAMP]  # type: ignore[no-any-return]
    if row[CLOCK] != BOOT_MS:
        return np.nan
    if isnan(newest):
        return row[STAMP]  # type: ignore[no-any-return]
    # not np.round, which takes half of numba's modules to load
    wraps = floor((newest - row[STAMP]) / MS_WRAP_US + 0.5)
    unrolled = row[STAMP] + max(wraps, 0) * MS_WRAP_US
    return unrolled if abs(unrolled - newest) <= UNROLL_US else row[STAMP]  # type: ignore[no-any-return]


@kernel
def emit(row: Any, time_us: float, state: Any, out: Any) -> None:
    """Append a row to `out`."""
    n = int(state[WRITTEN])
    for j in range(ROW_WIDTH):  # compiles ten times faster than an assignment of arrays
        out[n, j] = row[j]
    out[n, TIME] = time_us * 1e-6
    out[n, SESSION] = state[NUMBER]
    state[ROWS] += 1
    state[WRITTEN] += 1


@kernel
def take_untimed(row: Any, state: Any, out: Any) -> None:
    """Take a row without a boot stamp: it has the time of the timed row before, or its UNIX time mapped."""
    time_us = state[BEFORE]
    if isnan(time_us):
        state[UNTIMED] += 1
        return
    if row[CLOCK] == UNIX and not isnan(state[OFFSET]):
        time_us = row[STAMP] - state[OFFSET]
        if time_us < state[NEWEST] - state[WINDOW]:
            state[LATE] += 1
            return
        if time_us > state[NEWEST] + state[WINDOW]:
            state[BAD_STAMPS] += 1
            return
    emit(row, time_us, state, out)


@kernel
def begin_session(boot_us: float, state: Any) -> None:
    """Start the clock of a session at its first boot time."""
    state[NEWEST] = boot_us
    state[OFFSET] = np.nan
    state[FALL_TOP] = np.nan
    state[TAKEN] = 0


@kernel
def begin_fall(boot_us: float, state: Any) -> None:
    """Note that the clock fell by less than a window, and how dense its rows were there before."""
    state[FALL_TOP] = state[NEWEST]
    state[FALL_START] = state[FALL_NEWEST] = boot_us
    state[FALL_ROWS] = 1
    rows = 0
    for i in range(min(int(state[TAKEN]), HISTORY)):
        if boot_us <= state[STAMPS + i] <= state[NEWEST]:
            rows += 1
    state[FALL_BEFORE] = rows


@kernel
def is_small_reboot(boot_us: float, state: Any) -> bool:
    """Follow a fall by less than a window; True at the row that shows that it was a reboot."""
    depth = state[FALL_TOP] - state[FALL_START]
    if boot_us > state[FALL_NEWEST] + 0.5 * depth:
        state[FALL_TOP] = np.nan  # the old clock goes on: it was lateness
        return False
    state[FALL_NEWEST] = max(state[FALL_NEWEST], boot_us)
    if boot_us <= state[FALL_TOP]:
        state[FALL_ROWS] += 1
    if state[FALL_NEWEST] - state[FALL_START] < state[WINDOW]:
        return False
    # Late rows are few among those before, or fill the hole that they had left there.
    rows, before = state[FALL_ROWS], state[FALL_BEFORE]
    state[FALL_TOP] = np.nan
    return bool(rows >= 0.5 * before and before >= 0.5 * rows)


@kernel
def take_timed(row: Any, boot_us: float, state: Any, out: Any) -> None:
    """Take a row whose boot time belongs to the session."""
    if not isnan(state[FALL_TOP]) and is_small_reboot(boot_us, state):
        state[NUMBER] += 1
        state[REBOOTS] += 1
        begin_session(boot_us, state)
    if isnan(state[FALL_TOP]) and boot_us < state[NEWEST] - LEAST_FALL_US:
        begin_fall(boot_us, state)
    if boot_us > state[NEWEST]:
        gap = boot_us - state[NEWEST]
        if gap > GAP_US:
            state[GAPS] += 1
            state[LONGEST_GAP] = max(state[LONGEST_GAP], gap * 1e-6)
        state[NEWEST] = boot_us
    state[BEFORE] = boot_us
    state[STAMPS + int(state[TAKEN]) % HISTORY] = boot_us
    state[TAKEN] += 1
    if row[KIND] == SYSTEM_TIME and not isnan(row[UNIX_US]):
        state[OFFSET] = row[UNIX_US] - boot_us
    emit(row, boot_us, state, out)


@kernel
def release(state: Any, held: Any, out: Any) -> None:
    """Take the rows held back, or, if nothing confirmed their stamps, only those among them without a stamp."""
    rows = int(state[HELD])
    confirmed = state[HELD_TIMED] == CONFIRMATIONS
    state[HELD] = state[HELD_TIMED] = 0
    if confirmed and held[0, TIME] < state[NEWEST]:
        state[NUMBER] += 1
        state[REBOOTS] += 1
        begin_session(held[0, TIME], state)
    for i in range(rows):
        boot_us = held[i, TIME]
        if isnan(boot_us):
            take_untimed(held[i], state, out)
        elif confirmed:
            take_timed(held[i], boot_us, state, out)
        else:
            state[LATE if boot_us < state[NEWEST] else BAD_STAMPS] += 1


@long_kernel
def advance(rows: Any, state: Any, held: Any, out: Any) -> None:
    """Judge rows one by one; write those that are decided to `out` (at least rows + held)."""
    state[WRITTEN] = 0
    for i in range(rows.shape[0]):
        row = rows[i]
        boot_us = boot_time(row, state[NEWEST])
        if isnan(boot_us):
            if state[HELD] == 0:
                take_untimed(row, state, out)
                continue
            if state[HELD] >= HELD_ROWS - CONFIRMATIONS:
                state[UNTIMED] += 1
                continue
        elif isnan(state[NEWEST]):
            begin_session(boot_us, state)
            take_timed(row, boot_us, state, out)
            continue
        elif state[NEWEST] - state[WINDOW] <= boot_us <= state[NEWEST] + JUMP_US:
            if state[HELD] > 0:
                release(state, held, out)
            take_timed(row, boot_us, state, out)
            continue
        else:
            group = state[HELD_NEWEST]
            if state[HELD] > 0 and not (group - state[WINDOW] <= boot_us <= group + JUMP_US):
                release(state, held, out)
            state[HELD_NEWEST] = boot_us if state[HELD] == 0 else max(group, boot_us)
            state[HELD_TIMED] += 1
        k = int(state[HELD])
        for j in range(ROW_WIDTH):
            held[k, j] = row[j]
        held[k, TIME] = boot_us
        state[HELD] += 1
        if state[HELD_TIMED] == CONFIRMATIONS:
            release(state, held, out)


class VehicleClock:
    """Gives the rows of one vehicle, a (system, component), their TIME and SESSION."""

    def __init__(self, window_s: float = 3.0) -> None:
        """Start before the first row; window_s: how late a row may be, seconds."""
        self._state = np.zeros(STAMPS + HISTORY)
        self._state[[NEWEST, BEFORE, OFFSET, FALL_TOP]] = np.nan
        self._state[WINDOW] = window_s * 1e6
        self._held = np.zeros((HELD_ROWS, ROW_WIDTH))

    @property
    def counts(self) -> ClockCounts:
        """Everything since the start."""
        rows, reboots, late, bad_stamps, untimed, gaps = map(int, self._state[ROWS:LONGEST_GAP])
        return ClockCounts(rows, reboots, late, bad_stamps, untimed, gaps, float(self._state[LONGEST_GAP]))

    def push(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take rows (n, ROW_WIDTH) in order of arrival; return those decided by now, in order of arrival."""
        out = np.empty((len(rows) + int(self._state[HELD]), ROW_WIDTH))
        advance(np.ascontiguousarray(rows), self._state, self._held, out)
        return out[: int(self._state[WRITTEN])]

    def flush(self) -> NDArray[np.float64]:
        """Decide about the rows held back, because nothing follows; return those of them that are taken."""
        out = np.empty((int(self._state[HELD]), ROW_WIDTH))
        self._state[WRITTEN] = 0
        release(self._state, self._held, out)
        return out[: int(self._state[WRITTEN])]
