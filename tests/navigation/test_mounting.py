"""Where the sensors are: an IMU that is mounted askew, and an antenna away from it."""

from math import cos, radians, sin

import numpy as np
import pytest

from mavkf.config import settings, with_settings
from mavkf.models.order import ANTENNA, DANTENNA
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.offline import Offline, run_offline
from mavkf.samples import (
    ACCEL,
    FIELD,
    GYRO,
    KIND,
    LATITUDE,
    PARAMETER,
    PARAMETER_VALUE,
    ROW_WIDTH,
    SOURCE,
    TIME,
    AutopilotParameter,
    Kind,
    Source,
)

from ._session import CONFIG, RADII, motion, position_error, run, session

Array = np.ndarray


def about(axis: int, degrees: float) -> Array:
    """The matrix of a turn about one axis, written out."""
    c, s = cos(radians(degrees)), sin(radians(degrees))
    return np.array(
        [
            [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]],
            [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
            [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
        ][axis]
    )


def mounted(rows: Array, roll: float, pitch: float, yaw: float) -> Array:
    """Rows as a board shows them whose frame is turned by these angles (deg) in the body."""
    C_bs = about(2, yaw) @ about(1, pitch) @ about(0, roll)
    turned = rows.copy()
    for kind, columns in ((Kind.IMU, (GYRO, ACCEL)), (Kind.MAGNETOMETER, (FIELD,))):
        mine = rows[:, KIND] == kind
        for k in columns:
            turned[mine, k : k + 3] = rows[mine, k : k + 3] @ C_bs
    return turned


@pytest.mark.parametrize("angles", [(180.0, 0.0, 0.0), (0.0, -90.0, 0.0), (0.0, 0.0, 45.0), (20.0, -70.0, 130.0)])
def test_a_turned_board_gives_the_same_estimate_once_it_is_told(
    rows: Array, batch: Offline, angles: tuple[float, ...]
) -> None:
    config = with_settings(CONFIG, [f"vehicle.imu_rotation_deg={list(angles)}"])
    turned = run_offline(mounted(rows, *angles), config)
    np.testing.assert_allclose(turned.state[: L.T], batch.state[: L.T], rtol=1e-6, atol=1e-9)


def test_a_turned_board_is_the_same_row_by_row(rows: Array) -> None:
    config = with_settings(CONFIG, ["imu_rotation_deg=[20, -70, 130]"])
    first = rows[:1200]
    assert run(first, list(range(1, 1200)), config)[0].state.tobytes() == run(first, config=config)[0].state.tobytes()


def test_settings_of_vectors_say_their_range() -> None:
    said = {name: text for name, _, text in settings()}
    assert said["vehicle.imu_rotation_deg"].endswith("(-180 to 180)")


ARM = (1.6, -1.1, 0.5)


def rms(poses: Array) -> float:
    return float(np.sqrt(np.mean(position_error(poses[poses[:, L.R_TIME] > 112.0]) ** 2)))


def test_a_lever_arm_that_is_told_does_no_harm() -> None:
    told = with_settings(CONFIG, [f"gnss_antenna_b_m={list(ARM)}"])
    rows = session(antenna=ARM)
    without = rms(run_offline(session(), CONFIG).output.poses)
    untold = rms(run_offline(rows, CONFIG).output.poses)
    result = run_offline(rows, told)
    assert untold > without + 0.8
    # a heading off by 3 deg is 0.1 m at the antenna
    assert rms(result.output.poses) == pytest.approx(without, abs=0.1)
    # the height is that of the IMU, which is half a metre above its antenna
    last = result.output.poses[-1]
    truth = motion(last[L.R_TIME : L.R_TIME + 1] - 100.0).p[0, 2]
    assert last[L.R_HEIGHT] - 400.0 + truth == pytest.approx(0.0, abs=0.9)
    np.testing.assert_array_equal(result.state[ANTENNA : ANTENNA + 3], ARM)
    assert not L.covariance(result.state)[DANTENNA : DANTENNA + 3].any()


def test_a_lever_arm_is_found_while_the_vehicle_turns() -> None:
    errors = []
    for seed in range(4):
        rows = session(duration=60.0, seed=seed, antenna=(0.4, -0.3, 0.1))
        result = run_offline(rows, with_settings(CONFIG, ["estimate_antenna=true"]))
        P = L.covariance(result.state)
        sigma = np.sqrt(np.diag(P)[DANTENNA : DANTENNA + 3])
        errors.append((result.state[ANTENNA : ANTENNA + 3] - [0.4, -0.3, 0.1]) / sigma)
        assert P.shape[0] == DANTENNA + 3  # what the telemetry model brings is not there
        assert np.all(sigma[:2] < 0.2)
    assert np.sqrt(np.mean(np.square(errors))) < 1.6
    told = run_offline(rows, with_settings(CONFIG, ["estimate_antenna=true", "gnss_antenna_b_m=[0.4, -0.3, 0.1]"]))
    assert np.abs(told.state[ANTENNA : ANTENNA + 3] - [0.4, -0.3, 0.1]).max() < 0.1


def test_without_a_heading_the_lever_arm_is_uncertainty(rows: Array) -> None:
    config = with_settings(CONFIG, ["use_motion_yaw=false", "use_magnetometer=false", f"gnss_antenna_b_m={list(ARM)}"])
    poses = run_offline(session(antenna=ARM), config).output.poses
    late = poses[poses[:, L.R_TIME] > 106.0]
    sigma = np.sqrt(late[:, L.R_POSE_COVARIANCE] + late[:, L.R_POSE_COVARIANCE + 7])
    assert np.sqrt(np.mean((position_error(late) / sigma) ** 2)) < 1.3


def test_a_reset_takes_the_lever_arm_and_its_uncertainty(rows: Array) -> None:
    moved = session(antenna=ARM)
    moved[(moved[:, KIND] == Kind.GNSS) & (moved[:, TIME] > 120.0), LATITUDE] += 60.0 / RADII[0]
    for more in ([], ["estimate_antenna=true"]):
        config = with_settings(CONFIG, [f"gnss_antenna_b_m={list(ARM)}", "integrity.suspicion_s=8", *more])
        output = run_offline(moved, config, rate_hz=0.0).output
        reset = output.notes[output.notes[:, L.NOTE_CODE] == NoteCode.POSITION_RESET]
        assert reset.shape[0] == 1
        after = output.poses[output.poses[:, L.R_TIME] > reset[0, L.NOTE_END] + 0.02].copy()
        after[:, L.R_LATITUDE] -= 60.0 / RADII[0]
        assert position_error(after[:100]).max() < 2.2
        P = after[0, L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36].reshape(6, 6)
        assert np.linalg.eigvalsh(P).min() > 0.0


def stated_rows(values: dict[AutopilotParameter, float], first: Array) -> Array:
    """Rows of parameters as they come with the first of a session's rows."""
    rows = np.full((len(values), ROW_WIDTH), np.nan)
    rows[:, :8] = first[:8]
    rows[:, KIND], rows[:, SOURCE] = Kind.PARAMETER, Source.PARAM_VALUE
    rows[:, PARAMETER], rows[:, PARAMETER_VALUE] = list(values), list(values.values())
    return rows


def test_a_lever_arm_of_the_autopilots_parameters_does_the_same_as_one_that_is_configured() -> None:
    # both ends are away from the autopilot's origin
    axes = zip("XYZ", ARM, (-0.4, 0.3, 0.2), strict=True)
    values = {
        AutopilotParameter[name]: value
        for axis, arm, imu in axes
        for name, value in ((f"GPS1_POS_{axis}", arm + imu), (f"INS_POS1_{axis}", imu))
    }
    for seed in range(3):
        rows = session(seed=seed, antenna=ARM)
        result = run_offline(np.concatenate([stated_rows(values, rows[0]), rows]), CONFIG)
        told = run_offline(rows, with_settings(CONFIG, [f"gnss_antenna_b_m={list(ARM)}"]))
        assert result.state[: L.T].tobytes() == told.state[: L.T].tobytes()
        late = result.output.poses[result.output.poses[:, L.R_TIME] > 112.0]
        sigma = np.sqrt(late[:, L.R_POSE_COVARIANCE] + late[:, L.R_POSE_COVARIANCE + 7])
        over_sigma = np.sqrt(np.mean((position_error(late) / sigma) ** 2))
        assert 0.2 < over_sigma < 1.5
        untold = run_offline(rows, CONFIG).output.poses
        assert rms(result.output.poses) < 0.5 * rms(untold)
        assert any("1.6 m ahead of, 1.1 m left of, 0.5 m below the IMU" in reason for reason in result.setup.reasons)
