"""Several IMUs, magnetometers and barometers: one that falls silent gives way, and comes back when the other dies."""

import numpy as np
import pytest

from mavkf.models.strapdown import BG, IRON
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode, Sensor
from mavkf.navigation.offline import run_offline
from mavkf.navigation.records import RecordWriter
from mavkf.samples import ACCEL, FIELD, GYRO, KIND, PRESSURE, SOURCE, TIME, Kind, Source

from ._session import CONFIG, copied, merged, motion, position_error, run, session, without

Array = np.ndarray
HIGHRES, SECOND = Source.HIGHRES_IMU, Source.SCALED_IMU2
BIAS = np.array([0.004, -0.003, 0.002])  # rad/s, of the IMU of `session`
OTHER_BIAS = np.array([-0.011, 0.006, 0.009])


def two_imus(rows: Array, scale: float = 1.0) -> Array:
    """The rows with another IMU at 50 Hz that has biases of its own."""
    other = copied(rows, Kind.IMU, SECOND, every=2)
    other[:, GYRO : GYRO + 3] += OTHER_BIAS - BIAS
    other[:, ACCEL : ACCEL + 3] = scale * (other[:, ACCEL : ACCEL + 3] + [0.1, -0.05, 0.08])
    return merged(rows, other)


def events(output, code: NoteCode) -> Array:
    return output.notes[output.notes[:, L.NOTE_CODE] == code]


def attitude_errors(poses: Array) -> tuple[float, float]:
    """Largest tilt and yaw errors, deg."""
    C = motion(poses[:, L.R_TIME] - 100.0).C_nb
    yaw = np.angle(np.exp(1j * (poses[:, L.R_EULER + 2] - np.arctan2(C[:, 1, 0], C[:, 0, 0]))))
    return float(np.degrees(np.nanmax(np.abs(poses[:, L.R_EULER : L.R_EULER + 2])))), float(
        np.degrees(np.nanmax(np.abs(yaw)))
    )


def test_an_imu_that_is_not_in_use_changes_nothing(rows: Array) -> None:
    both, alone = run_offline(two_imus(rows), CONFIG, rate_hz=0.0), run_offline(rows, CONFIG, rate_hz=0.0)
    assert both.output.poses.tobytes() == alone.output.poses.tobytes()
    assert both.output.innovations.tobytes() == alone.output.innovations.tobytes()
    # nor what is published while it happens
    assert run(two_imus(rows), rate_hz=0.0)[1].poses.tobytes() == run(rows, rate_hz=0.0)[1].poses.tobytes()


def test_an_imu_that_falls_silent_gives_way_and_comes_back_when_the_other_does(rows: Array) -> None:
    flight = two_imus(rows)
    for source, start, end in ((HIGHRES, 115.0, 120.0), (SECOND, 128.0, 200.0)):
        flight = without(flight, source, start, end, Kind.IMU)
    result = run_offline(flight, CONFIG, rate_hz=0.0)
    changes = events(result.output, NoteCode.IMU_CHANGED)
    assert changes[:, L.NOTE_A : L.NOTE_B + 1].tolist() == [[HIGHRES, SECOND], [SECOND, HIGHRES]]
    # a gap, and three samples
    np.testing.assert_allclose(changes[:, L.NOTE_END], [115.0 + 0.6 + 0.05, 128.0 + 0.6 + 0.02], atol=0.04)
    event = RecordWriter("1-1").event(changes[0], 0)
    assert (event.kind, event.evidence) == ("imu_changed", {"before": "HIGHRES_IMU", "now": "SCALED_IMU2"})
    poses = result.output.poses
    t = poses[:, L.R_TIME]
    assert np.all(np.diff(t) > 0.0)
    assert np.median(np.diff(t[(t > 116.0) & (t < 127.0)])) == pytest.approx(0.02, abs=1e-6)
    assert np.median(np.diff(t[t > 129.0])) == pytest.approx(0.01, abs=1e-6)
    known = poses[np.isfinite(poses[:, L.R_LATITUDE]) & (t > 108.0)]
    assert position_error(known).max() < 2.0
    # a gyro of unknown bias turns the attitude off for a while, which the covariance says
    tilt, yaw = attitude_errors(known)
    assert tilt < 5.0
    assert yaw < 8.0
    assert yaw < 4.0 * np.degrees(known[:, L.R_SIGMA_EULER + 2].max())
    assert np.max(np.abs(known[:, L.R_EULER : L.R_EULER + 2] / known[:, L.R_SIGMA_EULER : L.R_SIGMA_EULER + 2])) < 4.0
    for start, end, bias in ((126.0, 128.0, OTHER_BIAS), (138.5, 140.0, BIAS)):
        found = poses[(t > start) & (t < end), L.R_BG : L.R_BG + 3]
        np.testing.assert_allclose(found[-1], bias, atol=4e-3)
    # what was fused meanwhile came at its own time
    assert result.state[L.GAP_COUNT] == 2.0


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_one_of_unknown_scale_is_not_taken(rows: Array, scale: float) -> None:
    flight = without(two_imus(rows, scale), HIGHRES, 120.0, 124.0, Kind.IMU)
    late = flight[(flight[:, SOURCE] != SECOND) | (flight[:, TIME] > 110.0)]
    # known to be wrong from the set-up, and found out by the fold when it begins later
    for these in (flight, late):
        result = run_offline(these, CONFIG)
        assert not events(result.output, NoteCode.IMU_CHANGED).size
        assert result.state[L.GAP_COUNT] == 1.0


