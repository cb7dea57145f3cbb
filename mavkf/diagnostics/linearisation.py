"""Whether the first order is enough: the second-order terms that an extended filter neglects, against S and P.

For a Gaussian error the neglected terms have the mean m and covariance L of `filters.orders`. The innovation (or predicted error) is then
not N(0, S) but N(m, S + L), to second order, and the share of it that falls outside the region that S gives for 95 % is more than 5 %.
That share is the number here. It is the tail of a quadratic form of Gaussian variables, taken by the chi-square variable of the same first
two moments: Patnaik, "The Non-Central Chi-Square and F Distributions and Their Applications", Biometrika 36 (1949).
"""

import math

import numpy as np

from mavkf.diagnostics import distributions
from mavkf.diagnostics.records import Finding
from mavkf.errors import UsageError
from mavkf.filters.orders import second_order_covariance, second_order_mean

Array = np.ndarray
NOMINAL = 0.05  # outside the region of 95 %, were the model linear
FINE, MARGINAL = 0.06, 0.10  # outside: one in a hundred more than claimed; twice as many as claimed
SOURCE = "share outside the region of 95 %: 5 % if linear, fine to 6 %, marginal to 10 %; Patnaik (1949)"


def outside(hessians: Array, P: Array, S: Array) -> float:
    """The share outside the region that S gives for 95 %, with the second-order terms. It is 0.05 where they vanish, and never less.

    hessians: (k, n, n) of h or f at the estimate; P: (n, n) there; S: (k, k), the innovation's covariance, or of the predicted state.
    """
    values, vectors = np.linalg.eigh(S)
    if not values.min() > 0.0:
        raise UsageError("The covariance that second-order terms are compared with must be positive definite.")
    whitener = vectors / np.sqrt(values)
    m = second_order_mean(hessians, P) @ whitener
    C = np.eye(len(S)) + whitener.T @ second_order_covariance(hessians, P) @ whitener
    mean = float(np.trace(C) + m @ m)
    variance = float(2.0 * np.sum(C * C) + 4.0 * m @ C @ m)
    limit = distributions.chi_square_quantile(1.0 - NOMINAL, len(S))
    return distributions.chi_square_survival(limit * 2.0 * mean / variance, 2.0 * mean**2 / variance)


def judge(shares: Array, what: str = "measurement") -> Finding:
    """One finding of the shares (n,) of `outside`, over a run; what: the measurement or the prediction."""
    name = f"linearisation of the {what}"
    if len(shares) == 0:
        return Finding(name, "", math.nan, NOMINAL, FINE, math.nan, math.nan, "unknown", SOURCE, "Nothing to judge.")
    value = float(np.mean(shares))
    numbers = f"{100.0 * value:.2g} % instead of 5 % lie outside the region of 95 %"
    if value <= FINE:
        verdict, meaning = "fine", "The first order is enough"
    elif value <= MARGINAL:
        verdict, meaning = "marginal", "The first order is just enough: covariances are a little too small"
    else:
        verdict, meaning = (
            "broken",
            "The first order is not enough: use the iterated or second-order update, or a better start",
        )
    return Finding(name, "", value, NOMINAL, FINE, math.nan, math.nan, verdict, SOURCE, f"{meaning} ({numbers}).")
