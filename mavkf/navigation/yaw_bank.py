"""Yaw without a compass: a bank of small filters, each with a guess of the heading, weighed by how well it explains the GNSS velocity.

Hypothesis i holds a velocity (m/s), the angle psi (rad) by which north of the state's attitude, whose heading is arbitrary, is off, and
what the error of the tilt does to the horizontal acceleration in that frame (m/s^2):

    v <- v + Rz(psi) (a' + b) dt,   a' the horizontal acceleration seen by the levelled accelerometer

An attitude that was found in the middle of a turn takes the acceleration for gravity: a' is then wrong by as much as it shows, and lasts.
Gaussian sum filter: Alspach and Sorenson, "Nonlinear Bayesian Estimation Using Gaussian Sum Approximations", IEEE Trans. Automatic Control
17(4), 1972. While the vehicle does not accelerate no guess is better than another and yaw stays unknown.
"""

import math

import numpy as np

from mavkf.compiled import INTEGER, NOTHING, VECTOR, compiled, compiled_apart, kernel
from mavkf.models.earth import STANDARD_GRAVITY
from mavkf.models.rotation import rotation_matrix, wrap_angle
from mavkf.models.strapdown import BA, DBG, THETA, Q
from mavkf.navigation import layout as L
from mavkf.navigation.alignment import turn_heading
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.fusing import note
from mavkf.navigation.layout import OUT
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.receivers import way_since, white_variance
from mavkf.samples import SIGMA_SPEED, TIME, VELOCITY_E, VELOCITY_N
from mavkf.stack import block, matrix, zero_matrix, zero_vector

ACCELERATION_NOISE = 0.3  # m/s^2/sqrt(Hz): a tilt of two degrees, lasting a second
HEADING_NOISE = 5e-3  # rad/sqrt(s): what an unknown gyro bias turns
FORGOTTEN = 4.0  # times the variance of the tilt, at which a guess's own error of it is begun anew
CERTAIN = math.radians(10.0)  # one sigma, at which the bank becomes one filter
LEAST_UPDATES = 10
# Columns of a hypothesis: velocity, heading, acceleration by the tilt's error; their covariance (5, 5); weight (a logarithm); and what was
# covered since the last fix, m
VN, VE, PSI, BN, BE = range(5)
M = 5
COVARIANCE, WEIGHT, DN, DE = M, M + M * M, M + M * M + 1, M + M * M + 2


@compiled
def guesses(s):
    """The bank (GUESSES, GUESS) of a state, as a view."""
    return block(s, L.BANK, L.GUESSES, L.GUESS)


@compiled
def covariance_of(b):
    """P (M, M) of a hypothesis, as a view."""
    return block(b, COVARIANCE, M, M)


@kernel
def tilt_variances(s):
    """Variances of an axis of the tilt (rad^2) and of the gyro bias ((rad/s)^2), of the axis that is known worst."""
    P = L.covariance(s)
    tilt = max(P[THETA, THETA], P[THETA + 1, THETA + 1])
    return tilt, max(P[DBG, DBG], P[DBG + 1, DBG + 1], P[DBG + 2, DBG + 2])


@kernel
def begin_bank(s, v):
    """Spread the guesses evenly over the circle, each with the velocity v."""
    bank = guesses(s)
    bank[:, :] = 0.0
    width = 2.0 * math.pi / L.GUESSES
    tilt, _ = tilt_variances(s)
    for i in range(L.GUESSES):
        bank[i, VN], bank[i, VE] = v[0], v[1]
        bank[i, PSI] = -math.pi + (i + 0.5) * width
        own = covariance_of(bank[i])
        for j in range(2):
            own[VN + j, VN + j] = 0.5**2
            own[BN + j, BN + j] = STANDARD_GRAVITY**2 * tilt
        own[PSI, PSI] = (0.6 * width) ** 2
    s[L.BANK_UPDATES] = 1.0
    s[L.BANK_SINCE] = s[L.T]


@kernel
def predict_bank(s, imu0, imu1, dt):
    """Advance every guess by dt (s) with the samples (6,) at both ends."""
    C = matrix(3, 3)
    rotation_matrix(s[Q : Q + 4], C)
    an, ae = 0.0, 0.0
    for j in range(3):
        f = 0.5 * (imu0[3 + j] + imu1[3 + j]) - s[BA + j]
        an += C[0, j] * f
        ae += C[1, j] * f
    # an error of the gyro bias turns the tilt steadily: (g sigma t)^2
    tilt, bias = tilt_variances(s)
    drift = 2.0 * STANDARD_GRAVITY**2 * bias * (s[L.T] - s[L.BANK_SINCE] + 0.5 * dt) * dt
    bank = guesses(s)
    Phi = zero_matrix(M, M)
    for i in range(M):
        Phi[i, i] = 1.0
    A = matrix(M, M)
    for i in range(L.GUESSES):
        b = bank[i]
        cos, sin = math.cos(b[PSI]), math.sin(b[PSI])
        north = cos * (an + b[BN]) - sin * (ae + b[BE])
        east = sin * (an + b[BN]) + cos * (ae + b[BE])
        b[DN] += (b[VN] + 0.5 * north * dt) * dt
        b[DE] += (b[VE] + 0.5 * east * dt) * dt
        b[VN] += north * dt
        b[VE] += east * dt
        # dv/dpsi = (-a_E, a_N) dt
        Phi[VN, PSI], Phi[VE, PSI] = -east * dt, north * dt
        Phi[VN, BN], Phi[VN, BE] = cos * dt, -sin * dt
        Phi[VE, BN], Phi[VE, BE] = sin * dt, cos * dt
        P = covariance_of(b)
        for j in range(M):
            for k in range(M):
                A[j, k] = 0.0
                for m in range(M):
                    A[j, k] += Phi[j, m] * P[m, k]
        for j in range(M):
            for k in range(j, M):
                total = 0.0
                for m in range(M):
                    total += A[j, m] * Phi[k, m]
                P[j, k] = total
                P[k, j] = total
        for j in range(2):
            P[VN + j, VN + j] += ACCELERATION_NOISE**2 * dt
            P[BN + j, BN + j] += drift
        P[PSI, PSI] += HEADING_NOISE**2 * dt
        if max(P[BN, BN], P[BE, BE]) > FORGOTTEN * STANDARD_GRAVITY**2 * tilt:
            # what levelling has found since says more
            for j in range(2):
                b[BN + j] = 0.0
                P[BN + j, :] = 0.0
                P[:, BN + j] = 0.0
                P[BN + j, BN + j] = STANDARD_GRAVITY**2 * tilt


