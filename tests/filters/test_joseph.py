"""Joseph's update against the textbook, in dense numpy."""

import numpy as np
import pytest

from mavkf.filters.joseph import correct, innovation_covariance, invert, quadratic, row_variance

Array = np.ndarray


def textbook(P: Array, H: Array, R: Array, r: Array) -> tuple[Array, Array, float, Array]:
    """S, dx, nis and the corrected covariance, as written in the books."""
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    A = np.eye(P.shape[0]) - K @ H
    return S, K @ r, float(r @ np.linalg.solve(S, r)), A @ P @ A.T + K @ R @ K.T


def update(P: Array, H: Array, R: Array, r: Array) -> tuple[Array, Array, float, Array]:
    """The same by the code under test."""
    n, m = P.shape[0], H.shape[0]
    P = P.copy()
    PHt, S, inverse, dx = np.empty((n, m)), np.empty((m, m)), np.empty((m, m)), np.empty(n)
    innovation_covariance(P, H, R, PHt, S)
    assert invert(S, inverse)
    correct(P, PHt, S, inverse, r, dx, np.empty((n, m)), np.empty((2 * m, n)), -1, 0, n)
    return S, dx, quadratic(inverse, r), P


def positive(random: np.random.Generator, n: int, spread: float = 1.0) -> Array:
    """A random covariance whose standard deviations range over some decades."""
    A = random.normal(size=(n, n + 2)) * 10.0 ** random.uniform(-spread, spread, (n, 1))
    return np.asarray(A @ A.T)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_equals_the_textbook(m: int) -> None:
    for seed in range(100):
        random = np.random.default_rng([m, seed])
        n = int(random.integers(m, 20))
        P, R, r = positive(random, n), positive(random, m), random.normal(size=m)
        H = random.normal(size=(m, n)) * (random.random((m, n)) < 0.5)  # sparse, as the real ones
        S, dx, nis, after = update(P, H, R, r)
        S0, dx0, nis0, after0 = textbook(P, H, R, r)
        scale = np.sqrt(np.outer(np.diag(P), np.diag(P)))
        np.testing.assert_allclose(S, S0, rtol=1e-12, atol=1e-12 * np.abs(S0).max())
        np.testing.assert_allclose(dx, dx0, rtol=0, atol=1e-9 * np.sqrt(np.diag(P)).max() * (1.0 + np.sqrt(nis0)))
        assert nis == pytest.approx(nis0, rel=1e-9)
        np.testing.assert_allclose(after / scale, after0 / scale, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(after, after.T)
        np.testing.assert_array_equal(S, S.T)


def test_correlated_noise_matters() -> None:
    # two measurements of one state with noise that cancels in their mean
    R = np.array([[1.0, -0.9], [-0.9, 1.0]])
    *_, after = update(np.array([[4.0]]), np.ones((2, 1)), R, np.zeros(2))
    assert after[0, 0] == pytest.approx(1.0 / (1.0 / 4.0 + 2.0 / 0.1))  # information adds: 1' R^-1 1 = 2 / 0.1


def test_stays_positive_where_the_short_form_does_not() -> None:
    # two nearly parallel measurements that are far better than what was known (after Bierman)
    e = 1e-7
    short_failed = False
    for seed in range(20):
        random = np.random.default_rng(seed)
        P = np.eye(3) * random.uniform(0.5, 2.0)
        short = P.copy()
        for H in (np.array([[1.0, 1.0, 1.0]]), np.array([[1.0, 1.0, 1.0 + e]]), np.array([[1.0, 1.0 + e, 1.0]])):
            R = np.array([[e * e]])
            *_, P = update(P, H, R, np.zeros(1))
            K = short @ H.T / (H @ short @ H.T + R)
            short = (np.eye(3) - K @ H) @ short
            assert np.linalg.eigvalsh(P).min() > -1e-16
            assert np.all(np.diag(P) > 0.0)
            short_failed |= bool(np.linalg.eigvalsh(0.5 * (short + short.T)).min() < -1e-11)
    assert short_failed  # or the case is not hard enough to show anything


def test_a_gain_that_is_not_the_best_leaves_a_larger_covariance() -> None:
    random = np.random.default_rng(3)
    P, H, R = positive(random, 4), random.normal(size=(2, 4)), positive(random, 2)
    PHt, S, inverse, dx = np.empty((4, 2)), np.empty((2, 2)), np.empty((2, 2)), np.empty(4)
    innovation_covariance(P, H, R, PHt, S)
    assert invert(S, inverse)
    K = PHt @ (0.7 * inverse)
    A = np.eye(4) - K @ H
    expected = A @ P @ A.T + K @ R @ K.T
    after = P.copy()
    correct(after, PHt, S, 0.7 * inverse, np.zeros(2), dx, np.empty((4, 2)), np.empty((4, 4)), -1, 0, 4)
    np.testing.assert_allclose(after, expected, rtol=1e-9, atol=1e-9 * np.abs(P).max())
    best = textbook(P, H, R, np.zeros(2))[3]
    assert np.linalg.eigvalsh(after - best).min() > -1e-9


@pytest.mark.parametrize(("considered", "first", "last"), [(4, 0, 6), (-1, 2, 5)], ids=["one", "outside of a range"])
@pytest.mark.parametrize("m", [1, 2, 3])
def test_what_is_considered_is_left_alone_but_counts(m: int, considered: int, first: int, last: int) -> None:
    random = np.random.default_rng(m)
    n = 6
    P, H, R, r = positive(random, n), random.normal(size=(m, n)), positive(random, m), random.normal(size=m)
    PHt, S, inverse, dx = np.empty((n, m)), np.empty((m, m)), np.empty((m, m)), np.empty(n)
    innovation_covariance(P, H, R, PHt, S)
    assert invert(S, inverse)
    alone = np.array([i == considered or not first <= i < last for i in range(n)])
    K = P @ H.T @ np.linalg.inv(S)
    K[alone] = 0.0
    A = np.eye(n) - K @ H
    expected = A @ P @ A.T + K @ R @ K.T
    after = P.copy()
    correct(after, PHt, S, inverse, r, dx, np.empty((n, m)), np.empty((2 * m, n)), considered, first, last)
    np.testing.assert_allclose(dx, K @ r, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(dx[alone], 0.0)
    np.testing.assert_allclose(after, expected, rtol=1e-9, atol=1e-9 * np.abs(P).max())
    np.testing.assert_allclose(np.diag(after)[alone], np.diag(P)[alone])


@pytest.mark.parametrize("m", [1, 2, 3])
def test_inverse(m: int) -> None:
    for seed in range(50):
        S, inverse = positive(np.random.default_rng([m, seed]), m), np.empty((m, m))
        assert invert(S, inverse)
        np.testing.assert_allclose(inverse, np.linalg.inv(S), rtol=1e-9, atol=1e-9 * np.abs(np.linalg.inv(S)).max())


@pytest.mark.parametrize(
    "S",
    [
        [[0.0]],
        [[-1.0]],
        [[np.nan]],
        [[1.0, 2.0], [2.0, 1.0]],
        [[1.0, 1.0], [1.0, 1.0]],
        [[1.0, np.nan], [np.nan, 1.0]],
    ],
)
def test_not_positive_definite_is_said(S: list[list[float]]) -> None:
    A = np.array(S)
    assert not invert(A, np.empty_like(A))


def test_the_variance_of_a_row_is_that_of_the_whole_product() -> None:
    random = np.random.default_rng(8)
    A, H = random.normal(size=(7, 7)), random.normal(size=(3, 7))
    H[1, ::2] = 0.0
    P = A @ A.T
    np.testing.assert_allclose([row_variance(P, H, i) for i in range(3)], np.diag(H @ P @ H.T), rtol=1e-12)
