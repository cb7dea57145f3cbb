"""Simulated flights by the hundred: errors over claimed sigma, and normalised squares of the errors (NEES)."""

import math
from collections.abc import Iterable
from pathlib import Path
from statistics import NormalDist

import numpy as np

from benchmarks.accuracy.common import Array, estimate, read_rows
from mavkf.config import Config
from mavkf.models.earth import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS
from mavkf.navigation import layout as L
from mavkf.replay.export import columns
from mavkf.replay.simulation import SensorNoise, draw_noise, simulate
from mavkf.replay.simulation.flight import Vehicle
from mavkf.replay.truth import Statistics, Truth, errors

VEHICLES: tuple[Vehicle, ...] = ("copter", "plane")
IMU_RATES = (200.0, 50.0, 4.0)  # Hz
DURATION = 150.0  # s
BEGIN = 40.0  # s of boot time: scored from here
GNSS_DELAY, GNSS_DELAY_SIGMA = 0.085, 0.03  # s: of the flights' receivers, cut at two sigma
RATIOS = ("horizontal_m", "down_m", "velocity_ms", "tilt_deg", "yaw_deg")
BLOCKS = ("position", "velocity", "attitude")


def ratios(statistics: dict[str, Statistics]) -> dict[str, float]:
    """Error over sigma by the names of RATIOS; velocity is that of all three axes, NaN where nothing is known."""
    found = {name: each.error_over_sigma for name, each in statistics.items()}
    speeds = [found.get(name, math.nan) for name in ("vn_ms", "ve_ms", "vd_ms")]
    found["velocity_ms"] = math.sqrt(sum(x * x for x in speeds) / 3.0)
    return {name: found.get(name, math.nan) for name in RATIOS}


