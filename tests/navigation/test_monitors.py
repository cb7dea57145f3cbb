"""Faults are found, named, taken out and forgiven: against the same flight without the fault, and against the truth."""

from functools import cache

import numpy as np
import pytest

from mavkf.config import with_settings
from mavkf.navigation import layout as L
from mavkf.navigation.codes import FAULT_CODES, NoteCode, Reason, Sensor
from mavkf.navigation.covariance import bring_up
from mavkf.navigation.monitors import (
    ACCELEROMETER,
    GYRO,
    KIND,
    RAMP,
    VELOCITY,
    carry_effects,
    effects,
    hypothesis,
    regress,
)
from mavkf.navigation.offline import Offline, run_offline
from mavkf.navigation.records import RecordWriter
from mavkf.replay.faults import apply_faults, parse_fault
from mavkf.samples import ACCEL, TIME, Kind
from mavkf.samples import GYRO as GYRO_COLUMN
from mavkf.samples import KIND as ROW_KIND

from ._session import CONFIG, Array, motion, position_error, session

DELAY = 0.2  # s: the fixes of the flight are stamped so long after they were measured
BEGIN = 140.0


@cache
def flight(duration: float = 90.0) -> Array:
    return session(duration)


def faulty(*faults: str, duration: float = 90.0) -> Array:
    return apply_faults(flight(duration), [parse_fault(fault) for fault in faults])


def told(result: Offline, code: NoteCode) -> Array:
    notes = result.output.notes
    return notes[notes[:, L.NOTE_CODE] == code]


def faults_of(result: Offline) -> set[str]:
    return {NoteCode(int(code)).name for code in result.output.notes[:, L.NOTE_CODE] if code in FAULT_CODES}


def error_over_sigma(poses: Array) -> Array:
    covariance = poses[:, L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36]
    return position_error(poses) / np.sqrt(covariance[:, 0] + covariance[:, 7])


SMALL = {RAMP: "gnss-drift:size=0.004,towards=0", VELOCITY: "gnss-velocity:size=0.01,towards=0"}
SMALL |= {GYRO: "gyro-step:size=0.002,towards=x", ACCELEROMETER: "accelerometer-step:size=0.001,towards=x"}
UNIT = {RAMP: 0.004, VELOCITY: 0.01, GYRO: np.radians(0.002), ACCELEROMETER: 0.001}


@pytest.mark.parametrize("kind", SMALL, ids=["ramp", "velocity", "gyro", "accelerometer"])
def test_the_effect_of_a_fault_is_the_difference_to_the_same_flight_without_it(kind: int) -> None:
    """The whole filter is the finite difference: on a flight almost without noise, so that nothing is learnt from the innovations."""
    rows = session(48.0, noise=1e-3)
    clean = run_offline(rows, CONFIG)
    ages = [clean.state[L.T] - clean.state[hypothesis(h)] if KIND[h] == kind else 0.0 for h in range(L.HYPOTHESES)]
    h = int(np.argmax(ages))
    since = clean.state[hypothesis(h)]
    assert 4.0 < ages[h] < 60.0
    # a fix is measured before its stamp, an IMU's step falls between two samples
    at = since + (DELAY + 0.01 if kind in (RAMP, VELOCITY) else 0.0)
    if kind == RAMP:
        at = since + DELAY
    name, options = SMALL[kind].split(":")
    with_fault = run_offline(apply_faults(rows, [parse_fault(f"{name}:at={at},{options}")]), CONFIG)
    bring_up.python(clean.state, clean.parameters, L.buffers(1, 1, 1))  # they stand at the last measurement
    carry_effects(clean.state)
    n = int(clean.state[L.STATES])
    a, b = clean.state, with_fault.state
    np.testing.assert_allclose(a[L.P : L.P + n * n], b[L.P : L.P + n * n], rtol=0.05, atol=1e-4)
    shift = (b - a)[4:6]
    expected = effects(clean.state)[:, 3 * h] * UNIT[kind]
    assert np.abs(expected[3:5]).max() > 1e-6
    np.testing.assert_allclose(shift, expected[3:5], rtol=0.05, atol=0.05 * np.abs(expected[3:5]).max())
    moved = [(b[7] - a[7]) * 6_372_000.0, (b[8] - a[8]) * 6_389_800.0 * np.cos(np.radians(47.0))]
    assert np.linalg.norm(moved - expected[6:8]) < 0.05 * np.linalg.norm(expected[6:8])


