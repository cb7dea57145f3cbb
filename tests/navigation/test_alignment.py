"""The first attitude: known attitudes come out, within the sigma that is claimed, with the accelerometer's bias in its place."""

from math import atan2, cos, pi, radians, sin

import numpy as np
import pytest

from mavkf.config import Config
from mavkf.models.rotation import (
    euler_angles,
    quaternion_from_euler,
    rotation_matrix,
)
from mavkf.models.strapdown import BG, DBA, DBARO, DBG, THETA, Q
from mavkf.navigation import layout as L
from mavkf.navigation.alignment import collect
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.propagation import begin
from mavkf.navigation.setup import choose, parameters
from mavkf.navigation.use_magnetometer import use_magnetometer
from mavkf.samples import FIELD, TIME

Array = np.ndarray
G = 9.80665


def outputs() -> tuple[Array, ...]:
    return L.buffers(64, 64, 1024)


def new_state() -> tuple[Array, Array]:
    config = Config()
    c = parameters(config, choose(np.empty((0, 24)), config))
    s = np.empty(L.STATE_SIZE)
    begin(s, c)
    return s, c


def quaternion(roll: float, pitch: float, yaw: float = 0.0) -> Array:
    q = np.empty(4)
    quaternion_from_euler(roll, pitch, yaw, q)
    return q


def matrix(q: Array) -> Array:
    C = np.empty((3, 3))
    rotation_matrix(q, C)
    return C


def covariance(s: Array) -> Array:
    return L.covariance(s)


def align(C_nb: Array, gyro=(0.0, 0.0, 0.0), bias=(0.0, 0.0, 0.0), noise: float = 0.0, rate: float = 100.0):
    """State, parameters and time after a second or so of samples at rest in this attitude."""
    s, c = new_state()
    out, random, t = outputs(), np.random.default_rng(0), 50.0
    for _ in range(2000):
        force = C_nb.T @ [0.0, 0.0, -G] + bias + noise * random.normal(size=3)
        if collect.python(s, np.concatenate([gyro, force]), t, c, out):
            return s, c, out
        s[L.T_IMU] = t
        t += 1.0 / rate
    raise AssertionError("no alignment in 2000 samples")


ATTITUDES = [(0.0, 0.0), (10.0, -20.0), (-95.0, 3.0), (180.0, 0.0), (170.0, 60.0), (30.0, 85.0), (-60.0, -85.0)]


@pytest.mark.parametrize(("roll", "pitch"), ATTITUDES)
def test_tilt(roll: float, pitch: float) -> None:
    s, _, out = align(matrix(quaternion(radians(roll), radians(pitch), 1.0)), noise=0.05)
    euler = np.empty(3)
    euler_angles(s[Q : Q + 4], euler)
    down = matrix(s[Q : Q + 4]).T[:, 2]
    angle = np.arccos(np.clip(down @ matrix(quaternion(radians(roll), radians(pitch))).T[:, 2], -1.0, 1.0))
    assert angle < 0.003  # 0.05 / sqrt(100) / g is 5e-4
    if abs(pitch) < 80.0:
        assert abs((euler[0] - radians(roll) + pi) % (2 * pi) - pi) < 0.005
        assert abs(euler[1] - radians(pitch)) < 0.005
    P = covariance(s)
    assert angle < 3.0 * np.sqrt(max(P[0, 0], P[1, 1]))
    # the heading is arbitrary, and must not be turned by what is learnt of the tilt
    assert np.sqrt(P[2, 2]) < 0.1
    assert s[L.YAW_KNOWN] == 0.0
    assert out[1][0, L.NOTE_CODE] == NoteCode.ALIGNED
    assert out[1][0, L.NOTE_A] == 1.0


@pytest.mark.parametrize(("roll", "pitch"), ATTITUDES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_tilt_error_of_a_bias_is_what_the_covariance_says(roll: float, pitch: float, axis: int) -> None:
    truth, bias = quaternion(radians(roll), radians(pitch)), 0.1 * np.eye(3)[axis]
    s, *_ = align(matrix(truth), bias=bias)
    C, D = matrix(truth), matrix(s[Q : Q + 4])
    tilt = np.cross(D @ C.T @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0])[:2]  # of down, seen in the estimated n
    P = covariance(s)
    expected = P[THETA : THETA + 2, DBA : DBA + 3] @ np.linalg.solve(P[DBA : DBA + 3, DBA : DBA + 3], bias)
    np.testing.assert_allclose(tilt, expected, atol=3e-4)  # second order: (0.1 / g)^2
    assert np.all(np.abs(tilt) < 3.0 * np.sqrt(np.diag(P)[:2]))
    assert np.linalg.eigvalsh(P).min() > -1e-12


