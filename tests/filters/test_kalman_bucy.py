"""The filter of continuous observations: its Riccati equation, and that the discrete filter tends to it."""

import numpy as np
import pytest

from mavkf.errors import UsageError
from mavkf.filters import kalman, kalman_bucy
from mavkf.filters.discretise import van_loan

Array = np.ndarray
F = np.array([[0.0, 1.0], [-1.0, -0.4]])
H = np.array([[1.0, 0.0]])
QC, RC = np.diag([0.0, 0.5]), np.array([[0.1]])
B, U = np.array([[0.0], [1.0]]), np.array([0.3])
X, P = np.array([1.0, 0.0]), np.diag([0.5, 0.8])
END = 2.0


def z(t: float) -> Array:
    return np.array([np.cos(1.3 * t)])


def continuous(count: int) -> tuple[Array, Array]:
    """By steps of the Kalman-Bucy filter, z at the middle of each."""
    x, cov, dt = X, P, END / count
    for i in range(count):
        x, cov = kalman_bucy.step(x, cov, F, H, QC, RC, z((i + 0.5) * dt), dt, B=B, u=U)
    return x, cov


def discrete(count: int) -> tuple[Array, Array]:
    """The discrete filter with Phi and Qd of each dt, R = Rc / dt, z at the end of each."""
    dt = END / count
    augmented = np.zeros((3, 3))
    augmented[:2, :2], augmented[:2, 2:] = F, B
    Phi_B, _ = van_loan(augmented, np.zeros((3, 3)), dt)
    Phi, Qd = van_loan(F, QC, dt)
    x, cov = X.copy(), P.copy()
    for i in range(count):
        kalman.predict(x, cov, Phi, np.ascontiguousarray(Phi_B[:2, 2:]), U, Qd)
        kalman.correct(x, cov, H, RC / dt, z((i + 1) * dt), np.empty(1))
    return x, cov


def test_is_the_limit_of_the_discrete_filter() -> None:
    """The difference shrinks with dt, at order one, in state and covariance."""
    x, cov = continuous(2000)
    counts = np.array([50, 100, 200, 400])
    errors = []
    for count in counts:
        x_discrete, cov_discrete = discrete(count)
        errors.append([np.abs(x_discrete - x).max(), np.abs(cov_discrete - cov).max()])
    for column in np.log(errors).T:
        assert 0.9 < -np.polyfit(np.log(counts), column, 1)[0] < 1.1
    assert np.max(errors[-1]) < 0.01


def test_riccati_equation() -> None:
    """The closed solution against Runge-Kutta, the rate against its difference quotient, and a scalar solution by hand."""
    _, cov = continuous(400)
    np.testing.assert_allclose(kalman_bucy.covariance(P, F, H, QC, RC, END), cov, rtol=1e-9)
    e = 1e-5
    ends = [kalman_bucy.covariance(P, F, H, QC, RC, dt) for dt in (e, 2.0 * e)]
    quotient = (-3.0 * P + 4.0 * ends[0] - ends[1]) / (2.0 * e)
    np.testing.assert_allclose(quotient, kalman_bucy.riccati(P, F, H, QC, RC), rtol=1e-6, atol=1e-6)
    # dp/dt = q - p^2 / r from 0: sqrt(q r) tanh(sqrt(q / r) t)
    one = np.eye(1)
    after = kalman_bucy.covariance(0.0 * one, 0.0 * one, one, 2.0 * one, 0.5 * one, 0.7)
    assert after[0, 0] == pytest.approx(np.tanh(2.0 * 0.7), rel=1e-12)
    np.testing.assert_allclose(kalman_bucy.gain(P, H, RC), [[5.0], [0.0]])


def test_what_is_not_observed_is_predicted() -> None:
    x, cov = kalman_bucy.step(X, P, F, H, QC, RC, np.array([np.nan]), 0.5, steps=50)
    Phi, Qd = van_loan(F, QC, 0.5)
    np.testing.assert_allclose(x, Phi @ X, rtol=1e-8)
    np.testing.assert_allclose(cov, Phi @ P @ Phi.T + Qd, rtol=1e-8)


def test_bad_arguments_are_said() -> None:
    with pytest.raises(UsageError, match="Rc must be positive definite"):
        kalman_bucy.step(X, P, F, H, QC, 0.0 * RC, np.zeros(1), 0.1)
    with pytest.raises(UsageError, match="needs its matrix B"):
        kalman_bucy.step(X, P, F, H, QC, RC, np.zeros(1), 0.1, u=U)
