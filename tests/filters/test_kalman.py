"""The linear filter: its own equations, an outside library's, and the least-squares estimate of everything at once."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from mavkf.filters import kalman

from . import _naive as naive

Array = np.ndarray


def test_control_input_and_partial_measurements() -> None:
    for seed in range(30):
        random = np.random.default_rng(seed)
        n, m, k = 1 + seed % 5, 1 + seed % 3, 1 + seed % 2
        F, B, H = random.normal(size=(n, n)), random.normal(size=(n, k)), random.normal(size=(m, n))
        Q, R = naive.positive(random, n), naive.positive(random, m)
        x, P = random.normal(size=n), naive.positive(random, n)
        mine, mine_P, r = x.copy(), P.copy(), np.empty(m)
        for _ in range(4):
            u, z = random.normal(size=k), random.normal(size=m)
            z[random.random(m) < 0.3] = np.nan
            kalman.predict(mine, mine_P, F, B, u, Q)
            x, P = F @ x + B @ u, F @ P @ F.T + Q
            predicted = H @ x
            assert kalman.correct(mine, mine_P, H, R, z, r) == np.sum(~np.isnan(z))
            np.testing.assert_allclose(r, z - predicted, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(predicted).max()))
            x, P = naive.update(x, P, H, R, z)
            assert naive.difference(mine, mine_P, x, P) < 1e-9
            np.testing.assert_array_equal(mine_P, mine_P.T)


def test_measurements_without_noise_are_refused() -> None:
    x, P = np.ones(2), np.eye(2)
    assert kalman.correct(x, P, np.eye(2), np.ones((2, 2)), np.zeros(2), np.empty(2)) == -1
    np.testing.assert_array_equal(x, 1.0)
    np.testing.assert_array_equal(P, np.eye(2))


@pytest.mark.parametrize("m", [1, 3])
def test_equals_filterpy(m: int) -> None:
    for seed in range(10):
        random = np.random.default_rng([m, seed])
        n = 4
        theirs = KalmanFilter(dim_x=n, dim_z=m, dim_u=1)
        theirs.F, theirs.B = naive.orthogonal(random, n) * 0.95, random.normal(size=(n, 1))
        theirs.H, theirs.Q, theirs.R = random.normal(size=(m, n)), naive.positive(random, n), naive.positive(random, m)
        theirs.x, theirs.P = random.normal(size=(n, 1)), naive.positive(random, n)
        x, P = theirs.x[:, 0].copy(), theirs.P.copy()
        for _ in range(20):
            u, z = random.normal(size=1), random.normal(size=m)
            theirs.predict(u=u[:, None])
            theirs.update(z[:, None])
            kalman.predict(x, P, theirs.F, theirs.B, u, theirs.Q)
            kalman.correct(x, P, theirs.H, theirs.R, z, np.empty(m))
        assert naive.difference(x, P, theirs.x[:, 0], theirs.P) < 1e-9


def test_attains_batch_least_squares() -> None:
    """A state without process noise: the last estimate is the weighted least-squares fit to the prior and all measurements."""
    for seed in range(10):
        random = np.random.default_rng(seed)
        n, m, count = 3, 2, 12
        F = naive.orthogonal(random, n)
        x0, P0 = random.normal(size=n), naive.positive(random, n)
        x, P = x0.copy(), P0.copy()
        rows, values, back = [np.linalg.inv(np.linalg.cholesky(P0))], [], np.eye(n)
        values.append(rows[0] @ x0)
        for _ in range(count):
            H, R, z = random.normal(size=(m, n)), naive.positive(random, m), random.normal(size=m)
            kalman.predict(x, P, F, np.zeros((n, 0)), np.zeros(0), np.zeros((n, n)))
            kalman.correct(x, P, H, R, z, np.empty(m))
            back = F @ back
            whitener = np.linalg.inv(np.linalg.cholesky(R))
            rows.append(whitener @ H @ back)
            values.append(whitener @ z)
        design = np.vstack(rows)
        first = np.linalg.lstsq(design, np.concatenate(values), rcond=None)[0]
        covariance = back @ np.linalg.inv(design.T @ design) @ back.T
        assert naive.difference(x, P, back @ first, covariance) < 1e-9
