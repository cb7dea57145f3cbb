"""Smoothers against least squares over the whole interval, against each other, and against an outside library."""

import numpy as np
import pytest
from filterpy.kalman import rts_smoother

from mavkf.errors import UsageError
from mavkf.filters import Filter, Linear
from mavkf.filters.smoothers import FixedLag, Step, modified_bryson_frazier, rauch_tung_striebel
from mavkf.models.textbook import coordinated_turn

from . import _naive as naive

Array = np.ndarray


def run(
    seed: int, n: int = 3, m: int = 2, count: int = 10, form: str = "joseph"
) -> tuple[list[Step], tuple[Array, ...]]:
    """A recorded run with missing measurements, two at one time and none at another; and least squares' view of it."""
    random = np.random.default_rng(seed)
    F, H = naive.orthogonal(random, n) * 0.95, random.normal(size=(m, n))
    Q, R = naive.positive(random, n), naive.positive(random, m)
    x0, P0 = random.normal(size=n), naive.positive(random, n)
    kf = Filter(Linear(F, H, Q, R), x0, P0, form=form, record=True)
    prior, noise = np.linalg.inv(np.linalg.cholesky(P0)), np.linalg.inv(np.linalg.cholesky(Q))
    rows, values = [np.hstack([prior, np.zeros((n, n * count))])], [prior @ x0]
    for i in range(1, count + 1):
        kf.predict(1.0)
        row = np.zeros((n, n * (count + 1)))
        row[:, n * i - n : n * i], row[:, n * i : n * i + n] = -noise @ F, noise
        rows.append(row)
        values.append(np.zeros(n))
        for _ in range({4: 2, 7: 0}.get(i, 1)):
            z = random.normal(size=m)
            z[random.random(m) < 0.3] = np.nan
            kf.update(z)
            there = ~np.isnan(z)
            whitener = np.linalg.inv(np.linalg.cholesky(R[np.ix_(there, there)]))
            row = np.zeros((there.sum(), n * (count + 1)))
            row[:, n * i : n * i + n] = whitener @ H[there]
            rows.append(row)
            values.append(whitener @ z[there])
    return kf.history, (np.vstack(rows), np.concatenate(values))


@pytest.mark.parametrize("smoother", [rauch_tung_striebel, modified_bryson_frazier])
def test_equals_least_squares_over_the_interval(smoother) -> None:
    for seed in range(15):
        n = 1 + seed % 4
        history, (design, values) = run(seed, n)
        solution = np.linalg.lstsq(design, values, rcond=None)[0].reshape(-1, n)
        covariance = np.linalg.inv(design.T @ design)
        x, P = smoother(history)
        for step, x_smoothed, P_smoothed in zip(history, x, P, strict=True):
            i = round(step.t)
            block = covariance[n * i : n * i + n, n * i : n * i + n]
            assert naive.difference(x_smoothed, P_smoothed, solution[i], block) < 1e-9, (seed, i)


@pytest.mark.parametrize("form", ["ud", "square-root-information", "extended-array"])
def test_two_smoothers_agree_in_any_form(form: str) -> None:
    for seed in range(5):
        history, _ = run(seed, form=form)
        (x, P), (x0, P0) = modified_bryson_frazier(history), rauch_tung_striebel(history)
        for i in range(len(x)):
            assert naive.difference(x[i], P[i], x0[i], P0[i]) < 1e-9


def test_smoothed_variance_is_never_above_the_filtered() -> None:
    for seed in range(10):
        history, _ = run(seed, count=20)
        for smoother in (rauch_tung_striebel, modified_bryson_frazier):
            _, P = smoother(history)
            for step, smoothed in zip(history, P, strict=True):
                scale = np.sqrt(np.diag(step.P_filtered))
                assert np.linalg.eigvalsh((step.P_filtered - smoothed) / np.outer(scale, scale)).min() > -1e-12


