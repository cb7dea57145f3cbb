"""Moments by Runge-Kutta: order four, the tolerance kept, exact against Van Loan where the model is linear."""

import numpy as np
import pytest

from mavkf.errors import UsageError
from mavkf.filters import runge_kutta
from mavkf.filters.continuous import moments, transition
from mavkf.filters.discretise import van_loan
from mavkf.filters.forms import noise_factor
from mavkf.models.textbook import falling_body, van_der_pol

from . import _naive as naive

Array = np.ndarray
X, P = np.array([1.5, -0.3]), np.array([[0.2, 0.05], [0.05, 0.1]])
QC = van_der_pol.Qc(X)


def f(x: Array, t: float) -> Array:
    """The oscillator under a force of known course: the time matters."""
    return van_der_pol.f(x, np.sin(2.0 * t))


def jacobian(x: Array, t: float) -> Array:
    return van_der_pol.F(x, None)


def hessian(x: Array, t: float) -> Array:
    return van_der_pol.F_xx(x, None)


def flat(result: tuple[Array, ...]) -> Array:
    return np.concatenate([part.ravel() for part in result])


@pytest.mark.parametrize("second", [False, True])
@pytest.mark.parametrize("function", [moments, transition])
def test_order_four(function, second: bool) -> None:
    """Halving the step takes the error down by 2^4: the slope over three halvings lies between 3.8 and 4.2."""
    options = {"F_xx": hessian if second else None, "t": 0.4}

    def run(steps: int) -> Array:
        if function is moments:
            return flat(moments(f, jacobian, QC, X, P, 1.0, steps=steps, **options))
        return flat(transition(f, jacobian, QC, X, 1.0, P=P, steps=steps, **options))

    reference = run(512)
    steps = np.array([8, 16, 32, 64])
    errors = [np.abs(run(count) - reference).max() for count in steps]
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 3.8 < slope < 4.2


def test_moments_and_transition_are_the_same_prediction() -> None:
    for second in (None, hessian):
        x, P_after = moments(f, jacobian, QC, X, P, 0.5, F_xx=second, steps=64)
        x_too, Phi, Qd = transition(f, jacobian, QC, X, 0.5, P=P, F_xx=second, steps=64)
        np.testing.assert_allclose(x, x_too, rtol=1e-9)
        np.testing.assert_allclose(P_after, Phi @ P @ Phi.T + Qd, rtol=1e-8)


