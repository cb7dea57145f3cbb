"""A recorded flight whose receiver jumps, drifts and is lost: when each is told, and how far the position goes meanwhile."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.accuracy.common import cell, estimate, head, read_rows, row
from benchmarks.integrity.common import Settings
from benchmarks.integrity.drawing import HORIZONTAL
from benchmarks.integrity.scoring import track
from benchmarks.integrity.signs import OUTAGE, Sign, events_of, fault_events
from mavkf.replay.export import columns
from mavkf.replay.truth import errors, read_truth

BACK = "gnss_back"
FLIGHT, BEGIN, END = "ap03_copter_wind_gps_glitch_loss", 50.0, 285.0
MOST_RMS = 1.3  # m, horizontal, from BEGIN to END


@dataclass(frozen=True)
class Happening:
    """What happened to the receiver from `begin` to `end`, s of boot time, the events that name it, and its bars.

    rate: m/s by which the receiver was off more and more. most_delay: s until it is told. most_error: m, horizontal, meanwhile.
    """

    name: str
    begin: float
    end: float
    events: tuple[str, ...]
    rate: float = math.nan
    most_delay: float = math.inf
    most_error: float = math.inf


HAPPENINGS = (
    Happening("step of 40 m", 103.68, 111.67, ("gnss_jump", "gnss_drift")),
    Happening("drift of 12 m in 20 s", 149.37, 169.41, ("gnss_drift", "gnss_jump"), 0.6, 10.0, 3.5),
    Happening("loss", 175.42, 195.46, ("gnss_outage",), most_error=4.0),
)


def first_told(signs: list[Sign], happening: Happening) -> Sign | None:
    """The first event that names a happening: while it lasts, or an outage that had been told before and lasted when it began."""
    if OUTAGE in happening.events:
        before = [sign for sign in signs if sign.t < happening.begin and sign.kind in (OUTAGE, BACK)]
        if before and before[-1].kind == OUTAGE:
            return before[-1]
    during = (sign for sign in signs if happening.begin <= sign.t < happening.end)
    return next((sign for sign in during if sign.kind in happening.events), None)


def run(settings: Settings) -> dict[str, Any]:
    """Estimate the flight as live and print what was told and how far it went."""
    truth = read_truth(settings.folder / f"{FLIGHT}.truth.csv")
    output = estimate(read_rows(settings.folder / f"{FLIGHT}.tlog", settings.config), settings.config).output
    signs = events_of(output)
    names = ("what", "told as", "after s", "receiver off by m", "error then m", "largest error m")
    head(f"flights: {FLIGHT.split('_', maxsplit=1)[0]}", names)
    results = []
    for each in HAPPENINGS:
        run = track(output.poses, truth, HORIZONTAL, each.begin, each.end)
        first = first_told(signs, each)
        delay = max(0.0, first.t - each.begin) if first else math.nan
        then = float(np.interp(each.begin + delay, run.t, run.error)) if first else math.nan
        largest, off = float(np.nanmax(run.error)), delay * each.rate
        result: dict[str, Any] = {
            "what": each.name,
            "told_at_s": first.t if first else None,
            "event": first.kind if first else None,
            "text": first.text if first else None,
            "delay_s": delay,
            "receiver_off_m": off,
            "error_then_m": then,
            "largest_m": largest,
        }
        results.append(result)
        row(
            each.name,
            f"{first.kind} at {first.t:.1f} s" if first else "**not told**",
            cell(delay, each.most_delay, digits=1),
            cell(off, digits=1),
            cell(then, digits=2),
            cell(largest, each.most_error, digits=2),
        )
    rms = errors(columns(output.poses), truth, begin=BEGIN, end=END).statistics[HORIZONTAL].rms
    head(f"flights: horizontal rms from {BEGIN:g} to {END:g} s", ("flight", "m"))
    row(FLIGHT.split("_", maxsplit=1)[0], cell(rms, MOST_RMS))
    events = fault_events(output)
    if events:
        head("flights: every fault event", ("told at s", "event", "sentence"))
    for sign in events:
        row(f"{sign.t:.1f}", sign.kind, sign.text)
    return {"happenings": results, "rms_m": rms, "events": [[sign.t, sign.kind, sign.text] for sign in events]}
