"""What the estimator does when a receiver errs, jumps or falls silent, and when no IMU or magnetometer is there."""

import numpy as np
import pytest

from mavkf.config import with_settings
from mavkf.models.earth import gravity
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Flag, ModeCode, NoteCode, Reason, Sensor
from mavkf.navigation.offline import Offline, run_offline
from mavkf.navigation.propagation import COAST_RATE, coast
from mavkf.samples import FIELD, FIX, HEIGHT_AMSL, KIND, LATITUDE, TIME, Kind

from ._session import CONFIG, RADII, G, motion, position_error, run, session

Array = np.ndarray
LIMIT_3 = 21.108  # chi-square of three degrees of freedom at 1e-4, from a table

IMPATIENT = with_settings(CONFIG, ["integrity.suspicion_s=10"])


def innovations(output, sensor: Sensor) -> Array:
    return output.innovations[output.innovations[:, L.I_SENSOR] == sensor]


def notes(output, code: NoteCode) -> Array:
    return output.notes[output.notes[:, L.NOTE_CODE] == code]


def flagged(poses: Array, flag: Flag) -> Array:
    return (poses[:, L.R_FLAGS].astype(int) >> flag & 1).astype(bool)


def test_follows_the_truth_within_what_it_claims(batch: Offline) -> None:
    poses = batch.output.poses
    late = poses[poses[:, L.R_TIME] > 106.0]
    assert np.all(late[:, L.R_MODE] == ModeCode.NAVIGATING)
    assert np.all(late[:, L.R_VALID] == 15.0)
    assert np.all(late[:, L.R_MODEL] == 1.0)
    sigma = np.sqrt(late[:, L.R_POSE_COVARIANCE] + late[:, L.R_POSE_COVARIANCE + 7])
    ratio = position_error(late) / sigma
    assert 0.2 < np.sqrt(np.mean(ratio**2)) < 1.5
    truth = motion(late[:, L.R_TIME] - 100.0)
    yaw = np.arctan2(truth.C_nb[:, 1, 0], truth.C_nb[:, 0, 0])
    assert np.sqrt(np.mean((late[:, L.R_EULER + 2] - yaw) ** 2)) < np.radians(2.0)
    assert np.abs(late[:, L.R_EULER : L.R_EULER + 2]).max() < np.radians(2.0)
    assert np.sqrt(np.mean((late[:, L.R_V : L.R_V + 3] - truth.v) ** 2)) < 0.2
    assert np.sqrt(np.mean((late[:, L.R_HEIGHT] - 400.0 + truth.p[:, 2]) ** 2)) < 0.6
    np.testing.assert_allclose(late[-1, L.R_BG : L.R_BG + 3], [0.004, -0.003, 0.002], atol=5e-4)
    assert notes(batch.output, NoteCode.ARMED)[:, L.NOTE_END].tolist() == [108.5]
    assert not notes(batch.output, NoteCode.POSITION_RESET).size


def test_poses_come_at_the_asked_rate(rows: Array, batch: Offline) -> None:
    t = batch.output.poses[:, L.R_TIME]
    np.testing.assert_allclose(np.diff(t), 0.02, atol=1e-9)
    slow = run_offline(rows, CONFIG, rate_hz=5.0).output.poses[:, L.R_TIME]
    np.testing.assert_allclose(np.diff(slow), 0.2, atol=1e-9)
    every = run_offline(rows, CONFIG, rate_hz=0.0).output.poses[:, L.R_TIME]
    np.testing.assert_allclose(np.diff(every), 0.01, atol=1e-9)


