"""Strapdown navigation: the IMU is the input, the state is attitude, velocity, position and the slow errors of sensors.

Nominal state x (shape `X_SIZE`): q_nb (4), v_n (3, m/s), latitude and longitude (rad), height (m), gyro bias (3, rad/s),
accelerometer bias (3, m/s^2), barometer bias (1, m), coloured error of the GNSS position (3, m, north-east-down), GNSS delay beyond the
nominal one (1, s), magnetic field of the earth in n (3, T), bias of the magnetometer in b (3, T).

Error state dx (shape `N`), with its covariance P: dtheta_n (3, rad, on the left), dv_n (3, m/s), dp_n (3, m, north-east-down),
then differences of the rest in the same order.

Mechanisation: Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems", 2nd ed., section 5.4, with rotation
and force averaged by the trapezoid of two samples and the coning term of two-sample algorithms (Savage 1998, eq. 46: dt^2/12 w0 x w1).
Error equations: Groves section 14.2.4, with the signs of the left error used here.
"""

import math

from mavkf.compiled import FLOAT, MATRIX, VECTOR, called_with, kernel
from mavkf.models.earth import EARTH_RATE, SEMI_MAJOR_AXIS, gravity, radii
from mavkf.models.rotation import (
    quaternion_log,
    quaternion_product,
    rotate_left,
    rotate_right,
    rotation_matrix,
    wrap_angle,
)
from mavkf.stack import block, matrix, vector

Q, V, LATITUDE, LONGITUDE, HEIGHT, BG, BA, BARO, GNSS, DELAY, EARTH_FIELD, IRON = (
    0,
    4,
    7,
    8,
    9,
    10,
    13,
    16,
    17,
    20,
    21,
    24,
)
X_SIZE = 27

THETA, VEL, POS, DBG, DBA, DBARO, DGNSS, DDELAY, DFIELD, DIRON = 0, 3, 6, 9, 12, 15, 16, 19, 20, 23
N = 26
SUMS = 51  # integrals over an interval, of which its transition is made
TOP = 15  # error states that the rotation, velocity and position rows depend on


@kernel
def rates_of_frame(x, out):
    """Fill out (9,): omega_in = omega_ie + omega_en and omega_ie in n (rad/s), g (m/s^2), and two radii plus height (m); returns g.

    The radii of curvature are the meridian and the transverse one. Raises nothing; near the poles the transport rate grows without bound
    (such positions are refused earlier). x: nominal state.
    """
    latitude, h = x[LATITUDE], x[HEIGHT]
    sine, cosine = math.sin(latitude), math.cos(latitude)
    meridian, transverse = radii(latitude)
    out[6], out[7], out[8] = gravity(latitude, h), meridian + h, transverse + h
    out[3] = EARTH_RATE * cosine
    out[4] = 0.0
    out[5] = -EARTH_RATE * sine
    out[0] = out[3] + x[V + 1] / out[8]
    out[1] = -x[V] / out[7]
    out[2] = out[5] - x[V + 1] * sine / (cosine * out[8])
    return out[6]


@kernel
def move(x, north, east, down):
    """Move the position by metres in n, in place."""
    meridian, transverse = radii(x[LATITUDE])
    x[LONGITUDE] += east / ((transverse + x[HEIGHT]) * math.cos(x[LATITUDE]))
    x[LATITUDE] += north / (meridian + x[HEIGHT])
    x[HEIGHT] -= down
    x[LONGITUDE] = wrap_angle(x[LONGITUDE])


@kernel
def offset(latitude, longitude, height, latitude0, longitude0, height0, out):
    """Metres north, east, down (3,) from position 0 to the first; curvature taken half way."""
    meridian, transverse = radii(0.5 * (latitude + latitude0))
    half = 0.5 * (height + height0)
    east = wrap_angle(longitude - longitude0)
    out[0] = (latitude - latitude0) * (meridian + half)
    out[1] = east * (transverse + half) * math.cos(0.5 * (latitude + latitude0))
    out[2] = height0 - height