def test_without_a_fault_the_ratios_are_those_of_chance() -> None:
    ratios = []
    for seed in range(4):
        result = run_offline(session(60.0, seed), CONFIG)
        size, covariance = np.empty(3), np.empty((3, 3))
        ratios += [regress(result.state, h, size, covariance) for h in range(L.HYPOTHESES)]
        assert not faults_of(result)
    # chi-square with three degrees of freedom has a mean of three
    assert 0.0 < np.mean(ratios) < 6.0
    assert np.max(ratios) < 25.0


NAMED = {
    "gnss-drift:at=140,for=25,size=1.2,towards=90": {"GNSS_DRIFT"},
    "gnss-drift:at=140,for=25,size=2,towards=down": {"GNSS_HEIGHT_DRIFT", "GNSS_JUMP"},
    "gnss-step:at=140,for=10,size=40,towards=330": {"GNSS_JUMP"},
    "gnss-velocity:at=140,for=20,size=1.5,towards=0": {"GNSS_VELOCITY_WRONG"},
    "gnss-velocity:at=140,for=20,size=8,towards=0": {"GNSS_VELOCITY_WRONG"},
    "gnss-freeze:at=140,for=10": {"GNSS_FROZEN"},
    "gnss-noise:at=140,for=20,size=15": {"GNSS_JAMMED"},
    "magnetometer:at=140,for=10,size=40,towards=y": {"MAGNETIC_DISTURBANCE"},
    "barometer:at=140,for=10,size=15": {"BAROMETER_DISTURBANCE"},
    "gyro-step:at=140,size=2,towards=x": {"GYRO_STEP"},
    "accelerometer-step:at=140,size=1.5,towards=x": {"ACCELEROMETER_STEP"},
}


@pytest.mark.parametrize("fault", NAMED)
def test_a_fault_is_named_with_its_span_and_the_pose_stays_right(fault: str) -> None:
    result = run_offline(faulty(fault), CONFIG)
    found = faults_of(result)
    assert found & NAMED[fault], found
    first = next(note for note in result.output.notes if note[L.NOTE_CODE] in FAULT_CODES)
    assert BEGIN - 6.0 < first[L.NOTE_START] <= first[L.NOTE_TIME]
    assert BEGIN < first[L.NOTE_TIME] < BEGIN + 12.0
    poses = result.output.poses[result.output.poses[:, L.R_TIME] > 115.0]
    assert position_error(poses).max() < 9.0
    height = np.abs(poses[:, L.R_NED + 2] - motion(poses[:, L.R_TIME] - 100.0).p[:, 2])
    assert np.all(position_error(poses) < poses[:, L.R_PL_H])
    assert np.all(height < poses[:, L.R_PL_V] + 1.0)
    last = poses[poses[:, L.R_TIME] > 185.0]
    assert position_error(last).max() < 3.0
    writer = RecordWriter("1-1")
    events = [writer.event(note, 0) for note in result.output.notes if note[L.NOTE_CODE] in FAULT_CODES]
    assert all(event.text and event.t_start_s is not None and event.size is not None for event in events)
    lasting = {event.kind for event in events if event.t_end_s is None}
    over = {event.kind for event in events if event.t_end_s is not None}
    assert lasting <= over, "each fault that began is told to be over"


