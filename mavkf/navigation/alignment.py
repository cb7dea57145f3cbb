"""The first attitude: tilt from gravity over a second of samples, as good as the samples allow."""

import math

from mavkf.compiled import BOOLEAN, FLOAT, VECTOR, compiled_apart, kernel
from mavkf.models.earth import STANDARD_GRAVITY
from mavkf.models.rotation import quaternion_from_euler, rotate_left, rotation_matrix
from mavkf.models.strapdown import BA, BG, DBA, DBG, THETA, Q
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.disturbances import begin_fault
from mavkf.navigation.fusing import forget, note
from mavkf.navigation.layout import OUT
from mavkf.navigation.monitors import stop_monitors
from mavkf.navigation.parameter import Parameter
from mavkf.stack import matrix, vector, zero_vector

DURATION = 1.0  # s
SAMPLES = 4  # a slow IMU takes longer
# Still: what a vehicle on the ground shows, propellers off or idling.
STILL_RATE, STILL_RATE_SPREAD, STILL_FORCE_SPREAD, STILL_FORCE = 0.05, 0.02, 0.3, 0.6  # rad/s, rad/s, m/s^2, m/s^2
STILL_SPEED = (
    1.0  # m/s: what no receiver shows of a vehicle that stands; steady braking looks as still as standing does
)
WRONG_FORCE = 1.0  # m/s^2 off gravity at rest: a tenth of a scale, more than any calibration leaves
YAW_ARBITRARY = (
    0.01  # rad: one sigma about a heading that is arbitrary until yaw is found, so that levelling does not turn it
)
GYRO_STILL = 2e-3  # rad/s: how well a still second tells the gyro bias, vibration and counts included


@compiled_apart(BOOLEAN, VECTOR, VECTOR, FLOAT, VECTOR, OUT)
def collect(s, e_imu, t, c, out):
    """Take one sample (6,) into the sums; when they are complete, set the attitude and its covariance. Returns whether it did."""
    k = L.ALIGN_SUM
    if s[L.ALIGN_COUNT] == 0.0 or t - s[L.T_IMU] > 1.0 + c[Parameter.GAP]:
        s[L.ALIGN_START] = t
        s[L.ALIGN_COUNT] = 0.0
        s[k : k + 12] = 0.0
    s[L.ALIGN_COUNT] += 1.0
    for i in range(6):
        s[k + i] += e_imu[i]
        s[k + 6 + i] += e_imu[i] * e_imu[i]
    n = s[L.ALIGN_COUNT]
    if n < SAMPLES or t - s[L.ALIGN_START] < DURATION:
        return False
    mean = vector(6)
    spread = zero_vector(2)
    for i in range(6):
        mean[i] = s[k + i] / n
        spread[i // 3] += max(0.0, s[k + 6 + i] / n - mean[i] * mean[i])
    s[L.ALIGN_COUNT] = 0.0
    force = math.sqrt(mean[3] ** 2 + mean[4] ** 2 + mean[5] ** 2)
    rate = math.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2)
    if force < 0.3 * STANDARD_GRAVITY:
        return False  # falling, or no accelerometer: which way is down cannot be seen
    calm = (
        rate < STILL_RATE
        and spread[0] < STILL_RATE_SPREAD**2
        and spread[1] < STILL_FORCE_SPREAD**2
        and math.hypot(s[L.GNSS_SPEED], s[L.GNSS_SPEED + 1]) < STILL_SPEED
    )
    still = calm and abs(force - STANDARD_GRAVITY) < STILL_FORCE
    if calm and s[L.ARMED] != 1.0 and abs(force - STANDARD_GRAVITY) > WRONG_FORCE:
        # which way is down it still shows, but nothing that can be integrated
        begin_fault(s, out, NoteCode.ACCELEROMETER_SCALE, s[L.ALIGN_START], force, STANDARD_GRAVITY, 0.0)
    x = s[L.X : L.P]
    # f_b = -C_nb' g: roll and pitch of the specific force
    roll = math.atan2(-mean[4], -mean[5])
    pitch = math.atan2(mean[3], math.hypot(mean[4], mean[5]))
    quaternion_from_euler(roll, pitch, 0.0, x[Q : Q + 4])
    for i in range(3):
        x[BG + i] = mean[i] if still else 0.0
    x[BA : BA + 3] = 0.0
    # what makes the force longer or shorter than gravity, where it lies across it: a^2 = f^2 - g^2
    set_covariance(s, c, still, math.sqrt(spread[1] + abs(force * force - STANDARD_GRAVITY**2)))
    s[L.ALIGNED] = 1.0
    s[L.YAW_KNOWN] = 0.0
    s[L.T] = t
    P = L.covariance(s)
    note(out, NoteCode.ALIGNED, s[L.ALIGN_START], t, math.sqrt(P[THETA, THETA]), 1.0 if still else 0.0, force)
    return True


@kernel
def doubt_stillness(s, c):
    """Align as a moving vehicle does after all, where the first fix shows one that must have moved when it seemed still."""
    s[BG : BG + 3] = 0.0
    set_covariance(s, c, False, c[Parameter.ACCELERATION])


@kernel
def set_covariance(s, c, still, unrest):
    """Covariance of attitude and biases after levelling; `unrest` (m/s^2): how far the force was from constant gravity.

    Levelling lays the accelerometer's bias into the tilt, dtheta_E = -(C dba)_N / g and dtheta_N = (C dba)_E / g, so the two are
    correlated from the start.
    """
    x = s[L.X : L.P]
    P = L.covariance(s)
    C = matrix(3, 3)
    rotation_matrix(x[Q : Q + 4], C)
    bias = c[Parameter.ACCEL_BIAS] ** 2
    other = (0.02 if still else 0.1 + 0.5 * min(unrest / STANDARD_GRAVITY, 1.0)) ** 2
    forget(s, THETA, 3, 0.0)
    forget(s, DBG, 3, GYRO_STILL**2 if still else c[Parameter.GYRO_BIAS] ** 2)
    forget(s, DBA, 3, bias)
    for i in range(2):
        P[THETA + i, THETA + i] = bias / STANDARD_GRAVITY**2 + other
        sign = 1.0 if i == 0 else -1.0
        for j in range(3):
            P[THETA + i, DBA + j] = sign * C[1 - i, j] * bias / STANDARD_GRAVITY
            P[DBA + j, THETA + i] = P[THETA + i, DBA + j]
    P[THETA + 2, THETA + 2] = YAW_ARBITRARY**2


@kernel
def turn_heading(s, turn, variance):
    """Turn the attitude about down by an angle (rad): the heading is known from now on, with this variance (rad^2), free of all else.

    The tilt's part of P turns with it: it is the error of the same body axes, seen from another north.
    """
    P = L.covariance(s)
    stop_monitors(s)
    rotate_left(s[Q : Q + 4], 0.0, 0.0, turn)
    c, d = math.cos(turn), math.sin(turn)
    for j in range(P.shape[0]):
        north, east = P[THETA, j], P[THETA + 1, j]
        P[THETA, j] = c * north - d * east
        P[THETA + 1, j] = d * north + c * east
    for j in range(P.shape[0]):
        north, east = P[j, THETA], P[j, THETA + 1]
        P[j, THETA] = c * north - d * east
        P[j, THETA + 1] = d * north + c * east
    forget(s, THETA + 2, 1, variance)
    s[L.YAW_KNOWN] = 1.0
    s[L.BANK_UPDATES] = 0.0
