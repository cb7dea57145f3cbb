"""The whole judgement of a session as plain values: its sensors, what it learnt, its linearisation, its covariance."""

import math
from dataclasses import asdict
from typing import Any

from mavkf.diagnostics import Finding
from mavkf.diagnostics.covariance import judge_condition, judge_symmetry
from mavkf.navigation import layout as L
from mavkf.replay.judgement import Judgement, judge_session
from mavkf.replay.learnt import learnt
from mavkf.replay.linearity import judge_linearity
from mavkf.replay.results import SessionResult


def diagnose(session: SessionResult, details: bool) -> dict[str, Any]:
    """What a session's innovations and end tell of its filter, of numbers, text and None.

    details: with the findings of all tests, which take most of the time. "said": a sentence for each thing that people should know.
    """
    sensors = judge_session(session, details)
    slow = [asdict(each) for each in learnt(session)]
    lines = {name: _finding(finding) for name, finding in judge_linearity(session).items()}
    P = L.covariance(session.state)
    covariance = [_finding(judge_condition(P)), _finding(judge_symmetry(P))]
    said = [each.sentence for each in sensors if each.sentence]
    said += [each["sentence"] for each in slow if each["sentence"]]
    said += [f"{name}: {finding['sentence']}" for name, finding in lines.items() if finding["verdict"] == "broken"]
    said += [finding["sentence"] for finding in covariance if finding["verdict"] == "broken"]
    return {
        "said": said,
        "sensors": {each.sensor: _sensor(each) for each in sensors},
        "learnt": [_numbers(each) for each in slow],
        "linearisation": lines,
        "covariance": covariance,
    }


def _sensor(judgement: Judgement) -> dict[str, Any]:
    return {
        "source": judgement.source,
        "used": judgement.used,
        "refused": judgement.refused,
        "verdict": judgement.verdict,
        "sentence": judgement.sentence,
        "consequences": [_finding(finding) for finding in judgement.consequences],
        "findings": [_finding(finding) for finding in judgement.findings],
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return _numbers(asdict(finding))


def _numbers(values: dict[str, Any]) -> dict[str, Any]:
    """The same with None for what is not finite, and numbers of six digits."""
    return {
        name: (float(f"{value:.6g}") if math.isfinite(value) else None) if isinstance(value, float) else value
        for name, value in values.items()
    }
