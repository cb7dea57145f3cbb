"""A few states evenly spread over a session, with what a judgement of the linearisation needs of their time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor

Array = NDArray[np.float64]
FEWEST = 8  # states, where a session is long enough; twice as many at most
SPAN = 2.0  # s of poses that one may be taken of
BASE = 1.0  # s that an acceleration is taken over: from one pose to the next it would be what a fix has corrected
JUDGED = (Sensor.GNSS_POSITION, Sensor.GNSS_VELOCITY, Sensor.MAGNETOMETER)
KNOWN = [L.R_LATITUDE, L.R_V, L.R_Q, L.R_RATE]


@dataclass(frozen=True)
class State:
    """A pose row (POSE_WIDTH,), the acceleration (3,), m/s^2 in n, and the newest innovation row of each judged sensor."""

    row: Array
    acceleration: Array
    innovations: dict[Sensor, Array]


class States:
    """Takes the state in the middle of a SPAN, and of those every second, fourth, ... where they become many."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.found: dict[int, State] = {}
        """By number of the span."""
        self._waiting: list[Array] = []
        self._newest: dict[Sensor, Array] = {}
        self._begin = np.nan  # s: of the first span
        self._number = 0  # of the span that is waited for
        self._every = 1

    def take(self, poses: Array, innovations: Array) -> None:
        """Take pose rows (m, POSE_WIDTH) and the innovation rows (n, INNOVATION_WIDTH) that came with them."""
        t = poses[:, L.R_TIME]
        if len(t) and np.isnan(self._begin):
            known = np.flatnonzero(_are_known(poses))
            self._begin = float(t[known[0]]) if len(known) else np.nan
        while len(t) and t[-1] >= self._start:
            first, last = np.searchsorted(t, (self._start, self._start + SPAN))
            some = poses[first:last]
            self._waiting.append(some[_are_known(some)])
            if last == len(t):
                break
            self._end_span(innovations)
            # where nothing came for a while, spans are passed over
            self._number = max(self._number + 1, int((t[last] - self._begin) / SPAN))
            self._number += -self._number % self._every
        for sensor in JUDGED:
            mine = innovations[innovations[:, L.I_SENSOR] == sensor.value]
            if len(mine):
                self._newest[sensor] = mine[-1].copy()

    def finish(self) -> None:
        """Take it that nothing follows."""
        self._end_span(np.empty((0, L.INNOVATION_WIDTH)))

    @property
    def _start(self) -> float:
        return self._begin + self._number * SPAN

    def _end_span(self, innovations: Array) -> None:
        """Take the state in the middle of what waited."""
        rows = np.concatenate([np.empty((0, L.POSE_WIDTH)), *self._waiting])
        self._waiting = []
        if not len(rows):
            return
        row = rows[len(rows) // 2].copy()
        t = row[L.R_TIME]
        ends = np.searchsorted(rows[:, L.R_TIME], (t - 0.5 * BASE, t + 0.5 * BASE))
        first, last = rows[np.clip(ends, 0, len(rows) - 1)][:, [L.R_TIME, L.R_V, L.R_V + 1, L.R_V + 2]]
        change = last - first
        newest = self._newest.copy()
        for sensor in JUDGED:
            mine = innovations[(innovations[:, L.I_SENSOR] == sensor.value) & (innovations[:, L.I_TIME] <= t)]
            if len(mine):
                newest[sensor] = mine[-1].copy()
        self.found[self._number] = State(row, change[1:] / change[0] if change[0] > 0.0 else np.zeros(3), newest)
        if len(self.found) > 2 * FEWEST:
            self._every *= 2
            self.found = {k: state for k, state in self.found.items() if k % self._every == 0}


def _are_known(poses: Array) -> NDArray[np.bool_]:
    return np.asarray(np.all(np.isfinite(poses[:, KNOWN]), axis=1))
