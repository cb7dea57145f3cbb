"""The filter that has run for ever: the equations hold, the running filter gets there, and what has no steady state is said."""

import numpy as np
import pytest

from mavkf.errors import UsageError
from mavkf.filters import kalman, kalman_bucy, steady_state

from . import _naive as naive


def test_discrete() -> None:
    for seed in range(30):
        random = np.random.default_rng(seed)
        n, m = 1 + seed % 6, 1 + seed % 3
        F, H, Q, R = (
            random.normal(size=(n, n)),
            random.normal(size=(m, n)),
            naive.positive(random, n),
            naive.positive(random, m),
        )
        P, K = steady_state.discrete(F, H, Q, R)
        S = H @ P @ H.T + R
        np.testing.assert_allclose(K, P @ H.T @ np.linalg.inv(S), rtol=1e-8, atol=1e-10)
        closed = F @ (np.eye(n) - K @ H)
        scale = np.sqrt(np.outer(np.diag(P), np.diag(P)))
        again = closed @ P @ closed.T + F @ K @ R @ K.T @ F.T + Q
        np.testing.assert_allclose(again / scale, P / scale, rtol=0, atol=1e-9)
        assert np.abs(np.linalg.eigvals(closed)).max() < 1.0  # the stabilising solution, not another


def test_the_running_filter_gets_there() -> None:
    F, H, Q, R = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.diag([0.01, 0.02]), np.eye(1)
    x, P = np.zeros(2), np.eye(2) * 100.0
    for _ in range(300):
        kalman.correct(x, P, H, R, np.zeros(1), np.empty(1))
        kalman.predict(x, P, F, np.zeros((2, 0)), np.zeros(0), Q)
    np.testing.assert_allclose(steady_state.discrete(F, H, Q, R)[0], P, rtol=1e-10)


def test_a_random_walk_by_hand() -> None:
    """p = p r / (p + r) + q: p = (q + sqrt(q^2 + 4 q r)) / 2."""
    one = np.eye(1)
    P, K = steady_state.discrete(one, one, 2.0 * one, 3.0 * one)
    p = 0.5 * (2.0 + np.sqrt(4.0 + 24.0))
    assert P[0, 0] == pytest.approx(p, rel=1e-14)
    assert K[0, 0] == pytest.approx(p / (p + 3.0), rel=1e-14)


def test_continuous() -> None:
    for seed in range(30):
        random = np.random.default_rng(seed)
        n, m = 1 + seed % 6, 1 + seed % 3
        F, H, Qc, Rc = (
            random.normal(size=(n, n)),
            random.normal(size=(m, n)),
            naive.positive(random, n),
            naive.positive(random, m),
        )
        P, K = steady_state.continuous(F, H, Qc, Rc)
        residual = kalman_bucy.riccati(P, F, H, Qc, Rc)
        assert np.abs(residual).max() < 1e-9 * max(np.abs(F @ P).max(), np.abs(Qc).max())
        assert np.linalg.eigvals(F - K @ H).real.max() < 0.0


def test_continuous_is_where_the_riccati_equation_ends() -> None:
    F, H, Qc, Rc = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]]), np.diag([0.0, 2.0]), np.eye(1)
    P, _ = steady_state.continuous(F, H, Qc, Rc)
    # by hand: p11 = r (4 q / r)^(1/4) ... = sqrt(2 r sqrt(q r)), p12 = sqrt(q r)
    np.testing.assert_allclose(P[0], [np.sqrt(2.0 * np.sqrt(2.0)), np.sqrt(2.0)], rtol=1e-12)
    running = np.eye(2)
    for _ in range(40):
        running = kalman_bucy.covariance(running, F, H, Qc, Rc, 0.5)
    np.testing.assert_allclose(running, P, rtol=1e-9)


def test_what_has_none_is_said() -> None:
    unseen = np.diag([1.2, 0.5]), np.array([[0.0, 1.0]])  # grows, and is not measured
    with pytest.raises(UsageError, match="no steady state"):
        steady_state.discrete(*unseen, np.eye(2), np.eye(1))
    with pytest.raises(UsageError, match="no steady state"):
        steady_state.continuous(np.diag([0.3, -0.5]), unseen[1], np.eye(2), np.eye(1))
    one = np.eye(1)
    for F in (2.0, 1.0):
        with pytest.raises(UsageError, match="not driven by noise"):
            steady_state.discrete(F * one, one, 0.0 * one, one)
    with pytest.raises(UsageError, match="not driven by noise"):
        steady_state.continuous(0.5 * one, one, 0.0 * one, one)
    assert steady_state.discrete(0.5 * one, one, 0.0 * one, one)[0] == 0.0  # it forgets by itself
    for F in (1e200, np.nan):
        with pytest.raises(UsageError, match="no steady state"):
            steady_state.discrete(np.diag([F, 0.5]), unseen[1], np.eye(2), np.eye(1))
