"""Nothing that a sample can hold reaches a pose as NaN, or leaves the estimate wrecked once good samples follow."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavkf.models.strapdown import BARO
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.samples import KIND, TIME, Kind

from ._session import position_error, run, session

Array = np.ndarray
FLIGHT = session(duration=16.0)
VALUES = {Kind.GNSS: range(8, 23), Kind.IMU: range(8, 17), Kind.MAGNETOMETER: range(8, 11), Kind.BAROMETER: (8,)}
BAD = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e9, -1e9, 1e30, 1e200, -1e308, 5e-324)


def check(rows: Array) -> Array:
    """Poses of a run, which must be finite where they claim to be valid, with covariances that are some."""
    estimator, output = run(rows)
    poses = output.poses
    parts = {
        L.VALID_POSITION: [L.R_LATITUDE, L.R_LONGITUDE, L.R_HEIGHT, L.R_POSE_COVARIANCE, L.R_POSE_COVARIANCE + 7],
        L.VALID_VELOCITY: [L.R_V, L.R_V + 1, L.R_V + 2, *range(L.R_VELOCITY_COVARIANCE, L.R_VELOCITY_COVARIANCE + 9)],
        L.VALID_TILT: [L.R_EULER, L.R_EULER + 1, L.R_SIGMA_EULER, L.R_SIGMA_EULER + 1],
        L.VALID_YAW: [*range(L.R_Q, L.R_Q + 4), L.R_EULER + 2, L.R_SIGMA_EULER + 2],
    }
    assert np.all(np.isfinite(poses[:, [L.R_TIME, L.R_MODE, L.R_FLAGS, L.R_VALID]]))
    valid = poses[:, L.R_VALID].astype(int)
    for bit, columns in parts.items():
        assert np.all(np.isfinite(poses[(valid & bit) != 0][:, columns])), bit
    P = L.covariance(estimator.state)
    assert np.all(np.isfinite(P))
    np.testing.assert_array_equal(P, P.T)
    assert np.all(np.diag(P) >= 0.0)
    assert np.all(np.isfinite(estimator.state[: BARO + 1]))
    return poses


def corrupted(count: int, seed: int, kinds: tuple[Kind, ...]) -> Array:
    random = np.random.default_rng(seed)
    rows = FLIGHT.copy()
    for i in random.choice(np.flatnonzero(np.isin(rows[:, KIND], kinds)), count, replace=False):
        columns = VALUES[Kind(int(rows[i, KIND]))]
        for column in random.choice(list(columns), random.integers(1, len(columns) + 1), replace=False):
            rows[i, column] = random.choice(BAD)
    return rows


@pytest.mark.parametrize("kind", list(VALUES), ids=[kind.name for kind in VALUES])
@settings(max_examples=15, derandomize=True)
@given(count=st.sampled_from([1, 5, 40]), seed=st.integers(0, 2**32 - 1))
def test_any_corrupt_values(kind: Kind, count: int, seed: int) -> None:
    check(corrupted(count, seed, (kind,)))


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("kind", list(VALUES), ids=[kind.name for kind in VALUES])
def test_one_corrupt_sample_is_got_over(kind: Kind, value: float) -> None:
    """Every value of one sample in flight is bad; four seconds later the estimate is as good as ever."""
    rows = FLIGHT.copy()
    i = int(np.flatnonzero((rows[:, KIND] == kind) & (rows[:, TIME] > 112.0))[0])
    rows[i, list(VALUES[kind])] = value
    poses = check(rows)
    assert poses[-1, L.R_TIME] > 115.9
    assert poses[-1, L.R_VALID] == 15.0
    assert position_error(poses[-1:])[0] < 3.0


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9])
@pytest.mark.parametrize("kind", list(VALUES), ids=[kind.name for kind in VALUES])
def test_a_first_sample_that_is_corrupt_spoils_nothing(kind: Kind, value: float) -> None:
    rows = FLIGHT.copy()
    i = int(np.flatnonzero(rows[:, KIND] == kind)[0])
    rows[i, list(VALUES[kind])] = value
    poses = check(rows)
    assert poses[-1, L.R_VALID] == 15.0
    assert position_error(poses[-1:])[0] < 3.0


def test_the_first_pressure_after_the_first_position_may_be_corrupt() -> None:
    rows = FLIGHT.copy()
    some = (rows[:, KIND] == Kind.BAROMETER) & (rows[:, TIME] < 101.5)
    rows[some, 8] = np.nan
    check(rows)
    output = run(rows)[1]
    record = output.innovations[output.innovations[:, L.I_SENSOR] == Sensor.BAROMETER]
    assert np.sum(record[:, L.I_FUSED]) > 100
