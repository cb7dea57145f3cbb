"""Whether the filter is as good as it says: error over claimed sigma, and NEES where it is told the truth about the noise."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.common import Settings, cell, estimate, head, read_rows, row, say
from benchmarks.accuracy.monte_carlo import (
    BLOCKS,
    IMU_RATES,
    RATIOS,
    drawn_flight,
    mean_band,
    ratios,
    told_flights,
    told_settings,
)
from mavkf.config import with_settings
from mavkf.replay.export import columns
from mavkf.replay.simulation import SensorNoise
from mavkf.replay.truth import errors, read_truth

FLIGHT, BEGIN, END = "ap03_copter_wind_gps_glitch_loss", 50.0, 285.0
# s: a step and a drift of the receiver, which nobody can tell from motion while they last
LEFT_OUT = ((103.0, 114.0), (149.0, 197.0))
RECORDED_BAND, POOLED_BAND = (0.3, 1.5), (0.7, 1.4)
FLIGHTS, TOLD_FLIGHTS = (100, 12), (40, 10)  # simulated, all and quick
GRID = np.arange(40.0, 148.0, 2.0)  # s
LEAST_SHARE = 0.9  # of the grid's times at which the mean NEES lies in its band


def recorded(settings: Settings) -> dict[str, float]:
    """Error over sigma, by the names of RATIOS, on the recorded flight with a receiver that misbehaves."""
    rows = read_rows(settings.folder / f"{FLIGHT}.tlog", settings.config)
    pose = columns(estimate(rows, settings.config, settings.as_live).output.poses)
    t = pose["time_boot_s"]
    keep = np.all([(t < low) | (t > high) for low, high in LEFT_OUT], axis=0)
    truth = read_truth(settings.folder / f"{FLIGHT}.truth.csv")
    pose = {name: column[keep] for name, column in pose.items()}
    return ratios(errors(pose, truth, begin=BEGIN, end=END).statistics)


def pooled(flights: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Of each of RATIOS the root mean square over flights, their median, and how many flights do not know it."""
    result = {}
    for name in RATIOS:
        values = np.array([flight[name] for flight in flights])
        known = values[np.isfinite(values)]
        nothing = known.size == 0
        result[name] = {
            "pooled": np.nan if nothing else float(np.sqrt(np.mean(known**2))),
            "median": np.nan if nothing else float(np.median(known)),
            "unknown": float(values.size - known.size),
        }
    return result


def run(settings: Settings) -> dict[str, Any]:
    """The recorded flight, the pool of drawn ones, and NEES; print their tables."""
    names = [name.split("_")[0] for name in RATIOS]
    head("honesty: error over sigma", ("flights", *names))
    found = recorded(settings)
    low, high = RECORDED_BAND
    row(FLIGHT.split("_", maxsplit=1)[0], *(cell(found[name], high, low, 2) for name in RATIOS))
    result: dict[str, Any] = {"recorded": found}

    quick = int(settings.quick)
    low, high = POOLED_BAND
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flights = []
        for number in range(FLIGHTS[quick]):
            flights.append(drawn_flight(number, folder, settings.config, settings.as_live))
            if number % 10 == 9:
                say(f"{number + 1} of {FLIGHTS[quick]} simulated flights")
        pool = pooled(flights)
        count = len(flights)
        row(f"{count} simulated, pooled", *(cell(pool[q]["pooled"], high, low, 2) for q in RATIOS))
        row(f"{count} simulated, median", *(cell(pool[q]["median"], high, low, 2) for q in RATIOS))
        for rate in IMU_RATES:
            mine = [flight for flight in flights if flight["imu_hz"] == rate]
            row(f"those with the IMU at {rate:g} Hz, pooled", *(f"{pooled(mine)[q]['pooled']:.2f}" for q in RATIOS))
        result |= {"simulated": flights, "pooled": pool}

        told = with_settings(settings.config, told_settings(SensorNoise()))
        squares = told_flights(range(TOLD_FLIGHTS[quick]), folder, told, settings.as_live, GRID)
    bounds = mean_band(squares.shape[0], 3)
    mean = np.mean(squares, axis=0)
    share = np.mean((mean > bounds[0]) & (mean < bounds[1]), axis=0)
    head(
        f"honesty: NEES of {squares.shape[0]} simulated flights, noise told",
        (
            "block",
            f"share of times in {bounds[0]:.2f} to {bounds[1]:.2f}",
            "below",
            "above",
            "mean NEES per degree of freedom",
        ),
    )
    for i, block in enumerate(BLOCKS):
        row(
            block,
            cell(float(share[i]), least=LEAST_SHARE, digits=2),
            f"{np.mean(mean[:, i] <= bounds[0]):.2f}",
            f"{np.mean(mean[:, i] >= bounds[1]):.2f}",
            f"{np.mean(mean[:, i]) / 3.0:.2f}",
        )
    result["nees"] = {"band": bounds, "share": dict(zip(BLOCKS, share, strict=True)), "grid_s": GRID, "mean": mean}
    return result
