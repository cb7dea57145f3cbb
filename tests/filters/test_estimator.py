"""The filter of any model: every form and order agrees where they must, and what a user may get wrong is said."""

import contextlib
import io
from types import SimpleNamespace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from mavkf.errors import UsageError
from mavkf.filters import Filter, Linear, estimator, kalman
from mavkf.filters.forms import FORMS, KEEP_INVERSE
from mavkf.filters.orders import ORDERS
from mavkf.models.textbook import constant_velocity, coordinated_turn, falling_body, van_der_pol

from . import _naive as naive

Array = np.ndarray


def fly(model, order: str, form: str = "joseph", count: int = 12, **options) -> Filter:
    """A run of a model on measurements of its own, some of them missing or partial."""
    random = np.random.default_rng(7)
    kf = Filter(model, model.X0, model.P0, form=form, order=order, **options)
    for i in range(count):
        kf.predict(0.4)
        z = model.h(model.X0) + np.sqrt(np.diag(model.R)) * random.normal(size=len(model.R)) * 0.3
        if i % 4 == 2:
            z[0] = np.nan
        kf.update(z)
    return kf


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("form", FORMS)
def test_on_a_linear_model_all_are_the_kalman_filter(form: str, order: str) -> None:
    random = np.random.default_rng(1)
    n, m = 4, 2
    F, B, H = naive.orthogonal(random, n) * 0.9, random.normal(size=(n, 1)), random.normal(size=(m, n))
    Q, R = naive.positive(random, n), naive.positive(random, m)
    x, P, r = random.normal(size=n), naive.positive(random, n), np.empty(m)
    kf = Filter(Linear(F, H, Q, R, B), x, P, form=form, order=order, t=5.0)
    for i in range(10):
        u, z = random.normal(size=1), random.normal(size=m)
        z[i % 2] = np.nan if i % 3 == 1 else z[i % 2]
        kf.predict(0.5, u)
        kalman.predict(x, P, F, B, u, Q)
        S = H @ P @ H.T + R
        innovation = kf.update(z)
        kalman.correct(x, P, H, R, z, r)
        assert naive.difference(kf.x, kf.P, x, P) < 1e-9
        there = ~np.isnan(z)
        np.testing.assert_allclose(innovation.r, r, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(innovation.S, S, rtol=1e-8)
        assert innovation.nis == pytest.approx(r[there] @ np.linalg.inv(S[np.ix_(there, there)]) @ r[there], rel=1e-6)
        assert innovation.components == there.sum()
    assert kf.t == 10.0


@pytest.mark.parametrize("form", FORMS)
def test_every_form_equals_filterpy(form: str) -> None:
    """An outside library on a linear problem, with measurements that are missing."""
    random = np.random.default_rng(3)
    theirs = KalmanFilter(dim_x=4, dim_z=2)
    theirs.F, theirs.H = naive.orthogonal(random, 4) * 0.95, random.normal(size=(2, 4))
    theirs.Q, theirs.R, theirs.P = naive.positive(random, 4), naive.positive(random, 2), naive.positive(random, 4)
    theirs.x = random.normal(size=(4, 1))
    kf = Filter(Linear(theirs.F, theirs.H, theirs.Q, theirs.R), theirs.x[:, 0], theirs.P, form=form)
    for i in range(30):
        z = None if i % 5 == 3 else random.normal(size=2)
        theirs.predict()
        theirs.update(z)
        kf.predict(1.0)
        kf.update([np.nan, np.nan] if z is None else z)
        assert naive.difference(kf.x, kf.P, theirs.x[:, 0], theirs.P) < 1e-9


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    "model", [coordinated_turn, falling_body, van_der_pol], ids=lambda model: model.__name__.split(".")[-1]
)
def test_forms_agree_on_nonlinear_models(model, order: str) -> None:
    reference = fly(model, order)
    for form in FORMS:
        if model is falling_body and form == "information":
            continue  # its information matrix spans 18 decades: the square-root form is for that
        kf = fly(model, order, form)
        assert naive.difference(kf.x, kf.P, reference.x, reference.P) < 1e-7, form


def test_orders_differ_where_the_model_is_curved() -> None:
    first, iterated, second = (fly(coordinated_turn, order) for order in ORDERS)
    sigma = np.sqrt(np.diag(first.P))
    assert np.max(np.abs(second.x - first.x) / sigma) > 1e-4
    assert np.max(np.abs(iterated.x - first.x) / sigma) > 1e-4


def test_adaptive_steps_are_many_small_ones() -> None:
    fine, adaptive, coarse = (
        fly(van_der_pol, "second-order", steps=64),
        fly(van_der_pol, "second-order", tolerance=1e-8),
        fly(van_der_pol, "second-order", steps=1),
    )
    assert naive.difference(adaptive.x, adaptive.P, fine.x, fine.P) < 1e-5
    assert naive.difference(coarse.x, coarse.P, fine.x, fine.P) > 1e-4


def test_sensors_of_others() -> None:
    """The turning target seen by a second radar, which measures its range alone."""
    place = np.array([500.0, -800.0])
    sensor = SimpleNamespace(
        h=lambda x: np.array([np.hypot(*(x[:2] - place))]),
        H=lambda x: np.array([[*(x[:2] - place) / np.hypot(*(x[:2] - place)), 0.0, 0.0, 0.0]]),
        R=np.array([[1.0]]),
    )
    kf = Filter(coordinated_turn, coordinated_turn.X0, coordinated_turn.P0)
    x, P = naive.update(kf.x, kf.P, sensor.H(kf.x), sensor.R, sensor.H(kf.x) @ kf.x + 3.0)
    innovation = kf.update(sensor.h(kf.x) + 3.0, sensor)
    np.testing.assert_allclose(innovation.r, 3.0)
    assert naive.difference(kf.x, kf.P, x, P) < 1e-9


