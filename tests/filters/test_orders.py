"""Beyond the first order: exact where the model is quadratic, iterated to the most probable state, better where they should be."""

from types import SimpleNamespace

import numpy as np
import pytest

from mavkf.filters import Filter
from mavkf.filters.orders import second_order_covariance, second_order_mean
from mavkf.models.textbook import coordinated_turn, falling_body

from . import _naive as naive

Array = np.ndarray


def quadratic(seed: int, n: int, m: int) -> SimpleNamespace:
    """A random model, quadratic in both functions."""
    random = np.random.default_rng(seed)
    F, F2, H, H2 = (random.normal(size=shape) for shape in ((n, n), (n, n, n), (m, n), (m, n, n)))
    F2, H2 = F2 + F2.transpose(0, 2, 1), H2 + H2.transpose(0, 2, 1)
    return SimpleNamespace(
        f=lambda x, u, dt: F @ x + 0.5 * np.einsum("aij,i,j->a", F2, x, x),
        F=lambda x, u, dt: F + F2 @ x,
        F_xx=lambda x, u, dt: F2,
        Q=lambda x, dt: np.eye(n),
        h=lambda x: H @ x + 0.5 * np.einsum("aij,i,j->a", H2, x, x),
        H=lambda x: H + H2 @ x,
        H_xx=lambda x: H2,
        R=naive.positive(random, m),
    )


def gaussian_moments(g, x: Array, P: Array) -> tuple[Array, Array]:
    """Mean and covariance of g of a Gaussian: a product rule of Gauss and Hermite, exact for squares of quadratics."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(4)
    grid = np.stack(np.meshgrid(*[nodes] * len(x), indexing="ij"), axis=-1).reshape(-1, len(x))
    weight = np.prod(np.stack(np.meshgrid(*[weights] * len(x), indexing="ij"), axis=-1).reshape(-1, len(x)), axis=1)
    weight /= weight.sum()
    values = np.array([g(x + np.linalg.cholesky(P) @ node) for node in grid])
    mean = weight @ values
    return mean, (values - mean).T @ np.diag(weight) @ (values - mean)


@pytest.mark.parametrize("form", ["joseph", "ud"])
def test_second_order_is_exact_for_quadratic_models(form: str) -> None:
    """Predicted state and covariance, predicted measurement and innovation covariance are the Gaussian's exact moments."""
    for seed in range(10):
        n, m = 1 + seed % 3, 1 + seed % 2
        model, random = quadratic(seed, n, m), np.random.default_rng(seed + 100)
        x, P = random.normal(size=n), naive.positive(random, n)
        kf = Filter(model, x, P, form=form, order="second-order")
        kf.predict(1.0)
        mean, covariance = gaussian_moments(lambda y, model=model: model.f(y, None, 1.0), x, P)
        assert naive.difference(kf.x, kf.P, mean, covariance + np.eye(n)) < 1e-9
        x, P = kf.x, kf.P
        innovation = kf.update(np.zeros(m))
        mean, covariance = gaussian_moments(model.h, x, P)
        assert naive.difference(-innovation.r, innovation.S, mean, covariance + model.R) < 1e-9
        # and the update is the best linear one of those moments
        K = P @ model.H(x).T @ np.linalg.inv(innovation.S)
        assert naive.difference(kf.x, kf.P, x + K @ innovation.r, P - K @ innovation.S @ K.T) < 1e-8


def test_terms_are_traces() -> None:
    random = np.random.default_rng(0)
    hessians, P = random.normal(size=(2, 3, 3)), naive.positive(random, 3)
    hessians = hessians + hessians.transpose(0, 2, 1)
    a, b = hessians
    np.testing.assert_allclose(second_order_mean(hessians, P), 0.5 * np.array([np.trace(a @ P), np.trace(b @ P)]))
    expected = 0.5 * np.array([[np.trace(x @ P @ y @ P) for y in (a, b)] for x in (a, b)])
    np.testing.assert_allclose(second_order_covariance(hessians, P), expected)


def cost(x: Array, x0: Array, P0: Array, z: Array) -> float:
    """Twice the negative logarithm of the posterior density, but for a constant."""
    r = coordinated_turn.residual(z, coordinated_turn.h(x))
    there = ~np.isnan(r)
    R = coordinated_turn.R[np.ix_(there, there)]
    return float((x - x0) @ np.linalg.solve(P0, x - x0) + r[there] @ np.linalg.solve(R, r[there]))


@pytest.mark.parametrize("form", ["potter", "square-root-information", "extended-array"])
@pytest.mark.parametrize("missing", [False, True])
def test_iterated_finds_the_most_probable_state(form: str, missing: bool) -> None:
    """Near the radar with a vague position: the first order stops where the density is lower; the iterated where it is stationary."""
    better = 0
    for seed in range(8):
        random = np.random.default_rng(seed)
        x0 = np.array([150.0, 80.0, 0.0, 0.0, 0.0])
        P0 = np.diag([50.0**2, 50.0**2, 1.0, 1.0, 1e-4])
        z = coordinated_turn.h(x0 + np.sqrt(np.diag(P0)) * random.normal(size=5))
        if missing:
            z[1] = np.nan
        first, iterated = (Filter(coordinated_turn, x0, P0, form=form, order=order) for order in ("first", "iterated"))
        assert first.update(z).iterations == 1
        assert 1 < iterated.update(z).iterations < 20
        lowest = cost(iterated.x, x0, P0, z)
        better += lowest < 0.99 * cost(first.x, x0, P0, z)
        assert lowest <= cost(first.x, x0, P0, z) + 1e-9
        for direction in np.eye(5) * np.sqrt(np.diag(iterated.P)):
            for sign in (1e-3, -1e-3):
                assert cost(iterated.x + sign * direction, x0, P0, z) > lowest - 1e-6
        # Gauss-Newton's covariance at the solution
        there = ~np.isnan(z)
        H, R = coordinated_turn.H(iterated.x)[there], coordinated_turn.R[np.ix_(there, there)]
        P = np.linalg.inv(np.linalg.inv(P0) + H.T @ np.linalg.solve(R, H))
        assert naive.difference(iterated.x, iterated.P, iterated.x, P) < 1e-6
    assert missing or better >= 3  # or the case is not curved enough to show anything


def falling_bias(order: str, runs: int = 25, seconds: int = 22) -> Array:
    """Mean error of the state of the paper's problem over many runs, after drag has set in: altitude (m), velocity, ballistic parameter."""
    truth = [falling_body.TRUTH]
    for _ in range(seconds):
        exact = Filter(falling_body, truth[-1], falling_body.P0 * 1e-6, steps=50)
        exact.predict(1.0)
        truth.append(exact.x)
    errors = []
    for seed in range(runs):
        random = np.random.default_rng(seed)
        kf = Filter(falling_body, falling_body.X0, falling_body.P0, order=order, steps=8)
        for x in truth[1:]:
            kf.predict(1.0)
            kf.update(falling_body.h(x) + np.sqrt(falling_body.R[0]) * random.normal(size=1))
        errors.append(kf.x - x)
    return np.asarray(np.mean(errors, axis=0))


def test_second_order_on_the_falling_body() -> None:
    """What Athans, Wishner and Bertolini showed: the first order is left with a bias that the second has not."""
    first, second = falling_bias("first"), falling_bias("second-order")
    assert np.all(np.abs(second) < 0.5 * np.abs(first))
    assert abs(first[0]) > 30.0  # 3 sigma of a fix of the radar, or there is nothing to see
