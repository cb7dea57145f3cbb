"""The telemetry model: Phi against finite differences, Qd against Van Loan's, the mean against closed forms."""

import numpy as np
import pytest

from mavkf.models import telemetry
from mavkf.models.order import STATES_MOST, X_SIZE
from mavkf.models.rotation import quaternion_from_euler, rotation_matrix
from mavkf.models.strapdown import HEIGHT, LATITUDE, Q, V, local, rates_of_frame, retract
from mavkf.models.telemetry import FORCE, OMEGA, M, Y

Array = np.ndarray
PLACES = [telemetry.place(m) for m in range(M)]
# a step of finite differences for each state that moves: rad, m/s, m, rad/s, m/s^2
EPSILON = np.array([1e-3] * 3 + [1.0] * 3 + [10.0] * 3 + [1e-3] * 3 + [1e-2] * 3)
TAU = np.array([10.0, 4.0])


def random_state(random: np.random.Generator) -> Array:
    x = np.zeros(X_SIZE)
    quaternion_from_euler(*random.uniform(-1.2, 1.2, 3), x[Q : Q + 4])
    x[V : V + 3] = 15.0 * random.normal(size=3)
    x[LATITUDE], x[HEIGHT] = random.uniform(-1.2, 1.2), 300.0
    x[OMEGA : OMEGA + 3] = random.normal(size=3)
    x[FORCE : FORCE + 3] = [0.0, 0.0, -9.8] + 3.0 * random.normal(size=3)
    return x


def propagated(x: Array, dt: float, tau: Array = TAU, density: Array | None = None) -> tuple[Array, Array, Array]:
    y, Phi, Qd = x.copy(), np.empty((M, M)), np.empty((M, M))
    telemetry.propagate(y, dt, tau, np.zeros(M) if density is None else density, Phi, Qd)
    return y, Phi, Qd


@pytest.mark.parametrize("dt", [0.02, 0.25, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_phi_is_the_derivative_of_the_mean_on_the_manifold(seed: int, dt: float) -> None:
    x = random_state(np.random.default_rng(seed))
    centre, Phi, _ = propagated(x, dt)
    numeric = np.empty((M, M))
    for b, place in enumerate(PLACES):
        ends = []
        for sign in (1.0, -1.0):
            dx, found = np.zeros(STATES_MOST), np.empty(STATES_MOST)
            dx[place] = sign * EPSILON[b]
            y = x.copy()
            retract(y, dx)
            local(centre, propagated(y, dt)[0], found)
            ends.append(found[PLACES])
        numeric[:, b] = (ends[0] - ends[1]) / (2.0 * EPSILON[b])
    np.testing.assert_allclose(Phi, numeric, rtol=0, atol=3e-5)


def exponential(A: Array) -> Array:
    """exp A of a small matrix by its series."""
    term, total = np.eye(A.shape[0]), np.eye(A.shape[0])
    for k in range(1, 30):
        term = term @ A / k
        total += term
    return total


def test_qd_is_van_loans() -> None:
    """With a constant F: Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automatic Control 23(3), 1978."""
    x = random_state(np.random.default_rng(1))
    x[OMEGA : OMEGA + 3] = 0.0
    dt, tau, density = 0.04, np.array([1e9, 1e9]), np.array([1e-4] * 3 + [1e-2] * 3 + [0.0] * 3 + [0.3] * 3 + [2.0] * 3)
    _, Phi, Qd = propagated(x, dt, tau, density)
    frame, F, y = np.empty(9), np.empty((M, M)), np.zeros(Y)
    g = rates_of_frame(x, frame)
    y[:4], y[4:7], y[10:16] = x[Q : Q + 4], x[V : V + 3], x[OMEGA : FORCE + 3]
    telemetry.dynamics(y, frame, g, tau, np.array([x[LATITUDE], 6.37e6, 6.39e6]), F)
    block = exponential(np.block([[-F, np.diag(density)], [np.zeros((M, M)), F.T]]) * dt)
    np.testing.assert_allclose(Phi, block[M:, M:].T, rtol=0, atol=1e-6)
    expected = block[M:, M:].T @ block[:M, M:]
    # in sigmas: of the position the leading term, f dt^5 / 20, is beyond the fourth order of one step
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(Qd / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), rtol=0, atol=0.06)
    assert Qd[3, 0] == pytest.approx(expected[3, 0], rel=1e-3)


def test_rate_and_force_die_away_and_the_attitude_follows_the_integral_of_the_rate() -> None:
    x = np.zeros(X_SIZE)
    x[Q], x[OMEGA + 2], x[FORCE], x[LATITUDE] = 1.0, 0.8, 2.0, 0.8
    g = rates_of_frame(x, np.empty(9))
    x[FORCE + 2] = -g
    y, _, _ = propagated(x, 3.0)
    assert y[OMEGA + 2] == pytest.approx(0.8 * np.exp(-0.3), rel=1e-6)
    # gravity leaves the vertical by that too
    assert y[FORCE] == pytest.approx(2.0 * np.exp(-0.75), rel=1e-3)
    C = np.empty((3, 3))
    rotation_matrix(y[Q : Q + 4], C)
    # the earth's rotation is 2e-4 rad in that time
    assert np.arctan2(C[1, 0], C[0, 0]) == pytest.approx(0.8 * 10.0 * (1.0 - np.exp(-0.3)), abs=3e-4)


def test_covariance_is_phi_p_phi_plus_qd_in_the_order_of_the_error_state() -> None:
    random = np.random.default_rng(2)
    for n in (STATES_MOST, STATES_MOST + 1):  # and whatever else there is
        A = random.normal(size=(n, n))
        P = A @ A.T
        Phi, Qd = random.normal(size=(M, M)), np.diag(random.uniform(size=M))
        whole, noise = np.eye(n), np.zeros((n, n))
        whole[np.ix_(PLACES, PLACES)] = Phi
        noise[np.ix_(PLACES, PLACES)] = Qd
        expected = whole @ P @ whole.T + noise
        telemetry.propagate_covariance(P, Phi, Qd)
        np.testing.assert_allclose(P, expected, rtol=1e-10, atol=1e-9)
