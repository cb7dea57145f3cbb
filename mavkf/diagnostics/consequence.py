"""What a departure costs: the share of measurements that lie outside the region which the filter gives for 95 % of them.

A test of many innovations finds departures that nobody would notice, and an estimator that allows for errors which innovations cannot
show (noise floors, coloured errors as states) has innovations that are too small and not white by design. So a departure is weighed: it
counts where it is more than chance and puts more than 5 % outside. The limits are those of `linearisation`: fine to 6 %, marginal to
10 %, broken beyond. What makes innovations smaller than claimed puts fewer outside, and is fine here.

    refused    the share that the gate, or a suspicion, kept out: all of them lie outside
    size       mean NIS by component, k times what it should be: measurements scatter by sqrt(k)
    coverage   the share itself, as counted: outliers
    lasting    the long-run variance of an axis, c_0 + 2 sum w_j c_j (Newey and West, "A Simple, Positive Semi-Definite, Heteroskedasticity
               and Autocorrelation Consistent Covariance Matrix", Econometrica 55, 1987): how much the mean of many scatters against
               what white innovations of S would; below 1 a correlation does no harm
    mean       of an axis, its chance by that long-run variance
    growth     NIS of the second half where it outgrew the first while S did not: divergence

Bounds are closed forms, cheap enough for a live watch: normal quantiles, and Wilson's and Hilferty's of chi-square (Proc. National Academy
of Sciences 17, 1931).
"""

import math
from collections.abc import Sequence
from functools import cache, lru_cache
from statistics import NormalDist

import numpy as np

from mavkf.diagnostics import consistency, distributions
from mavkf.diagnostics.linearisation import FINE, MARGINAL, NOMINAL
from mavkf.diagnostics.records import Finding

Array = np.ndarray
FEWEST = 20
LAGS = 10
SOURCE = "share outside the region of 95 %: fine to 6 %, marginal to 10 %"
HALF_WIDTH = NormalDist().inv_cdf(1.0 - 0.5 * NOMINAL)


@cache
def _region(components: int) -> float:
    return distributions.chi_square_quantile(1.0 - NOMINAL, components)


_expected_in_gate = lru_cache(64)(consistency.expected_in_gate)


@cache
def _normal_bound(probability: float) -> float:
    return NormalDist().inv_cdf(1.0 - probability)


def share_of_scale(scale: float, components: int = 1) -> float:
    """The share outside where squares are `scale` times as large as claimed."""
    return distributions.chi_square_survival(_region(components) / scale, components) if scale > 0.0 else 0.0


def share_of_mean(mean: float) -> float:
    """The share outside where one axis has this mean, in parts of its sigma."""
    cdf = NormalDist().cdf
    return cdf(mean - HALF_WIDTH) + cdf(-mean - HALF_WIDTH)


def ratio_bound(degrees: int, probability: float) -> float:
    """What a chi-square variable over its degrees exceeds with this probability (Wilson and Hilferty)."""
    part = 2.0 / (9.0 * degrees)
    return max(1.0 - part + _normal_bound(probability) * math.sqrt(part), 0.0) ** 3


