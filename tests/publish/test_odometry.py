"""ODOMETRY: what pymavlink reads out of the bytes, against rotations by scipy."""

from math import isnan
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scipy.spatial.transform import Rotation

from mavkf.estimate import Pose, Validity
from mavkf.publish.odometry import odometry

from .conftest import make_pose

ALL = Validity(position=True, velocity=True, tilt=True, yaw=True)
TURN = Rotation.from_euler("ZYX", [130.0, -20.0, 35.0], degrees=True)  # b to n
RANDOM = np.random.default_rng(3)


def whole(**fields: Any) -> Pose:
    x, y, z, w = TURN.as_quat()
    A, B = RANDOM.normal(size=(6, 6)), RANDOM.normal(size=(3, 3))
    values: dict[str, Any] = {
        "t_boot_s": 1234.5678,
        "quaternion_nb": (w, x, y, z),
        "pose_covariance": tuple((A @ A.T).ravel()),
        "velocity_covariance": tuple((B @ B.T).ravel()),
        "valid": ALL,
    }
    return make_pose(0, **(values | fields))


def decoded(pose: Pose, resets: int = 0) -> Any:
    """Through the bytes, by pymavlink's own parser."""
    message = odometry(pose, resets)
    assert message is not None
    (found,) = mavlink.MAVLink(None).parse_buffer(message.pack(mavlink.MAVLink(None, 1, 191)))
    return found


def test_the_bytes_say_the_pose() -> None:
    pose = whole()
    found = decoded(pose, 259)
    assert (
        (found.frame_id, found.child_frame_id) == (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD) == (20, 12)
    )
    assert found.time_usec == 1_234_567_800
    assert (found.x, found.y, found.z) == pytest.approx(pose.position_ned_m)
    assert found.q == pytest.approx(pose.quaternion_nb)
    v_b = TURN.inv().apply(pose.velocity_ned_m_s)
    assert (found.vx, found.vy, found.vz) == pytest.approx(tuple(v_b), abs=1e-6)
    assert (found.rollspeed, found.pitchspeed, found.yawspeed) == pytest.approx(pose.angular_rate_b_rad_s)
    assert found.reset_counter == 3
    assert found.estimator_type == mavlink.MAV_ESTIMATOR_TYPE_GPS_INS


def test_covariances_are_the_upper_triangles_row_by_row() -> None:
    pose = whole()
    found = decoded(pose)
    P = np.reshape(pose.pose_covariance, (6, 6))  # type: ignore[arg-type]
    # by the indices of the specification: variances of x, y, z, roll, pitch, yaw, and some that lie beside them
    assert [found.pose_covariance[k] for k in (0, 6, 11, 15, 18, 20)] == pytest.approx(np.diag(P), rel=1e-6)
    assert [found.pose_covariance[k] for k in (1, 5, 7, 19)] == pytest.approx(
        [P[0, 1], P[0, 5], P[1, 2], P[4, 5]], rel=1e-5
    )
    C = TURN.as_matrix()
    V = C.T @ np.reshape(pose.velocity_covariance, (3, 3)) @ C  # type: ignore[arg-type]
    assert [found.velocity_covariance[k] for k in (0, 1, 2, 6, 7, 11)] == pytest.approx(
        V[np.triu_indices(3)], rel=1e-5, abs=1e-6
    )
    assert all(isnan(found.velocity_covariance[k]) for k in (15, 18, 20))


def test_what_is_not_known_is_nan_and_quality_says_so() -> None:
    found = decoded(whole(pose_covariance=None, angular_rate_b_rad_s=None))
    assert isnan(found.pose_covariance[0]) and isnan(found.rollspeed)
    assert found.quality == 0


@pytest.mark.parametrize(("variance", "quality"), [(0.0, 100), (0.5, 50), (1e6, 1)])
def test_quality_falls_with_sigma(variance: float, quality: int) -> None:
    covariance = tuple(variance if i in (0, 7) else 0.0 for i in range(36))
    assert decoded(whole(pose_covariance=covariance)).quality == quality


@pytest.mark.parametrize("missing", ["position", "velocity", "tilt", "yaw"])
def test_nothing_is_sent_of_what_may_not_be_used(missing: str) -> None:
    valid = Validity(**{name: name != missing for name in ("position", "velocity", "tilt", "yaw")})
    assert odometry(whole(valid=valid), 0) is None
