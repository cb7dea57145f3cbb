"""The judgement of a session by its own innovations: what each sensor shows, in words for people and in findings for machines.

A sensor that is in use twice (two receivers) is judged twice. One with more than MOST measurements is judged by STRETCHES stretches of
measurements in a row, evenly spread over the session.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavkf.diagnostics import Finding, judge_sensor
from mavkf.navigation import layout as L
from mavkf.replay.innovations import PROBABILITY, Innovations, by_sensor
from mavkf.replay.run import SessionResult

Array = NDArray[np.float64]
MOST, STRETCHES = 10_000, 20  # beyond that BLAS would start threads for each sum
GRADES = ("fine", "marginal", "broken")


@dataclass(frozen=True)
class Judgement:
    """What is found of one sensor.

    verdict: fine, marginal, broken, or unknown (too few); sentence: of the worst, None where there is nothing to say; consequences:
    departures by what they cost; findings: of all tests, whether it costs anything or not.
    """

    sensor: str
    source: str
    used: int
    refused: int
    verdict: str
    sentence: str | None
    consequences: tuple[Finding, ...]
    findings: tuple[Finding, ...]


def judge_session(session: SessionResult, details: bool = True) -> list[Judgement]:
    """All sensors of a session. details: with the findings of all tests, which take most of the time."""
    rows = session.output.innovations
    found = by_sensor(rows, speed_at(rows[:, L.I_TIME], session.output.poses), session.state[L.MAIN])
    return [_judge(thinned(each), session.setup.imu_rate_hz, details) for each in found]


def thinned(innovations: Innovations) -> Innovations:
    """All of them, or stretches where there are more than MOST."""
    n = len(innovations.rows)
    if n <= MOST:
        return innovations
    each = MOST // STRETCHES
    starts = np.linspace(0, n - each, STRETCHES).astype(int)
    return innovations.some((starts[:, None] + np.arange(each)).ravel())


def speed_at(t: Array, poses: Array) -> Array:
    """Horizontal speed (n,), m/s, at times (n,), of the next pose row; NaN where it is not known."""
    if not len(poses):
        return np.full(len(t), np.nan)
    k = np.clip(np.searchsorted(poses[:, L.R_TIME], t), 0, len(poses) - 1)
    return np.asarray(np.hypot(poses[k, L.R_V], poses[k, L.R_V + 1]))


def _judge(found: Innovations, imu_rate_hz: float, details: bool) -> Judgement:
    consequences = found.consequences()
    findings: tuple[Finding, ...] = ()
    if details:
        r, S = found.vectors()
        tests = judge_sensor(
            found.name, found.t, r, S, found.fused, axes=found.axes, probability=PROBABILITY, gate=found.gate
        )
        findings = tests.findings
    return Judgement(
        sensor=found.name,
        source=found.source.name,
        used=int(found.fused.sum()),
        refused=int(np.sum(~found.fused)),
        verdict=max((finding.verdict for finding in consequences), key=GRADES.index, default="unknown"),
        sentence=found.sentence(consequences, imu_rate_hz),
        consequences=consequences,
        findings=findings,
    )
