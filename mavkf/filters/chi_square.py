"""Limits of the chi-square distribution for one, two and three degrees of freedom, without SciPy."""

import math
from statistics import NormalDist


def survival(x: float, degrees: int) -> float:
    """Probability that a chi-square variable of 1, 2 or 3 degrees of freedom is larger than x (closed forms)."""
    if degrees == 2:
        return math.exp(-0.5 * x)
    tail = math.erfc(math.sqrt(0.5 * x))
    return tail if degrees == 1 else tail + math.sqrt(2.0 * x / math.pi) * math.exp(-0.5 * x)


def limit(probability: float, degrees: int) -> float:
    """The x that a chi-square variable of 1, 2 or 3 degrees of freedom exceeds with this probability (0 to 1, exclusive)."""
    if degrees == 1:
        return NormalDist().inv_cdf(1.0 - 0.5 * probability) ** 2
    if degrees == 2:
        return -2.0 * math.log(probability)
    low, high = 0.0, 1e4
    while high - low > 1e-12 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if survival(middle, degrees) > probability else (low, middle)
    return 0.5 * (low + high)
