"""How often messages come."""

import math
from collections import Counter, deque
from collections.abc import Mapping

WINDOW_S = 3.0


class Rates:
    """How often messages came in the last WINDOW_S. Times are seconds of a clock that runs evenly."""

    def __init__(self) -> None:
        self._buckets: deque[tuple[float, Counter[str]]] = deque()

    def add(self, t: float, counts: Mapping[str, int]) -> None:
        """Count messages heard at a time."""
        if not self._buckets or t - self._buckets[-1][0] > WINDOW_S / 10:
            self._buckets.append((t, Counter()))
        self._buckets[-1][1].update(counts)

    def count(self, t: float, names: tuple[str, ...]) -> int:
        """How many of the most frequent of some messages."""
        self._forget(t)
        return max((sum(counts[name] for _, counts in self._buckets) for name in names), default=0)

    def span(self, t: float) -> float:
        """The seconds that are looked at."""
        self._forget(t)
        return max(t - self._buckets[0][0], 0.5) if self._buckets else WINDOW_S

    def _forget(self, t: float) -> None:
        while self._buckets and self._buckets[0][0] < t - WINDOW_S:
            self._buckets.popleft()

    def rate(self, t: float, names: tuple[str, ...]) -> float:
        """Hz of the most frequent of some messages."""
        return self.count(t, names) / self.span(t)

    def reaches(self, t: float, names: tuple[str, ...], rate_hz: float) -> bool:
        """Whether that is a rate; of slow messages one in the window is enough."""
        return self.count(t, names) >= max(1, math.ceil(rate_hz * self.span(t)))
