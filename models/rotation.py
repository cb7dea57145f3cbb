"""Rotations: Hamilton quaternions, scalar first, that take body vectors to n; the attitude error is on the left, in n.

q_true = exp(dtheta_n) * q_nb. References: Sola, "Quaternion kinematics for the error-state Kalman filter" (2017),
eqs. 12 (product), 101 (exponential), 115 (rotation matrix).
"""

import math

from mavkf.compiled import kernel
from mavkf.stack import vector


@kernel
def quaternion_product(a, b, out):
    """Hamilton product out = a * b; each of shape (4,), scalar first. `out` may be neither a nor b."""
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]


@kernel
def quaternion_exp(x, y, z, out):
    """Unit quaternion (4,) of the rotation vector (x, y, z) in rad; exact at zero through the series of sin(a)/a."""
    angle_squared = x * x + y * y + z * z
    if angle_squared < 1e-8:
        # half-angle series: the next term is below 1e-18
        scale = 0.5 - angle_squared / 48.0
        out[0] = 1.0 - angle_squared / 8.0
    else:
        angle = math.sqrt(angle_squared)
        scale = math.sin(0.5 * angle) / angle
        out[0] = math.cos(0.5 * angle)
    out[1] = scale * x
    out[2] = scale * y
    out[3] = scale * z


@kernel
def quaternion_log(q, out):
    """Rotation vector (3,) in rad, of length at most pi, of the unit quaternion q (4,): inverse of `quaternion_exp`."""
    sign = 1.0 if q[0] >= 0.0 else -1.0
    sine = math.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    scale = 2.0 * sign if sine < 1e-9 else 2.0 * sign * math.atan2(sine, sign * q[0]) / sine
    out[0] = scale * q[1]
    out[1] = scale * q[2]
    out[2] = scale * q[3]


@kernel
def rotate_left(q, x, y, z):
    """q <- exp((x, y, z)) * q, normalised, in place: a rotation by a vector (rad) given in n."""
    e = vector(4)
    quaternion_exp(x, y, z, e)
    a, b, c, d = q[0], q[1], q[2], q[3]
    w0 = e[0] * a - e[1] * b - e[2] * c - e[3] * d
    w1 = e[0] * b + e[1] * a + e[2] * d - e[3] * c
    w2 = e[0] * c - e[1] * d + e[2] * a + e[3] * b
    w3 = e[0] * d + e[1] * c - e[2] * b + e[3] * a
    scale = 1.0 / math.sqrt(w0 * w0 + w1 * w1 + w2 * w2 + w3 * w3)
    q[0] = w0 * scale
    q[1] = w1 * scale
    q[2] = w2 * scale
    q[3] = w3 * scale


@kernel
def rotate_right(q, x, y, z):
    """q <- q * exp((x, y, z)), normalised, in place: a rotation by a vector (rad) given in b."""
    e = vector(4)
    quaternion_exp(x, y, z, e)
    a, b, c, d = q[0], q[1], q[2], q[3]
    w0 = a * e[0] - b * e[1] - c * e[2] - d * e[3]
    w1 = a * e[1] + b * e[0] + c * e[3] - d * e[2]
    w2 = a * e[2] - b * e[3] + c * e[0] + d * e[1]
    w3 = a * e[3] + b * e[2] - c * e[1] + d * e[0]
    scale = 1.0 / math.sqrt(w0 * w0 + w1 * w1 + w2 * w2 + w3 * w3)
    q[0] = w0 * scale
    q[1] = w1 * scale
    q[2] = w2 * scale
    q[3] = w3 * scale


@kernel
def rotation_matrix(q, C):
    """C_nb (3, 3) of the unit quaternion q_nb (4,)."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    C[0, 0] = a * a + b * b - c * c - d * d
    C[0, 1] = 2.0 * (b * c - a * d)
    C[0, 2] = 2.0 * (b * d + a * c)
    C[1, 0] = 2.0 * (b * c + a * d)
    C[1, 1] = a * a - b * b + c * c - d * d
    C[1, 2] = 2.0 * (c * d - a * b)
    C[2, 0] = 2.0 * (b * d - a * c)
    C[2, 1] = 2.0 * (c * d + a * b)
    C[2, 2] = a * a - b * b - c * c + d * d


@kernel
def euler_angles(q, out):
    """Roll, pitch, yaw (3,) in rad, sequence ZYX, body forward-right-down to n, of the unit quaternion q_nb (4,)."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    out[0] = math.atan2(2.0 * (c * d + a * b), a * a - b * b - c * c + d * d)
    out[1] = math.asin(min(1.0, max(-1.0, -2.0 * (b * d - a * c))))
    out[2] = math.atan2(2.0 * (b * c + a * d), a * a + b * b - c * c - d * d)


@kernel
def quaternion_from_euler(roll, pitch, yaw, q):
    """q_nb (4,) of the ZYX Euler angles in rad."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    q[0] = cr * cp * cy + sr * sp * sy
    q[1] = sr * cp * cy - cr * sp * sy
    q[2] = cr * sp * cy + sr * cp * sy
    q[3] = cr * cp * sy - sr * sp * cy


@kernel
def wrap_angle(angle):
    """The angle (rad) brought to [-pi, pi]."""
    return angle - 2.0 * math.pi * round(angle / (2.0 * math.pi))