def long_run_variance(v: Array) -> tuple[float, float]:
    """Of v (n,) about its mean, by Bartlett's weights over LAGS lags; and the relative error of it where v is white."""
    n = len(v)
    lags = max(1, min(LAGS, n // 4))
    v = v - v.mean()
    total = float(v @ v)
    for k in range(1, lags + 1):
        total += 2.0 * (1.0 - k / (lags + 1.0)) * float(v[k:] @ v[:-k])
    return total / n, math.sqrt(4.0 * (lags + 1.0) / (3.0 * n))


def _finding(name: str, axis: str, share: float, probability: float, by_chance: bool, fine: str, said: str) -> Finding:
    """fine, said: the sentence where it costs nothing, and where it does."""
    verdict = "fine" if by_chance or share <= FINE else "marginal" if share <= MARGINAL else "broken"
    sentence = fine if verdict == "fine" else said
    return Finding(name, axis, share, 0.0, FINE, probability, math.nan, verdict, SOURCE, sentence)


def weigh(
    r: Array,
    variances: Array,
    nis: Array,
    components: Array,
    axes: Sequence[str],
    *,
    unit: str = "",
    probability: float = 0.01,
    gate: float = 0.0,
    along: Array | None = None,
) -> tuple[Finding, ...]:
    """Weigh the departures of one sensor's innovations, in time order; none where there are fewer than FEWEST.

    r, variances: (n, m), NaN in r where a component is missing; nis, components: (n,), of each measurement. axes: m names; unit: of r, for
    the sentences. probability: that a right filter shows any departure by chance, shared out evenly; gate: as of `consistency`.
    along: (n,) which measurements are judged by axis too (all, if not given): means and correlations say nothing of errors that the filter
    itself takes for lasting ones.
    """
    n, m = r.shape
    if n < FEWEST:
        return ()
    level = probability / (3 + 2 * m)
    size = max(1, round(float(components.mean())))
    found = [
        _size(nis, components, size, level, gate),
        _coverage(nis, components, level),
        _growth(r, variances, nis, components, level),
    ]
    for a, axis in enumerate(axes):
        there = np.isfinite(r[:, a]) if along is None else np.isfinite(r[:, a]) & along
        if np.count_nonzero(there) >= FEWEST:
            found += _of_axis(r[there, a], variances[there, a], axis, unit, level)
    return tuple(found)


def weigh_refusals(refused: int, count: int, probability: float = 0.01, gate: float = 0.0) -> Finding:
    """Weigh how many of all measurements were not used; arguments as of `weigh`."""
    share = refused / count if count else 0.0
    by_chance = count < FEWEST or distributions.binomial_survival(refused, count, gate) > probability
    numbers = f"{100.0 * share:.2g} % of {count}"
    return _finding(
        "refused", "", share, probability, by_chance, f"{numbers} were refused", f"is refused: {numbers} were not used"
    )


def _size(nis: Array, components: Array, size: int, level: float, gate: float) -> Finding:
    degrees = int(components.sum())
    ratio = float(nis.sum()) / degrees / _expected_in_gate(size, gate)
    by_chance = ratio <= ratio_bound(degrees, level)
    sentence = f"scatters {math.sqrt(ratio):.2g} times as much as the filter allows for"
    return _finding("size", "", share_of_scale(ratio, size), level, by_chance, sentence, sentence)


def _coverage(nis: Array, components: Array, level: float) -> Finding:
    n = len(nis)
    limits = np.array([math.inf, *(_region(k) for k in range(1, int(components.max()) + 1))])
    outside = int(np.count_nonzero(nis > limits[components]))
    by_chance = outside <= NOMINAL * n or distributions.binomial_survival(outside, n, NOMINAL) > level
    numbers = f"{100.0 * outside / n:.2g} % lie outside the region of 95 %"
    return _finding("coverage", "", outside / n, level, by_chance, numbers, f"has outliers: {numbers}")


def _growth(r: Array, variances: Array, nis: Array, components: Array, level: float) -> Finding:
    half = len(nis) // 2
    early, late = (float(nis[part].sum() / components[part].sum()) for part in (slice(half), slice(half, None)))
    degrees = int(components[:half].sum()), int(components[half:].sum())
    # both halves vary: the logarithm of their ratio has the variance 2/d + 2/d
    bound = math.exp(_normal_bound(level) * math.sqrt(2.0 / degrees[0] + 2.0 / degrees[1]))
    there = np.isfinite(r)
    variances = np.where(there, variances, 0.0)
    typical = variances.sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    by_axis = (variances / np.where(typical > 0.0, typical, 1.0)).sum(axis=1)
    surer = bool(by_axis[half:].sum() / degrees[1] <= by_axis[:half].sum() / degrees[0])
    halves = f"its squares were {early:.2g} times what the filter says in the first half and {late:.2g} in the second"
    return _finding(
        "growth",
        "",
        share_of_scale(late),
        level,
        not (surer and late > early * bound),
        f"does not diverge: {halves}",
        f"diverges: {halves}, and the filter grew surer",
    )


def _of_axis(r: Array, variances: Array, axis: str, unit: str, level: float) -> list[Finding]:
    u = r / np.sqrt(variances)
    long_run, error = long_run_variance(u)
    mean = float(u.mean())
    along = f" along {axis}" if axis else ""
    times = f"{math.sqrt(max(long_run, 0.0)):.2g} times as much"
    lasting = _finding(
        "lasting",
        axis,
        share_of_scale(long_run),
        level,
        long_run <= 1.0 + _normal_bound(level) * error,
        f"the mean of many{along} scatters {times} as the filter allows for",
        f"has errors{along} that last longer than the filter allows for: the mean of many scatters {times}",
    )
    spread = math.sqrt(max(long_run, float(u.var())) / len(u))
    size = f"{float(r.mean()):+.2g}{' ' + unit if unit else ''} in the mean, {abs(mean):.2g} of its sigma"
    by_chance = abs(mean) <= _normal_bound(0.5 * level) * spread
    biased = _finding("mean", axis, share_of_mean(mean), level, by_chance, f"{size}{along}", f"is off{along} by {size}")
    return [lasting, biased]
