"""Drifts of a receiver whose velocity agrees with its position: how far they lead before they are noticed, if ever.

Such a drift is what the receiver would say of a real motion. Only its onset can be told from one, by the IMU, and only where it
is quicker than what the IMU may be wrong by: one receiver cannot bound it.
"""

import math
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.accuracy.common import head, row
from benchmarks.integrity.common import Settings, middle, pair, spread
from benchmarks.integrity.drawing import ACCELERATIONS, SPOOF
from benchmarks.integrity.flown import pool_of
from benchmarks.integrity.runs import FILTERS, Job, as_values, do
from mavkf.replay.export import columns

BANDS = (ACCELERATIONS[0], 0.05, 0.2, ACCELERATIONS[1])  # m/s^2: of the onset, from one to the next
COLUMNS = (
    "onset m/s^2",
    "filter",
    "runs",
    "noticed %",
    "noticed after s",
    "error then m",
    "never noticed: largest error m",
    "all: largest error m",
    "error above protection level %",
)


def measure(job: Job) -> dict[str, Any]:
    """One run, as JSON has it; `at_notice` and `largest` (m) are errors, `beyond`: whether one was above its protection level."""
    done = do(job)
    values = as_values(job, done) | {"acceleration": done.fault.acceleration}
    for name in FILTERS:
        track, told = done.tracks[name], done.scores[name].told
        during = (track.t >= done.fault.at) & (track.t < done.fault.end)
        pose = columns(done.outputs[name].poses)
        level = np.interp(track.t, pose["time_boot_s"], pose["pl_h_m"])
        error = track.error[during]
        values[name] |= {
            "at_notice": float(np.interp(done.fault.at + told, track.t, track.error)),
            "largest": float(np.nanmax(error, initial=0.0)),
            "beyond": bool(np.any(error > level[during])) if np.isfinite(level[during]).any() else None,
        }
    return values


def run(settings: Settings) -> dict[str, Any]:
    """Do the runs, and print their table by how quickly the velocity built up; pairs in it are median / 90 %."""
    pool, configs = pool_of(settings, settings.runs), (settings.config, settings.plain)
    numbers = range(settings.first, settings.first + settings.runs)
    runs = spread(settings, measure, [Job(SPOOF.fault, number, pool, configs) for number in numbers], "spoofed runs")
    head("spoof: position and velocity drift alike; pairs are median / 90 %", COLUMNS)
    result: dict[str, Any] = {"runs": runs, "summary": []}
    for low, high in pairwise(BANDS):
        mine = [each for each in runs if low <= each["acceleration"] < high]
        for name in FILTERS if mine else ():
            found = _summary([each[name] for each in mine])
            result["summary"].append({"from": low, "to": high, "filter": name, **found})
            row(
                f"{low:g} to {high:g}" if name == FILTERS[0] else "",
                name,
                str(found["runs"]),
                f"{100.0 * found['noticed']:.0f}",
                pair(found["told_s"]),
                pair(found["at_notice"]),
                pair(found["never_noticed"]),
                pair(found["largest"]),
                f"{100.0 * found['beyond']:.0f}" if math.isfinite(found["beyond"]) else "not known",
            )
    return result


def _summary(scores: list[dict[str, Any]]) -> dict[str, Any]:
    noticed = [each for each in scores if math.isfinite(each["told"])]
    beyond = [each["beyond"] for each in scores if each["beyond"] is not None]
    return {
        "runs": len(scores),
        "noticed": len(noticed) / len(scores),
        "told_s": middle(each["told"] for each in noticed),
        "at_notice": middle(each["at_notice"] for each in noticed),
        "never_noticed": middle(each["largest"] for each in scores if not math.isfinite(each["told"])),
        "largest": middle(each["largest"] for each in scores),
        "beyond": float(np.mean(beyond)) if beyond else math.nan,
    }