def drawn_flight(number: int, folder: Path, config: Config, as_live: bool) -> dict[str, float | str]:
    """Fly one flight with drawn sensors, estimate it: its vehicle, IMU rate, and error over sigma by the names of RATIOS."""
    rng = np.random.default_rng([20, number])
    vehicle, rate = VEHICLES[number % 2], IMU_RATES[number // 2 % 3]
    delay = GNSS_DELAY + GNSS_DELAY_SIGMA * float(np.clip(rng.standard_normal(), -2.0, 2.0))
    log = folder / "flight.tlog"
    truth = simulate(
        log,
        seed=1000 + number,
        duration_s=DURATION,
        vehicle=vehicle,
        imu_hz=rate,
        gnss_delay=delay,
        noise=draw_noise(rng),
    )
    poses = estimate(read_rows(log, config), config, as_live).output.poses
    found = errors(columns(poses), truth, begin=BEGIN).statistics
    return {"flight": float(number), "vehicle": vehicle, "imu_hz": rate, **ratios(found)}


def told_settings(noise: SensorNoise) -> list[str]:
    """Settings that tell the filter what the simulator does; what it would learn or doubt besides is switched off where it can be."""
    horizontal = math.hypot(noise.gnss_horizontal, noise.gnss_drift_horizontal)
    vertical = math.hypot(noise.gnss_vertical, noise.gnss_drift_vertical)
    pascal = 1.0 / (1.225 * 9.80665)  # m
    return [
        f"noise.gyro={math.hypot(noise.gyro_density, noise.gyro_vibration)}",
        f"noise.accelerometer={math.hypot(noise.accel_density, noise.accel_vibration)}",
        f"noise.gyro_bias_walk={noise.gyro_walk}",
        f"noise.accelerometer_bias_walk={noise.accel_walk}",
        f"noise.gyro_bias_initial={noise.gyro_bias}",
        f"noise.accelerometer_bias_initial={noise.accel_bias}",
        "noise.sampling=0.0",
        f"noise.gnss_position_floor_m={noise.gnss_horizontal}",
        f"noise.gnss_colour={noise.gnss_drift_horizontal / horizontal}",
        f"noise.gnss_colour_vertical={noise.gnss_drift_vertical / vertical}",
        f"noise.gnss_colour_time_s={noise.gnss_time_constant}",
        f"noise.gnss_speed_floor_m_s={noise.gnss_speed_horizontal}",
        "noise.gnss_course_m_s=0.0",
        "noise.gnss_delay_initial_s=0.0",
        "noise.gnss_delay_walk=0.0",
        f"noise.barometer_m={noise.baro_noise * pascal}",
        f"noise.barometer_walk={noise.baro_drift * pascal * math.sqrt(2.0 / noise.baro_time_constant)}",
        f"noise.magnetometer_t={noise.magnetometer_noise}",
        f"noise.magnetometer_bias_t={noise.hard_iron}",
        "noise.earth_field_t=1e-8",
    ]


def nees(poses: Array, truth: Truth, grid: Array) -> Array:
    """Normalised squares (k, 3) of the errors of position, velocity, attitude (BLOCKS) of the first poses from the times of a grid (k) on.

    poses: rows (n, POSE_WIDTH). NaN where the pose is not known.
    """
    rows = poses[np.clip(np.searchsorted(poses[:, L.R_TIME], grid), 0, poses.shape[0] - 1)]
    t = rows[:, L.R_TIME]
    at = [np.interp(t, truth.time_boot_s, column) for column in (truth.lat, truth.lon, truth.alt)]
    w = np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(at[0]) ** 2)
    north = (rows[:, L.R_LATITUDE] - at[0]) * SEMI_MAJOR_AXIS * (1.0 - ECCENTRICITY_SQUARED) / w**3
    east = (rows[:, L.R_LONGITUDE] - at[1]) * SEMI_MAJOR_AXIS / w * np.cos(at[0])
    place = np.stack([north, east, at[2] - rows[:, L.R_HEIGHT]], axis=1)
    speed = rows[:, L.R_V : L.R_V + 3] - np.stack(
        [np.interp(t, truth.time_boot_s, v) for v in truth.velocity.T], axis=1
    )
    # q_true = exp(dtheta) q, between neighbours of one hemisphere
    after = np.clip(np.searchsorted(truth.time_boot_s, t), 1, truth.time_boot_s.size - 1)
    before, step = truth.quaternion[after - 1], truth.quaternion[after]
    step *= np.sign(np.sum(before * step, axis=1, keepdims=True))
    share = (t - truth.time_boot_s[after - 1]) / np.diff(truth.time_boot_s)[after - 1]
    a, b, c, d = (before + share[:, None] * (step - before)).T
    p, x, y, z = rows[:, L.R_Q : L.R_Q + 4].T
    turn = 2.0 * np.stack(
        [b * p - a * x - c * z + d * y, c * p - a * y - d * x + b * z, d * p - a * z - b * y + c * x], axis=1
    )
    turn *= np.sign(a * p + b * x + c * y + d * z)[:, None]
    pose = rows[:, L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36].reshape(-1, 6, 6)
    velocity = rows[:, L.R_VELOCITY_COVARIANCE : L.R_VELOCITY_COVARIANCE + 9].reshape(-1, 3, 3)
    blocks = ((place, pose[:, :3, :3]), (speed, velocity), (turn, pose[:, 3:, 3:]))
    return np.stack([_normalised(error, P) for error, P in blocks], axis=1)


def _normalised(error: Array, P: Array) -> Array:
    known = np.isfinite(error).all(axis=1) & np.isfinite(P).all(axis=(1, 2))
    result = np.full(error.shape[0], np.nan)
    result[known] = np.einsum("ni,nij,nj->n", error[known], np.linalg.inv(P[known]), error[known])
    return result


def mean_band(count: int, degrees: int, probability: float = 0.95) -> tuple[float, float]:
    """Where the mean of `count` chi-square variables lies with a probability, by Wilson and Hilferty (1931)."""
    k, z = count * degrees, NormalDist().inv_cdf(0.5 + 0.5 * probability)
    low, high = (k * (1.0 - 2.0 / (9.0 * k) + s * z * math.sqrt(2.0 / (9.0 * k))) ** 3 / count for s in (-1.0, 1.0))
    return low, high


def told_flights(numbers: Iterable[int], folder: Path, config: Config, as_live: bool, grid: Array) -> Array:
    """NEES (flights, k, 3) of flights with the simulator's usual sensors and the IMU at 200 Hz; config: as told_settings say."""
    found = []
    for number in numbers:
        log = folder / "flight.tlog"
        truth = simulate(
            log, seed=5000 + number, duration_s=DURATION, vehicle=VEHICLES[number % 2], gnss_delay=GNSS_DELAY
        )
        poses = estimate(read_rows(log, config), config, as_live).output.poses
        found.append(nees(poses, truth, grid))
    return np.stack(found)
