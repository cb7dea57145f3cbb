"""Flights without faults: simulated ones with drawn sensors, and recorded ones, kept as sample rows into which faults are put."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.accuracy.common import read_rows
from benchmarks.accuracy.monte_carlo import GNSS_DELAY, GNSS_DELAY_SIGMA, VEHICLES
from benchmarks.integrity.common import Array, Settings, spread
from benchmarks.integrity.drawing import seeded
from mavkf.config import Config
from mavkf.replay.simulation import draw_noise, simulate
from mavkf.replay.truth import Truth, read_truth

IMU_RATES = (200.0, 50.0)  # Hz
POOL, POOL_SEED, POOL_DURATION = 24, 40_000, 280.0  # flights, their seeds from here, s
ONSET = (75.0, 110.0)  # s of boot time: a fault of a simulated flight of the pool begins; a minute or more in the air
LANDING = 15.0  # s
RECORDED_EACH = 4  # each fourth run is one of a recorded flight


@dataclass(frozen=True)
class Recorded:
    """A recorded flight without faults: its name, when a fault may begin, and when the flight is over, s of boot time."""

    log: str
    onset: tuple[float, float]
    until: float


RECORDED = (
    Recorded("ap01_copter_highrate", (75.0, 120.0), 240.0),
    Recorded("ap05_plane_mission", (60.0, 95.0), 172.0),
    Recorded("ap07_copter_long_stationary", (256.0, 285.0), 336.0),
    Recorded("sih_quad_box_orbit", (75.0, 110.0), 205.0),
)


@dataclass(frozen=True)
class Flown:
    """A flight without faults.

    name: for people; rows (n, ROW_WIDTH), in the order of arrival; truth; onset: when a fault may begin; until: when the flight is over
    (s of boot time).
    """

    name: str
    rows: Array
    truth: Truth
    onset: tuple[float, float]
    until: float


def fly(seed: int, duration: float, folder: Path, config: Config) -> Flown:
    """A simulated flight with sensors drawn from a seed; even seeds are copters, and of each two one has the IMU at 200 Hz."""
    rng = seeded(seed)
    vehicle, rate = VEHICLES[seed % 2], IMU_RATES[seed // 2 % 2]
    delay = GNSS_DELAY + GNSS_DELAY_SIGMA * float(np.clip(rng.standard_normal(), -2.0, 2.0))
    log = folder / f"flight-{os.getpid()}.tlog"
    noise = draw_noise(rng)
    truth = simulate(log, seed=seed, duration_s=duration, vehicle=vehicle, imu_hz=rate, gnss_delay=delay, noise=noise)
    rows = read_rows(log, config)
    log.unlink()
    return Flown(f"{vehicle} {seed}, IMU {rate:g} Hz", rows, truth, ONSET, duration - LANDING)


def fly_once(seed: int, duration: float, folder: Path, config: Config) -> Flown:
    """What `fly` gives, flown the first time and read from the folder from then on."""
    path = folder / f"{seed}-{duration:g}.npy"
    if not path.exists():
        flown = fly(seed, duration, folder, config)
        part = path.with_name(f"part-{os.getpid()}.npy")
        _save(part, flown)
        _truth_of(part).replace(_truth_of(path))
        part.replace(path)  # last, since its being there says that all is
    rate = IMU_RATES[seed // 2 % 2]
    rows, truth = _load(path)
    return Flown(f"{VEHICLES[seed % 2]} {seed}, IMU {rate:g} Hz", rows, truth, ONSET, duration - LANDING)


def _truth_of(path: Path) -> Path:
    return path.with_name(f"{path.stem}-truth.npy")


def _save(path: Path, flown: Flown) -> None:
    truth = flown.truth
    table = np.column_stack([truth.time_boot_s, truth.lat, truth.lon, truth.alt, truth.velocity, truth.euler])
    np.save(_truth_of(path), table)
    np.save(path, flown.rows)


def _load(path: Path) -> tuple[Array, Truth]:
    table = np.load(_truth_of(path))
    truth = Truth(table[:, 0], table[:, 1], table[:, 2], table[:, 3], table[:, 4:7], table[:, 7:10])
    return np.load(path, mmap_mode="r"), truth


def recorded(folder: Path, flight: Recorded, config: Config) -> Flown:
    """A recorded flight."""
    truth = read_truth(folder / f"{flight.log}.truth.csv")
    name = flight.log.split("_", maxsplit=1)[0]
    return Flown(name, read_rows(folder / f"{flight.log}.tlog", config), truth, flight.onset, flight.until)


def pool_of(settings: Settings, runs: int) -> Path:
    """Fly and read as many flights of the pool as some runs need, and keep them in a folder, which is returned."""
    folder = settings.work / "pool"
    folder.mkdir(exist_ok=True)
    needed = sorted({member(settings.first + run) for run in range(runs)})
    missing = [number for number in needed if not (folder / f"{number}.npy").exists()]
    if missing:
        jobs = [(number, folder, settings.folder, settings.config) for number in missing]
        spread(settings, _keep, jobs, "flights made ready")
    return folder


def member(run: int) -> int:
    """Number of the flight of the pool that a run uses; the recorded ones come after the simulated ones."""
    lap, place = divmod(run, RECORDED_EACH)
    if place == RECORDED_EACH - 1:
        return POOL + lap % len(RECORDED)
    return (lap * (RECORDED_EACH - 1) + place) % POOL


def _keep(job: tuple[int, Path, Path, Config]) -> None:
    number, folder, recordings, config = job
    if number < POOL:
        flown = fly(POOL_SEED + number, POOL_DURATION, folder, config)
    else:
        flown = recorded(recordings, RECORDED[number - POOL], config)
    _save(folder / f"{number}.npy", flown)


def load(folder: Path, number: int) -> Flown:
    """A flight of the pool."""
    rows, truth = _load(folder / f"{number}.npy")
    if number >= POOL:
        flight = RECORDED[number - POOL]
        return Flown(flight.log.split("_", maxsplit=1)[0], rows, truth, flight.onset, flight.until)
    rate = IMU_RATES[number // 2 % 2]
    name = f"{VEHICLES[number % 2]} {POOL_SEED + number}, IMU {rate:g} Hz"
    return Flown(name, rows, truth, ONSET, POOL_DURATION - LANDING)
