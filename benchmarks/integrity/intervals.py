"""The confidence interval of a share that was counted."""

import math
from collections.abc import Callable


def clopper_pearson(hits: int, count: int, confidence: float = 0.95) -> tuple[float, float]:
    """The exact interval (Clopper and Pearson, 1934) of a probability of which `count` trials had `hits`."""
    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if hits == 0 else _root(lambda p: 1.0 - _at_most(hits - 1, count, p) - tail)
    high = 1.0 if hits == count else _root(lambda p: tail - _at_most(hits, count, p))
    return low, high


def _at_most(hits: int, count: int, p: float) -> float:
    """The probability of at most `hits` in `count` trials, each with the probability p, 0 < p < 1."""
    log_p, log_q, whole = math.log(p), math.log1p(-p), math.lgamma(count + 1)
    terms = (
        whole - math.lgamma(k + 1) - math.lgamma(count - k + 1) + k * log_p + (count - k) * log_q
        for k in range(hits + 1)
    )
    return min(1.0, math.fsum(math.exp(term) for term in terms))


def _root(rising: Callable[[float], float]) -> float:
    """Where a function that rises from below zero at 0 to above it at 1 is zero, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(60):
        half = 0.5 * (low + high)
        if rising(half) < 0.0:
            low = half
        else:
            high = half
    return 0.5 * (low + high)