@pytest.mark.parametrize("size", [0.75, 1.2])
def test_a_wrong_scale_along_the_vertical_is_not_laid_on_those_who_contradict_it(size: float) -> None:
    result = run_offline(faulty(f"accelerometer-scale:at=140,for=15,size={size}"), CONFIG)
    assert "ACCELEROMETER_STEP" in faults_of(result)
    poses = result.output.poses[result.output.poses[:, L.R_TIME] > 120.0]
    height = np.abs(poses[:, L.R_NED + 2] - motion(poses[:, L.R_TIME] - 100.0).p[:, 2])
    assert height.max() < 20.0
    assert height[poses[:, L.R_TIME] > 175.0].max() < 4.0


def test_suspected_positions_are_recorded_and_not_fused() -> None:
    result = run_offline(faulty("gnss-drift:at=140,for=25,size=1.2,towards=90"), CONFIG)
    drift = told(result, NoteCode.GNSS_DRIFT)
    begin, end = drift[0, L.NOTE_TIME], drift[-1, L.NOTE_END]
    assert end == pytest.approx(165.0, abs=3.0)
    position = result.output.innovations[result.output.innovations[:, L.I_SENSOR] == Sensor.GNSS_POSITION]
    during = position[(position[:, L.I_TIME] > begin) & (position[:, L.I_TIME] < end - 0.1)]
    assert during.shape[0] > 30
    assert np.all(during[:, L.I_REASON] == Reason.SUSPECTED)
    assert not np.any(during[:, L.I_FUSED])


def test_after_the_patience_the_state_is_reset_and_the_doubt_stays_in_the_bound() -> None:
    rows = faulty("gnss-step:at=140,size=40,towards=0")
    result = run_offline(rows, with_settings(CONFIG, ["integrity.suspicion_s=15"]))
    reset = told(result, NoteCode.POSITION_RESET)
    assert reset[:, L.NOTE_TIME] == pytest.approx([155.4], abs=1.0)
    after = result.output.poses[result.output.poses[:, L.R_TIME] > reset[0, L.NOTE_TIME] + 2.0]
    assert np.all(after[:, L.R_PL_H] > 15.0)


def test_an_accelerometer_of_the_wrong_scale_is_named_at_rest_and_not_integrated() -> None:
    rows = flight(60.0).copy()
    rows[rows[:, ROW_KIND] == Kind.IMU, ACCEL : ACCEL + 3] *= 7.7 / 9.81
    result = run_offline(rows, CONFIG)
    scale = told(result, NoteCode.ACCELEROMETER_SCALE)
    assert scale.shape[0] == 1
    assert scale[0, L.NOTE_SIZE] == pytest.approx(7.7, abs=0.05)
    poses = result.output.poses[result.output.poses[:, L.R_TIME] > 112.0]
    assert np.all(poses[:, L.R_MODEL] == L.CONSTANT_VELOCITY)
    assert position_error(poses).max() < 4.0


def test_repeated_and_interpolated_samples_of_the_imu_are_named_and_their_time_is_not_trusted() -> None:
    rows = flight(60.0).copy()
    held = (rows[:, ROW_KIND] == Kind.IMU) & (rows[:, TIME] > 130.0) & (rows[:, TIME] < 131.5)
    order = np.flatnonzero(held)[np.argsort(rows[held, TIME])]
    share = (rows[order, TIME] - rows[order[0], TIME]) / (rows[order[-1], TIME] - rows[order[0], TIME])
    for k in range(6):
        column = GYRO_COLUMN + k
        rows[order, column] = (1.0 - share) * rows[order[0], column] + share * rows[order[-1], column]
    result = run_offline(rows, CONFIG)
    frozen = told(result, NoteCode.IMU_FROZEN)
    assert frozen.shape[0] == 2
    assert frozen[0, L.NOTE_START] == pytest.approx(130.0, abs=0.2)
    assert frozen[1, L.NOTE_END] == pytest.approx(131.5, abs=0.1)
    assert error_over_sigma(result.output.poses[result.output.poses[:, L.R_TIME] > 120.0]).max() < 3.5


