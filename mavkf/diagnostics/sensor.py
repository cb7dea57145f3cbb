"""The judgement of one sensor's innovations: all diagnostics that need nothing else, as one record."""

import math
from collections.abc import Sequence

import numpy as np

from mavkf.diagnostics import bias, consistency, divergence, linearisation, normality, whiteness
from mavkf.diagnostics.records import Finding, SensorJudgement
from mavkf.errors import UsageError

Array = np.ndarray
GRAVEST_FIRST = ("broken", "off", "marginal", "fine", "unknown")


def judge_sensor(
    sensor: str,
    t: Array,
    r: Array,
    S: Array,
    fused: Array | None = None,
    *,
    axes: Sequence[str] | None = None,
    probability: float = 0.01,
    gate: float = 0.0,
    outside: Array | None = None,
) -> SensorJudgement:
    """Judge one sensor by its innovations, in time order.

    t: (n,) s; r: (n, m) innovations z - z_hat, NaN where a component is missing; S: (n, m, m) their covariances; fused: (n,) whether the
    filter used it (all, if not given): the rejected are counted and not judged. axes: m names for the sentences. probability: that a right
    filter has anything off at all, shared out evenly among the tests (Bonferroni). gate: the probability with which a right measurement is
    rejected for its NIS; outside: (k,) shares of `linearisation.outside`, if the Hessians are at hand. Raises UsageError for shapes.
    """
    t, r, S = (np.asarray(array, dtype=float) for array in (t, r, S))
    n, m = r.shape if r.ndim == 2 else (-1, -1)
    fused = np.ones(len(t), dtype=bool) if fused is None else np.asarray(fused, dtype=bool)
    if t.shape != (n,) or S.shape != (n, m, m) or fused.shape != (n,):
        raise UsageError(
            f"Shapes t {t.shape}, r {r.shape}, S {S.shape}, fused {fused.shape} must be (n,), (n, m), (n, m, m), (n,)."
        )
    names = [str(i + 1) for i in range(m)] if axes is None else list(axes)
    if len(names) != m:
        raise UsageError(f"There are {len(names)} names of axes for {m} components.")
    if not 0.0 < probability < 1.0:
        raise UsageError(f"The probability is {probability:g}; it must lie between 0 and 1.")
    # what the filter could not foretell (S unknown) says nothing about it
    variances = np.diagonal(S, axis1=1, axis2=2)
    r = np.where(np.isfinite(r) & np.isfinite(variances) & (variances > 0.0), r, np.nan)
    known = ~np.isnan(r).all(axis=1)
    used, rejected = fused & known, int(np.sum(~fused & known))
    t, r, S = t[used], r[used], S[used]
    level = probability / (3 + 6 * m)
    nis, components = consistency.squared(r, S)
    findings = [
        consistency.judge(nis, components, level, gate=gate),
        consistency.judge_share(nis, components, level, gate=gate),
        divergence.judge(r, S, level),
    ]
    u = r / np.sqrt(np.where(np.isnan(r), 1.0, np.diagonal(S, axis1=1, axis2=2)))
    for a, axis in enumerate(names):
        there = ~np.isnan(u[:, a])
        v = u[there, a]
        findings += [
            whiteness.judge_autocorrelation(v, level, axis),
            whiteness.judge_ljung_box(v, level, axis),
            whiteness.judge_periodogram(v, level, axis),
            normality.judge(v, level, axis),
            bias.judge_mean(v, level, axis),
            bias.judge_trend(t[there], v, level, axis),
        ]
    if outside is not None:
        findings.append(linearisation.judge(outside))
    verdict = next(grade for grade in GRAVEST_FIRST if any(finding.verdict == grade for finding in findings))
    return SensorJudgement(
        sensor, int(used.sum()), rejected, verdict, _sentence(sensor, verdict, findings), tuple(findings)
    )


def _sentence(sensor: str, verdict: str, findings: list[Finding]) -> str:
    """The worst finding of the gravest verdict: the least probable of a right filter."""
    if verdict == "fine":
        return f"{sensor}: nothing in its innovations speaks against the filter."
    if verdict == "unknown":
        return f"{sensor}: too few innovations to judge it."
    bad = [finding for finding in findings if finding.verdict in ("broken", "off", "marginal")]
    worst = min(
        (finding for finding in bad if finding.verdict == verdict),
        key=lambda finding: 0.0 if math.isnan(finding.p_value) else finding.p_value,
    )
    where = f" {worst.axis}" if worst.axis else ""
    return f"{sensor}{where}: {worst.sentence} ({worst.name}; {len(bad)} of {len(findings)} findings are not fine.)"
