"""The innovations of a session that are judged: all of them, or, where they are many, stretches in a row evenly spread over it."""

import numpy as np
from numpy.typing import NDArray

from mavkf.navigation import layout as L
from mavkf.replay.innovations import Innovations, kinds, of_one
from mavkf.samples import Source

Array = NDArray[np.float64]
# Rows in a stretch, and how many at most: beyond 10,000 rows BLAS would start threads for each sum.
EACH, STRETCHES = 500, 20
SPEED = L.INNOVATION_WIDTH  # m/s: a column behind those of an innovation row
MOST_WAITING = 4096  # innovations that wait for the next pose


def sensor_of(kind: float) -> int:
    """The value of the Sensor of a number that `kinds` gives."""
    return int(kind) // len(Source)


class Kept:
    """The stretches of one sensor and source, and what all its innovations sum up to."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.count = 0
        self.refused = 0
        self.nis = 0.0
        """Sum over the fused, for each degree of freedom."""
        self._every = 1  # of so many stretches one is kept
        self._stretches: dict[int, list[Array]] = {}  # by number

    @property
    def rows(self) -> Array:
        """What is kept (n, INNOVATION_WIDTH + 1), speed included."""
        return np.concatenate([part for parts in self._stretches.values() for part in parts])

    def take(self, rows: Array) -> None:
        """Take rows (n, INNOVATION_WIDTH + 1) that follow those before."""
        fused = rows[rows[:, L.I_FUSED] > 0.0]
        self.nis += float(np.sum(fused[:, L.I_NIS] / fused[:, L.I_SIZE]))
        self.refused += len(rows) - len(fused)
        i = 0
        while i < len(rows):
            number, inside = divmod(self.count, EACH)
            some = rows[i : i + EACH - inside]
            i += len(some)
            self.count += len(some)
            if number % self._every == 0:
                self._stretches.setdefault(number, []).append(some.copy())
            if len(self._stretches) > STRETCHES:
                self._every *= 2
                self._stretches = {k: part for k, part in self._stretches.items() if k % self._every == 0}


class Stretches:
    """The innovations of a session, by sensor and source, each with the speed of the vehicle."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.kept: dict[float, Kept] = {}
        """By `kinds`."""
        self._waiting = np.empty((0, L.INNOVATION_WIDTH))
        self._speed = np.nan

    def take(self, innovations: Array, poses: Array) -> None:
        """Take innovation rows (n, INNOVATION_WIDTH) and the pose rows (m, POSE_WIDTH) made with them.

        The speed is that of the next pose.
        """
        waiting = np.concatenate([self._waiting, innovations])
        after = np.searchsorted(poses[:, L.R_TIME], waiting[:, L.I_TIME])
        ready = after < len(poses)
        if len(poses):
            self._add(waiting[ready], np.hypot(poses[after[ready], L.R_V], poses[after[ready], L.R_V + 1]))
            self._speed = float(np.hypot(poses[-1, L.R_V], poses[-1, L.R_V + 1]))
        self._waiting = waiting[~ready]
        if len(self._waiting) > MOST_WAITING:
            self.finish()

    def finish(self) -> None:
        """Take it that no pose follows."""
        self._add(self._waiting, np.full(len(self._waiting), self._speed))
        self._waiting = self._waiting[:0]

    def by_sensor(self, main: float) -> list[Innovations]:
        """What is kept, a sensor and source at a time. main: source of the main receiver."""
        found = []
        for _, kept in sorted(self.kept.items()):
            rows = kept.rows
            found.append(of_one(rows[:, :SPEED], rows[:, SPEED], main))
        return found

    def _add(self, rows: Array, speed: Array) -> None:
        kind = kinds(rows)
        order = np.argsort(kind, kind="stable")
        table = np.column_stack([rows, speed])[order]
        ends = np.flatnonzero(np.diff(kind[order], append=np.inf)) + 1
        first = 0
        for end in ends.tolist():
            self.kept.setdefault(float(kind[order[first]]), Kept()).take(table[first:end])
            first = end
