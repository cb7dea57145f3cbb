"""Quaternions against rotation matrices made another way (Rodrigues' formula, products of elementary rotations)."""

from math import pi

import numpy as np
import pytest

from mavkf.models.rotation import (
    euler_angles,
    quaternion_exp,
    quaternion_from_euler,
    quaternion_log,
    quaternion_product,
    rotate_left,
    rotate_right,
    rotation_matrix,
    wrap_angle,
)

ANGLES = [0.0, 1e-300, 1e-12, 1e-9, 1e-5, 0.99e-4, 1.01e-4, 1e-3, 0.5, pi / 2, 3.0, pi - 1e-6, pi - 1e-9]


def directions(count: int = 20) -> np.ndarray:
    d = np.random.default_rng(1).normal(size=(count, 3))
    return np.concatenate([np.eye(3), -np.eye(3), d / np.linalg.norm(d, axis=1, keepdims=True)])


def skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rodrigues(v: np.ndarray) -> np.ndarray:
    """The rotation matrix of a rotation vector, without quaternions."""
    angle = np.linalg.norm(v)
    if angle == 0.0:
        return np.eye(3)
    u = skew(v / angle)
    # 1 - cos as a square, so that it keeps its digits when small
    return np.eye(3) + np.sin(angle) * u + 2.0 * np.sin(angle / 2.0) ** 2 * u @ u


def exp(v: np.ndarray) -> np.ndarray:
    q = np.empty(4)
    quaternion_exp(v[0], v[1], v[2], q)
    return q


def matrix(q: np.ndarray) -> np.ndarray:
    C = np.empty((3, 3))
    rotation_matrix(q, C)
    return C


def random_quaternions(count: int, seed: int) -> np.ndarray:
    q = np.random.default_rng(seed).normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_is_rodrigues_and_log_is_its_inverse(angle: float) -> None:
    for u in directions():
        v = angle * u
        q = exp(v)
        assert abs(q @ q - 1.0) < 1e-15
        np.testing.assert_allclose(matrix(q), rodrigues(v), rtol=0, atol=4e-16 + 1e-15 * angle)
        for representative in (q, -q):
            back = np.empty(3)
            quaternion_log(representative, back)
            np.testing.assert_allclose(back, v, rtol=1e-12, atol=1e-300 if angle < 3.0 else 1e-12)


@pytest.mark.parametrize("angle", [pi + 1e-6, 4.0, 2 * pi - 1e-3])
def test_log_takes_the_short_way_round(angle: float) -> None:
    for u in directions():
        back = np.empty(3)
        quaternion_log(exp(angle * u), back)
        np.testing.assert_allclose(back, (angle - 2 * pi) * u, rtol=0, atol=1e-12)


def test_half_a_turn_has_a_log_of_length_pi() -> None:
    for u in directions():
        back = np.empty(3)
        quaternion_log(np.array([0.0, *u]), back)
        np.testing.assert_allclose(back, pi * u, rtol=0, atol=1e-14)


def test_product_is_the_product_of_matrices() -> None:
    for a, b in zip(random_quaternions(200, 2), random_quaternions(200, 3), strict=True):
        out = np.empty(4)
        quaternion_product(a, b, out)
        np.testing.assert_allclose(matrix(out), matrix(a) @ matrix(b), rtol=0, atol=2e-15)


def test_hamilton_convention() -> None:
    i, j, k = np.eye(4)[1:]
    out = np.empty(4)
    quaternion_product(i, j, out)
    np.testing.assert_array_equal(out, k)


def test_rotate_left_turns_in_n_and_rotate_right_in_b() -> None:
    vectors = np.random.default_rng(4).normal(size=(200, 3))
    for q, v in zip(random_quaternions(200, 5), vectors, strict=True):
        left, right = q.copy(), q.copy()
        rotate_left(left, *v)
        rotate_right(right, *v)
        np.testing.assert_allclose(matrix(left), rodrigues(v) @ matrix(q), rtol=0, atol=3e-15)
        np.testing.assert_allclose(matrix(right), matrix(q) @ rodrigues(v), rtol=0, atol=3e-15)


def test_a_hundred_thousand_steps_leave_a_unit_quaternion() -> None:
    q = random_quaternions(1, 6)[0]
    steps = 0.1 * np.random.default_rng(7).normal(size=(100_000, 3))
    for x, y, z in steps.tolist():
        rotate_right(q, x, y, z)
        rotate_left(q, y, z, x)
    assert abs(q @ q - 1.0) < 1e-14


def elementary(axis: int, angle: float) -> np.ndarray:
    v = np.zeros(3)
    v[axis] = angle
    return rodrigues(v)


def test_euler_angles_are_yaw_then_pitch_then_roll_and_come_back() -> None:
    random = np.random.default_rng(8)
    for roll, pitch, yaw in random.uniform([-pi, -pi / 2 + 1e-3, -pi], [pi, pi / 2 - 1e-3, pi], (500, 3)):
        q, back = np.empty(4), np.empty(3)
        quaternion_from_euler(roll, pitch, yaw, q)
        expected = elementary(2, yaw) @ elementary(1, pitch) @ elementary(0, roll)
        np.testing.assert_allclose(matrix(q), expected, rtol=0, atol=2e-15)
        euler_angles(q, back)
        # near +-90 deg of pitch roll and yaw lose digits as 1 / cos(pitch)
        np.testing.assert_allclose(back, [roll, pitch, yaw], rtol=0, atol=1e-11)


@pytest.mark.parametrize("pitch", [pi / 2, -pi / 2])
def test_straight_up_and_down_have_euler_angles(pitch: float) -> None:
    q, back = np.empty(4), np.empty(3)
    quaternion_from_euler(0.3, pitch, 0.8, q)
    euler_angles(q, back)
    assert np.all(np.isfinite(back))
    assert abs(back[1] - pitch) < 1e-7  # the sine is flat there


def test_the_z_axis_of_a_level_body_points_down_and_its_x_axis_along_the_yaw() -> None:
    q = np.empty(4)
    quaternion_from_euler(0.0, 0.0, pi / 2, q)
    np.testing.assert_allclose(matrix(q) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)  # east
    quaternion_from_euler(0.0, 0.2, 0.0, q)
    assert (matrix(q) @ [1.0, 0.0, 0.0])[2] < 0.0  # nose up


@pytest.mark.parametrize("turns", [-1000, -1, 0, 1, 7])
def test_wrap_angle(turns: int) -> None:
    for angle in np.linspace(-pi + 1e-9, pi - 1e-9, 101):
        assert abs(wrap_angle(angle + 2 * pi * turns) - angle) < 1e-12
