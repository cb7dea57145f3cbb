"""What the links received, on its way to the one worker: stamped once, in one order, bounded."""

import time
from collections import deque
from collections.abc import Callable
from threading import Condition
from typing import NamedTuple

CAPACITY = 16 << 20
"""Bytes that may wait: more than ten seconds of the fastest serial link."""
OVERHEAD = 256  # bytes that a waiting chunk costs beside its own
BATCH = 256
REPORT_US = 1_000_000


class Chunk(NamedTuple):
    """What one link received at once.

    link: its number. arrival_us: microseconds UTC. last: nothing continues it.
    """

    link: int
    arrival_us: int
    data: bytes
    last: bool


class Inbox:
    """A bounded queue of chunks from several threads to one.

    Stamps never decrease, and chunks of different links never share one: a recording of each link holds the whole order.
    """

    def __init__(self, say: Callable[[str], None], now_us: Callable[[], int] = lambda: time.time_ns() // 1000) -> None:
        """say: told when chunks had to be dropped; now_us: the clock, microseconds UTC."""
        self.dropped = 0
        self.lag_us = 0
        """How much had arrived after what was given last, by stamps."""
        self._say, self._now_us = say, now_us
        self._chunks: deque[Chunk] = deque()
        self._size = 0
        self._stamp, self._link = 0, -1
        self._told_us, self._told = 0, 0
        self._is_closed = False
        self._changed = Condition()

    def put(self, link: int, data: bytes, last: bool, *, patient: bool = False) -> None:
        """Stamp a chunk and queue it; where there is no room it is dropped, counted, and that is said.

        patient: rather wait for room, for a source that can be held up.
        """
        with self._changed:
            if patient:
                self._changed.wait_for(lambda: self._is_closed or self._has_room(data))
            # the stamp and the place in the queue are taken together, so that their orders agree
            self._stamp = max(self._now_us(), self._stamp + (link != self._link))
            self._link = link
            if not self._has_room(data):
                self.dropped += 1
                self._complain()
                return
            self._size += len(data) + OVERHEAD
            self._chunks.append(Chunk(link, self._stamp, data, last))
            self._changed.notify_all()

    def get(self, timeout_s: float) -> list[Chunk]:
        """Give the chunks that wait (at most BATCH), in order; none if none came in time."""
        with self._changed:
            if not self._chunks:
                self._changed.wait(timeout_s)
            batch = [self._chunks.popleft() for _ in range(min(BATCH, len(self._chunks)))]
            self._size -= sum(len(chunk.data) + OVERHEAD for chunk in batch)
            self.lag_us = self._stamp - batch[0].arrival_us if batch else 0
            self._changed.notify_all()
            return batch

    def close(self) -> None:
        """Let go of who waits for room."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    @property
    def size(self) -> int:
        """Bytes that wait."""
        return self._size

    def _has_room(self, data: bytes) -> bool:
        return self._size + len(data) + OVERHEAD <= CAPACITY

    def _complain(self) -> None:
        if self._stamp - self._told_us >= REPORT_US:
            self._say(f"too slow for the link: {self.dropped - self._told} chunks of telemetry were dropped")
            self._told_us, self._told = self._stamp, self.dropped
