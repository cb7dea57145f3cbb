"""Recorded flights with truth: root mean square of the errors, their bars, and error over claimed sigma."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.common import QUANTITIES, Settings, cell, head, row
from mavkf.config import Config
from mavkf.replay.export import columns
from mavkf.replay.options import Options
from mavkf.replay.run import run as replay
from mavkf.replay.truth import SIGMAS, errors, read_truth


@dataclass(frozen=True)
class Flight:
    """A recorded flight: its log and truth, the vehicle and time to score (s of boot time), and the bars (m, m, deg, deg)."""

    log: str
    bars: tuple[float, float, float, float]
    truth: str = ""
    vehicle: str | None = None
    begin: float = 50.0
    end: float = math.inf
    leave_out: tuple[float, float] | None = None

    @property
    def name(self) -> str:
        """How the table calls it."""
        return self.log.split("_")[0] + (f" {self.vehicle}" if self.vehicle else "")


FLIGHTS = (
    Flight("ap01_copter_highrate", (0.025, 0.025, 0.05, 0.12)),
    Flight("ap02_copter_gcs4hz", (0.05, 0.05, 0.27, 0.65)),
    Flight("ap03_copter_wind_gps_glitch_loss", (1.3, 0.70, 0.20, 0.80), end=285.0),
    Flight("ap04b_copter_nocompass_gsf", (0.08, 0.04, 0.13, 0.45), begin=66.0, end=190.0),
    Flight("ap05_plane_mission", (0.18, 0.09, 0.27, 0.28)),
    Flight("ap06_two_vehicles", (0.025, 0.03, 0.09, 0.13), truth="ap06_two_vehicles_v1", vehicle="1-1"),
    Flight("ap06_two_vehicles", (0.15, 0.06, 0.11, 0.12), truth="ap06_two_vehicles_v2", vehicle="2-1"),
    Flight("ap07_copter_long_stationary", (0.80, 0.45, 0.08, 0.30)),
    Flight("ap08a_lossy_of_ap01", (0.025, 0.03, 0.11, 0.36), truth="ap01_copter_highrate", leave_out=(139.0, 147.0)),
    Flight("sih_quad_box_orbit", (0.08, 0.035, 0.13, 0.33)),
)


def measure(folder: Path, flight: Flight, config: Config, as_live: bool, smooth: bool = False) -> dict[str, Any]:
    """Errors of one flight, by quantity: rms, error over sigma, coverage."""
    options = Options(as_live=as_live, config=config, vehicle=flight.vehicle, smooth=smooth)
    estimate = columns(replay(folder / f"{flight.log}.tlog", options).sessions[0].output.poses)
    if flight.leave_out is not None:
        t = estimate["time_boot_s"]
        keep = (t < flight.leave_out[0]) | (t > flight.leave_out[1])
        estimate = {name: column[keep] for name, column in estimate.items()}
    truth = read_truth(folder / f"{flight.truth or flight.log}.truth.csv")
    found = errors(estimate, truth, begin=flight.begin, end=flight.end).statistics
    return {
        "flight": flight.name,
        "rms": {name: found[name].rms if name in found else None for name in QUANTITIES},
        "bars": dict(zip(QUANTITIES, flight.bars, strict=True)),
        "coverage": {name: found[name].coverage if name in found else 0.0 for name in QUANTITIES},
        "error_over_sigma": {name: found[name].error_over_sigma for name in (*QUANTITIES, *SIGMAS) if name in found},
    }


def run(settings: Settings) -> list[dict[str, Any]]:
    """Measure all flights and print their table."""
    results = []
    head("flights", ("flight", "horizontal m", "down m", "tilt deg", "yaw deg", "error over sigma (the same)"))
    for flight in FLIGHTS:
        result = measure(settings.folder, flight, settings.config, settings.as_live)
        results.append(result)
        cells = [cell(result["rms"][name], result["bars"][name]) for name in QUANTITIES]
        ratios = " / ".join(f"{result['error_over_sigma'].get(name, np.nan):.2f}" for name in QUANTITIES)
        row(result["flight"], *cells, ratios)
    return results
