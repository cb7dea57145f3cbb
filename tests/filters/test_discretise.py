"""Van Loan's map, and the matrix exponential under it, against closed forms and the integral as it is defined."""

import math

import numpy as np
import pytest
from sympy import Matrix

from mavkf.errors import UsageError
from mavkf.filters.discretise import exponential, van_loan

from . import _naive as naive


def test_exponential_of_known_matrices() -> None:
    np.testing.assert_array_equal(exponential(np.zeros((3, 3))), np.eye(3))
    np.testing.assert_allclose(exponential(np.array([[0.0, 7.0], [0.0, 0.0]])), [[1.0, 7.0], [0.0, 1.0]], rtol=1e-15)
    for angle in (0.3, 30.0, 3000.0):
        turn = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
        np.testing.assert_allclose(
            exponential(np.array([[0.0, -angle], [angle, 0.0]])), turn, atol=1e-15 * (10.0 + angle)
        )
    np.testing.assert_allclose(
        exponential(np.diag([1.0, -50.0, 20.0])), np.diag(np.exp([1.0, -50.0, 20.0])), rtol=1e-13
    )
    exact = np.array(Matrix([[1, 2], [3, 4]]).exp().evalf(25), dtype=float)
    np.testing.assert_allclose(exponential(np.array([[1.0, 2.0], [3.0, 4.0]])), exact, rtol=1e-14)
    with pytest.raises(UsageError, match="finite"):
        exponential(np.array([[np.nan]]))


def test_white_acceleration() -> None:
    for dt in (0.0, 1e-3, 1.0, 100.0):
        Phi, Qd = van_loan(np.array([[0.0, 1.0], [0.0, 0.0]]), np.diag([0.0, 2.0]), dt)
        np.testing.assert_allclose(Phi, [[1.0, dt], [0.0, 1.0]], rtol=1e-13)
        np.testing.assert_allclose(Qd, 2.0 * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]]), rtol=1e-13)


@pytest.mark.parametrize("beta", [1e-6, 1.0, 1e3, 1e6])
def test_gauss_markov_also_over_many_time_constants(beta: float) -> None:
    """Where exp(-F dt) would overflow the doubling does not."""
    Phi, Qd = van_loan(np.array([[-beta]]), np.array([[3.0]]), 2.0)
    assert Phi[0, 0] == pytest.approx(math.exp(-2.0 * beta), rel=1e-9, abs=1e-300)
    assert Qd[0, 0] == pytest.approx(-3.0 * math.expm1(-4.0 * beta) / (2.0 * beta), rel=1e-9)


def test_is_the_integral() -> None:
    """Qd = integral of Phi(s) Qc Phi(s)' ds, by Gauss and Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    for seed in range(10):
        random = np.random.default_rng(seed)
        n, dt = 1 + seed % 4, float(random.uniform(0.1, 2.0))
        F, Qc = random.normal(size=(n, n)), naive.positive(random, n)
        Phi, Qd = van_loan(F, Qc, dt)
        np.testing.assert_allclose(Phi, exponential(F * dt), rtol=1e-12, atol=1e-12 * np.abs(Phi).max())
        expected = np.zeros((n, n))
        for node, weight in zip(nodes, weights, strict=True):
            part = exponential(F * dt * 0.5 * (1.0 + node))
            expected += 0.5 * dt * weight * part @ Qc @ part.T
        np.testing.assert_allclose(Qd, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())
        np.testing.assert_array_equal(Qd, Qd.T)


def test_time_does_not_go_back() -> None:
    with pytest.raises(UsageError, match="must not be negative"):
        van_loan(np.eye(1), np.eye(1), -1.0)
