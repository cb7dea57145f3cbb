"""Runs with one fault each, under the filter and under a plain gate, and what many of them add up to."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.integrity.common import middle
from benchmarks.integrity.drawing import KINDS, SPOOF, Kind, draw_fault, seeded
from benchmarks.integrity.flown import load, member
from benchmarks.integrity.scoring import Score, Track, score, track
from benchmarks.integrity.signs import refused, told
from mavkf.config import Config
from mavkf.navigation.estimator import Output
from mavkf.replay.faults import Fault
from mavkf.replay.options import Options
from mavkf.replay.run import run_rows

RATE = 10.0  # Hz: of the poses that are scored
AFTERWARDS = 45.0  # s: scored after the end of a fault
FILTERS = ("mavkf", "plain gate")


@dataclass(frozen=True)
class Job:
    """One run: its kind (a key of KINDS, or "gnss-spoof") and number, the folder of the pool, and the settings of each of FILTERS."""

    kind: str
    number: int
    pool: Path
    configs: tuple[Config, Config]


@dataclass(frozen=True)
class Done:
    """What one run gave: its flight, its fault, and of each of FILTERS the score, the track of the error and the output."""

    flight: str
    fault: Fault
    scores: dict[str, Score]
    tracks: dict[str, Track]
    outputs: dict[str, Output]


def kind_of(name: str) -> Kind:
    """The kind of a name."""
    return SPOOF if name == SPOOF.fault else KINDS[name]


def do(job: Job) -> Done:
    """Put the run's fault into its flight, estimate it in the order of measurement under both filters, and score it."""
    kind, flown = kind_of(job.kind), load(job.pool, member(job.number))
    index = list(KINDS).index(job.kind) if job.kind in KINDS else len(KINDS)
    fault = draw_fault(seeded(index, job.number), kind, flown.onset, flown.until - AFTERWARDS / 3.0)
    end = min(fault.end + AFTERWARDS, flown.until)
    scores, tracks, outputs = {}, {}, {}
    for name, config in zip(FILTERS, job.configs, strict=True):
        options = Options(rate_hz=RATE, config=config, faults=(fault,), span=(-math.inf, end))
        output = run_rows("1-1", flown.rows, options)[0][0].output
        signs, right = (told(output), kind.events) if name == FILTERS[0] else (refused(output), kind.gates)
        tracks[name] = track(output.poses, flown.truth, kind.error, fault.at, end)
        scores[name] = score(tracks[name], fault.at, fault.end, signs, right)
        outputs[name] = output
    return Done(flown.name, fault, scores, tracks, outputs)


def as_values(job: Job, done: Done) -> dict[str, Any]:
    """A run as JSON has it."""
    scores = {name: asdict(each) | {"never": each.recovery == math.inf} for name, each in done.scores.items()}
    head = {"kind": job.kind, "number": job.number, "flight": done.flight, "fault": str(done.fault)}
    return head | {"size": done.fault.size} | scores


def summary(scores: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """What runs of one kind add up to: shares, and (median, 90 %) of times, s, and errors, in the unit of the kind's error."""
    found = list(scores)
    count = len(found)
    return {
        "runs": count,
        "named": sum(math.isfinite(each["named"]) for each in found) / count,
        "told": sum(math.isfinite(each["told"]) for each in found) / count,
        "told_s": middle(each["told"] for each in found),
        "named_s": middle(each["named"] for each in found),
        "before": middle(each["before"] for each in found),
        "after": middle(each["after"] for each in found),
        "recovery_s": middle(each["recovery"] for each in found),
        "early": sum(each["early"] for each in found) / count,
        "never": sum(each["never"] for each in found),
    }
