"""GNSS cut out of a flight for a while: how far off the position is when the outage ends."""

from typing import Any

import numpy as np

from benchmarks.accuracy.common import Array, Settings, cell, estimate, head, read_rows, row, say
from mavkf.replay.export import columns
from mavkf.replay.truth import errors, read_truth
from mavkf.samples import KIND, TIME, Kind

FLIGHT = "ap01_copter_highrate"
STARTS = range(60, 201, 10)  # s of boot time
# length of an outage, s, and the most that the median of the horizontal error at its end may be, m
LENGTHS = ((10.0, 0.4), (20.0, 1.2), (30.0, 2.8))


def cut(rows: Array, begin: float, end: float) -> Array:
    """Timed rows (n, ROW_WIDTH) without the GNSS ones from `begin` to before `end`, s of boot time."""
    t = rows[:, TIME]
    left: Array = rows[~((rows[:, KIND] == Kind.GNSS) & (t >= begin) & (t < end))]
    return left


def run(settings: Settings) -> list[dict[str, Any]]:
    """Cut all windows out, one run each, and print the table of their ends."""
    rows = read_rows(settings.folder / f"{FLIGHT}.tlog", settings.config)
    truth = read_truth(settings.folder / f"{FLIGHT}.truth.csv")
    head("outages", ("outage s", "windows", "median m", "90 % m", "largest m", "error over sigma, rms per axis"))
    results = []
    for length, bar in LENGTHS:
        ends: list[dict[str, float]] = []
        for start in STARTS[:: 3 if settings.quick else 1]:
            end = start + length
            # nothing after the end is needed
            session = estimate(
                cut(rows[rows[:, TIME] <= end], start, end), settings.config, settings.as_live, rate_hz=10.0
            )
            pose = columns(session.output.poses)
            last = {name: column[-1:] for name, column in pose.items()}
            found = errors(last, truth).values
            ends.append(
                {
                    "start_s": float(start),
                    "end_s": float(last["time_boot_s"][0]),
                    "horizontal_m": float(found["horizontal_m"][0]),
                    "north_over_sigma": float(found["north_m"][0] / last["sigma_n_m"][0]),
                    "east_over_sigma": float(found["east_m"][0] / last["sigma_e_m"][0]),
                }
            )
            say(f"outage of {length:g} s from {start} s: {ends[-1]['horizontal_m']:.2f} m")
        error = np.array([end["horizontal_m"] for end in ends])
        ratio = np.array([[end["north_over_sigma"], end["east_over_sigma"]] for end in ends])
        result: dict[str, Any] = {
            "length_s": length,
            "median_m": float(np.median(error)),
            "p90_m": float(np.percentile(error, 90)),
            "max_m": float(error.max()),
            "error_over_sigma": float(np.sqrt(np.mean(ratio**2))),
            "windows": ends,
        }
        results.append(result)
        row(
            f"{length:g}",
            str(len(ends)),
            cell(result["median_m"], bar, digits=2),
            *(f"{result[key]:.2f}" for key in ("p90_m", "max_m", "error_over_sigma")),
        )
    return results
