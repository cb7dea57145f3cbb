"""What is known without a sensor: which way gravity points, and that a vehicle standing still stands still."""

import math

import numpy as np

from mavkf.compiled import kernel
from mavkf.models.earth import STANDARD_GRAVITY
from mavkf.models.rotation import rotation_matrix
from mavkf.models.strapdown import BA, BG, DBA, DBG, THETA, VEL, Q, V
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Reason, Sensor
from mavkf.navigation.covariance import bring_up
from mavkf.navigation.fusing import fuse
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.yaw_bank import relevel_bank
from mavkf.samples import GYRO_RESOLUTION
from mavkf.stack import matrix, vector, zero_matrix

LEVEL_PERIOD = 0.1  # s between levelling updates
LEVEL_QUIET = 0.3  # m/s^2: acceleration of a vehicle that seems to be still
LEVEL_MOVING = 1.5  # m/s^2: and of one that is known to move
REST_PERIOD = 0.2  # s between updates at rest
REST_AFTER = 1.0  # s without a sign of motion
# Signs of motion: a gust on the parked vehicle stays below, rotors do not. rad/s, (rad/s)^2 and (m/s^2)^2 of sample differences per axis.
REST_RATE, REST_GYRO, REST_ACCEL = 0.03, 0.01**2, 0.15**2
REST_DRIFT_SPEED = 0.3  # m/s: mean of the receiver over seconds, beyond what its noise and wander show at rest
REST_VELOCITY = 0.02  # m/s
REST_GYRO_NOISE = 1e-3  # rad/s
REST_COUNTS = 300.0  # updates in which the rounding to whole counts stays the same


@kernel
def level(s, e, c, out):
    """Level by gravity while the velocity is not carried by the accelerometer: the specific force is -g but for the acceleration.

    r = (C_nb f_b) horizontal, f_n about (0, 0, -g), so H = [f_n x] on dtheta. The unknown acceleration lasts, so its variance is
    spread over its time constant.
    """
    x = s[L.X : L.P]
    if not s[L.T] >= s[L.T_GRAVITY] + LEVEL_PERIOD - 1e-6 and math.isfinite(s[L.T_GRAVITY]):
        return
    since = s[L.T] - s[L.T_GRAVITY] if math.isfinite(s[L.T_GRAVITY]) else LEVEL_PERIOD
    s[L.T_GRAVITY] = s[L.T]
    bring_up(s, c, out)
    C = matrix(3, 3)
    rotation_matrix(x[Q : Q + 4], C)
    f = vector(3)
    for i in range(3):
        f[i] = s[L.IMU + 3 + i] - x[BA + i]
    size = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    r = vector(2)
    for i in range(2):
        r[i] = C[i, 0] * f[0] + C[i, 1] * f[1] + C[i, 2] * f[2]
    H = zero_matrix(2, int(s[L.STATES]))
    H[0, THETA + 1] = STANDARD_GRAVITY
    H[1, THETA] = -STANDARD_GRAVITY
    for i in range(2):
        for j in range(3):
            H[i, DBA + j] = C[i, j]
    moving = s[L.POSITION_KNOWN] != 0.0 and math.hypot(x[V], x[V + 1]) > 1.0
    variance = LEVEL_QUIET**2 + (size - STANDARD_GRAVITY) ** 2 + s[L.DIFFERENCE_ACCEL]
    if moving:
        # in a turn the acceleration is speed times rate, however steady it looks
        turn = C[2, 0] * s[L.RATE] + C[2, 1] * s[L.RATE + 1] + C[2, 2] * s[L.RATE + 2]
        variance += LEVEL_MOVING**2 + (x[V] * x[V] + x[V + 1] * x[V + 1]) * turn * turn
    R = zero_matrix(2, 2)
    R[0, 0] = variance * max(1.0, c[Parameter.ACCELERATION_TIME] / max(since, 1e-3))
    R[1, 1] = R[0, 0]
    fuse(s, e, c, out, Sensor.GRAVITY, r, H, R, Reason.FUSED)
    if s[L.BANK_UPDATES] > 0.0:
        rotation_matrix(x[Q : Q + 4], C)
        for j in range(3):
            f[j] = s[L.IMU + 3 + j] - x[BA + j]
        north = C[0, 0] * f[0] + C[0, 1] * f[1] + C[0, 2] * f[2]
        east = C[1, 0] * f[0] + C[1, 1] * f[1] + C[1, 2] * f[2]
        relevel_bank(s, north - r[0], east - r[1])


@kernel
def rest(s, e, c, out, gyro, accel):
    """At rest (disarmed, and no sign of motion for a while) the velocity is zero, the attitude stays and the gyro shows its bias.

    gyro, accel: mean squared differences of this sample and the one before, per axis. A hovering vehicle is armed, however smooth it is.
    """
    rate = 0.0
    for i in range(3):
        rate += s[L.RATE + i] ** 2
    drifts = s[L.GNSS_SPEED] ** 2 + s[L.GNSS_SPEED + 1] ** 2 > REST_DRIFT_SPEED**2
    moving = drifts or s[L.ARMED] != 0.0 or not rate < REST_RATE**2 or not gyro < REST_GYRO or not accel < REST_ACCEL
    if moving or not math.isfinite(s[L.REST_SINCE]):
        s[L.REST_SINCE] = s[L.T] if not moving else np.nan
        if s[L.RESTING] != 0.0:
            bring_up(s, c, out)
            s[L.RESTING] = 0.0
        return
    if s[L.T] - s[L.REST_SINCE] < REST_AFTER:
        return
    if s[L.RESTING] == 0.0:
        bring_up(s, c, out)
        s[L.RESTING] = 1.0
    if s[L.T] < s[L.T_REST] + REST_PERIOD - 1e-6:
        return
    s[L.T_REST] = s[L.T]
    bring_up(s, c, out)
    x = s[L.X : L.P]
    r = vector(3)
    H = zero_matrix(3, int(s[L.STATES]))
    R = zero_matrix(3, 3)
    if s[L.POSITION_KNOWN] != 0.0:
        for i in range(3):
            r[i] = -x[V + i]
            H[i, VEL + i] = 1.0
            R[i, i] = REST_VELOCITY**2
        fuse(s, e, c, out, Sensor.REST_VELOCITY, r, H, R, Reason.FUSED)
    for i in range(3):
        r[i] = s[L.IMU + i] - x[BG + i]
        for j in range(H.shape[1]):
            H[i, j] = 0.0
        H[i, DBG + i] = 1.0
        R[i, i] = REST_GYRO_NOISE**2 + REST_COUNTS * e[GYRO_RESOLUTION] ** 2 / 12.0
    fuse(s, e, c, out, Sensor.REST_RATE, r, H, R, Reason.FUSED)
