"""Departures are weighed by what they cost: what is only improbable says nothing, what puts measurements outside does."""

import math

import numpy as np
import pytest

from mavkf.diagnostics import Finding
from mavkf.diagnostics.consequence import (
    FEWEST,
    long_run_variance,
    share_of_mean,
    share_of_scale,
    weigh,
    weigh_refusals,
)

Array = np.ndarray
AXES = ("north", "east")


def white(n: int = 2000, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(size=(n, 2))


def lasting(rho: float, n: int = 2000) -> Array:
    """Innovations of variance 1 that are correlated by rho with the one before."""
    w, u = white(n), np.zeros((n, 2))
    for i in range(1, n):
        u[i] = rho * u[i - 1] + math.sqrt(1.0 - rho * rho) * w[i]
    return u


def weighed(u: Array, along: Array | None = None) -> dict[tuple[str, str], Finding]:
    """Findings by name and axis of innovations that the filter takes for white of variance 1."""
    nis = np.sum(u * u, axis=1)
    found = weigh(u, np.ones_like(u), nis, np.full(len(u), 2), AXES, along=along)
    assert all(0.0 <= finding.value <= 1.0 for finding in found)
    return {(finding.name, finding.axis): finding for finding in found}


def wrong(u: Array, along: Array | None = None) -> set[tuple[str, str]]:
    return {key for key, finding in weighed(u, along).items() if finding.verdict != "fine"}


def test_a_right_filter_has_nothing_said_of_it() -> None:
    assert sum(bool(wrong(white(200, seed))) for seed in range(200)) <= 7  # 2 expected; more once in a thousand


@pytest.mark.parametrize(
    ("u", "expected"),
    [
        (1.5 * white(), {("size", ""), ("coverage", ""), ("lasting", "north"), ("lasting", "east")}),
        (white() + np.array([0.8, 0.0]), {("mean", "north")}),
        (lasting(0.7), {("lasting", "north"), ("lasting", "east")}),
        (white() * np.where(np.arange(2000) < 1000, 0.6, 1.3)[:, None], {("growth", "")}),
        (white() * np.where(np.arange(2000) % 8, 0.5, 2.4)[:, None], {("coverage", "")}),
    ],
)
def test_what_costs_is_named(u: Array, expected: set[tuple[str, str]]) -> None:
    assert expected <= wrong(u)


def test_what_is_improbable_and_harmless_is_fine() -> None:
    """Noise that is assumed ten times too large, coloured and biased: by design of floors, and no harm."""
    assert not wrong(0.1 * lasting(0.9) + 0.05)


def test_what_is_left_out_is_not_judged_by_axis() -> None:
    u = white()
    u[:1000] += 3.0
    along = np.arange(2000) >= 1000
    assert ("mean", "north") in wrong(u)
    assert not {name for name, _ in wrong(u, along)} & {"mean", "lasting"}
    assert not {name for name, _ in weighed(u, np.zeros(2000, dtype=bool))} & {"mean", "lasting"}


def test_missing_components_are_left_out() -> None:
    u = white()
    u[:, 1] = np.nan
    found = weigh(u, np.ones_like(u), u[:, 0] ** 2, np.ones(2000, dtype=int), AXES)
    assert {finding.axis for finding in found} == {"", "north"}
    assert {finding.verdict for finding in found} == {"fine"}


@pytest.mark.parametrize(
    ("refused", "count", "verdict"),
    [(0, 500, "fine"), (25, 500, "fine"), (40, 500, "marginal"), (400, 408, "broken"), (9, 10, "fine")],
)
def test_refusals_are_weighed(refused: int, count: int, verdict: str) -> None:
    assert weigh_refusals(refused, count, gate=1e-4).verdict == verdict


def test_too_few_say_nothing() -> None:
    assert not weighed(white(FEWEST - 1))
    assert weighed(white(FEWEST))


def test_shares_are_those_of_the_distributions() -> None:
    u = np.random.default_rng(3).normal(size=(200_000, 3))
    assert share_of_scale(1.0, 3) == pytest.approx(0.05)
    assert share_of_mean(0.0) == pytest.approx(0.05)
    assert share_of_scale(2.0, 3) == pytest.approx(np.mean(2.0 * np.sum(u**2, axis=1) > 7.8147), abs=0.004)
    assert share_of_mean(0.7) == pytest.approx(np.mean(np.abs(u[:, 0] + 0.7) > 1.96), abs=0.004)


def test_the_long_run_variance_is_of_the_mean_of_many() -> None:
    value, error = long_run_variance(lasting(0.5, 20_000)[:, 0])
    assert value == pytest.approx(1.5 / 0.5, rel=0.15)  # of an autoregression: (1 + rho) / (1 - rho)
    spread = np.std([long_run_variance(white(500, seed)[:, 0])[0] for seed in range(200)])
    assert spread == pytest.approx(long_run_variance(white(500)[:, 0])[1], rel=0.25)
    assert error < 0.05
