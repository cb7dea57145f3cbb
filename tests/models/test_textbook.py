"""Jacobians and Hessians of the textbook models against finite differences. A model joins by being a module of mavkf.models.textbook."""

import importlib
import pkgutil
from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

from mavkf.models import textbook
from mavkf.models.textbook import coordinated_turn, falling_body

Array = np.ndarray
STEP = 1e-4  # of the standard deviations that a model starts with


def models() -> list[ModuleType]:
    return [
        importlib.import_module(f"{textbook.__name__}.{info.name}") for info in pkgutil.iter_modules(textbook.__path__)
    ]


each_model = pytest.mark.parametrize("model", models(), ids=lambda model: model.__name__.rsplit(".", 1)[1])


def derivative(g: Callable[[Array], Array], x: Array, sigma: Array) -> Array:
    """dg/dx by central differences of order four, the new axis last."""
    columns = []
    for j in range(len(x)):
        d = np.zeros(len(x))
        d[j] = STEP * sigma[j]
        near, far = g(x + d) - g(x - d), g(x + 2.0 * d) - g(x - 2.0 * d)
        columns.append((8.0 * near - far) / (12.0 * d[j]))
    return np.stack(columns, axis=-1)


def check(model: ModuleType, value: str, derived: str, *arguments: object) -> None:
    sigma = np.sqrt(np.diag(model.P0))
    for seed in range(20):
        x = model.X0 + sigma * np.random.default_rng(seed).normal(size=len(sigma))
        expected = derivative(lambda y: getattr(model, value)(y, *arguments), x, sigma)
        found = getattr(model, derived)(x, *arguments)
        assert found.shape == expected.shape
        # each entry by what a change of a sigma does to the component, beside what rounding of the value leaves
        size = np.abs(getattr(model, value)(x, *arguments))
        scale = np.abs(found * sigma).max(axis=-1, keepdims=True)
        error = np.abs(found - expected) * sigma
        assert np.all(error <= 1e-6 * scale + 1e-10 * size[..., None] + 1e-15), (seed, value)


@each_model
def test_jacobians_and_hessians(model: ModuleType) -> None:
    if hasattr(model, "Qc"):
        check(model, "f", "F", None)
        check(model, "F", "F_xx", None)
    else:
        for dt in (0.1, 1.0, 5.0):
            check(model, "f", "F", None, dt)
            check(model, "F", "F_xx", None, dt)
    check(model, "h", "H")
    check(model, "H", "H_xx")


@each_model
def test_noise_is_a_covariance(model: ModuleType) -> None:
    noise = model.Qc(model.X0) if hasattr(model, "Qc") else model.Q(model.X0, 0.7)
    for P in (noise, model.R, model.P0):
        np.testing.assert_array_equal(P, P.T)
        assert np.linalg.eigvalsh(P).min() > -1e-12
    assert noise.shape == model.P0.shape == (len(model.X0),) * 2
    assert model.h(model.X0).shape == (len(model.R),)


def test_discovery() -> None:
    names = {model.__name__.rsplit(".", 1)[1] for model in models()}
    assert {"constant_velocity", "coordinated_turn", "falling_body", "van_der_pol"} <= names


def test_the_hard_models_are_not_linear() -> None:
    """Or their Hessians would prove nothing."""
    assert np.abs(falling_body.F_xx(falling_body.TRUTH, None)).max() > 0.0
    assert np.abs(falling_body.H_xx(falling_body.TRUTH)).max() > 0.0
    assert np.abs(coordinated_turn.F_xx(coordinated_turn.X0, None, 1.0)).max() > 1.0


def test_a_turn_closes_and_is_smooth_through_straight_flight() -> None:
    x = np.array([100.0, 0.0, 3.0, 4.0, 0.1])
    np.testing.assert_allclose(coordinated_turn.f(x, None, 2.0 * np.pi / 0.1), x, atol=1e-9)
    x[4] = 0.0
    np.testing.assert_allclose(coordinated_turn.f(x, None, 2.0)[:2], [106.0, 8.0], rtol=1e-15)
    edge = coordinated_turn.SERIES / 1.7
    series, closed = (coordinated_turn.integrals(edge * side, 1.7) for side in (1.0 - 1e-13, 1.0 + 1e-13))
    np.testing.assert_allclose(series, closed, rtol=1e-10)


def test_a_bearing_is_compared_the_short_way() -> None:
    r = coordinated_turn.residual(np.array([10.0, 3.1]), np.array([9.0, -3.1]))
    np.testing.assert_allclose(r, [1.0, 6.2 - 2.0 * np.pi])
