"""Whether innovations are Gaussian: skewness and kurtosis together, by D'Agostino's and Pearson's K^2.

D'Agostino, Belanger and D'Agostino, "A Suggestion for Using Powerful and Informative Tests of Normality", The American Statistician 44
(1990); the transform of the kurtosis is that of Anscombe and Glynn (Biometrika 70, 1983). A Kalman filter is the best estimator only
where noise is Gaussian; heavy tails call for a gate or a robust weight, not for another R.
"""

import math

import numpy as np

from mavkf.diagnostics import distributions
from mavkf.diagnostics.records import Finding

Array = np.ndarray
FEWEST = 20
SOURCE = "chi-square with 2 degrees of K^2; D'Agostino, Belanger and D'Agostino (1990)"


def skewness_and_kurtosis(u: Array) -> tuple[float, float]:
    """Third and fourth moments of u (n,), about its mean and by its standard deviation: 0 and 3 of a Gaussian."""
    d = u - u.mean()
    squares = d * d
    variance = float(np.mean(squares))
    if variance == 0.0:
        return 0.0, 3.0
    return float(np.mean(squares * d)) / variance**1.5, float(np.mean(squares * squares)) / variance**2


def standard_scores(u: Array) -> tuple[float, float]:
    """Skewness and kurtosis of u (n,) as normal variables of mean 0 and variance 1, for n of 20 and more."""
    n = float(len(u))
    skewness, kurtosis = skewness_and_kurtosis(u)
    y = skewness * math.sqrt((n + 1.0) * (n + 3.0) / (6.0 * (n - 2.0)))
    beta = 3.0 * (n * n + 27.0 * n - 70.0) * (n + 1.0) * (n + 3.0) / ((n - 2.0) * (n + 5.0) * (n + 7.0) * (n + 9.0))
    w2 = math.sqrt(2.0 * (beta - 1.0)) - 1.0
    skew_score = math.asinh(y / math.sqrt(2.0 / (w2 - 1.0))) / math.sqrt(0.5 * math.log(w2))
    mean = 3.0 * (n - 1.0) / (n + 1.0)
    variance = 24.0 * n * (n - 2.0) * (n - 3.0) / ((n + 1.0) ** 2 * (n + 3.0) * (n + 5.0))
    third = (
        6.0
        * (n * n - 5.0 * n + 2.0)
        / ((n + 7.0) * (n + 9.0))
        * math.sqrt(6.0 * (n + 3.0) * (n + 5.0) / (n * (n - 2.0) * (n - 3.0)))
    )
    a = 6.0 + 8.0 / third * (2.0 / third + math.sqrt(1.0 + 4.0 / third**2))
    ratio = (1.0 - 2.0 / a) / (1.0 + (kurtosis - mean) / math.sqrt(variance) * math.sqrt(2.0 / (a - 4.0)))
    tail_score = (1.0 - 2.0 / (9.0 * a) - math.copysign(abs(ratio) ** (1.0 / 3.0), ratio)) / math.sqrt(2.0 / (9.0 * a))
    return skew_score, tail_score


def judge(u: Array, probability: float, axis: str = "") -> Finding:
    """K^2 of normalised innovations u (n,) of one axis."""
    if len(u) < FEWEST:
        sentence = f"{len(u)} innovations are too few to tell; {FEWEST} are needed."
        return Finding("normality", axis, math.nan, 0.0, math.nan, probability, math.nan, "unknown", SOURCE, sentence)
    skew_score, tail_score = standard_scores(u)
    value = skew_score**2 + tail_score**2
    high = distributions.chi_square_quantile(1.0 - probability, 2)
    skewness, kurtosis = skewness_and_kurtosis(u)
    if value <= high:
        meaning = "Innovations look Gaussian"
    elif abs(tail_score) >= abs(skew_score):
        meaning = (
            "Innovations have heavy tails: outliers, or noise that changes"
            if tail_score > 0.0
            else "Innovations have no tails"
        )
    else:
        meaning = "Innovations lean to one side"
    sentence = f"{meaning} (skewness {skewness:.2f}, kurtosis {kurtosis:.2f}; 0 and 3 would be)."
    p_value = distributions.chi_square_survival(value, 2)
    return Finding(
        "normality", axis, value, 0.0, high, probability, p_value, "fine" if value <= high else "off", SOURCE, sentence
    )