@kernel
def propagate_attitude(x, imu0, imu1, dt, frame):
    """Advance q by the gyro only, in place. imu: (6,) omega_b, f_b; frame: as of `rates_of_frame`."""
    w0x, w0y, w0z = imu0[0] - x[BG], imu0[1] - x[BG + 1], imu0[2] - x[BG + 2]
    w1x, w1y, w1z = imu1[0] - x[BG], imu1[1] - x[BG + 1], imu1[2] - x[BG + 2]
    k = dt * dt / 12.0
    q = x[Q : Q + 4]
    rotate_right(
        q,
        0.5 * dt * (w0x + w1x) + k * (w0y * w1z - w0z * w1y),
        0.5 * dt * (w0y + w1y) + k * (w0z * w1x - w0x * w1z),
        0.5 * dt * (w0z + w1z) + k * (w0x * w1y - w0y * w1x),
    )
    rotate_left(q, -frame[0] * dt, -frame[1] * dt, -frame[2] * dt)


@called_with(VECTOR, VECTOR, VECTOR, FLOAT, VECTOR)
@kernel
def propagate(x, imu0, imu1, dt, average):
    """Advance the nominal state by dt (s) with the samples at both ends of the interval, in place.

    imu0, imu1: (6,) angular rate omega_b (rad/s) and specific force f_b (m/s^2) as measured, biases not removed.
    average: (21,), filled with what `gather` needs of the interval: f_n (3), C_nb at its middle (9), the rates of the frame (6),
    g, and the radii plus height (2).
    """
    frame = average[12:21]
    g = rates_of_frame(x, frame)
    C0 = matrix(3, 3)
    C1 = matrix(3, 3)
    rotation_matrix(x[Q : Q + 4], C0)
    propagate_attitude(x, imu0, imu1, dt, frame)
    rotation_matrix(x[Q : Q + 4], C1)
    for i in range(3):
        total = 0.0
        for j in range(3):
            total += C0[i, j] * (imu0[3 + j] - x[BA + j]) + C1[i, j] * (imu1[3 + j] - x[BA + j])
            average[3 + 3 * i + j] = 0.5 * (C0[i, j] + C1[i, j])
        average[i] = 0.5 * total
    v0, v1, v2 = x[V], x[V + 1], x[V + 2]
    rx, ry, rz = frame[0] + frame[3], frame[1] + frame[4], frame[2] + frame[5]
    x[V] = v0 + dt * (average[0] - (ry * v2 - rz * v1))
    x[V + 1] = v1 + dt * (average[1] - (rz * v0 - rx * v2))
    x[V + 2] = v2 + dt * (average[2] - (rx * v1 - ry * v0) + g)
    # as `move` does it, with the radii that are there
    x[LONGITUDE] = wrap_angle(x[LONGITUDE] + 0.5 * dt * (v1 + x[V + 1]) / (average[20] * math.cos(x[LATITUDE])))
    x[LATITUDE] += 0.5 * dt * (v0 + x[V]) / average[19]
    x[HEIGHT] -= 0.5 * dt * (v2 + x[V + 2])


@called_with(VECTOR, FLOAT, VECTOR)
@kernel
def gather(average, dt, sums):
    """Add a step's averages (21,) over dt to the integrals `sums` (SUMS,) of an interval, zero at its begin, that `transition` is made of.

    Of f_n: once and twice over time; of C_nb the same; of [f x] times the integral of C once and twice; and the last rates of the frame.
    """
    f = average[0:3]
    C = block(average, 3, 3, 3)
    F, FF = sums[0:3], sums[3:6]
    S, SS, D, DD = block(sums, 6, 3, 3), block(sums, 15, 3, 3), block(sums, 24, 3, 3), block(sums, 33, 3, 3)
    half, sixth = 0.5 * dt * dt, dt * dt * dt / 6.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        FF[i] += F[i] * dt + f[i] * half
        for m in range(3):
            # ([f x] C)_im, and of the integral of C so far
            cross = f[j] * C[k, m] - f[k] * C[j, m]
            before = f[j] * S[k, m] - f[k] * S[j, m]
            DD[i, m] += D[i, m] * dt + before * half + cross * sixth
            D[i, m] += before * dt + cross * half
    for i in range(3):
        F[i] += f[i] * dt
        for m in range(3):
            SS[i, m] += S[i, m] * dt + C[i, m] * half
            S[i, m] += C[i, m] * dt
    for i in range(9):
        sums[42 + i] = average[12 + i]