def test_equals_filterpy() -> None:
    random = np.random.default_rng(5)
    F, H = naive.orthogonal(random, 3) * 0.95, random.normal(size=(2, 3))
    Q, R = naive.positive(random, 3), naive.positive(random, 2)
    kf = Filter(Linear(F, H, Q, R), np.zeros(3), np.eye(3), record=True)
    for _ in range(25):
        kf.predict(1.0)
        kf.update(random.normal(size=2))
    x, P = modified_bryson_frazier(kf.history)
    Xs, Ps = (np.array([getattr(step, name) for step in kf.history]) for name in ("x_filtered", "P_filtered"))
    theirs = rts_smoother(Xs, Ps, [F] * 26, [Q] * 26)
    for i in range(26):
        assert naive.difference(x[i], P[i], theirs[0][i], theirs[1][i]) < 1e-9


def test_a_state_known_exactly_is_no_trouble_without_inverses() -> None:
    """A bias known to be 2 beside a random walk: every P is singular."""
    model = Linear(np.eye(2), np.array([[1.0, 1.0]]), np.diag([1.0, 0.0]), np.eye(1))
    kf = Filter(model, [0.0, 2.0], np.diag([1.0, 0.0]), record=True)
    for z in (2.0, 3.0, 4.0):
        kf.predict(1.0)
        kf.update([z])
    x, P = modified_bryson_frazier(kf.history)
    np.testing.assert_array_equal(x[:, 1], 2.0)
    np.testing.assert_array_equal(P[:, 1], 0.0)
    alone = Filter(Linear(np.eye(1), np.eye(1), np.eye(1), np.eye(1)), [0.0], np.eye(1), record=True)
    for z in (0.0, 1.0, 2.0):
        alone.predict(1.0)
        alone.update([z])
    np.testing.assert_allclose(x[:, 0], rauch_tung_striebel(alone.history)[0][:, 0], rtol=1e-12)


def test_fixed_lag_is_the_interval_that_ends_now() -> None:
    history, _ = run(3, count=12)
    for lag in (0, 1, 4):
        smoother = FixedLag(lag)
        for i, step in enumerate(history):
            result = smoother.push(step)
            if i < lag:
                assert result is None
                continue
            assert result is not None
            t, x, P = result
            x0, P0 = rauch_tung_striebel(history[: i + 1])
            assert t == history[i - lag].t
            assert naive.difference(x, P, x0[i - lag], P0[i - lag]) < 1e-9


def test_smoothing_a_turn_helps() -> None:
    """A nonlinear run: smoothed errors are well below the filtered ones, and the two smoothers agree."""
    random = np.random.default_rng(1)
    truth, kf = (
        coordinated_turn.X0.copy(),
        Filter(coordinated_turn, coordinated_turn.X0, coordinated_turn.P0, record=True),
    )
    G = np.linalg.cholesky(coordinated_turn.Q(truth, 1.0) + 1e-12 * np.eye(5))
    truths = [truth]
    for _ in range(60):
        truth = coordinated_turn.f(truth, None, 1.0) + G @ random.normal(size=5)
        truths.append(truth)
        kf.predict(1.0)
        kf.update(coordinated_turn.h(truth) + np.sqrt(np.diag(coordinated_turn.R)) * random.normal(size=2))
    x, _ = modified_bryson_frazier(kf.history)
    np.testing.assert_allclose(x, rauch_tung_striebel(kf.history)[0], atol=1e-6)
    filtered = np.array([step.x_filtered for step in kf.history])
    error, before = (np.sqrt(np.mean((y - truths)[:, :2] ** 2)) for y in (x, filtered))
    assert error < 0.8 * before


def test_what_cannot_be_smoothed_is_said() -> None:
    for smoother in (rauch_tung_striebel, modified_bryson_frazier):
        with pytest.raises(UsageError, match="no steps"):
            smoother([])
    kf = Filter(Linear(np.eye(2), np.eye(2), np.eye(2), np.eye(2)), [0.0, 0.0], form="information", record=True)
    with pytest.raises(UsageError, match="not known yet"):
        rauch_tung_striebel(kf.history)
    exact = Filter(Linear(np.eye(1), np.eye(1), np.zeros((1, 1)), np.eye(1)), [0.0], np.zeros((1, 1)), record=True)
    exact.predict(1.0)
    with pytest.raises(UsageError, match="needs no inverse"):
        rauch_tung_striebel(exact.history)
    with pytest.raises(UsageError, match="lag is -1"):
        FixedLag(-1)
