"""The last minute of a vehicle's innovations, for its status: bounded, cheap, the same however rows are cut into calls."""

import numpy as np
from numpy.typing import NDArray

from mavkf.estimate import Consistency
from mavkf.navigation import layout as L
from mavkf.replay.innovations import Innovations, kinds, of_one

Array = NDArray[np.float64]
WINDOW = 60.0  # s
NEWEST = 256  # rows of one sensor and source
WAITING = 4096  # rows between two reports
SPEED = L.INNOVATION_WIDTH  # m/s: a column behind those of an innovation row


class RecentInnovations:
    """What each sensor has shown of late. One of them is judged in each report, in turn; NIS is of all."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self._rows: dict[float, Array] = {}  # by sensor and source
        self._waiting: list[Array] = []
        self._count = 0
        self._sentences: dict[float, str | None] = {}
        self._turn = 0

    def take(self, rows: Array) -> None:
        """Note innovation rows (n, INNOVATION_WIDTH)."""
        if not len(rows):
            return
        self._waiting.append(rows)
        self._count += len(rows)
        if self._count > 2 * WAITING:
            self._waiting = [np.concatenate(self._waiting)[-WAITING:]]
            self._count = WAITING

    def report(self, now: float, speed: float, main: float, imu_rate_hz: float) -> dict[str, Consistency]:
        """By sensor. now: s; speed: horizontal, m/s, NaN: not known; main: source of the main receiver; imu_rate_hz: of the IMU in use."""
        self._add_waiting(speed)
        for kind, rows in list(self._rows.items()):
            old = int(np.count_nonzero(rows[:, L.I_TIME] < now - WINDOW))
            if old == len(rows):
                del self._rows[kind]
                self._sentences.pop(kind, None)
            elif old:
                self._rows[kind] = rows[old:]
        found = {kind: of_one(rows, rows[:, SPEED], main) for kind, rows in sorted(self._rows.items())}
        if found:
            self._turn = (self._turn + 1) % len(found)
            kind, judged = list(found.items())[self._turn]
            self._sentences[kind] = judged.sentence(judged.consequences(), imu_rate_hz)
        return {each.name: _consistency(each, self._sentences.get(kind)) for kind, each in found.items()}

    def _add_waiting(self, speed: float) -> None:
        """Put what has come since the last report, at this speed, to the rest, and keep the newest."""
        if not self._count:
            return
        new = np.full((min(self._count, WAITING), SPEED + 1), speed)
        new[:, :SPEED] = np.concatenate(self._waiting)[-WAITING:]
        self._waiting, self._count = [], 0
        kind = kinds(new)
        for each in np.unique(kind):
            mine = new[kind == each]
            before = self._rows.get(float(each), new[:0])
            self._rows[float(each)] = np.concatenate([before, mine])[-NEWEST:]


def _consistency(innovations: Innovations, sentence: str | None) -> Consistency:
    fused = innovations.fused
    count = int(np.count_nonzero(fused))
    # what was refused may have no NIS
    nis, size = innovations.rows[fused, L.I_NIS].sum(), innovations.rows[fused, L.I_SIZE].sum()
    return Consistency(
        count=count, refused=len(fused) - count, nis=float(nis / size) if count else None, sentence=sentence
    )
