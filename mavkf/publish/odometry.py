"""A pose as MAVLink ODOMETRY, with the frames that ArduPilot and PX4 take: LOCAL_FRD, whose forward axis is north here, and BODY_FRD."""

from math import isfinite, nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mavkf.estimate import Pose

UPPER = np.triu_indices(6)
"""The elements of a 6x6 covariance that are sent, row by row."""


def odometry(pose: Pose, resets: int) -> mavlink.MAVLink_odometry_message | None:
    """The ODOMETRY of a pose; None where position, velocity or attitude may not be used.

    resets: how often the estimate has jumped or begun anew; sent modulo 256. Position is from the pose's origin; the time is of the
    vehicle's boot clock. Covariances: position and rotation about the axes of the local frame; velocity in b, that of the rates is not
    known (NaN). Quality: 100 where the horizontal sigma is 0, 50 at 1 m, at least 1.
    """
    if not (pose.valid.position and pose.valid.velocity and pose.valid.tilt and pose.valid.yaw):
        return None
    if (
        pose.position_ned_m is None
        or pose.velocity_ned_m_s is None
        or pose.quaternion_nb is None
        or pose.t_boot_s is None
    ):
        return None
    C_nb = _rotation(*pose.quaternion_nb)
    v_b = C_nb.T @ np.array(pose.velocity_ned_m_s)
    pose_covariance = _matrix(pose.pose_covariance, 6)
    velocity_covariance = np.zeros((6, 6))
    velocity_covariance[:3, :3] = C_nb.T @ _matrix(pose.velocity_covariance, 3) @ C_nb
    velocity_covariance[3:, 3:] = np.diag([nan] * 3)
    rates = pose.angular_rate_b_rad_s or (nan,) * 3
    return mavlink.MAVLink_odometry_message(
        round(pose.t_boot_s * 1e6),
        mavlink.MAV_FRAME_LOCAL_FRD,
        mavlink.MAV_FRAME_BODY_FRD,
        *pose.position_ned_m,
        list(pose.quaternion_nb),
        *v_b.tolist(),
        *rates,
        _sent(pose_covariance),
        _sent(velocity_covariance),
        resets % 256,
        mavlink.MAV_ESTIMATOR_TYPE_GPS_INS,
        _quality(pose_covariance),
    )


def _rotation(w: float, x: float, y: float, z: float) -> NDArray[np.float64]:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _matrix(values: Any, n: int) -> NDArray[np.float64]:
    return np.array([nan if value is None else value for value in values or [None] * n * n], float).reshape(n, n)


def _sent(covariance: NDArray[np.float64]) -> list[float]:
    found: list[float] = covariance[UPPER].tolist()
    return found


def _quality(covariance: NDArray[np.float64]) -> int:
    variance = float(covariance[0, 0] + covariance[1, 1])
    return max(1, round(100.0 / (1.0 + sqrt(variance)))) if isfinite(variance) and variance >= 0.0 else 0
