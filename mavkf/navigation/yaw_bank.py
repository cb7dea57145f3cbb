"""Yaw without a compass: a bank of small filters, each with a guess of the heading, weighed by how well it explains the GNSS velocity.

Hypothesis i holds a velocity (m/s) and the angle psi (rad) by which north of the state's attitude, whose heading is arbitrary, is off:

    v <- v + Rz(psi) a' dt,   a' the horizontal acceleration seen by the levelled accelerometer

Gaussian sum filter: Alspach and Sorenson, "Nonlinear Bayesian Estimation Using Gaussian Sum Approximations", IEEE Trans. Automatic Control
17(4), 1972. While the vehicle does not accelerate no guess is better than another and yaw stays unknown.
"""

import math

import numpy as np

from mavkf.compiled import compiled
from mavkf.models.earth import STANDARD_GRAVITY
from mavkf.models.rotation import rotation_matrix, wrap_angle
from mavkf.models.strapdown import BA, THETA, Q
from mavkf.navigation import layout as L
from mavkf.navigation.alignment import turn_heading
from mavkf.navigation.fusing import note
from mavkf.navigation.layout import NoteCode
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.receivers import way_since, white_variance
from mavkf.samples import SIGMA_SPEED, TIME, VELOCITY_E, VELOCITY_N

ACCELERATION_NOISE = 0.3  # m/s^2/sqrt(Hz): a tilt of two degrees, lasting a second
TILT_TIME = 1.0  # s
HEADING_NOISE = 5e-3  # rad/sqrt(s): what an unknown gyro bias turns
CERTAIN = math.radians(10.0)  # one sigma, at which the bank becomes one filter
LEAST_UPDATES = 10
# Columns of a hypothesis: velocity, heading, their covariance, weight (a logarithm), and what was covered since the last fix, m
VN, VE, PSI, P00, P01, P02, P11, P12, P22, WEIGHT, DN, DE = range(12)


@compiled
def begin_bank(s, v):
    """Spread the guesses evenly over the circle, each with the velocity v."""
    bank = s[L.BANK : L.BANK + L.GUESSES * L.GUESS].reshape((L.GUESSES, L.GUESS))
    width = 2.0 * math.pi / L.GUESSES
    for i in range(L.GUESSES):
        for j in range(L.GUESS):
            bank[i, j] = 0.0
        bank[i, VN], bank[i, VE] = v[0], v[1]
        bank[i, PSI] = -math.pi + (i + 0.5) * width
        bank[i, P00] = 0.5**2
        bank[i, P11] = 0.5**2
        bank[i, P22] = (0.6 * width) ** 2
    s[L.BANK_UPDATES] = 1.0
    s[L.BANK_SINCE] = s[L.T]


@compiled
def predict_bank(s, imu0, imu1, dt):
    """Advance every guess by dt (s) with the samples (6,) at both ends."""
    C = np.empty((3, 3))
    rotation_matrix(s[Q : Q + 4], C)
    # a wrong tilt is an acceleration that lasts
    P = L.covariance(s)
    tilt = STANDARD_GRAVITY**2 * max(P[THETA, THETA], P[THETA + 1, THETA + 1]) * TILT_TIME
    noise = ACCELERATION_NOISE**2 + tilt
    an, ae = 0.0, 0.0
    for j in range(3):
        f = 0.5 * (imu0[3 + j] + imu1[3 + j]) - s[BA + j]
        an += C[0, j] * f
        ae += C[1, j] * f
    bank = s[L.BANK : L.BANK + L.GUESSES * L.GUESS].reshape((L.GUESSES, L.GUESS))
    for i in range(L.GUESSES):
        b = bank[i]
        cos, sin = math.cos(b[PSI]), math.sin(b[PSI])
        north, east = cos * an - sin * ae, sin * an + cos * ae
        b[DN] += (b[VN] + 0.5 * north * dt) * dt
        b[DE] += (b[VE] + 0.5 * east * dt) * dt
        b[VN] += north * dt
        b[VE] += east * dt
        # dv/dpsi = (-a_E, a_N) dt
        fn, fe = -east * dt, north * dt
        p02, p12, p22 = b[P02], b[P12], b[P22]
        b[P00] += 2.0 * fn * p02 + fn * fn * p22 + noise * dt
        b[P01] += fn * p12 + fe * p02 + fn * fe * p22
        b[P11] += 2.0 * fe * p12 + fe * fe * p22 + noise * dt
        b[P02] += fn * p22
        b[P12] += fe * p22
        b[P22] += HEADING_NOISE**2 * dt


@compiled
def weigh(b, r0, r1, variance):
    """Update one guess with a velocity innovation of this variance per axis, in place; its weight by the likelihood."""
    s00, s01, s11 = b[P00] + variance, b[P01], b[P11] + variance
    determinant = s00 * s11 - s01 * s01
    i00, i01, i11 = s11 / determinant, -s01 / determinant, s00 / determinant
    b[WEIGHT] -= 0.5 * (r0 * (i00 * r0 + i01 * r1) + r1 * (i01 * r0 + i11 * r1)) + 0.5 * math.log(determinant)
    # columns of P that the velocity sees: (P00, P01), (P01, P11), (P02, P12)
    p00, p01, p02, p11, p12 = b[P00], b[P01], b[P02], b[P11], b[P12]
    k00, k01 = p00 * i00 + p01 * i01, p00 * i01 + p01 * i11
    k10, k11 = p01 * i00 + p11 * i01, p01 * i01 + p11 * i11
    k20, k21 = p02 * i00 + p12 * i01, p02 * i01 + p12 * i11
    b[VN] += k00 * r0 + k01 * r1
    b[VE] += k10 * r0 + k11 * r1
    b[PSI] += k20 * r0 + k21 * r1
    b[P00] -= k00 * p00 + k01 * p01
    b[P01] -= k00 * p01 + k01 * p11
    b[P02] -= k00 * p02 + k01 * p12
    b[P11] -= k10 * p01 + k11 * p11
    b[P12] -= k10 * p02 + k11 * p12
    b[P22] -= k20 * p02 + k21 * p12


@compiled
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


@compiled
def use_bank(s, e, c, out, b):
    """Weigh the guesses by a fix's velocity; where they agree well enough, turn the attitude to their mean. b: the receiver's book."""
    if s[L.YAW_KNOWN] != 0.0 or s[L.ALIGNED] == 0.0 or c[Parameter.USE_MOTION_YAW] == 0.0:
        return
    v = np.zeros(3)
    variance = seen_velocity(s, e, c, b, v)
    if variance == 0.0 or s[L.RESTING] != 0.0:
        s[L.BANK_UPDATES] = 0.0
        return
    if s[L.BANK_UPDATES] == 0.0:
        begin_bank(s, v)
        return
    way = not math.isfinite(e[VELOCITY_N])
    dt = e[TIME] - s[b + L.F_T_BEFORE]
    bank = s[L.BANK : L.BANK + L.GUESSES * L.GUESS].reshape((L.GUESSES, L.GUESS))
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
        spread += w * (bank[i, P22] + wrap_angle(bank[i, PSI] - mean) ** 2)
    s[L.BANK_UPDATES] += 1.0
    if spread < CERTAIN**2 and s[L.BANK_UPDATES] >= LEAST_UPDATES:
        turn_heading(s, mean, spread)
        s[L.YAW_KNOWN] = 1.0
        s[L.BANK_UPDATES] = 0.0
        note(out, NoteCode.YAW_FROM_MOTION, s[L.BANK_SINCE], s[L.T], math.sqrt(spread), 0.0, 0.0)
