"""The last minute of a vehicle's innovations, for its status: bounded, cheap, the same however rows are cut into calls."""

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavkf.estimate import Consistency
from mavkf.navigation import layout as L
from mavkf.navigation.counting import renew
from mavkf.replay.innovations import kinds, of_one

Array = NDArray[np.float64]
WINDOW = 60.0  # s
NEWEST = 256  # rows of one sensor and source
WAITING = 4096  # rows between two reports
JUDGED_EVERY = 2  # reports, between one sensor and the next
SPEED = L.INNOVATION_WIDTH  # m/s: a column behind those of an innovation row


class RecentInnovations:
    """What each sensor has shown of late. One of them is judged in every second report, in turn; NIS is of all."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self._kept: dict[int, tuple[Array, NDArray[np.int64]]] = {}  # by sensor and source, as of `renew`
        self._waiting: list[Array] = []
        self._count = 0
        self._sentences: dict[int, str | None] = {}
        self._names: dict[tuple[int, float], str] = {}
        self._turn = 0
        self._nis = np.empty(NEWEST)

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
        """By sensor. now: s; speed: horizontal, m/s, NaN: not known; main: source of the main receiver; imu_rate_hz: of the IMU in use.

        What has come since the last report came at this speed.
        """
        new = np.concatenate([np.empty((0, SPEED)), *self._waiting])[-WAITING:]
        self._waiting, self._count = [], 0
        kind = kinds(new).astype(np.int64)
        for each in set(kind.tolist()) - self._kept.keys():
            self._kept[each] = np.empty((2 * NEWEST, SPEED + 1)), np.zeros(2, np.int64)
        found: dict[int, Consistency] = {}
        for each, (rows, span) in sorted(self._kept.items()):
            fused, size = renew(rows, span, new, kind, each, speed, now - WINDOW, self._nis)
            count = int(span[1] - span[0])
            if not count:
                del self._kept[each]
                self._sentences.pop(each, None)
                continue
            # what was refused may have no NIS
            nis = float(self._nis[:fused].sum() / size) if fused else None
            found[each] = Consistency(count=fused, refused=count - fused, nis=nis)
        return self._judged(found, main, imu_rate_hz)

    def _judged(self, found: dict[int, Consistency], main: float, imu_rate_hz: float) -> dict[str, Consistency]:
        """By name, each with the sentence of when it was judged last: the next of them now."""
        self._turn += 1
        if found and self._turn % JUDGED_EVERY == 0:
            each = list(found)[self._turn // JUDGED_EVERY % len(found)]
            rows, (first, last) = self._kept[each]
            judged = of_one(rows[first:last], rows[first:last, SPEED], main)
            self._sentences[each] = judged.sentence(judged.consequences(), imu_rate_hz)
        return {
            self._name(each, main): replace(one, sentence=sentence)
            if (sentence := self._sentences.get(each)) is not None
            else one
            for each, one in found.items()
        }

    def _name(self, kind: int, main: float) -> str:
        """What people call the sensor and source of a kind."""
        if (kind, main) not in self._names:
            rows = self._kept[kind][0][:1]
            self._names[kind, main] = of_one(rows, rows[:, SPEED], main).name
        return self._names[kind, main]
