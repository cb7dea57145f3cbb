"""Fault events in flights without faults: each of them is false."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.accuracy.common import estimate, head, read_rows, row
from benchmarks.integrity.common import Settings, spread
from benchmarks.integrity.flown import fly
from benchmarks.integrity.signs import fault_events
from mavkf.config import Config
from mavkf.samples import TIME

RECORDED = (
    ("ap01_copter_highrate", None),
    ("ap02_copter_gcs4hz", None),
    ("ap05_plane_mission", None),
    ("ap06_two_vehicles", "1-1"),
    ("ap06_two_vehicles", "2-1"),
    ("ap07_copter_long_stationary", None),
    ("sih_quad_box_orbit", None),
)
SEED, DURATION = 50_000, 900.0  # of the first simulated flight, and s of each
MOST_RECORDED, HOURS_OF_ONE = 1, 10.0  # events in all recorded flights, and hours of simulated flight that may have one

Recording = tuple[Path, str, str | None, Config]
Simulated = tuple[int, Path, Config]


def in_recorded(job: Recording) -> dict[str, Any]:
    """The fault events of a recorded flight, as live."""
    folder, log, vehicle, config = job
    rows = read_rows(folder / f"{log}.tlog", config, vehicle)
    name = log.split("_", maxsplit=1)[0] + (f" {vehicle}" if vehicle else "")
    hours = float(rows[:, TIME].max() - rows[:, TIME].min()) / 3600.0
    events = fault_events(estimate(rows, config, as_live=True, rate_hz=1.0).output)
    return {"flight": name, "hours": hours, "events": [asdict(event) for event in events]}


def in_simulated(job: Simulated) -> dict[str, Any]:
    """The fault events of a simulated flight, in the order of measurement."""
    number, folder, config = job
    flown = fly(SEED + number, DURATION, folder, config)
    events = fault_events(estimate(flown.rows, config, as_live=False, rate_hz=1.0).output)
    return {"flight": flown.name, "hours": DURATION / 3600.0, "events": [asdict(event) for event in events]}


def run(settings: Settings) -> dict[str, Any]:
    """Count the events of all flights, print the counts and every event."""
    logs: list[Recording] = [(settings.folder, log, vehicle, settings.config) for log, vehicle in RECORDED]
    count = round(settings.hours * 3600.0 / DURATION)
    numbers = range(settings.first, settings.first + count)
    flights: list[Simulated] = [(number, settings.work, settings.config) for number in numbers]
    recorded = spread(settings, in_recorded, logs, "recorded flights without faults")
    simulated = spread(settings, in_simulated, flights, f"simulated flights of {DURATION / 60.0:g} min without faults")
    head("false: fault events in flights without faults", ("flights", "hours", "events", "at most"))
    for name, found, most in (
        (f"{len(recorded)} recorded", recorded, float(MOST_RECORDED)),
        (f"{len(simulated)} simulated", simulated, sum(each["hours"] for each in simulated) / HOURS_OF_ONE),
    ):
        hours, events = sum(each["hours"] for each in found), sum(len(each["events"]) for each in found)
        row(name, f"{hours:.2f}", f"**{events}**" if events > most else str(events), f"{most:g}")
    wrong = [(each["flight"], event) for each in (*recorded, *simulated) for event in each["events"]]
    if wrong:
        head("false: every event", ("flight", "told at s", "event", "sentence"))
    for flight, event in wrong:
        row(flight, f"{event['t']:.1f}", event["kind"], event["text"])
    return {"recorded": recorded, "simulated": simulated}