def test_a_wild_fix_is_refused_recorded_and_moves_nothing(rows: Array, batch: Offline) -> None:
    wild = rows.copy()
    where = int(np.flatnonzero((rows[:, KIND] == Kind.GNSS) & (rows[:, TIME] > 125.0))[0])
    wild[where, LATITUDE] += 50.0 / RADII[0]
    t = wild[where, TIME] - 0.2
    estimator, output = run(wild)
    record = innovations(output, Sensor.GNSS_POSITION)
    record = record[np.abs(record[:, L.I_TIME] - t) < 1e-6]
    assert record.shape[0] == 1
    assert record[0, L.I_FUSED] == 0.0
    assert record[0, L.I_REASON] == Reason.GATE
    assert record[0, L.I_LIMIT] == pytest.approx(LIMIT_3, abs=1e-2)
    r, S = record[0, L.I_R : L.I_R + 3], record[0, L.I_S : L.I_S + 9].reshape(3, 3)
    assert r[0] == pytest.approx(50.0, abs=4.0)
    assert record[0, L.I_NIS] == pytest.approx(r @ np.linalg.solve(S, r), rel=1e-9)
    assert record[0, L.I_NIS] > 1000.0

    # the same as if its position had not come, but for the correction that it would have made
    def ned(poses: Array) -> Array:
        return poses[(poses[:, L.R_TIME] > t) & (poses[:, L.R_TIME] < t + 3.0), L.R_NED : L.R_NED + 3]

    assert np.abs(ned(output.poses) - ned(run(rows)[1].poses)).max() < 0.5
    assert not notes(output, NoteCode.POSITION_RESET).size
    assert estimator.state[L.BOOKS + L.F_REFUSED_COUNT] == 0.0


@pytest.mark.parametrize("jump", [60.0, 400.0])
def test_a_lasting_jump_ends_in_one_reset_with_its_size(rows: Array, jump: float) -> None:
    moved = rows.copy()
    gnss = (rows[:, KIND] == Kind.GNSS) & (rows[:, TIME] > 120.0)
    moved[gnss, LATITUDE] += jump / RADII[0]
    _, output = run(moved, config=IMPATIENT)
    resets = notes(output, NoteCode.POSITION_RESET)
    assert resets.shape[0] == 1
    assert resets[0, L.NOTE_SIZE] == pytest.approx(jump, abs=0.1 * jump + 4.0)
    assert resets[0, L.NOTE_END] - resets[0, L.NOTE_START] == pytest.approx(IMPATIENT.integrity.suspicion_s, abs=0.3)
    refused = innovations(output, Sensor.GNSS_POSITION)
    refused = refused[refused[:, L.I_FUSED] == 0.0]
    assert refused.shape[0] >= resets[0, L.NOTE_A] > 40
    poses = output.poses
    during = (poses[:, L.R_TIME] > 121.0) & (poses[:, L.R_TIME] < resets[0, L.NOTE_END] - 0.1)
    assert np.all(flagged(poses[during], Flag.GNSS_REFUSED))
    assert position_error(poses[during]).max() < 8.0
    after = poses[poses[:, L.R_TIME] > resets[0, L.NOTE_END] + 1.0].copy()
    after[:, L.R_LATITUDE] -= jump / RADII[0]
    assert position_error(after).max() < 3.0
    assert not np.any(flagged(after, Flag.GNSS_REFUSED))


def test_a_lasting_jump_is_followed_after_the_configured_time(rows: Array) -> None:
    moved = rows.copy()
    moved[(rows[:, KIND] == Kind.GNSS) & (rows[:, TIME] > 120.0), LATITUDE] += 60.0 / RADII[0]
    resets = notes(run(moved, config=IMPATIENT)[1], NoteCode.POSITION_RESET)
    assert resets[0, L.NOTE_START] == pytest.approx(120.0, abs=0.5)
    assert resets[0, L.NOTE_A] == pytest.approx(5 * IMPATIENT.integrity.suspicion_s, abs=2)
    assert resets[0, L.NOTE_END] == pytest.approx(120.0 + IMPATIENT.integrity.suspicion_s, abs=1.0)


