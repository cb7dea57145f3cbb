"""Whether P is still a covariance to the computer: its condition and its symmetry.

Both with each state in units of its own sigma, so that metres and radians do not matter. Digits that are lost are the logarithm of the
condition number (Golub and Van Loan, "Matrix Computations", 4th ed., section 2.6): a covariance form keeps half of the 16 up to a
condition of 1 / sqrt(eps), and none at 1 / eps; a root's condition is the square root of P's (Bierman 1977), so that root and UD forms
still have half of them there.
"""

import math

import numpy as np

from mavkf.diagnostics.records import Finding
from mavkf.errors import UsageError

Array = np.ndarray
EPSILON = float(np.finfo(float).eps)
HALF_THE_DIGITS = 1.0 / math.sqrt(EPSILON)
CONDITION_SOURCE = (
    "1 / sqrt(eps), where half of the digits are lost, and 1 / eps, where all are; Golub and Van Loan, section 2.6"
)
SYMMETRY_SOURCE = "sqrt(eps): half of the digits"


def _scaled(P: Array) -> Array:
    """P (n, n) as correlations; states known exactly are left out. Raises UsageError where P is not square."""
    if np.ndim(P) != 2 or P.shape[0] != P.shape[1]:
        raise UsageError(f"P has the shape {np.shape(P)}; it must be square.")
    there = np.diag(P) != 0.0
    P = P[np.ix_(there, there)]
    sigma = np.sqrt(np.abs(np.diag(P)))
    return np.asarray(P / np.outer(sigma, sigma))


def judge_condition(P: Array) -> Finding:
    """The condition number of the correlations of P (n, n); infinite where P is not positive definite."""
    scaled = _scaled(P)
    value = math.inf
    if np.isfinite(scaled).all():
        values = np.linalg.eigvalsh(0.5 * (scaled + scaled.T)) if scaled.size else np.ones(1)
        value = float(values.max() / values.min()) if values.min() > 0.0 else math.inf
    if value <= HALF_THE_DIGITS:
        verdict, sentence = "fine", f"P is well conditioned ({value:.1e})."
    elif value < 1.0 / EPSILON:
        verdict, sentence = "marginal", f"P is ill conditioned ({value:.1e}): a square-root or UD form is called for."
    else:
        verdict, sentence = (
            "broken",
            "P is not positive definite any more: use a square-root or UD form, and look for states that nothing measures.",
        )
    return Finding(
        "condition of P", "", value, 1.0, HALF_THE_DIGITS, math.nan, math.nan, verdict, CONDITION_SOURCE, sentence
    )


def judge_symmetry(P: Array) -> Finding:
    """The largest difference of P (n, n) from its transpose, in correlations."""
    scaled = _scaled(P)
    high = math.sqrt(EPSILON)
    value = float(np.max(np.abs(scaled - scaled.T), initial=0.0))
    fine = value <= high
    meaning = (
        "P is symmetric"
        if fine
        else "P is not symmetric any more: rounding has eaten half of its digits; use Joseph's or a root form"
    )
    verdict = "fine" if fine else "broken"
    return Finding(
        "symmetry of P", "", value, 0.0, high, math.nan, math.nan, verdict, SYMMETRY_SOURCE, f"{meaning} ({value:.1e})."
    )
