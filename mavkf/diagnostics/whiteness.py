"""Whiteness of innovations: a right filter has taken all that the past tells, so none of them can be foretold from those before.

Three views of one axis, normalised by its own standard deviations: autocorrelations with their band (Box and Jenkins, "Time Series
Analysis"), their sum by Ljung and Box ("On a Measure of Lack of Fit in Time Series Models", Biometrika 65, 1978), and the cumulative
periodogram (Bartlett 1955; Durbin, "Tests for Serial Correlation in Regression Analysis Based on the Periodogram of Least-Squares
Residuals", Biometrika 56, 1969), which sees slow drifts and periods that single lags do not. Lags count measurements, not seconds.
"""

import math
from statistics import NormalDist

import numpy as np

from mavkf.diagnostics import distributions
from mavkf.diagnostics.records import Finding

Array = np.ndarray
FEWEST = 20  # innovations below which the asymptotic distributions are not to be had


def autocorrelation(u: Array, lags: int) -> Array:
    """rho (lags,) at 1, 2, ... of a sequence u (n,), its mean taken off."""
    u = u - u.mean()
    power = float(u @ u)
    return np.array([u[k:] @ u[:-k] / power if power > 0.0 else 0.0 for k in range(1, lags + 1)])


def lags_for(count: int) -> int:
    """How many lags to look at: ten, fewer for short sequences (Box, Jenkins, Reinsel and Ljung advise no more than a quarter)."""
    return max(1, min(10, count // 4))


def _too_few(name: str, axis: str, count: int, probability: float, source: str) -> Finding:
    sentence = f"{count} innovations are too few to tell; {FEWEST} are needed."
    return Finding(name, axis, math.nan, math.nan, math.nan, probability, math.nan, "unknown", source, sentence)


def judge_autocorrelation(u: Array, probability: float, axis: str = "") -> Finding:
    """The largest autocorrelation of u (n,) against the band of them all; the sentence gives its lag."""
    name, source = (
        "autocorrelation",
        "normal of variance 1/n at each lag, all lags together; Box and Jenkins, Time Series Analysis",
    )
    n = len(u)
    if n < FEWEST:
        return _too_few(name, axis, n, probability, source)
    lags = lags_for(n)
    rho = autocorrelation(u, lags)
    # the exact variance of the estimate is a little below 1/n: Ljung and Box (1978)
    sigma = np.sqrt((n - np.arange(1, lags + 1)) / (n * (n + 2.0)))
    k = int(np.argmax(np.abs(rho) / sigma))
    each = -math.expm1(math.log1p(-probability) / lags)
    bound = float(NormalDist().inv_cdf(1.0 - 0.5 * each) * sigma[k])
    value = float(rho[k])
    alone = math.erfc(abs(value) / sigma[k] / math.sqrt(2.0))
    p_value = -math.expm1(lags * math.log1p(-min(alone, 1.0 - 1e-16)))
    if abs(value) <= bound:
        sentence = (
            f"Innovations are not correlated with those before (largest {value:.2f} at lag {k + 1}, band {bound:.2f})."
        )
    else:
        cause = (
            "the sensor's noise is coloured, its delay is wrong, or Q is too small"
            if value > 0.0
            else "Q is too large for R"
        )
        sentence = f"Innovations {k + 1} apart are correlated by {value:.2f} (band {bound:.2f}): {cause}."
    return Finding(
        name,
        axis,
        value,
        -bound,
        bound,
        probability,
        p_value,
        "fine" if abs(value) <= bound else "off",
        source,
        sentence,
    )


def judge_ljung_box(u: Array, probability: float, axis: str = "") -> Finding:
    """Ljung and Box's sum over the first lags of u (n,), against chi-square."""
    name, source = "Ljung-Box", "chi-square with as many degrees as lags; Ljung and Box (1978)"
    n = len(u)
    if n < FEWEST:
        return _too_few(name, axis, n, probability, source)
    lags = lags_for(n)
    rho = autocorrelation(u, lags)
    value = float(n * (n + 2.0) * np.sum(rho**2 / (n - np.arange(1, lags + 1))))
    high = distributions.chi_square_quantile(1.0 - probability, lags)
    white = value <= high
    meaning = (
        "The first lags together look white"
        if white
        else "The first lags together are not white: the past could have told more"
    )
    sentence = f"{meaning} (sum {value:.3g} over {lags} lags, bound {high:.3g})."
    p_value = distributions.chi_square_survival(value, lags)
    return Finding(name, axis, value, 0.0, high, probability, p_value, "fine" if white else "off", source, sentence)


def cumulative_periodogram(u: Array) -> Array:
    """The share (k,) of the power of u (n,) at and below each of its frequencies, zero and the highest left out; white: a straight line."""
    power = np.abs(np.fft.rfft(u - u.mean()))[1 : (len(u) + 1) // 2] ** 2
    total = float(power.sum())
    return np.asarray(np.cumsum(power) / total if total > 0.0 else np.arange(1, len(power) + 1) / len(power))


def judge_periodogram(u: Array, probability: float, axis: str = "") -> Finding:
    """How far the cumulative periodogram of u (n,) departs from white noise's, against Kolmogorov's distribution."""
    name, source = "cumulative periodogram", "Kolmogorov's distribution; Durbin (1969), Stephens (1970)"
    n = len(u)
    if n < FEWEST:
        return _too_few(name, axis, n, probability, source)
    share = cumulative_periodogram(u)
    count = len(share) - 1  # ordered points of a uniform distribution, the last share is 1
    line = np.arange(1, count + 1) / count
    above, below = share[:-1] - line + 1.0 / count, line - share[:-1]
    value = float(max(above.max(), below.max()))
    high = distributions.kolmogorov_bound(probability, count)
    if value <= high:
        meaning = "Power is spread evenly over all frequencies"
    else:
        slow = above.max() >= below.max()
        meaning = "There is too much power at " + (
            "low frequencies: slow errors are left" if slow else "high frequencies: the gain is too high"
        )
    sentence = f"{meaning} (departure {value:.2f}, bound {high:.2f})."
    p_value = distributions.kolmogorov_survival(value, count)
    return Finding(
        name, axis, value, 0.0, high, probability, p_value, "fine" if value <= high else "off", source, sentence
    )
