"""Protection levels against errors: a Monte-Carlo with faults of every kind but spoofing, and all recorded flights."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.common import cell, estimate, head, read_rows, row
from benchmarks.accuracy.flights import FLIGHTS
from benchmarks.accuracy.flights import Flight as Recording
from benchmarks.integrity.common import Array, Settings, spread
from benchmarks.integrity.drawing import KINDS, draw_fault, seeded
from benchmarks.integrity.flown import Flown, fly_once
from benchmarks.integrity.intervals import clopper_pearson
from mavkf.config import Config
from mavkf.replay.export import columns
from mavkf.replay.faults import Fault
from mavkf.replay.options import Options
from mavkf.replay.run import run_rows
from mavkf.replay.truth import Truth, errors, read_truth

SEED, DURATION = 60_000, 900.0  # of the first simulated flight, and s of each
DRAWN = 48  # simulated; the faults, and the times of the samples, are others each time
BEGIN, EACH = 50.0, 60.0  # s: sampled from here, one sample each
BETWEEN = 270.0  # s, mean from the end of a fault to the begin of the next
FIRST_FAULT = 60.0  # s of boot time: none before
LAST_FAULT = 60.0  # s before the end: none begins after
RATE = 10.0  # Hz
MOST_SHARE, MOST_RATIO = 1e-3, 6.0  # of samples above their levels; of a level to its sigma in clean flight
LEVELS = {"horizontal": ("horizontal_m", "pl_h_m"), "vertical": ("down_m", "pl_v_m")}

Job = tuple[int, Path, Config]


def draw_faults(number: int, until: float) -> list[tuple[str, Fault]]:
    """The faults, with their kinds, of a flight that ends at a time, s: at random times, one each five minutes or so, one after another."""
    rng = seeded(SEED, number)
    found: list[tuple[str, Fault]] = []
    at = FIRST_FAULT + float(rng.exponential(BETWEEN))
    while at < until - LAST_FAULT:
        name = list(KINDS)[int(rng.integers(len(KINDS)))]
        found.append((name, draw_fault(rng, KINDS[name], (at, at), until)))
        at = found[-1][1].end + float(rng.exponential(BETWEEN))
    return found


def levels(poses: Array, truth: Truth) -> dict[str, Array]:
    """Of pose rows (n, POSE_WIDTH) from BEGIN on, while the truth is known: time (k), s, and error, level, sigma (k), m, of LEVELS."""
    pose = columns(poses)
    t = pose["time_boot_s"]
    use = (t >= max(BEGIN, truth.time_boot_s[0])) & (t <= truth.time_boot_s[-1])
    pose = {name: column[use] for name, column in pose.items()}
    found = errors(pose, truth).values
    result = {"time": pose["time_boot_s"]}
    for name, (error, level) in LEVELS.items():
        result[f"{name}_error"] = np.abs(found[error])
        result[f"{name}_level"] = pose[level]
    result["horizontal_sigma"] = np.hypot(pose["sigma_n_m"], pose["sigma_e_m"])
    result["vertical_sigma"] = pose["sigma_d_m"]
    return result


def in_simulated(job: Job) -> dict[str, Any]:
    """One flight with faults: samples [t, error, level], those above their levels, level over sigma before the first fault."""
    number, folder, config = job
    flown = fly_once(SEED + number % DRAWN, DURATION, folder, config)
    faults = draw_faults(number, flown.until)
    options = Options(rate_hz=RATE, config=config, faults=tuple(fault for _, fault in faults))
    found = levels(run_rows("1-1", flown.rows, options)[0][0].output.poses, flown.truth)
    phase = float(seeded(SEED, number, 1).uniform(0.0, EACH))
    times = np.arange(BEGIN + phase, flown.until, EACH)
    picked = np.searchsorted(found["time"], times)
    picked = picked[picked < found["time"].size]
    clean = found["time"] < min([fault.at for _, fault in faults], default=math.inf)
    result: dict[str, Any] = {"number": number, "flight": flown.name, "faults": [str(fault) for _, fault in faults]}
    result["phase_s"], result["exceeded"] = phase, []
    for name in LEVELS:
        error, level = found[f"{name}_error"], found[f"{name}_level"]
        ratio = (level / found[f"{name}_sigma"])[clean][:: round(RATE)]
        result[name] = {
            "samples": np.stack([found["time"], error, level])[:, picked].T.tolist(),
            "clean_ratio": ratio[np.isfinite(ratio)].tolist(),
            "largest_share": largest(error, level),
        }
        result["exceeded"] += _exceeded(name, result, flown, faults)
    return result


def _exceeded(name: str, result: dict[str, Any], flown: Flown, faults: list[tuple[str, Fault]]) -> list[dict[str, Any]]:
    """Each sample of a flight whose error is above its level, with the faults that had begun, the latest last."""
    return [
        {
            "number": result["number"],
            "flight": flown.name,
            "which": name,
            "t": t,
            "error": error,
            "level": level,
            "faults": [str(fault) for _, fault in faults if fault.at <= t + 1.0],
        }
        for t, error, level in result[name]["samples"]
        if error > level
    ]


def largest(error: Array, level: Array) -> float:
    """The largest share of errors (n) of their levels (n); NaN where none is known."""
    share = error / level
    share = share[np.isfinite(share)]
    return float(share.max()) if share.size else math.nan


def in_recorded(job: tuple[Path, Recording, Config]) -> dict[str, Any]:
    """The largest shares of errors of their levels in a recorded flight as live, also without its end, and level over sigma (median)."""
    folder, flight, config = job
    rows = read_rows(folder / f"{flight.log}.tlog", config, flight.vehicle)
    truth = read_truth(folder / f"{flight.truth or flight.log}.truth.csv")
    found = levels(estimate(rows, config).output.poses, truth)
    scored = found["time"] <= flight.end
    result: dict[str, Any] = {"flight": flight.name, "end": flight.end}
    for name in LEVELS:
        error, level = found[f"{name}_error"], found[f"{name}_level"]
        beyond = found["time"][error > level]
        ratio = level / found[f"{name}_sigma"]
        result[name] = {
            "largest_share": largest(error, level),
            "without_end": largest(error[scored], level[scored]),
            "ratio": float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else math.nan,
            "above": [float(beyond[0]), float(beyond[-1])] if beyond.size else [],
        }
    return result


def run(settings: Settings) -> dict[str, Any]:
    """Do the Monte-Carlo and the recorded flights, and print their tables."""
    each = int((DURATION - BEGIN) / EACH)  # samples a flight, at least
    count = -(-settings.samples // (each - 1))
    numbers = range(settings.first, settings.first + count)
    jobs: list[Job] = [(number, settings.work, settings.config) for number in numbers]
    flights = spread(settings, in_simulated, jobs, f"flights of {DURATION / 60.0:g} min with faults")
    head(
        "protection: errors above their levels, one sample each 60 s, faults but spoofing",
        ("level", "samples", "no level", "above", "share", "95 % interval of the share", "level / sigma, clean"),
    )
    summary = {name: _pooled(flights, name) for name in LEVELS}
    for name, found in summary.items():
        row(
            name,
            str(found["samples"]),
            str(found["unknown"]),
            str(found["above"]),
            cell(found["share"], MOST_SHARE, digits=5),
            f"{found['interval'][0]:.5f} to {found['interval'][1]:.5f}",
            cell(found["clean_ratio"], MOST_RATIO, digits=2),
        )
    exceeded = [one for flight in flights for one in flight["exceeded"]]
    if exceeded:
        head("protection: every error above its level", ("flight", "level", "at s", "error m", "level m", "last fault"))
    for one in exceeded:
        last = one["faults"][-1] if one["faults"] else "none"
        row(one["flight"], one["which"], f"{one['t']:.1f}", f"{one['error']:.2f}", f"{one['level']:.2f}", last)
    logs = [(settings.folder, flight, settings.config) for flight in FLIGHTS]
    recorded = spread(settings, in_recorded, logs, "recorded flights")
    _print_recorded(recorded)
    return {"summary": summary, "exceeded": exceeded, "flights": flights, "recorded": recorded}


def _print_recorded(flights: list[dict[str, Any]]) -> None:
    """The table of the recorded flights; of those that end with shocks also what comes before them."""
    head(
        f"protection: recorded flights from {BEGIN:g} s, largest error / level (from and to when it is above)",
        ("flight", *LEVELS, "without its end", *LEVELS, *(f"{name}: level / sigma" for name in LEVELS)),
    )
    for flight in flights:
        found = [flight[name] for name in LEVELS]
        ends = math.isfinite(flight["end"])
        row(
            flight["flight"],
            *(cell(each["largest_share"], 1.0, digits=2) + _span(each["above"]) for each in found),
            f"to {flight['end']:g} s" if ends else "",
            *(cell(each["without_end"], 1.0, digits=2) if ends else "" for each in found),
            *(cell(each["ratio"], digits=2) for each in found),
        )


def _span(times: list[float]) -> str:
    return f", {times[0]:.0f} to {times[1]:.0f} s" if times else ""


def _pooled(flights: list[dict[str, Any]], name: str) -> dict[str, Any]:
    """Of one of LEVELS: how many samples are known and above, their share and its interval, and the median of level over sigma."""
    samples = np.array([sample for flight in flights for sample in flight[name]["samples"]]).reshape(-1, 3)
    known = np.isfinite(samples).all(axis=1)
    count, above = int(known.sum()), int(np.sum(samples[known, 1] > samples[known, 2]))
    ratios = [ratio for flight in flights for ratio in flight[name]["clean_ratio"]]
    return {
        "samples": count,
        "unknown": int(np.sum(~known)),
        "above": above,
        "share": above / count if count else math.nan,
        "interval": clopper_pearson(above, count) if count else (math.nan, math.nan),
        "clean_ratio": float(np.median(ratios)) if ratios else math.nan,
    }
