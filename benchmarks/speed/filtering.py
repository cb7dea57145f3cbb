"""Filtering: what the fold costs for an IMU sample, everything included, against inslib; and its pieces, against dense numpy."""

import math
from collections.abc import Callable
from functools import partial

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmarks.speed import inslib, pieces
from benchmarks.speed.measure import Figure, Settings, alone, figure, in_turns, missing, seconds
from mavkf.config import Config, with_settings
from mavkf.models.strapdown import N
from mavkf.navigation import layout as L
from mavkf.navigation import timeline
from mavkf.navigation.codes import SENSORS
from mavkf.navigation.estimator import BUFFER, SessionEstimator
from mavkf.navigation.events import EventOrder
from mavkf.replay.boot_clock import on_boot_clock
from mavkf.replay.tlog import read_tlog
from mavkf.samples import GYRO, KIND, SOURCE, TIME, Kind, Source

Array = NDArray[np.float64]
RATE_HZ = 50.0
IMU = Source.RAW_IMU
RUNS, SLOW_RUNS = 7, 3
PER_SAMPLE = "us an IMU sample"


class Flight(msgspec.Struct):
    """Rows (n, ROW_WIDTH) of the first vehicle, in order of arrival, with boot times; and how many samples of the IMU are among them."""

    rows: Array
    samples: int


def read(settings: Settings) -> Flight:
    """Read the flight."""
    log = read_tlog(settings.log)
    rows, _ = on_boot_clock(log.rows[log.vehicles()[0]], Config().timeline.window_s)
    return Flight(rows, int(((rows[:, KIND] == Kind.IMU) & (rows[:, SOURCE] == IMU)).sum()))


def fold(flight: Flight, *, model: str | None = None, config: Config | None = None) -> Callable[[], float]:
    """Give what folds the flight in the order of measurement: microseconds an IMU sample, events made before the clock runs."""
    config = config or Config()

    def once() -> float:
        estimator = SessionEstimator(config, RATE_HZ, IMU, model)
        estimator.decide(flight.rows)
        assert estimator.setup is not None
        order = EventOrder(estimator.setup, config.timeline.window_s)
        block = np.concatenate(list(order.push(flight.rows, last=True)))
        out = L.buffers(16 * BUFFER, BUFFER, SENSORS)
        poses = np.empty((len(block), L.POSE_WIDTH))

        def work() -> None:
            i, slot, count = 0, -1, 0
            while i < len(block):
                out[2][:] = 0
                i, n, slot = timeline.run_batch(
                    estimator.state, block, i, slot, estimator.parameters, RATE_HZ, poses[count:], out
                )
                count += n

        return 1e6 * seconds(work) / flight.samples

    return once


def as_live(flight: Flight) -> Callable[[], float]:
    """Give what folds the flight once in the order of arrival, late fixes into their place."""

    def once() -> float:
        estimator = SessionEstimator(Config(), RATE_HZ, IMU)

        def work() -> None:
            for i in range(0, len(flight.rows), 4096):
                for _ in estimator.push(flight.rows[i : i + 4096]):
                    pass

        return 1e6 * seconds(work) / flight.samples

    return once


def without_compass(flight: Flight) -> Flight:
    """The flight with no magnetometer and a vehicle that stays where it began its turn: the yaw bank runs from its first fix to its end."""
    rows = flight.rows[(flight.rows[:, KIND] != Kind.MAGNETOMETER)]
    still = rows[rows[:, TIME] < rows[0, TIME] + STANDING_S].copy()
    mine = (still[:, KIND] == Kind.IMU) & (still[:, SOURCE] == IMU)
    # a turn a minute is no rest, and shows no heading
    still[mine, GYRO + 2] += 2.0 * math.pi / 60.0
    return Flight(still, int(mine.sum()))


STANDING_S = 25.0


def run(settings: Settings) -> list[Figure]:
    """Measure the fold in its variants, then its pieces."""
    flight = read(settings)
    quiet = with_settings(Config(), ["integrity.monitors=false"])
    standing = without_compass(flight)
    works = {
        "fold": fold(flight),
        "quiet": fold(flight, config=quiet),
        "bank": fold(standing),
        "telemetry": fold(flight, model="telemetry"),
        "live": as_live(flight),
    }
    library = inslib.module()
    if library is not None:
        made = inslib.calls(flight.rows, IMU, Config().vehicle.gnss_delay_s or 0.085)
        epochs = sum(name == "update" for name, _ in made)
        works["inslib"] = lambda: 1e6 * inslib.run(library, made) / epochs
    took = in_turns(works, settings.runs(RUNS))
    main = took["fold"]
    title = "the fold"
    figures = []
    if library is None:
        figures.append(missing("inslib", "not installed: `pip install inslib`"))
        figures.append(alone(title, PER_SAMPLE, main, f"{settings.named}, in the order of measurement"))
    else:
        figures.append(
            figure(
                title,
                PER_SAMPLE,
                main,
                "inslib through Python",
                took["inslib"],
                f"{settings.named}, all fusions, gates, records",
            )
        )
        figures.append(alone("inslib through Python", PER_SAMPLE, took["inslib"], "its calls only"))
    for name, what, bound in (
        ("quiet", "the fold without monitors", "the rest is what monitors and protection levels cost"),
        ("bank", "the fold with 12 guesses of yaw", "no compass, on the ground: bound by 12 covariances a sample"),
        ("telemetry", "the telemetry model", "bound by Runge-Kutta moments, 4 stages a sample"),
        ("live", "as live", "bound by the samples since each late fix, folded again, and snapshots"),
    ):
        figures.append(figure(what, PER_SAMPLE, took[name], title, main, bound))
    return figures + _pieces(settings, main)


def _pieces(settings: Settings, main: list[float]) -> list[Figure]:
    took = in_turns(
        {
            "state": pieces.state_us,
            "covariance": pieces.covariance_us,
            "dense covariance": pieces.dense_covariance_us,
            **{f"update {m}": partial(pieces.update_us, m) for m in (1, 3)},
            **{f"dense update {m}": partial(pieces.dense_update_us, m) for m in (1, 3)},
        },
        len(main),
    )
    return [
        figure("prediction of the state", "us", took["state"], "the fold", main, "for each IMU sample"),
        figure(
            "prediction of the covariance",
            "us",
            took["covariance"],
            "dense numpy",
            took["dense covariance"],
            f"{N} error states, every 20 ms and at each update",
        ),
        *(
            figure(
                f"update with {m} row{'s' * (m > 1)}",
                "us",
                took[f"update {m}"],
                "dense numpy",
                took[f"dense update {m}"],
            )
            for m in (1, 3)
        ),
    ]
