"""Faults drawn at random into simulated and recorded flights: how many are found and named, how soon, and how far the error goes."""

import math
from typing import Any

from benchmarks.accuracy.common import head, row
from benchmarks.integrity.common import Settings, pair, spread
from benchmarks.integrity.drawing import AXES, KINDS, Kind
from benchmarks.integrity.flown import pool_of
from benchmarks.integrity.runs import FILTERS, Job, as_values, do, summary
from mavkf.replay.faults import KINDS as FAULT_KINDS

COLUMNS = (
    "fault",
    "filter",
    "named right %",
    "noticed %",
    "sign in the 20 s before %",
    "noticed after s",
    "largest error before",
    "largest error after",
    "recovered after s",
    "never",
)
UNITS = {"horizontal_m": "m", "down_m": "m of height", "yaw_deg": "deg of yaw"}


def measure(job: Job) -> dict[str, Any]:
    """One run, as JSON has it."""
    return as_values(job, do(job))


def run(settings: Settings) -> dict[str, Any]:
    """Do the runs of every kind, and print their table; pairs in it are median / 90 %."""
    pool, configs = pool_of(settings, settings.runs), (settings.config, settings.plain)
    numbers = range(settings.first, settings.first + settings.runs)
    jobs = [Job(kind, number, pool, configs) for number in numbers for kind in KINDS]
    runs = spread(settings, measure, jobs, "runs with a fault, under two filters each")
    head(f"detection: {settings.runs} runs of each kind; pairs are median / 90 %", COLUMNS)
    result: dict[str, Any] = {"runs": runs, "summary": {}}
    for name, kind in KINDS.items():
        mine = [each for each in runs if each["kind"] == name]
        found = {each: summary(run[each] for run in mine) for each in FILTERS}
        result["summary"][name] = found
        for each in FILTERS:
            print_row(f"{name} ({UNITS[kind.error]})" if each == FILTERS[0] else "", each, found[each])
    _print_sizes(runs)
    return result


def _print_sizes(runs: list[dict[str, Any]]) -> None:
    """The shares found by the size of the fault, in thirds of its range."""
    head("detection by size: named right / noticed % by mavkf", ("fault", "sizes", "small", "middle", "large"))
    for name, kind in KINDS.items():
        if kind.sizes is None:
            continue
        thirds: list[list[dict[str, Any]]] = [[], [], []]
        for run in runs:
            if run["kind"] == name:
                thirds[min(2, int(3.0 * place_in_range(kind, run["size"])))].append(run[FILTERS[0]])
        unit = FAULT_KINDS[kind.fault].unit
        row(name, f"{kind.sizes[0]:g} to {kind.sizes[1]:g} {unit}", *(_shares(third) for third in thirds))


def place_in_range(kind: Kind, size: float) -> float:
    """Where a size lies in the range from which it was drawn, from 0, the smallest, to 1; a factor by how far it is from 1."""
    assert kind.sizes is not None
    low, high = kind.sizes
    if kind.towards == AXES:
        return abs(size - 1.0) / (high - 1.0)
    return math.log(size / low) / math.log(high / low)


def _shares(scores: list[dict[str, Any]]) -> str:
    if not scores:
        return "-"
    found = summary(scores)
    return f"{100.0 * found['named']:.0f} / {100.0 * found['told']:.0f}"


def print_row(name: str, which: str, found: dict[str, Any]) -> None:
    """One row of the table, of a summary."""
    row(
        name,
        which,
        f"{100.0 * found['named']:.0f}",
        f"{100.0 * found['told']:.0f}",
        f"{100.0 * found['early']:.0f}",
        pair(found["told_s"]),
        pair(found["before"]),
        pair(found["after"]),
        pair(found["recovery_s"]),
        str(found["never"]),
    )