@kernel
def relevel_bank(s, north, east):
    """Levelling has changed the horizontal acceleration a' by so much (m/s^2), and its error with it: their sum stays."""
    bank = guesses(s)
    for i in range(L.GUESSES):
        bank[i, BN] -= north
        bank[i, BE] -= east


@kernel
def weigh(b, r0, r1, variance):
    """Update one guess with a velocity innovation of this variance per axis, in place; its weight by the likelihood."""
    P = covariance_of(b)
    s00, s01, s11 = P[VN, VN] + variance, P[VN, VE], P[VE, VE] + variance
    determinant = s00 * s11 - s01 * s01
    i00, i01, i11 = s11 / determinant, -s01 / determinant, s00 / determinant
    b[WEIGHT] -= 0.5 * (r0 * (i00 * r0 + i01 * r1) + r1 * (i01 * r0 + i11 * r1)) + 0.5 * math.log(determinant)
    columns = matrix(M, 2)
    for j in range(M):
        for k in range(2):
            columns[j, k] = P[j, k]
    for j in range(M):
        k0 = columns[j, 0] * i00 + columns[j, 1] * i01
        k1 = columns[j, 0] * i01 + columns[j, 1] * i11
        b[j] += k0 * r0 + k1 * r1
        for k in range(M):
            P[j, k] -= k0 * columns[k, 0] + k1 * columns[k, 1]


@kernel
def seen_velocity(s, e, c, b, v):
    """Fill v (3,), of which two count, with the velocity of a fix, or of the way since the last one; returns its variance.

    Zero is returned where there is neither. b: the receiver's book.
    """
    if math.isfinite(e[VELOCITY_N]) and math.isfinite(e[VELOCITY_E]):
        v[0], v[1] = e[VELOCITY_N], e[VELOCITY_E]
        sigma = max(e[SIGMA_SPEED] if e[SIGMA_SPEED] > 0.0 else c[Parameter.SPEED], 2.0 * c[Parameter.SPEED_FLOOR])
        return sigma * sigma + (c[Parameter.COURSE] / (1.0 + math.hypot(v[0], v[1]))) ** 2
    dt = way_since(s, e, b, v)
    if dt == 0.0:
        return 0.0
    return 2.0 * white_variance(s, e, c, b, False) / (dt * dt) + c[Parameter.SPEED_FLOOR] ** 2


@compiled_apart(NOTHING, VECTOR, VECTOR, VECTOR, OUT, INTEGER)
def use_bank(s, e, c, out, b):
    """Weigh the guesses by a fix's velocity; where they agree well enough, turn the attitude to their mean. b: the receiver's book."""
    if s[L.YAW_KNOWN] != 0.0 or s[L.ALIGNED] == 0.0 or c[Parameter.USE_MOTION_YAW] == 0.0:
        return
    v = zero_vector(3)
    variance = seen_velocity(s, e, c, b, v)
    if variance == 0.0 or s[L.RESTING] != 0.0:
        s[L.BANK_UPDATES] = 0.0
        return
    if s[L.BANK_UPDATES] == 0.0:
        begin_bank(s, v)
        return
    way = not math.isfinite(e[VELOCITY_N])
    dt = e[TIME] - s[b + L.F_T_BEFORE]
    bank = guesses(s)
    best = -np.inf
    for i in range(L.GUESSES):
        north = bank[i, DN] / dt if way else bank[i, VN]
        east = bank[i, DE] / dt if way else bank[i, VE]
        weigh(bank[i], v[0] - north, v[1] - east, variance)
        bank[i, DN], bank[i, DE] = 0.0, 0.0
        best = max(best, bank[i, WEIGHT])
    total, cos, sin = 0.0, 0.0, 0.0
    for i in range(L.GUESSES):
        # the weights of hopeless guesses must not run away: they may be right after all
        bank[i, WEIGHT] = max(bank[i, WEIGHT] - best, -20.0)
        w = math.exp(bank[i, WEIGHT])
        total += w
        cos += w * math.cos(bank[i, PSI])
        sin += w * math.sin(bank[i, PSI])
    mean = math.atan2(sin, cos)
    spread = 0.0
    for i in range(L.GUESSES):
        w = math.exp(bank[i, WEIGHT]) / total
        spread += w * (covariance_of(bank[i])[PSI, PSI] + wrap_angle(bank[i, PSI] - mean) ** 2)
    s[L.BANK_UPDATES] += 1.0
    if spread < CERTAIN**2 and s[L.BANK_UPDATES] >= LEAST_UPDATES:
        turn_heading(s, mean, spread)
        note(out, NoteCode.YAW_FROM_MOTION, s[L.BANK_SINCE], s[L.T], math.sqrt(spread), 0.0, 0.0)