def test_an_outage_is_told_grows_sigma_and_ends(rows: Array) -> None:
    silent = (rows[:, KIND] == Kind.GNSS) & (rows[:, TIME] > 118.0) & (rows[:, TIME] < 130.0)
    _, output = run(rows[~silent])
    poses = output.poses
    t = poses[:, L.R_TIME]
    sigma = np.sqrt(poses[:, L.R_POSE_COVARIANCE])
    during = poses[(t > 120.5) & (t < 129.5)]
    assert np.all(during[:, L.R_MODE] == ModeCode.DEAD_RECKONING)
    assert np.all(flagged(during, Flag.NO_GNSS))
    grown = sigma[(t > 118.5) & (t < 129.5)]
    assert np.all(np.diff(grown) > 0.0)
    assert grown[-1] > 2.5 * grown[0]
    assert np.all(
        position_error(during) < 4.0 * np.sqrt(during[:, L.R_POSE_COVARIANCE] + during[:, L.R_POSE_COVARIANCE + 7])
    )
    after = poses[t > 131.0]
    assert np.all(after[:, L.R_MODE] == ModeCode.NAVIGATING)
    assert sigma[-1] < 1.0
    assert notes(output, NoteCode.GNSS_OUTAGE).shape[0] == 1
    back = notes(output, NoteCode.GNSS_BACK)
    assert back.shape[0] == 1
    assert back[0, L.NOTE_SIZE] == pytest.approx(12.1, abs=0.4)


def test_a_fix_without_a_position_is_counted_and_not_used(rows: Array, batch: Offline) -> None:
    lost = rows.copy()
    gnss = (rows[:, KIND] == Kind.GNSS) & (rows[:, TIME] > 118.0) & (rows[:, TIME] < 120.0)
    lost[gnss, FIX] = 1
    lost[gnss, LATITUDE], lost[gnss, HEIGHT_AMSL] = 0.0, 0.0
    estimator, output = run(lost)
    assert estimator.state[L.NO_FIX] == np.sum(gnss)
    assert position_error(output.poses[output.poses[:, L.R_TIME] > 106.0]).max() < 2.5


def test_a_gap_of_the_imu_is_told_and_survived(rows: Array) -> None:
    gap = (rows[:, KIND] == Kind.IMU) & (rows[:, TIME] > 120.0) & (rows[:, TIME] < 122.0)
    estimator, output = run(rows[~gap])
    assert estimator.state[L.GAP_COUNT] == 1.0
    gaps = notes(output, NoteCode.IMU_GAP)
    assert gaps.shape[0] == 1
    assert gaps[0, L.NOTE_SIZE] == pytest.approx(2.01, abs=0.02)
    late = output.poses[output.poses[:, L.R_TIME] > 127.0]
    assert position_error(late).max() < 2.5


def test_while_the_imu_is_silent_nobody_knows_that_a_vehicle_still_stands(rows: Array) -> None:
    # armed only at 108 s: until then it stands
    standing = run_offline(rows[rows[:, TIME] < 107.0], CONFIG)
    state, parameters = standing.state, standing.parameters
    assert state[L.RESTING] == 1.0
    before = L.covariance(state)[2, 2]
    coast(state, parameters, state[L.T] + 10.0, L.buffers(8, 8, 8))
    assert state[L.RESTING] == 0.0
    # as any vehicle that is not looked at turns
    assert L.covariance(state)[2, 2] - before == pytest.approx(10.0 * COAST_RATE**2, rel=0.05)


def test_without_a_magnetometer_yaw_is_not_claimed(rows: Array) -> None:
    config = with_settings(CONFIG, ["use_motion_yaw=false"])
    _, output = run(rows[rows[:, KIND] != Kind.MAGNETOMETER], config=config)
    poses = output.poses[output.poses[:, L.R_TIME] > 106.0]
    assert np.all(poses[:, L.R_VALID] == L.VALID_POSITION + L.VALID_VELOCITY + L.VALID_TILT)
    assert np.all(np.isnan(poses[:, L.R_EULER + 2]))
    assert np.all(np.isnan(poses[:, L.R_Q]))
    assert np.all(flagged(poses, Flag.YAW_UNKNOWN))
    assert position_error(poses).max() < 4.0


