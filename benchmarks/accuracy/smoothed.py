"""Smoothed flights: errors against what a live run knew, and inside of outages that the smoother sees the other side of."""

from typing import Any

import numpy as np

from benchmarks.accuracy.common import QUANTITIES, Settings, cell, head, read_rows, row, say
from benchmarks.accuracy.flights import FLIGHTS, measure
from benchmarks.accuracy.outages import FLIGHT, STARTS, cut
from mavkf.replay.export import columns
from mavkf.replay.options import Options
from mavkf.replay.run import run_rows
from mavkf.replay.truth import errors, read_truth

MOST_TILT, MOST_YAW = 0.6, 0.7  # of the bars of a live run
# length of an outage, s, and the most that the median of the largest horizontal error inside may be, m
LENGTHS = ((10.0, 0.06), (20.0, 0.1), (30.0, 0.15))
WITHOUT = ("ap04b", "ap08a", "sih")  # no bar: their starts and gaps are what they are about


def run(settings: Settings) -> dict[str, Any]:
    """Measure flights, then outages, and print their tables."""
    return {"flights": _flights(settings), "outages": _outages(settings)}


def _flights(settings: Settings) -> list[dict[str, Any]]:
    head("smoothed", ("flight", "horizontal m", "down m", "tilt deg", "yaw deg", "error over sigma (the same)"))
    results = []
    for flight in FLIGHTS:
        if flight.name.startswith(WITHOUT):
            continue
        live = measure(settings.folder, flight, settings.config, True)["rms"]
        result = measure(settings.folder, flight, settings.config, False, smooth=True)
        bars = (live["horizontal_m"], live["down_m"], MOST_TILT * flight.bars[2], MOST_YAW * flight.bars[3])
        result["bars"] = dict(zip(QUANTITIES, bars, strict=True))
        results.append(result)
        cells = [cell(result["rms"][name], bar, digits=4) for name, bar in zip(QUANTITIES, bars, strict=True)]
        ratios = " / ".join(f"{result['error_over_sigma'].get(name, np.nan):.2f}" for name in QUANTITIES)
        row(result["flight"], *cells, ratios)
    return results


def _outages(settings: Settings) -> list[dict[str, Any]]:
    rows = read_rows(settings.folder / f"{FLIGHT}.tlog", settings.config)
    truth = read_truth(settings.folder / f"{FLIGHT}.truth.csv")
    options = Options(smooth=True, rate_hz=10.0, config=settings.config)
    head("smoothed outages", ("outage s", "windows", "median of the largest error inside m", "90 % m", "largest m"))
    results = []
    for length, bar in LENGTHS:
        most = []
        for start in STARTS[:: 3 if settings.quick else 1]:
            end = start + length
            session = run_rows("1-1", cut(rows, start, end), options)[0][0]
            poses = session.output.poses
            most.append(float(errors(columns(poses), truth, begin=start, end=end).values["horizontal_m"].max()))
            say(f"smoothed over an outage of {length:g} s from {start} s: at most {most[-1]:.2f} m")
        result: dict[str, Any] = {"length_s": length, "median_m": float(np.median(most)), "largest_m": most}
        results.append(result)
        row(
            f"{length:g}",
            str(len(most)),
            cell(result["median_m"], bar),
            *(f"{np.percentile(most, p):.3f}" for p in (90, 100)),
        )
    return results
