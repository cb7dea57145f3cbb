"""Why there are square roots: two ill-conditioned problems on which the standard form loses positive definiteness.

- vague prior: Bierman, "Factorization Methods for Discrete Sequential Estimation" (1977): two states of variance 1 / delta^2, measured by
  x1 + delta x2 and then by x1 + x2, with unit noise. 1 + delta^2 is 1 to the computer, 1 + delta is not.
- parallel measurements: Grewal and Andrews, "Kalman Filtering: Theory and Practice" (chapter on implementation methods), after Dyer and
  McReynolds (1969): three states of unit variance, two measurements of their sum with noise delta, different by delta in one coefficient.

The reference is exact, in fractions.
"""

from fractions import Fraction
from types import ModuleType

import numpy as np
import pytest

from mavkf.filters.forms import FORMS, apply

Array = np.ndarray
EPSILON = float(np.finfo(float).eps)
DELTAS = [1e-3, 1e-6, 1e-8, 1e-9, 1e-10]
ROOTS = ("potter", "carlson", "square-root", "ud", "square-root-information", "extended-array")


def vague_prior(delta: float) -> tuple[Array, Array, float]:
    """P0, H and the variance of the noise of each measurement."""
    return np.eye(2) / delta**2, np.array([[1.0, delta], [1.0, 1.0]]), 1.0


def parallel(delta: float) -> tuple[Array, Array, float]:
    return np.eye(3), np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0 + delta]]), delta**2


each_problem = pytest.mark.parametrize("problem", [vague_prior, parallel])


def fractions(P: Array) -> list[list[Fraction]]:
    return [[Fraction(float(p)) for p in row] for row in P]


def exact(problem, delta: float) -> Array:
    """P after both measurements, rounded once at the end."""
    P0, H, R = problem(delta)
    P, n = fractions(P0), len(P0)
    for h in fractions(H):
        Ph = [sum(P[i][j] * h[j] for j in range(n)) for i in range(n)]
        s = sum(h[i] * Ph[i] for i in range(n)) + Fraction(R)
        P = [[P[i][j] - Ph[i] * Ph[j] / s for j in range(n)] for i in range(n)]
    return np.array([[float(p) for p in row] for row in P])


def corrected(form: ModuleType, problem, delta: float) -> tuple[Array, Array]:
    """P after both measurements, one after the other, and the form's own array."""
    P0, H, R = problem(delta)
    A = form.from_covariance(P0)
    for i in range(2):
        apply(form, A, H[i : i + 1], np.array([[R]]), np.zeros(1))
    return np.asarray(form.to_covariance(A)), A


def error(P: Array, problem, delta: float) -> float:
    """Largest error of P, of the standard deviations that there should be."""
    P0 = exact(problem, delta)
    sigma = np.sqrt(np.diag(P0))
    return float(np.max(np.abs(P - P0) / np.outer(sigma, sigma)))


def is_positive_definite(P: Array) -> bool:
    """Of the numbers as they stand, without rounding: pivots of the elimination in fractions."""
    rows = fractions(0.5 * (P + P.T))
    for k in range(len(rows)):
        if rows[k][k] <= 0:
            return False
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return True


def root(name: str, A: Array) -> Array:
    """The root S of P = S S' that the form's array stands for, whichever it keeps."""
    n = len(A)
    if name == "ud":
        return np.asarray((np.triu(A, 1) + np.eye(n)) * np.sqrt(np.diag(A)))
    if name == "square-root-information":
        return np.asarray(np.linalg.inv(A[:, :n]))
    return np.asarray(A[:, :n].T if name == "extended-array" else A)


@each_problem
def test_the_standard_form_is_no_covariance_any_more(problem) -> None:
    P, _ = corrected(FORMS["covariance"], problem, 1e-9)
    assert not is_positive_definite(P)
    assert error(P, problem, 1e-9) > 0.1


def test_negative_variances() -> None:
    """Bierman's: at some delta, it depends on how sums are rounded, the standard form claims a variance of -1 or less."""
    deltas = [1e-8, 3e-9, 1e-9, 3e-10, 1e-10]
    lowest = [np.diag(corrected(FORMS["covariance"], vague_prior, delta)[0]).min() for delta in deltas]
    assert min(lowest) < -0.9
    for delta in deltas:
        np.testing.assert_allclose(np.diag(exact(vague_prior, delta)), [1.0, 2.0], rtol=1e-7)


@each_problem
@pytest.mark.parametrize("name", ROOTS)
@pytest.mark.parametrize("delta", DELTAS)
def test_roots_stay_covariances(problem, name: str, delta: float) -> None:
    """They lose digits in proportion to delta over rounding, no more; and the root's smallest singular value is above zero, and right."""
    P, A = corrected(FORMS[name], problem, delta)
    assert error(P, problem, delta) < 20.0 * EPSILON / delta
    S = root(name, A)
    if name == "ud":
        assert np.all(np.diag(A) > 0.0)
    singular = np.linalg.svd(S, compute_uv=False)
    P0, H, R = problem(delta)
    information = np.linalg.svd(np.vstack([np.linalg.inv(np.sqrt(P0)), H / np.sqrt(R)]), compute_uv=False)
    assert singular.min() == pytest.approx(1.0 / information.max(), rel=20.0 * EPSILON / delta)


@each_problem
def test_all_agree_where_it_is_easy(problem) -> None:
    for form in FORMS.values():
        P, _ = corrected(form, problem, 0.1)
        assert error(P, problem, 0.1) < 1e-10
        assert is_positive_definite(P)
