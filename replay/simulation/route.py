"""What a simulated vehicle is told to do: speed, course rate, climb and yaw rate as chains of smooth steps.

A step is the septic 35x^4 - 84x^5 + 70x^6 - 20x^7 between two levels: three derivatives vanish at both ends, so a
rate is C3 and its integral C4. All steps begin and end on multiples of 0.1 s.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TICK = 0.1  # s
CHANNELS = ("speed", "course_rate", "climb", "yaw_rate")


def ticks(seconds: float) -> float:
    """Round a time to whole ticks, never below zero."""
    return max(0, round(seconds / TICK)) * TICK


@dataclass
class Route:
    """A flight, or a part of one, that is being written; what is added begins where the last thing ended.

    time:   its duration so far, s.
    steps:  of each channel: start (s), width (s), change (m/s or rad/s).
    """

    time: float = 0.0
    steps: dict[str, list[tuple[float, float, float]]] = field(default_factory=lambda: {name: [] for name in CHANNELS})

    def wait(self, seconds: float) -> None:
        """Keep all rates for a while."""
        self.time += ticks(seconds)

    def change(self, width: float, **changes: float) -> None:
        """Change rates smoothly and together, within `width` seconds."""
        width = max(ticks(width), TICK)
        for name, change in changes.items():
            self.steps[name].append((self.time, width, change))
        self.time += width

    def pulse(self, width: float, hold: float, **integrals: float) -> None:
        """Raise rates, hold them, and take them back; `integrals` is what they add up to (m or rad)."""
        width, hold = max(ticks(width), TICK), ticks(hold)
        rates = {name: integral / (hold + width) for name, integral in integrals.items()}
        self.change(width, **rates)
        self.wait(hold)
        self.change(width, **{name: -rate for name, rate in rates.items()})

    def append(self, part: "Route") -> None:
        """Add a part at the end."""
        for name, steps in part.steps.items():
            self.steps[name].extend((self.time + start, width, change) for start, width, change in steps)
        self.time += part.time


class Channel:
    """One rate as a function of time: an initial value of 0 and the steps (start, width, change), which do not overlap."""

    def __init__(self, steps: list[tuple[float, float, float]]) -> None:
        table = np.array([(0.0, TICK, 0.0), *steps])
        self._start, self._width, self._change = table.T
        self._base = np.concatenate([[0.0], np.cumsum(self._change[:-1])])
        length = np.diff(self._start)
        if len(length) > 1 and np.any(length[1:] < self._width[1:-1] - 1e-9):
            raise ValueError("steps of a channel overlap")
        area = self._base[:-1] * length + self._change[:-1] * (length - 0.5 * self._width[:-1])
        self._area = np.concatenate([[0.0], np.cumsum(area)])

    def at(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Give the integral from 0, the value and the derivative at times t (n), s; each (n)."""
        k = np.maximum(np.searchsorted(self._start, t, side="right") - 1, 0)
        width, change, since = self._width[k], self._change[k], t - self._start[k]
        x = np.clip(since / width, 0.0, 1.0)
        step = x**4 * (35.0 + x * (-84.0 + x * (70.0 - 20.0 * x)))
        slope = 140.0 * (x * (1.0 - x)) ** 3
        step_area = x**5 * (7.0 + x * (-14.0 + x * (10.0 - 2.5 * x))) * width + np.maximum(since - width, 0.0)
        integral = self._area[k] + self._base[k] * since + change * step_area
        return integral, self._base[k] + change * step, change * slope / width