def test_a_forced_imu_stays(rows: Array) -> None:
    flight = without(two_imus(rows), HIGHRES, 120.0, 124.0, Kind.IMU)
    result = run_offline(flight, CONFIG, imu=HIGHRES)
    assert not events(result.output, NoteCode.IMU_CHANGED).size


def test_another_magnetometer_takes_over_with_its_own_bias(rows: Array) -> None:
    other = copied(rows, Kind.MAGNETOMETER, SECOND)
    other[:, FIELD : FIELD + 3] += [1.5e-6, -1e-6, 5e-7]
    flight = without(merged(rows, other), HIGHRES, 115.0, kind=Kind.MAGNETOMETER)
    result = run_offline(flight, CONFIG)
    changes = events(result.output, NoteCode.MAGNETOMETER_CHANGED)
    assert changes[:, L.NOTE_A : L.NOTE_B + 1].tolist() == [[HIGHRES, SECOND]]
    assert changes[0, L.NOTE_END] == pytest.approx(117.0, abs=0.3)
    assert attitude_errors(result.output.poses[result.output.poses[:, L.R_TIME] > 108.0])[1] < 5.0
    assert not events(result.output, NoteCode.MAGNETOMETER_RELEARNT).size
    # until then the other one is not heard at all
    before = flight[flight[:, TIME] < 116.5]
    alone = before[(before[:, KIND] != Kind.MAGNETOMETER) | (before[:, SOURCE] == HIGHRES)]
    np.testing.assert_array_equal(
        run_offline(before, CONFIG).state[: L.T + 1], run_offline(alone, CONFIG).state[: L.T + 1]
    )
    assert abs(result.state[IRON + 1]) > 3e-7


def test_a_magnetometer_that_never_was_heard_gives_way(rows: Array) -> None:
    # in the set-up's seconds there is none, so it is looked for in the message of the IMU
    late = rows[(rows[:, KIND] != Kind.MAGNETOMETER) | (rows[:, TIME] > 107.0)].copy()
    late[late[:, KIND] == Kind.MAGNETOMETER, SOURCE] = Source.SCALED_IMU3
    result = run_offline(late, CONFIG)
    aligned = events(result.output, NoteCode.YAW_ALIGNED)
    assert aligned[0, L.NOTE_END] == pytest.approx(109.1, abs=0.3)
    assert not events(result.output, NoteCode.MAGNETOMETER_CHANGED).size


def test_another_barometer_takes_over_with_its_own_bias(rows: Array) -> None:
    other = copied(rows, Kind.BAROMETER, Source.SCALED_PRESSURE2)
    other[:, PRESSURE] += 900.0  # 75 m
    flight = without(merged(rows, other), Source.SCALED_PRESSURE, 118.0)
    result = run_offline(flight, CONFIG)
    changes = events(result.output, NoteCode.BAROMETER_CHANGED)
    assert changes[:, L.NOTE_A : L.NOTE_B + 1].tolist() == [[Source.SCALED_PRESSURE, Source.SCALED_PRESSURE2]]
    assert changes[0, L.NOTE_END] == pytest.approx(120.0, abs=0.3)
    poses = result.output.poses[result.output.poses[:, L.R_TIME] > 115.0]
    truth = motion(poses[:, L.R_TIME] - 100.0).p[:, 2]
    assert np.abs(poses[:, L.R_HEIGHT] - 400.0 + truth).max() < 2.0
    baro = result.output.innovations[result.output.innovations[:, L.I_SENSOR] == Sensor.BAROMETER]
    assert np.all(baro[:, L.I_FUSED] == 1.0)
    assert np.sum(baro[:, L.I_SOURCE] == Source.SCALED_PRESSURE2) > 150


def test_the_gyro_bias_is_not_taken_over() -> None:
    rows = session(duration=30.0)
    flight = without(two_imus(rows), HIGHRES, 118.0, kind=Kind.IMU)
    after = run_offline(flight[flight[:, TIME] < 118.75], CONFIG)
    np.testing.assert_array_equal(after.state[L.IMU_SOURCE], SECOND)
    sigma = np.sqrt(np.diag(L.covariance(after.state))[9:12])
    assert np.all(sigma > 0.9 * CONFIG.noise.gyro_bias_initial)
    assert np.abs(after.state[BG : BG + 3]).max() < 5e-3
