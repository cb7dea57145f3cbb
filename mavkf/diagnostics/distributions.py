"""Probabilities of the test statistics: chi-square, Student's t, F, the binomial's and Kolmogorov's, to ten digits and without SciPy.

Series and continued fractions of the incomplete gamma and beta functions: NIST Digital Library of Mathematical Functions, sections 8.7,
8.9 and 8.17. Kolmogorov's with the correction for finite samples of Stephens, "Use of the Kolmogorov-Smirnov, Cramer-von Mises and
Related Statistics Without Extensive Tables", J. Royal Statistical Society B 32 (1970).
"""

import math
from collections.abc import Callable
from functools import lru_cache

TINY = 1e-300
DIGITS = 1e-15
REMEMBERED = 256  # bounds: all axes of a sensor ask for the same


def _lower_gamma(a: float, x: float) -> float:
    """Regularised lower incomplete gamma function P(a, x)."""
    if x <= 0.0:
        return 0.0
    factor = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1.0:
        term = total = 1.0 / a
        k = a
        while term > DIGITS * total:
            k += 1.0
            term *= x / k
            total += term
        return factor * total
    return 1.0 - _upper_gamma(a, x)


def _upper_gamma(a: float, x: float) -> float:
    """1 - P(a, x), without cancellation in the tail; x beyond a + 1 by its continued fraction (Lentz)."""
    if x < a + 1.0:
        return 1.0 - _lower_gamma(a, x)
    b = x + 1.0 - a
    c, d = 1.0 / TINY, 1.0 / b
    fraction, change, k = d, 0.0, 0
    while abs(change - 1.0) > DIGITS:
        k += 1
        numerator = k * (a - k)
        b += 2.0
        d = 1.0 / (numerator * d + b or TINY)
        c = b + numerator / c or TINY
        change = c * d
        fraction *= change
    return math.exp(a * math.log(x) - x - math.lgamma(a)) * fraction


def _beta(a: float, b: float, x: float, y: float) -> float:
    """Regularised incomplete beta function I_x(a, b); y is 1 - x, given because the difference would lose digits."""
    if x <= 0.0 or y <= 0.0:
        return 0.0 if x <= 0.0 else 1.0
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - _beta(b, a, y, x)
    log_factor = a * math.log(x) + b * math.log(y) - math.log(a) - math.lgamma(a) - math.lgamma(b) + math.lgamma(a + b)
    c, d = 1.0, 1.0 / (1.0 - (a + b) * x / (a + 1.0) or TINY)
    fraction, change, m = d, 0.0, 0
    while abs(change - 1.0) > DIGITS * 10.0:
        m += 1
        for numerator in (
            m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0)),
        ):
            d = 1.0 / (1.0 + numerator * d or TINY)
            c = 1.0 + numerator / c or TINY
            change = c * d
            fraction *= change
    return math.exp(log_factor) * fraction


def _quantile(cdf: Callable[[float], float], probability: float) -> float:
    """The x at which a distribution function of positive numbers reaches a probability, by the Illinois form of false position.

    Dowell and Jarratt, "A Modified Regula Falsi Method for Computing the Root of an Equation", BIT 11 (1971).
    """
    low, high, at_low, at_high = 0.0, 1.0, -probability, cdf(1.0) - probability
    while at_high < 0.0:
        low, high, at_low = high, 2.0 * high, at_high
        at_high = cdf(high) - probability
    kept = 0  # the end that stayed the last time: -1 low, 1 high
    while high - low > 1e-12 * high:
        # where both ends agree to the last digit only halving gets on
        x = high - at_high * (high - low) / (at_high - at_low) if at_high > at_low else 0.5 * (low + high)
        x = min(max(x, low + 1e-13 * high), high - 1e-13 * high)
        at_x = cdf(x) - probability
        if at_x < 0.0:
            low, at_low = x, at_x
            at_high *= 0.5 if kept == 1 else 1.0
            kept = 1
        else:
            high, at_high = x, at_x
            at_low *= 0.5 if kept == -1 else 1.0
            kept = -1
    return 0.5 * (low + high)


def chi_square(x: float, degrees: float) -> float:
    """Probability that a chi-square variable of any positive degrees of freedom is at most x."""
    return _lower_gamma(0.5 * degrees, 0.5 * x)


def chi_square_survival(x: float, degrees: float) -> float:
    """Probability that it is larger than x."""
    return _upper_gamma(0.5 * degrees, 0.5 * x)


@lru_cache(REMEMBERED)
def chi_square_quantile(probability: float, degrees: float) -> float:
    """The x that it does not exceed with this probability."""
    return _quantile(lambda x: chi_square(x, degrees), probability)


def student_two_sided(t: float, degrees: float) -> float:
    """Probability that a variable of Student's distribution is farther from zero than t."""
    total = degrees + t * t
    return _beta(0.5 * degrees, 0.5, degrees / total, t * t / total)


@lru_cache(REMEMBERED)
def student_bound(probability: float, degrees: float) -> float:
    """The t that it is farther from zero than with this probability."""
    return _quantile(lambda t: 1.0 - student_two_sided(t, degrees), 1.0 - probability)


def f_survival(x: float, numerator: float, denominator: float) -> float:
    """Probability that a ratio of variances, of these degrees of freedom, is larger than x."""
    total = denominator + numerator * x
    return _beta(0.5 * denominator, 0.5 * numerator, denominator / total, numerator * x / total)


@lru_cache(REMEMBERED)
def f_bound(probability: float, numerator: float, denominator: float) -> float:
    """The x that it exceeds with this probability."""
    return _quantile(lambda x: 1.0 - f_survival(x, numerator, denominator), 1.0 - probability)


def binomial_survival(count: int, trials: int, probability: float) -> float:
    """Probability of `count` or more successes in independent trials."""
    if count <= 0 or count > trials:
        return float(count <= 0)
    return _beta(count, trials - count + 1.0, probability, 1.0 - probability)


def binomial_bound(probability: float, trials: int, success: float) -> int:
    """The smallest count that is exceeded with no more than this probability."""
    low, high = -1, trials
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if binomial_survival(middle + 1, trials, success) > probability else (low, middle)
    return high


def kolmogorov_survival(distance: float, count: int) -> float:
    """Probability that a sample of `count` departs from its distribution function by more than this distance anywhere."""
    root = math.sqrt(count)
    x = distance * (root + 0.12 + 0.11 / root)
    if x < 0.3:
        return 1.0  # to nine digits
    total = sum((-1.0) ** (k - 1) * math.exp(-2.0 * k * k * x * x) for k in range(1, 30))
    return min(1.0, max(0.0, 2.0 * total))


@lru_cache(REMEMBERED)
def kolmogorov_bound(probability: float, count: int) -> float:
    """The distance that is exceeded with this probability."""
    return _quantile(lambda distance: 1.0 - kolmogorov_survival(distance, count), 1.0 - probability)
