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
    """Takes one state of each SPAN, and of those every second, fourth, ... where they become many."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.found: dict[int, State] = {}
        """By number of the span."""
        self._waiting = np.empty((0, L.POSE_WIDTH))
        self._newest: dict[Sensor, Array] = {}
        self._number = 0
        self._every = 1

    def take(self, poses: Array, innovations: Array) -> None:
        """Take pose rows (m, POSE_WIDTH) and the innovation rows (n, INNOVATION_WIDTH) that came with them."""
        known = poses[np.all(np.isfinite(poses[:, KNOWN]), axis=1)]
        rows = np.concatenate([self._waiting, known]) if len(self._waiting) else known
        first = 0
        while len(rows) > first and rows[-1, L.R_TIME] - rows[first, L.R_TIME] >= SPAN:
            last = int(np.searchsorted(rows[:, L.R_TIME], rows[first, L.R_TIME] + SPAN)) + 1
            self._add(rows[first:last], innovations)
            first = last
        self._waiting = rows[first:].copy()
        for sensor in JUDGED:
            mine = innovations[innovations[:, L.I_SENSOR] == sensor.value]
            if len(mine):
                self._newest[sensor] = mine[-1].copy()

    def finish(self) -> None:
        """Take it that nothing follows."""
        if len(self._waiting):
            self._add(self._waiting, np.empty((0, L.INNOVATION_WIDTH)))

    def _add(self, rows: Array, innovations: Array) -> None:
        """Take the state in the middle of rows (n, POSE_WIDTH), if it is one of those that are kept."""
        number = self._number
        self._number += 1
        if number % self._every:
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
        self.found[number] = State(row, change[1:] / change[0] if change[0] > 0.0 else np.zeros(3), newest)
        if len(self.found) > 2 * FEWEST:
            self._every *= 2
            self.found = {k: state for k, state in self.found.items() if k % self._every == 0}
