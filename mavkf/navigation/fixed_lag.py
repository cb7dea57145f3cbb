"""Fixed-lag smoothing of a live session: poses of a few seconds ago, by what has come since.

A window of events slides along: behind it the state as the fold has left it, in it every event of the last seconds in the order in which it
was measured, late ones too. Each HOP the window is smoothed as a whole (`smoother`, which takes the flight for what is in the window), the
rows of its first HOP are given out, and the window moves on by that. What is older than the window when it comes is left out. It reads
boot times alone, so a live run and its repetition give the same.
"""

import numpy as np
from numpy.typing import NDArray

from mavkf.navigation import layout as L
from mavkf.navigation import smoothing
from mavkf.navigation.codes import SENSORS
from mavkf.navigation.hindsight import NOTHING_KNOWN
from mavkf.navigation.smoother import ROOM, smooth, without_delay
from mavkf.navigation.timeline import order
from mavkf.samples import KIND, SEQUENCE, SOURCE, TIME

Array = NDArray[np.float64]
HOP = 1.0  # s of poses that come at once
MOST = 200_000  # events that may wait: a minute at 3 kHz


class Window:
    """Events in the order of measurement, as `smoother.smooth` reads them."""

    def __init__(self, events: Array) -> None:
        """events: (n, EVENT_WIDTH)."""
        self._events = events

    def __len__(self) -> int:
        return len(self._events)

    def block(self, first: int, last: int) -> Array:
        """Events first..last (m, EVENT_WIDTH)."""
        return self._events[first:last]


class FixedLag:
    """Gives the pose rows of a session once all that came in `lag` seconds after them has been taken in."""

    def __init__(self, state: Array, c: Array, rate_hz: float, lag_s: float) -> None:
        """state: (STATE_SIZE,) before the first event; c: parameters; rate_hz: rows a second of boot time; lag_s: s."""
        self._state, self._rate, self._lag = state.copy(), rate_hz, lag_s
        self._c, _ = without_delay(self._state, c)
        self._events: list[Array] = []
        self._behind = -np.inf  # s: the state stands there
        self._slot = -1
        self.left_out = 0
        """Events that came after their time had been given out, or when too many waited."""

    def take(self, events: Array) -> None:
        """Take events (n, EVENT_WIDTH), in the order of arrival."""
        # a clock that stands still makes nothing due: what comes then must not be kept for ever
        room = MOST - sum(map(len, self._events))
        kept = events[events[:, TIME] > self._behind][: max(room, 0)]
        self.left_out += len(events) - len(kept)
        if len(kept):
            self._events.append(kept)

    def rows(self, now: float) -> Array:
        """Give the smoothed pose rows (n, POSE_WIDTH) that are due at boot time `now` (s), the newest that was heard."""
        events = np.concatenate([np.empty((0, L.EVENT_WIDTH)), *self._events])
        events = events[order(events[:, TIME], events[:, KIND], events[:, SOURCE], events[:, SEQUENCE])]
        if len(events) and not np.isfinite(self._behind):
            self._behind = float(np.floor(events[0, TIME]))
        found = [np.empty((0, L.POSE_WIDTH))]
        while len(events) and now >= self._behind + HOP + self._lag:
            found.append(self._hop(events))
            events = events[events[:, TIME] > self._behind]
        self._events = [events]
        return np.concatenate(found)

    def _hop(self, events: Array) -> Array:
        """Give the rows of the first HOP of sorted events, and go on by that."""
        ends = np.searchsorted(events[:, TIME], (self._behind + HOP, self._behind + HOP + self._lag), side="right")
        first, window = events[: ends[0]], events[: ends[1]]
        poses = np.empty((len(window), L.POSE_WIDTH))
        smoothed = smooth(self._state.copy(), Window(window), self._c, self._rate, NOTHING_KNOWN, _nobody, self._slot)
        for row, some in smoothed:
            poses[row : row + len(some)] = some
        # the state itself goes on without the smoother's hindsight
        held, faults, out = NOTHING_KNOWN.held, NOTHING_KNOWN.faults, L.buffers(ROOM, ROOM, SENSORS)
        self._slot, count = smoothing.fold_block(
            self._state, first, self._slot, 0, self._c, self._rate, held, faults, poses[:0], out
        )
        self._behind += HOP
        return poses[:count]


def _nobody(_: float) -> None:
    """Nobody watches."""
