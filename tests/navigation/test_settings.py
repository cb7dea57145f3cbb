"""No setting does nothing: each changes what the estimator makes of a flight in which everything happens."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from mavkf.config import Config, settings, with_settings
from mavkf.navigation.estimator import SessionEstimator
from mavkf.navigation.offline import run_offline
from mavkf.samples import GNSS_YAW, GYRO, KIND, LATITUDE, SIGMA_HORIZONTAL, SIGMA_SPEED, TIME, VELOCITY_N, Kind

from ._session import RADII, run, session

# other values than the defaults; those of `timeline` are tested below
OTHER: dict[str, Any] = {
    "vehicle.gnss_delay_s": 0.2,
    "vehicle.imu_delay_s": 0.01,
    "vehicle.magnetometer_delay_s": 0.02,
    "vehicle.barometer_delay_s": 0.03,
    "vehicle.magnetic_declination_deg": 5.0,
    "vehicle.imu_rotation_deg": [180.0, 0.0, 0.0],
    "vehicle.gnss_antenna_b_m": [0.3, 0.0, -0.1],
    "vehicle.estimate_antenna": "true",
    "vehicle.use_magnetometer": "false",
    "vehicle.use_barometer": "false",
    "vehicle.use_rest": "false",
    "vehicle.use_gnss_yaw": "false",
    "vehicle.use_class": "false",
    "vehicle.use_motion_yaw": "false",
    "gates.reset_s": 3.0,
    "integrity.monitors": "false",
    "integrity.suspicion_s": 1.0,
    "integrity.risk": 1e-2,
    "gates.gap_s": 1.5,
    "model.telemetry": "false",
    "model.even_hz": 8.0,
    "model.compare_hz": 0.0,
}
NAMES = [(name, default) for name, default, *_ in settings() if not name.startswith("timeline.")]


@cache
def flight() -> np.ndarray:
    """Half a minute: a turn at first, a field that comes late, a pause of the IMU, claims missing or too good,
    a short jump of a receiver that tells its velocity, a lasting one of one that does not.
    """
    rows = session(duration=28.0)
    t = rows[:, TIME]
    drop = (rows[:, KIND] == Kind.MAGNETOMETER) & (t < 104.0)
    drop |= (rows[:, KIND] == Kind.IMU) & (t > 111.0) & (t < 111.9)
    silent = (rows[:, KIND] == Kind.GNSS) & (np.arange(rows.shape[0]) % 2 == 0)
    rows[np.ix_(silent, range(SIGMA_HORIZONTAL, SIGMA_SPEED + 1))] = np.nan
    rows[(rows[:, KIND] == Kind.GNSS) & (np.arange(rows.shape[0]) % 8 == 1), SIGMA_HORIZONTAL] = 0.1
    rows[(rows[:, KIND] == Kind.IMU) & (t < 101.5), GYRO] += 0.1
    jumps = (rows[:, KIND] == Kind.GNSS) & (((t > 113.0) & (t < 115.5)) | (t > 118.0))
    rows[jumps, LATITUDE] += 60.0 / RADII[0]
    rows[(rows[:, KIND] == Kind.GNSS) & (t > 117.0), VELOCITY_N : VELOCITY_N + 3] = np.nan
    rows[(rows[:, KIND] == Kind.GNSS) & (t > 115.0), GNSS_YAW] = 0.4
    return rows[~drop]


@cache
def slow_flight() -> np.ndarray:
    """The same with an IMU at about 4 Hz."""
    rows = flight()
    samples = np.flatnonzero((rows[:, KIND] == Kind.IMU) | (rows[:, KIND] == Kind.MAGNETOMETER))
    keep = np.ones(rows.shape[0], dtype=bool)
    keep[samples] = np.floor(4.0 * rows[samples, TIME]) != np.floor(4.0 * np.r_[-1.0, rows[samples[:-1], TIME]])
    return rows[keep]


def outcome(config: Config, rows: np.ndarray) -> bytes:
    result = run_offline(rows, config, rate_hz=1.0)
    return result.state.tobytes() + result.output.innovations.tobytes() + result.output.poses.tobytes()


@cache
def default_outcome(slow: bool) -> bytes:
    return outcome(Config(), slow_flight() if slow else flight())


def test_the_same_settings_give_the_same_outcome() -> None:
    assert outcome(with_settings(Config(), []), flight()) == default_outcome(slow=False)


@pytest.mark.parametrize(("name", "default"), NAMES, ids=[name for name, _ in NAMES])
def test_every_setting_changes_something(name: str, default: Any) -> None:
    value = OTHER[name] if name in OTHER else 1.5 * default
    slow = name.startswith("model.")
    config = with_settings(Config(), [f"{name}={value}"])
    changed = outcome(config, slow_flight() if slow else flight()) != default_outcome(slow)
    assert changed


def test_the_window_decides_what_is_late() -> None:
    rows = session(duration=12.0)
    i = int(np.flatnonzero((rows[:, KIND] == Kind.GNSS) & (rows[:, TIME] > 107.0))[0])
    later = int(np.flatnonzero(rows[:, TIME] > rows[i, TIME] + 1.5)[0])
    late = np.concatenate([rows[:i], rows[i + 1 : later], rows[i : i + 1], rows[later:]])
    counts = [run(late, config=with_settings(Config(), [f"window_s={w}"]))[0].late for w in (1.0, 2.0)]
    assert counts == [1, 0]


@pytest.mark.parametrize("setup_s", [2.0, 5.0, 8.0])
def test_the_set_up_ends_when_its_time_is_over(setup_s: float) -> None:
    estimator = SessionEstimator(with_settings(Config(), [f"setup_s={setup_s}"]))
    rows = session(duration=12.0)
    for row in rows:
        for _ in estimator.push(row[None, :]):
            pass
        if estimator.setup is not None:
            break
    assert row[TIME] - rows[rows[:, KIND] == Kind.IMU, TIME].min() == pytest.approx(setup_s, abs=0.3)
