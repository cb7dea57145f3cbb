"""Runge-Kutta over one interval: the classical one of order four with fixed steps, and Dormand and Prince's with steps of its own choice.

Hairer, Norsett and Wanner, "Solving Ordinary Differential Equations I", 2nd ed. (1993): section II.1 and tables II.1.2 and II.5.2, step
control section II.4.
"""

from collections.abc import Callable

import numpy as np

from mavkf.errors import UsageError

Array = np.ndarray
Rate = Callable[[float, Array], Array]

NODES = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0)
STAGES = (
    (),
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
# the difference of the solutions of order five and four
DIFFERENCE = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
SHORTEST = 1e-9  # of the interval: what needs shorter steps has no solution that could be followed


def fixed(rate: Rate, t: float, y: Array, dt: float, steps: int) -> Array:
    """y (k,) after dt, in equal steps of order four. rate(t, y) = dy/dt. Raises UsageError where steps is not positive."""
    if steps < 1:
        raise UsageError(f"The number of steps is {steps}; it must be 1 or more.")
    h = dt / steps
    for i in range(steps):
        start = t + i * h
        k1 = rate(start, y)
        k2 = rate(start + 0.5 * h, y + 0.5 * h * k1)
        k3 = rate(start + 0.5 * h, y + 0.5 * h * k2)
        k4 = rate(start + h, y + h * k3)
        y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return y


def adaptive(rate: Rate, t: float, y: Array, dt: float, scale: Array) -> tuple[Array, list[float]]:
    """y (k,) after dt, and the lengths of the steps taken: in each the estimated error stays below `scale` (k,), in every component.

    Raises UsageError where not even the shortest steps keep it so: a solution that grows without bound inside the interval.
    """
    end = t + dt
    taken: list[float] = []
    # the first step changes y by no more than a hundredth of itself
    size, speed = np.max(np.abs(y) / scale), np.max(np.abs(rate(t, y)) / scale)
    h = min(dt, max(0.01 * size / speed, 1e-3 * dt)) if speed > 0.0 else dt
    while t < end:
        h = min(h, end - t)
        stages: list[Array] = []
        with np.errstate(over="ignore", invalid="ignore"):  # a step that is too long is tried, and not taken
            for node, weights in zip(NODES, STAGES, strict=True):
                at = y
                for weight, k in zip(weights, stages, strict=True):
                    at = at + h * weight * k
                stages.append(rate(t + node * h, at))
            # the last stage's point is the solution of order five
            error = np.max(np.abs(h * sum(w * k for w, k in zip(DIFFERENCE, stages, strict=True))) / scale)
        if error <= 1.0:
            y = at
            taken.append(h)
            t = end if h >= end - t else t + h
        h *= float(np.clip(0.9 * error**-0.2, 0.2, 5.0)) if error > 0.0 else 0.2 if np.isnan(error) else 5.0
        if h < SHORTEST * dt and t < end:
            raise UsageError(f"The model cannot be integrated past {t:g} s: shorten dt, or look at its rates there.")
    return y, taken