@pytest.mark.parametrize("yaw", [0.0, 1.0, pi / 2, 3.0, -2.0])
def test_finding_the_yaw_turns_the_covariance_with_it(yaw: float) -> None:
    s, c, out = align(matrix(quaternion(0.2, -0.1, yaw)))
    s[L.DECLINATION], s[L.STRENGTH] = 0.0, 4.8e-5
    e = np.full(L.EVENT_WIDTH, np.nan)
    e[TIME] = s[L.T]
    e[FIELD : FIELD + 3] = matrix(quaternion(0.2, -0.1, yaw)).T @ [2.1e-5, 0.0, 4.3e-5]
    use_magnetometer.python(s, e, c, out)
    assert s[L.YAW_KNOWN] == 1.0
    np.testing.assert_allclose(matrix(s[Q : Q + 4]), matrix(quaternion(0.2, -0.1, yaw)), atol=1e-6)
    # levelling at the true yaw: dtheta_N = (C dba)_E / g, dtheta_E = -(C dba)_N / g
    P, C = covariance(s), matrix(s[Q : Q + 4])
    bias = c[Parameter.ACCEL_BIAS] ** 2
    np.testing.assert_allclose(P[THETA, DBA : DBA + 3], C[1] * bias / G, atol=1e-9)
    np.testing.assert_allclose(P[THETA + 1, DBA : DBA + 3], -C[0] * bias / G, atol=1e-9)


def test_a_still_second_tells_the_gyro_bias() -> None:
    s, *_ = align(np.eye(3), gyro=(0.01, -0.02, 0.015))
    np.testing.assert_allclose(s[BG : BG + 3], [0.01, -0.02, 0.015], atol=1e-9)
    assert np.sqrt(covariance(s)[DBG, DBG]) < 0.005


def test_a_turning_vehicle_is_not_taken_for_still() -> None:
    s, c, out = align(np.eye(3), gyro=(0.0, 0.0, 0.5))
    assert np.all(s[BG : BG + 3] == 0.0)
    assert covariance(s)[DBG, DBG] == pytest.approx(c[Parameter.GYRO_BIAS] ** 2)
    assert covariance(s)[0, 0] > 0.1**2
    assert out[1][0, L.NOTE_A] == 0.0


def test_a_slow_imu_takes_four_samples() -> None:
    s, *_ = align(np.eye(3), rate=1.5)
    assert s[L.T] == pytest.approx(52.0)


def test_a_fall_aligns_nothing() -> None:
    s, c = new_state()
    out = outputs()
    for i in range(500):
        assert not collect.python(s, np.full(6, 0.1), 50.0 + 0.01 * i, c, out)
    assert s[L.ALIGNED] == 0.0


def test_an_attitude_found_late_leaves_the_barometer_tied_to_the_height() -> None:
    # a position and the bias of the barometer against it may be there before the IMU
    s, c = new_state()
    P = covariance(s)
    P[8, 8], P[8, DBARO], P[DBARO, 8], P[DBARO, DBARO] = 4.0, 4.0, 4.0, 4.16
    before = P[DBARO].copy()
    out = outputs()
    for i in range(200):
        collect.python(s, np.array([0.0, 0.0, 0.0, 0.0, 0.0, -G]), 50.0 + 0.01 * i, c, out)
    assert s[L.ALIGNED] == 1.0
    np.testing.assert_array_equal(P[DBARO], before)


def test_steady_braking_is_not_standing_still_for_a_receiver_that_sees_it_move() -> None:
    s, c = new_state()
    s[L.GNSS_SPEED] = 12.0
    out = outputs()
    for i in range(200):
        if collect.python(s, np.array([0.0, 0.0, 0.0, -1.33, 0.0, -G]), 50.0 + 0.01 * i, c, out):
            break
    assert out[1][0, L.NOTE_A] == 0.0
    assert np.sqrt(covariance(s)[1, 1]) > 1.33 / G


def test_this_file_measures_tilt_right() -> None:
    # a body rolled by +1 deg: its down, -g up, seen by the accelerometer as -g sin(roll) on y
    s, *_ = align(np.array([[1, 0, 0], [0, cos(0.0175), -sin(0.0175)], [0, sin(0.0175), cos(0.0175)]]))
    q = s[Q : Q + 4]
    assert 2.0 * atan2(q[1], q[0]) == pytest.approx(0.0175, abs=1e-9)
