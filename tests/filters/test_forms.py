"""Every form against the textbook's equations, on random systems of many sizes, with correlated and missing measurements."""

from types import ModuleType

import numpy as np
import pytest

from mavkf.errors import UsageError
from mavkf.filters import extended_array
from mavkf.filters.forms import FORMS, KEEP_INVERSE, apply, form_named, noise_factor, nothing_known

from . import _naive as naive

Array = np.ndarray
each_form = pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)


def run(form: ModuleType, case: dict[str, Array]) -> list[tuple[Array, Array]]:
    x, A, steps = case["x"].copy(), form.from_covariance(case["P"]), []
    for Phi, G, q, H, R, z in zip(*(case[name] for name in ("Phi", "G", "q", "H", "R", "z")), strict=True):
        form.predict(A, Phi, G, q)
        x = Phi @ x
        x = x + apply(form, A, H, R, z - H @ x)
        steps.append((x, form.to_covariance(A)))
    return steps


@each_form
@pytest.mark.parametrize("m", [1, 2, 3, 5])
def test_equals_the_textbook(form: ModuleType, m: int) -> None:
    for seed in range(12):
        n, k = 1 + seed % 7, seed % 4
        case = naive.problem([m, seed], n, m, k, steps=8)
        x, P = case["x"], case["P"]
        for i, (x_form, P_form) in enumerate(run(form, case)):
            x, P = naive.predict(x, P, case["Phi"][i], case["G"][i], case["q"][i])
            x, P = naive.update(x, P, case["H"][i], case["R"][i], case["z"][i])
            assert naive.difference(x_form, P_form, x, P) < 1e-9, (seed, i)


@each_form
def test_to_and_from_covariance(form: ModuleType) -> None:
    for seed in range(10):
        P = naive.positive(np.random.default_rng(seed), 1 + seed % 6)
        back = form.to_covariance(form.from_covariance(P))
        np.testing.assert_allclose(back, P, rtol=1e-9, atol=1e-10 * np.abs(P).max())


@each_form
def test_nearly_parallel_states_stay_apart(form: ModuleType) -> None:
    """A small pivot is not rounding: the variance of the difference of two states comes back."""
    for rest in (1e-2, 1e-4, 1e-6):
        P = np.array([[1.0, 1.0 - rest], [1.0 - rest, 1.0]])
        back = form.to_covariance(form.from_covariance(P))
        apart = np.array([1.0, -1.0])
        assert apart @ back @ apart == pytest.approx(2.0 * rest, rel=1e-8)


@pytest.mark.parametrize("name", [name for name in FORMS if name not in KEEP_INVERSE])
def test_a_state_known_exactly(name: str) -> None:
    """A zero variance is a covariance too; the state stays where it is, and what depends on it is right."""
    form, P = FORMS[name], np.array([[4.0, 0.0, 2.0], [0.0, 0.0, 0.0], [2.0, 0.0, 1.0]])
    A = form.from_covariance(P)
    np.testing.assert_allclose(form.to_covariance(A), P, atol=1e-15)
    H = np.array([[1.0, 5.0, 0.0]])
    dx = apply(form, A, H, np.array([[1.0]]), np.array([3.0]))
    np.testing.assert_allclose(dx, [2.4, 0.0, 1.2], atol=1e-14)
    np.testing.assert_allclose(form.to_covariance(A), P / 5.0, atol=1e-14)
    form.predict(A, np.eye(3), np.eye(3), np.zeros(3))
    np.testing.assert_allclose(form.to_covariance(A), P / 5.0, atol=1e-14)


