"""The judgement of a session by its own innovations: what each sensor shows, in words for people and in findings for machines.

A sensor that is in use twice (two receivers) is judged twice. One with many measurements is judged by some of them (`stretches`).
"""

from dataclasses import dataclass

import numpy as np

from mavkf.diagnostics import Finding, judge_sensor
from mavkf.navigation import layout as L
from mavkf.replay.innovations import PROBABILITY, Innovations
from mavkf.replay.results import SessionResult

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
    found = session.tally.innovations.by_sensor(session.state[L.MAIN])
    return [_judge(each, session.setup.imu_rate_hz, details) for each in found]


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