def test_clipping_and_vibration_are_named() -> None:
    rows = flight(60.0).copy()
    at = (rows[:, ROW_KIND] == Kind.IMU) & (rows[:, TIME] > 130.0) & (rows[:, TIME] < 130.06)
    rows[at, ACCEL + 2] = -16.0 * 9.80665
    assert "IMU_CLIPPING" in faults_of(run_offline(rows, CONFIG))
    rows = flight(60.0).copy()
    shaken = np.flatnonzero((rows[:, ROW_KIND] == Kind.IMU) & (rows[:, TIME] > 115.0) & (rows[:, TIME] < 145.0))
    rows[shaken, ACCEL : ACCEL + 3] += 60.0 * np.random.default_rng(1).normal(size=(shaken.size, 3))
    assert "IMU_VIBRATION" in faults_of(run_offline(rows, CONFIG))


KINDS = (
    "gnss-step:at={at},for={for_},size={big},towards={way}",
    "gnss-drift:at={at},for={for_},size={small},towards={way}",
    "gnss-velocity:at={at},for={for_},size={small},towards={way}",
    "gnss-freeze:at={at},for={for_}",
    "gnss-outage:at={at},for={for_}",
    "gnss-noise:at={at},for={for_},size={big}",
    "magnetometer:at={at},for={for_},size={big},towards=y",
    "barometer:at={at},for={for_},size={big}",
    "gyro-step:at={at},for={for_},size={small},towards=y",
    "accelerometer-step:at={at},for={for_},size={small},towards=x",
    "imu-gap:at={at},for=2",
)
CALM = 70.0  # s: patience with a receiver that nobody can judge, and ten more


@pytest.mark.parametrize("seed", range(12))
def test_nothing_healthy_is_locked_out_for_good(seed: int) -> None:
    """Random faults one after another: each time the sensors have been right again for a while, so is the pose, within its sigma."""
    random = np.random.default_rng(seed)
    faults, calm, at = [], [], 125.0
    while at < 640.0:
        lasts = float(random.uniform(5.0, 25.0))
        kind = KINDS[random.integers(len(KINDS))]
        sizes = {"big": random.uniform(5.0, 60.0), "small": random.uniform(0.5, 3.0), "way": random.uniform(0.0, 360.0)}
        faults.append(kind.format(at=at, for_=lasts, **sizes))
        calm.append((at + lasts + CALM - 5.0, at + lasts + CALM))
        at += lasts + CALM
    result = run_offline(faulty(*faults, duration=at - 100.0), CONFIG)
    poses = result.output.poses
    for (begin, end), fault in zip(calm, faults, strict=True):
        during = poses[(poses[:, L.R_TIME] > begin) & (poses[:, L.R_TIME] < end)]
        assert np.all(np.isfinite(during[:, L.R_LATITUDE])), fault
        assert np.median(error_over_sigma(during)) < 3.0, (fault, position_error(during).max())
        assert position_error(during).max() < during[:, L.R_PL_H].max(), fault


def test_the_bound_is_the_larger_of_sigma_and_of_what_the_monitors_leave_open() -> None:
    result = run_offline(flight(60.0), CONFIG)
    row = result.output.poses[-1]
    P = row[L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36].reshape(6, 6)
    clean = 1.5 * np.sqrt(-2.0 * np.log(1e-3) * np.linalg.eigvalsh(P[:2, :2]).max())
    assert row[L.R_PL_H] >= clean - 1e-9
    off = run_offline(flight(60.0), with_settings(CONFIG, ["integrity.monitors=false"])).output.poses[-1]
    P = off[L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36].reshape(6, 6)
    assert off[L.R_PL_H] == pytest.approx(1.5 * np.sqrt(-2.0 * np.log(1e-3) * np.linalg.eigvalsh(P[:2, :2]).max()))
    assert off[L.R_PL_V] == pytest.approx(1.5 * np.sqrt(-2.0 * np.log(1e-3) * P[2, 2]))