@pytest.mark.parametrize("yaw0", [0.4, 2.0, -2.8])
def test_without_a_magnetometer_yaw_is_found_from_the_motion(yaw0: float) -> None:
    rows = session(yaw0=yaw0)
    _, output = run(rows[rows[:, KIND] != Kind.MAGNETOMETER])
    poses = output.poses
    yaw = poses[:, L.R_EULER + 2]
    found = poses[np.isfinite(yaw), L.R_TIME]
    # standing still tells nothing; the vehicle speeds up from 110 s to 114 s
    assert 110.0 < found[0] < 120.0
    assert notes(output, NoteCode.YAW_FROM_MOTION).shape[0] == 1
    truth = motion(poses[:, L.R_TIME] - 100.0, yaw0)
    error = np.angle(np.exp(1j * (yaw - np.arctan2(truth.C_nb[:, 1, 0], truth.C_nb[:, 0, 0]))))
    known = np.isfinite(error)
    assert np.max(np.abs(error[known] / poses[known, L.R_SIGMA_EULER + 2])) < 4.0
    assert np.degrees(np.abs(error[-1])) < 4.0


def test_without_an_imu_position_and_velocity_come_from_the_fixes(rows: Array) -> None:
    _, output = run(rows[rows[:, KIND] != Kind.IMU])
    poses = output.poses[output.poses[:, L.R_TIME] > 121.0]
    assert poses.shape[0] > 80
    assert np.all(poses[:, L.R_VALID] == L.VALID_POSITION + L.VALID_VELOCITY)
    assert np.all(flagged(poses, Flag.NO_IMU))
    assert np.all(np.isnan(poses[:, L.R_EULER]))
    assert position_error(poses).max() < 3.5


def test_before_any_sensor_nothing_is_said(rows: Array) -> None:
    beats = rows[rows[:, KIND] == Kind.HEARTBEAT]
    estimator, output = run(beats)
    assert not estimator.has_sensor
    assert output.poses.shape[0] == 0


@pytest.mark.parametrize("yaw0", [0.0, 1.5, 3.1, -2.0])
def test_heading_from_the_magnetometer(yaw0: float) -> None:
    _, output = run(session(duration=9.0, yaw0=yaw0))
    last = output.poses[-1]
    error = (last[L.R_EULER + 2] - yaw0 + np.pi) % (2.0 * np.pi) - np.pi
    assert abs(error) < 3.0 * last[L.R_SIGMA_EULER + 2]
    assert last[L.R_SIGMA_EULER + 2] < np.radians(6.0)


def test_a_configured_declination_turns_the_heading(rows: Array) -> None:
    first = rows[rows[:, TIME] < 109.0]
    turned = with_settings(CONFIG, ["magnetic_declination_deg=30"])
    # the field points 3.2 deg east of north
    yaw = run(first)[1].poses[-1, L.R_EULER + 2], run(first, config=turned)[1].poses[-1, L.R_EULER + 2]
    assert np.degrees(yaw[1] - yaw[0]) == pytest.approx(30.0 - 3.2, abs=1.0)


def test_a_disturbed_field_is_refused_and_said(rows: Array) -> None:
    near_iron = rows.copy()
    some = (rows[:, KIND] == Kind.MAGNETOMETER) & (rows[:, TIME] > 120.0) & (rows[:, TIME] < 125.0)
    near_iron[some, FIELD] += 2e-4
    _, output = run(near_iron)
    record = innovations(output, Sensor.MAGNETOMETER)
    during = (record[:, L.I_TIME] > 120.0) & (record[:, L.I_TIME] < 124.95)
    assert np.all(record[during, L.I_REASON] == Reason.DISTURBED)
    assert np.all(record[~during, L.I_FUSED] == 1.0)


def test_gravity_of_the_session_is_that_of_the_place() -> None:
    assert gravity(np.radians(47.0), 400.0) == pytest.approx(G, abs=1e-3)