@pytest.mark.parametrize("name", KEEP_INVERSE)
def test_from_knowing_nothing(name: str) -> None:
    """A track from position fixes alone: unknown until two have come, then their straight line, by least squares."""
    form, A, x = FORMS[name], nothing_known(name, 2), np.zeros(2)
    Phi, H, R = np.array([[1.0, 2.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.array([[0.25]])
    z = np.array([1.0, 4.0, 9.0])
    for i in range(3):
        form.predict(A, Phi, np.zeros((2, 0)), np.zeros(0))
        x = Phi @ x
        x = x + apply(form, A, H, R, z[i : i + 1] - H @ x)
        if i == 0:
            assert np.isnan(form.to_covariance(A)).all()
            np.testing.assert_array_equal(x, 0.0)
    t = np.array([-4.0, -2.0, 0.0])
    design = np.column_stack([np.ones(3), t])
    np.testing.assert_allclose(x, np.linalg.lstsq(design, z, rcond=None)[0], rtol=1e-12)
    np.testing.assert_allclose(form.to_covariance(A), 0.25 * np.linalg.inv(design.T @ design), rtol=1e-12)
    assert np.isnan(form.from_covariance(np.zeros((1, 1)))).any()


@pytest.mark.parametrize("name", KEEP_INVERSE)
def test_a_sum_does_not_tell_its_parts(name: str) -> None:
    """However often it is measured; once one part is, both are known."""
    form, A = FORMS[name], nothing_known(name, 2)
    for H, known in (([[1.0, 3.0]], False), ([[1.0, 3.0]], False), ([[1.0, 0.0]], True)):
        dx = apply(form, A, np.array(H), np.eye(1), np.array([6.0]))
        assert np.isfinite(form.to_covariance(A)).all() == known
        np.testing.assert_allclose(dx, [6.0, 0.0] if known else [0.0, 0.0], atol=1e-12)


def test_state_and_covariance_in_one_transformation() -> None:
    """The extended array carries x itself: update and prediction in one step, never a gain."""
    for seed in range(10):
        case = naive.problem([seed], 4, 2, 2, steps=6, missing=0.0)
        x, P = case["x"], case["P"]
        A, carried = extended_array.from_covariance(P), np.empty(4)
        extended_array.set_state(A, x)
        for i in range(6):
            L = np.linalg.cholesky(case["R"][i])
            H, z = np.linalg.solve(L, case["H"][i]), np.linalg.solve(L, case["z"][i])
            extended_array.step(A, case["Phi"][i], case["G"][i], case["q"][i], H, z)
            x, P = naive.update(x, P, case["H"][i], case["R"][i], case["z"][i])
            x, P = naive.predict(x, P, case["Phi"][i], case["G"][i], case["q"][i])
            extended_array.to_state(A, carried)
            assert naive.difference(carried, extended_array.to_covariance(A), x, P) < 1e-9


@each_form
def test_nothing_measured_changes_nothing(form: ModuleType) -> None:
    P = naive.positive(np.random.default_rng(0), 3)
    A = form.from_covariance(P)
    before = A.copy()
    dx = apply(form, A, np.ones((2, 3)), np.eye(2), np.full(2, np.nan))
    np.testing.assert_array_equal(A, before)
    np.testing.assert_array_equal(dx, 0.0)


def test_noise_factor() -> None:
    for seed in range(10):
        Q = naive.positive(np.random.default_rng(seed), 4, spread=2.0)
        G, q = noise_factor(Q)
        np.testing.assert_allclose((G * q) @ G.T, Q, rtol=1e-10, atol=1e-12 * np.abs(Q).max())
    G, q = noise_factor(np.outer([1.0, 2.0, 0.0], [1.0, 2.0, 0.0]))  # one noise on two states
    np.testing.assert_allclose((G * q) @ G.T, [[1.0, 2.0, 0.0], [2.0, 4.0, 0.0], [0.0, 0.0, 0.0]], atol=1e-15)


def test_bad_arguments_are_said() -> None:
    with pytest.raises(UsageError, match="the forms are covariance, joseph"):
        form_named("cholesky")
    assert form_named("ud") is FORMS["ud"]
    with pytest.raises(UsageError, match="needs a covariance"):
        nothing_known("ud", 3)
    for Q in ([[1.0, 2.0], [2.0, 1.0]], [[-1.0]], [[1.0, 0.5], [0.0, 1.0]], [[0.0, 1.0], [1.0, 1.0]]):
        with pytest.raises(UsageError, match="Q must be"):
            noise_factor(np.array(Q))
    for R in (np.zeros((2, 2)), np.ones((2, 2)), -np.eye(2)):
        with pytest.raises(UsageError, match="R must be positive definite"):
            apply(FORMS["ud"], np.eye(2), np.eye(2), R, np.ones(2))