@pytest.mark.parametrize("order", ORDERS)
def test_a_bearing_across_the_cut_moves_the_state_a_little(order: str) -> None:
    """Predicted 3.14 and measured -3.14: the target is a little to one side, not behind."""
    kf = Filter(coordinated_turn, [-1000.0, 1.0, 0.0, 0.0, 0.0], coordinated_turn.P0, order=order)
    innovation = kf.update([1000.0, -np.pi + 0.002])
    assert abs(innovation.r[1]) < 0.004
    assert np.hypot(kf.x[0] + 1000.0, kf.x[1]) < 10.0


@pytest.mark.parametrize("form", KEEP_INVERSE)
def test_from_knowing_nothing(form: str) -> None:
    """Two fixes start a track; until then neither P nor the innovation's covariance is a number."""
    kf = Filter(constant_velocity, np.zeros(4), form=form)
    innovation = kf.update([10.0, 20.0])
    assert np.isnan(kf.P).all()
    assert np.isnan(innovation.nis)
    np.testing.assert_array_equal(kf.x, 0.0)
    kf.predict(2.0)
    kf.update([14.0, 18.0])
    np.testing.assert_allclose(kf.x, [14.0, 18.0, 2.0, -1.0], rtol=1e-9)
    # both fixes have 4 m^2; the velocity is their difference over 2 s, and noise moved it
    np.testing.assert_allclose(np.diag(kf.P)[:2], 4.0, rtol=1e-9)
    assert np.isfinite(kf.update([np.nan, 19.0]).nis)


def test_the_documented_example_runs() -> None:
    text = estimator.__doc__ or ""
    lines = text[text.index("    from mavkf.filters") : text.index("A model is a module")].splitlines()
    code = "\n".join(line[4:] for line in lines)
    assert len([line for line in lines if line.strip()]) <= 10
    names = {
        "x0": falling_body.X0,
        "P0": falling_body.P0,
        "times": [1.0, 2.0],
        "measured": [falling_body.h(falling_body.TRUTH)] * 2,
    }
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(code, names)
    assert len(names["x_smoothed"]) == 3
    assert "nan" not in printed.getvalue()


def test_nothing_measured_has_no_nis() -> None:
    kf = Filter(constant_velocity, constant_velocity.X0, constant_velocity.P0, order="iterated")
    innovation = kf.update([np.nan, np.nan])
    assert innovation.components == 0
    assert np.isnan(innovation.nis)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"form": "cholesky"}, "There is no form 'cholesky'"),
        ({"order": "third"}, "There is no order 'third'"),
        ({"P": None}, "'joseph' needs a covariance"),
        ({"P": np.eye(3)}, r"P has the shape \(3, 3\); it must be \(4, 4\)"),
        ({"P": -np.eye(4)}, "P must be symmetric with no negative variance"),
        ({"P": np.ones((4, 4)) - 0.5 * np.eye(4)}, "P must be positive semi-definite"),
        ({"P": np.full((4, 4), np.nan)}, "P must be"),
        ({"P": np.diag([1.0, 1.0, 1.0, 0.0]), "form": "information"}, "needs a P that can be inverted"),
        ({"x": np.zeros((2, 2))}, "x has the shape"),
        ({"x": [0.0, np.nan, 0.0, 0.0]}, "x is not finite"),
        ({"P": np.diag([1.0, np.inf, 1.0, 1.0])}, "P is not finite"),
    ],
)
def test_bad_starts_are_said(options: dict, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        Filter(constant_velocity, **({"x": np.zeros(4), "P": np.eye(4)} | options))


def test_bad_calls_are_said() -> None:
    kf = Filter(constant_velocity, np.zeros(4), np.eye(4))
    with pytest.raises(UsageError, match="must not be negative"):
        kf.predict(-0.1)
    with pytest.raises(UsageError, match=r"z has the shape \(3,\); it must be \(2,\)"):
        kf.update([1.0, 2.0, 3.0])
    with pytest.raises(UsageError, match="z is not finite"):
        kf.update([1.0, np.inf])
    with pytest.raises(UsageError, match="H has the shape"):
        kf.update([1.0], SimpleNamespace(h=lambda x: x[:1], H=lambda x: np.eye(1, 3), R=np.eye(1)))
    with pytest.raises(UsageError, match="R must be positive definite"):
        kf.update([1.0], SimpleNamespace(h=lambda x: x[:1], H=lambda x: np.eye(1, 4), R=np.zeros((1, 1))))
    for order, call in (("second-order", "predict"), ("iterated", "update")):
        unknown = Filter(constant_velocity, np.zeros(4), form="information", order=order)
        with pytest.raises(UsageError, match="not known yet"):
            getattr(unknown, call)(1.0 if call == "predict" else [1.0, 2.0])
    one = np.eye(1)
    with pytest.raises(UsageError, match=r"Q has the shape \(2, 2\)"):
        Linear(one, one, np.eye(2), one)
    with pytest.raises(UsageError, match="B has the shape"):
        Linear(one, one, one, one, np.zeros((2, 1)))
    with pytest.raises(UsageError, match="needs its matrix B"):
        Filter(Linear(one, one, one, one), [0.0], one).predict(1.0, [1.0])