def test_linear_models_are_van_loans() -> None:
    for seed in range(5):
        random = np.random.default_rng(seed)
        A, Qc, x = random.normal(size=(3, 3)), naive.positive(random, 3), random.normal(size=3)
        Phi, Qd = van_loan(A, Qc, 0.7)
        mean, Phi_rk, Qd_rk = transition(lambda x, t, A=A: A @ x, lambda x, t, A=A: A, Qc, x, 0.7, steps=200)
        np.testing.assert_allclose(mean, Phi @ x, rtol=1e-8)
        np.testing.assert_allclose(Phi_rk, Phi, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(Qd_rk, Qd, rtol=1e-8, atol=1e-8 * Qd.max())


def test_noise_stays_a_covariance_however_coarse_the_steps() -> None:
    """White noise through four integrators: a short polynomial is not positive, the sum of squares is; and it is near."""
    A, Qc = np.eye(4, k=1), np.diag([0.0, 0.0, 0.0, 2.0])
    for steps in (1, 2, 8):
        _, _, Qd = transition(lambda x, t: A @ x, lambda x, t: A, Qc, np.zeros(4), 3.0, steps=steps)
        G, q = noise_factor(Qd)
        sigma = np.sqrt(np.diag(Qd))
        np.testing.assert_allclose((G * q) @ G.T, Qd, atol=1e-9 * sigma.max() ** 2)
    exact = van_loan(A, Qc, 3.0)[1]
    np.testing.assert_allclose(Qd / np.outer(sigma, sigma), exact / np.outer(sigma, sigma), atol=1e-3)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_the_tolerance_is_kept(tolerance: float) -> None:
    """In parts of sigma, over a fall from space into the air: some tens of steps may each add their part."""

    def fall(x: Array, t: float) -> Array:
        return falling_body.f(x, None)

    def slope(x: Array, t: float) -> Array:
        return falling_body.F(x, None)

    start = falling_body.TRUTH, falling_body.P0 * 0.01
    Qc = np.zeros((3, 3))
    sigma = np.sqrt(np.diag(start[1]))
    reference, P_reference = moments(fall, slope, Qc, *start, 15.0, steps=4000)
    x, P_after = moments(fall, slope, Qc, *start, 15.0, tolerance=tolerance)
    assert np.max(np.abs(x - reference) / sigma) < 100.0 * tolerance
    assert np.max(np.abs(P_after - P_reference) / np.outer(sigma, sigma)) < 1000.0 * tolerance
    # of what is left of sigma at the end, which has grown a hundredfold in altitude
    sigma = np.sqrt(np.diag(P_reference))
    x_too, Phi, Qd = transition(fall, slope, Qc, start[0], 15.0, P=start[1], tolerance=tolerance)
    assert np.max(np.abs(x_too - reference) / sigma) < 100.0 * tolerance
    assert np.max(np.abs(Phi @ start[1] @ Phi.T + Qd - P_reference) / np.outer(sigma, sigma)) < 1000.0 * tolerance


def test_steps_are_spent_where_they_are_needed() -> None:
    def counted(scale: float) -> tuple[float, int]:
        y, steps = runge_kutta.adaptive(lambda t, y: -50.0 * (y - np.cos(t)), 0.0, np.zeros(1), 2.0, np.array([scale]))
        assert sum(steps) == pytest.approx(2.0)
        return float(y[0]), len(steps)

    (coarse, few), (fine, many) = counted(1e-4), counted(1e-10)
    assert few < many
    # y = (2500 cos t + 50 sin t) / 2501 after the transient
    exact = (2500.0 * np.cos(2.0) + 50.0 * np.sin(2.0)) / 2501.0
    assert coarse == pytest.approx(exact, abs=1e-3)
    assert fine == pytest.approx(exact, abs=1e-9)


def test_a_step_across_a_sudden_change_is_taken_back() -> None:
    """Nothing happens for a second, and the steps grow; then something does."""
    y, steps = runge_kutta.adaptive(
        lambda t, y: np.array([np.sin(20.0 * t) if t > 1.0 else 0.0]), 0.0, np.ones(1), 2.0, np.full(1, 1e-8)
    )
    assert y[0] == pytest.approx(1.0 + (np.cos(20.0) - np.cos(40.0)) / 20.0, abs=1e-6)
    assert max(steps) > 20.0 * min(steps)


def test_what_cannot_be_integrated_is_said() -> None:
    with pytest.raises(UsageError, match="cannot be integrated past 1 s"):
        runge_kutta.adaptive(lambda t, y: y * y, 0.0, np.ones(1), 2.0, np.full(1, 1e-6))  # 1 / (1 - t)
    for function in (moments, transition):
        with pytest.raises(UsageError, match="steps is 0"):
            function(f, jacobian, QC, X, P=P, dt=1.0, steps=0)
    with pytest.raises(UsageError, match="must be positive"):
        moments(f, jacobian, QC, X, P, 1.0, tolerance=0.0)
    with pytest.raises(UsageError, match="must not be negative"):
        moments(f, jacobian, QC, X, P, -1.0)
    with pytest.raises(UsageError, match="need the covariance"):
        transition(f, jacobian, QC, X, 1.0, tolerance=1e-6)
    np.testing.assert_array_equal(moments(f, jacobian, QC, X, P, 0.0, tolerance=1e-6)[0], X)
