"""NIS and NEES: whether innovations, and errors where the truth is known, are as large as the filter says.

    nis = r' S^-1 r        nees = (x - truth)' P^-1 (x - truth)

Both are chi-square variables of as many degrees of freedom as they have components, and those of a right filter's innovations are
independent, so that their sum is chi-square too: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation"
(2001), section 5.4.
"""

import math

import numpy as np

from mavkf.diagnostics import distributions
from mavkf.diagnostics.records import Finding
from mavkf.errors import UsageError

Array = np.ndarray
REGION = 0.95
SOURCE = "chi-square of the sum; Bar-Shalom, Li and Kirubarajan (2001), section 5.4"


def squared(errors: Array, covariances: Array) -> tuple[Array, Array]:
    """Normalised squares (n,) of errors (n, m) of covariances (n, m, m), and the components (n,) each is of.

    Components that are NaN are left out. Raises UsageError where the shapes do not fit, or a covariance is singular.
    """
    n, m = errors.shape if np.ndim(errors) == 2 else (-1, -1)
    if np.shape(covariances) != (n, m, m):
        raise UsageError(
            f"Errors {np.shape(errors)} and covariances {np.shape(covariances)} must be (n, m) and (n, m, m)."
        )
    there = ~np.isnan(errors)
    values = np.zeros(n)
    patterns = there @ (1 << np.arange(m))
    for pattern in np.unique(patterns):  # few: all components, or this one missing or that
        rows, kept = np.flatnonzero(patterns == pattern), np.flatnonzero(pattern >> np.arange(m) & 1)
        e = errors[np.ix_(rows, kept)]
        try:
            weighted = np.linalg.solve(covariances[np.ix_(rows, kept, kept)], e[..., None])[..., 0]
        except np.linalg.LinAlgError:
            raise UsageError("A covariance is singular: there is nothing to compare an error with.") from None
        values[rows] = np.sum(e * weighted, axis=1)
    return values, there.sum(axis=1)


def bounds(degrees: int, probability: float) -> tuple[float, float]:
    """What the mean of a chi-square's components lies between, but for this probability, half of it on each side; `degrees` in all."""
    low, high = (distributions.chi_square_quantile(p, degrees) for p in (0.5 * probability, 1.0 - 0.5 * probability))
    return low / degrees, high / degrees


def expected_in_gate(components: int, gate: float) -> float:
    """Mean NIS of a component of what passes a gate that a right measurement fails with probability `gate`: a little below 1."""
    if not gate > 0.0:
        return 1.0
    limit = distributions.chi_square_quantile(1.0 - gate, components)
    return distributions.chi_square(limit, components + 2) / (1.0 - gate)


def judge(values: Array, components: Array, probability: float, *, gate: float = 0.0, name: str = "NIS") -> Finding:
    """Whether the mean of NIS or NEES (n,), by component, is 1. components (n,) of each; gate: as of `expected_in_gate`."""
    degrees = int(np.sum(components))
    if degrees == 0:
        return Finding(
            name, "", math.nan, math.nan, math.nan, probability, math.nan, "unknown", SOURCE, "Nothing to judge."
        )
    counts = np.bincount(components)
    expected = sum(k * counts[k] * expected_in_gate(k, gate) for k in range(1, len(counts)) if counts[k]) / degrees
    value = float(np.sum(values)) / degrees
    low, high = (expected * bound for bound in bounds(degrees, probability))
    total = value / expected * degrees
    p_value = 2.0 * min(distributions.chi_square(total, degrees), distributions.chi_square_survival(total, degrees))
    size = f"Its square is {value:.3g} times what the filter says (right: {low:.3g} to {high:.3g})"
    what = "The error" if name == "NEES" else "The innovation"
    if value > high:
        meaning = f"{what} is larger than claimed: the filter trusts itself or this sensor too much (Q or R too small, or a fault)."
    elif value < low:
        meaning = (
            f"{what} is smaller than claimed: the filter trusts itself or this sensor too little (Q or R too large)."
        )
    else:
        meaning = f"{what} is as large as claimed."
    verdict = "fine" if low <= value <= high else "off"
    return Finding(name, "", value, low, high, probability, min(1.0, p_value), verdict, SOURCE, f"{meaning} {size}.")


def judge_share(
    values: Array, components: Array, probability: float, *, gate: float = 0.0, name: str = "NIS"
) -> Finding:
    """Whether 95 % of NIS or NEES (n,) lie inside their regions of 95 %; arguments as of `judge`. A few large ones do not make it off."""
    name, source = f"coverage of {name}", "binomial of independent measurements"
    values, components = values[components > 0], components[components > 0]
    n = len(values)
    if n == 0:
        return Finding(
            name, "", math.nan, math.nan, math.nan, probability, math.nan, "unknown", source, "Nothing to judge."
        )
    limits = {int(k): distributions.chi_square_quantile(REGION, k) for k in np.unique(components)}
    outside = int(np.sum(values > np.array([limits[int(k)] for k in components])))
    # what the gate took away lay outside
    chance = max(1.0 - REGION - gate, 0.0) / (1.0 - gate)
    most = distributions.binomial_bound(0.5 * probability, n, chance)
    fewest = n - distributions.binomial_bound(0.5 * probability, n, 1.0 - chance)
    above = distributions.binomial_survival(outside, n, chance)
    below = distributions.binomial_survival(n - outside, n, 1.0 - chance)
    value, low, high = (1.0 - count / n for count in (outside, most, fewest))
    if outside > most:
        meaning = "Too many lie outside the region of 95 %: outliers, or covariances that are too small"
    elif outside < fewest:
        meaning = "Too few lie outside the region of 95 %: covariances are too large"
    else:
        meaning = "As many lie inside the region of 95 % as should"
    sentence = f"{meaning} ({100.0 * value:.3g} % inside; right: {100.0 * low:.3g} to {100.0 * high:.3g} %)."
    verdict = "fine" if fewest <= outside <= most else "off"
    return Finding(
        name, "", value, low, high, probability, min(1.0, 2.0 * min(above, below)), verdict, source, sentence
    )
