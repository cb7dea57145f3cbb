"""Monte-Carlo: told the right noise, the filter's innovations and errors are as large as it says."""

from functools import cache

import numpy as np
import pytest

from mavkf.config import with_settings
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.navigation.offline import run_offline

from ._session import CONFIG, ORIGIN, RADII, motion, session

RUNS, BEGIN = 20, 112.0
# what `session` adds: 0.03 m/s^2 and 5e-4 rad/s at 100 Hz; 0.15 m/s of velocity, on a course that is known
TOLD = (
    "accelerometer=3e-3",
    "gyro=5e-5",
    "sampling=0",
    "gnss_speed_floor_m_s=0.15",
    "gnss_course_m_s=0",
    "accelerometer_bias_walk=1e-4",
    "gyro_bias_walk=1e-6",
    "use_barometer=false",
    "noise.gnss_colour=0",  # white noise only
    "gnss_colour_vertical=0",
    "gnss_delay_initial_s=0",
)


@cache
def monte_carlo() -> tuple[dict[Sensor, np.ndarray], np.ndarray]:
    """Innovation rows of each sensor after the start, and pose rows every 4 s, of all runs."""
    config = with_settings(CONFIG, TOLD)
    runs = [run_offline(session(duration=30.0, seed=100 + i), config, rate_hz=0.25).output for i in range(RUNS)]
    rows = np.concatenate([run.innovations for run in runs])
    rows = rows[rows[:, L.I_TIME] > BEGIN]
    poses = np.concatenate([run.poses[run.poses[:, L.R_TIME] > BEGIN] for run in runs])
    return {sensor: rows[rows[:, L.I_SENSOR] == sensor] for sensor in Sensor}, poses


def band(count: int, degrees: int) -> tuple[float, float]:
    """Where the mean of that many chi-square variables, per degree of freedom, lies but for one time in 10^4."""
    width = 3.9 * np.sqrt(2.0 / (count * degrees))
    return 1.0 - width, 1.0 + width


def test_innovations_of_position_are_as_large_as_said() -> None:
    rows = monte_carlo()[0][Sensor.GNSS_POSITION]
    assert rows.shape[0] > 1500
    low, high = band(rows.shape[0], 3)
    assert low < np.mean(rows[:, L.I_NIS]) / 3.0 < high
    assert np.mean(rows[:, L.I_FUSED]) > 0.999


def test_innovations_of_velocity_are_not_larger_than_said() -> None:
    # the vertical speed is given half as much noise again as is claimed: (1 + 1 + 1 / 2.25) / 3 = 0.81
    rows = monte_carlo()[0][Sensor.GNSS_VELOCITY]
    low, high = band(rows.shape[0], 3)
    assert 0.81 * low * 0.97 < np.mean(rows[:, L.I_NIS]) / 3.0 < 0.81 * high * 1.03


def test_innovations_of_position_are_white() -> None:
    rows = monte_carlo()[0][Sensor.GNSS_POSITION]
    r = rows[:, L.I_R : L.I_R + 3] / np.sqrt(rows[:, [L.I_S, L.I_S + 4, L.I_S + 8]])
    same_run = np.diff(rows[:, L.I_TIME]) > 0.0
    for axis in range(3):
        correlation = np.mean((r[1:, axis] * r[:-1, axis])[same_run])
        assert abs(correlation) < 3.9 / np.sqrt(np.sum(same_run))


@pytest.mark.parametrize("first", [0, 3], ids=["position", "attitude"])
def test_errors_are_as_large_as_said(first: int) -> None:
    poses = monte_carlo()[1]
    truth = motion(poses[:, L.R_TIME] - 100.0)
    if first == 0:
        error = origin_offset(poses) + poses[:, L.R_NED : L.R_NED + 3] - truth.p
    else:
        yaw = np.arctan2(truth.C_nb[:, 1, 0], truth.C_nb[:, 0, 0])
        euler = poses[:, L.R_EULER : L.R_EULER + 3]
        # level flight: dtheta_n in the axes of the heading is roll, pitch, yaw
        c, s = np.cos(yaw), np.sin(yaw)
        error = np.stack([c * euler[:, 0] - s * euler[:, 1], s * euler[:, 0] + c * euler[:, 1], euler[:, 2] - yaw], -1)
    P = poses[:, L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36].reshape(-1, 6, 6)[
        :, first : first + 3, first : first + 3
    ]
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error) / 3.0
    # poses 4 s apart are still correlated: the band is that of one independent value per run
    low, high = band(RUNS, 3)
    assert low < np.mean(nees) < high


def origin_offset(poses: np.ndarray) -> np.ndarray:
    """Metres (n, 3) from the true origin of `session` to the run's own."""
    north = (poses[:, L.R_ORIGIN_LATITUDE] - ORIGIN[0]) * RADII[0]
    east = (poses[:, L.R_ORIGIN_LONGITUDE] - ORIGIN[1]) * RADII[1] * np.cos(ORIGIN[0])
    return np.stack([north, east, ORIGIN[2] - poses[:, L.R_ORIGIN_HEIGHT]], -1)