@called_with(VECTOR, VECTOR, FLOAT, MATRIX)
@kernel
def transition(x, sums, dt, Phi):
    """Rows of attitude, velocity and position of the transition matrix over dt: Phi, shape (9, TOP); the other rows are the identity.

    sums: of `gather`, over that time. All orders where the coupling is through the specific force, first order in the (slow) rates of the
    frame.
    """
    Phi[:, :] = 0.0
    F, FF, frame = sums[0:3], sums[3:6], sums[42:51]
    for i in range(3):
        Phi[THETA + i, THETA + i] = 1.0
        Phi[VEL + i, VEL + i] = 1.0
        Phi[POS + i, POS + i] = 1.0
        Phi[POS + i, VEL + i] = dt
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        # -[w x]: entry (i, j) is +w_k, entry (i, k) is -w_j
        Phi[THETA + i, THETA + j] = frame[k] * dt
        Phi[THETA + i, THETA + k] = -frame[j] * dt
        Phi[VEL + i, VEL + j] += (frame[k] + frame[3 + k]) * dt
        Phi[VEL + i, VEL + k] -= (frame[j] + frame[3 + j]) * dt
        Phi[VEL + i, THETA + j] = F[k]
        Phi[VEL + i, THETA + k] = -F[j]
        Phi[POS + i, THETA + j] = FF[k]
        Phi[POS + i, THETA + k] = -FF[j]
        for m in range(3):
            Phi[THETA + i, DBG + m] = -sums[6 + 3 * i + m]
            Phi[VEL + i, DBA + m] = -sums[6 + 3 * i + m]
            Phi[POS + i, DBA + m] = -sums[15 + 3 * i + m]
            Phi[VEL + i, DBG + m] = sums[24 + 3 * i + m]
            Phi[POS + i, DBG + m] = sums[33 + 3 * i + m]
    # the frame turns with the velocity; gravity falls with height
    Phi[THETA, VEL + 1] = -dt / frame[8]
    Phi[THETA + 1, VEL] = dt / frame[7]
    Phi[THETA + 2, VEL + 1] = dt * math.tan(x[LATITUDE]) / frame[8]
    Phi[VEL + 2, POS + 2] = 2.0 * frame[6] / SEMI_MAJOR_AXIS * dt


@kernel
def retract(x, dx):
    """x <- x boxplus dx (n,), in place: left rotation by dtheta_n, metres in n for the position, sums for the rest.

    n may be larger than N: what other models add to the state follows in the order of dx.
    """
    rotate_left(x[Q : Q + 4], dx[THETA], dx[THETA + 1], dx[THETA + 2])
    for i in range(3):
        x[V + i] += dx[VEL + i]
    move(x, dx[POS], dx[POS + 1], dx[POS + 2])
    for i in range(dx.shape[0] - DBG):
        x[BG + i] += dx[DBG + i]


@kernel
def local(x, y, dx):
    """dx = y boxminus x, the inverse of `retract`: retract(x, dx) is y."""
    conjugate = vector(4)
    for i in range(4):
        conjugate[i] = x[Q + i] if i == 0 else -x[Q + i]
    difference = vector(4)
    quaternion_product(y[Q : Q + 4], conjugate, difference)
    quaternion_log(difference, dx[THETA : THETA + 3])
    for i in range(3):
        dx[VEL + i] = y[V + i] - x[V + i]
    meridian, transverse = radii(x[LATITUDE])
    dx[POS] = (y[LATITUDE] - x[LATITUDE]) * (meridian + x[HEIGHT])
    dx[POS + 1] = wrap_angle(y[LONGITUDE] - x[LONGITUDE]) * (transverse + x[HEIGHT]) * math.cos(x[LATITUDE])
    dx[POS + 2] = x[HEIGHT] - y[HEIGHT]
    for i in range(dx.shape[0] - DBG):
        dx[DBG + i] = y[BG + i] - x[BG + i]
