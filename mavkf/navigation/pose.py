"""The pose row: what a state says to the outside, as plain numbers."""

import math

import numpy as np

from mavkf.compiled import MATRIX, NOTHING, VECTOR, called_with, compiled_apart, kernel
from mavkf.models.rotation import euler_angles
from mavkf.models.strapdown import BA, BG, HEIGHT, LATITUDE, LONGITUDE, POS, THETA, TOP, VEL, Q, V, offset
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Flag, ModeCode, NoteCode
from mavkf.navigation.covariance import colour_decay, predict_covariance, transition_behind
from mavkf.navigation.disturbances import is_on
from mavkf.navigation.protection import protection_levels
from mavkf.navigation.receivers import book_of
from mavkf.stack import copy, matrix, vector

POSITION_LIMIT, VELOCITY_LIMIT = 50.0, 10.0  # m, m/s: one sigma, horizontal, up to which the value is called valid
TILT_LIMIT, YAW_LIMIT = math.radians(10.0), math.radians(20.0)
RECENT = 2.0  # s: sensors heard within it are there


@kernel
def mode_of(s):
    """The mode (value of a ModeCode) of a state."""
    if s[L.POSITION_KNOWN] != 0.0:
        return ModeCode.DEAD_RECKONING.value if s[L.OUTAGE] != 0.0 else ModeCode.NAVIGATING.value
    if s[L.ALIGNED] != 0.0:
        return ModeCode.ATTITUDE.value
    return ModeCode.ALIGNING.value if math.isfinite(s[L.T_IMU]) else ModeCode.WAITING.value


@kernel
def flags_of(s):
    """The flags of a state, as bits."""
    flags = 0
    if not s[L.T] - s[L.T_IMU] < RECENT:
        flags |= 1 << Flag.NO_IMU.value
    if not s[L.T] - s[L.T_FIX] < RECENT:
        flags |= 1 << Flag.NO_GNSS.value
    elif s[book_of(s[L.MAIN]) + L.F_REFUSED_COUNT] > 0.0:
        flags |= 1 << Flag.GNSS_REFUSED.value
    if math.isfinite(s[L.SUSPECT_POSITION]) or math.isfinite(s[L.SUSPECT_VELOCITY]) or is_on(s, NoteCode.GNSS_FROZEN):
        flags |= 1 << Flag.GNSS_SUSPECTED.value
    if is_on(s, NoteCode.MAGNETIC_DISTURBANCE):
        flags |= 1 << Flag.MAGNETOMETER_DISTURBED.value
    if not s[L.T] - s[L.T_FIELD] < RECENT:
        flags |= 1 << Flag.NO_MAGNETOMETER.value
    if s[L.YAW_KNOWN] == 0.0:
        flags |= 1 << Flag.YAW_UNKNOWN.value
    if s[L.PERIOD] > L.SLOW and math.isfinite(s[L.T_IMU]):
        flags |= 1 << Flag.IMU_SLOW.value
    if s[L.POSITION_KNOWN] != 0.0 and s[L.MODEL] == L.CONSTANT_VELOCITY:
        flags |= 1 << Flag.CONSTANT_VELOCITY.value
    return flags


@kernel
def valid_of(s, P):
    """Which parts may be used, as bits: known, and sure enough.

    A state that has crossed a gap of the IMU is nothing to go by until a few fixes have put it right.
    """
    if s[L.RECOVERING] > 0.0 and s[L.POSITION_KNOWN] != 0.0:
        return 0
    valid = 0
    if s[L.POSITION_KNOWN] != 0.0:
        if P[POS, POS] + P[POS + 1, POS + 1] < 2.0 * POSITION_LIMIT**2:
            valid |= L.VALID_POSITION
        if P[VEL, VEL] + P[VEL + 1, VEL + 1] < 2.0 * VELOCITY_LIMIT**2:
            valid |= L.VALID_VELOCITY
    if s[L.ALIGNED] != 0.0 and max(P[THETA, THETA], P[THETA + 1, THETA + 1]) < TILT_LIMIT**2:
        valid |= L.VALID_TILT
        if s[L.YAW_KNOWN] != 0.0 and P[THETA + 2, THETA + 2] < YAW_LIMIT**2:
            valid |= L.VALID_YAW
    return valid


@kernel
def sigma_euler(P, q, euler, out):
    """One sigma of roll, pitch, yaw (rad) from the covariance of dtheta_n: rows of d(euler)/d(dtheta), ZYX."""
    cy, sy = math.cos(euler[2]), math.sin(euler[2])
    cp = max(abs(math.cos(euler[1])), 1e-6)
    tp = math.sin(euler[1]) / cp
    rows = matrix(3, 3)
    rows[0, 0], rows[0, 1], rows[0, 2] = cy / cp, sy / cp, 0.0
    rows[1, 0], rows[1, 1], rows[1, 2] = -sy, cy, 0.0
    rows[2, 0], rows[2, 1], rows[2, 2] = cy * tp, sy * tp, 1.0
    for a in range(3):
        total = 0.0
        for i in range(3):
            for j in range(3):
                total += rows[a, i] * P[THETA + i, THETA + j] * rows[a, j]
        out[a] = math.sqrt(max(total, 0.0))


@compiled_apart(NOTHING, VECTOR, VECTOR, MATRIX, VECTOR)
def pose_row_with(s, c, P, row):
    """What `pose_row` does, with the covariance P (n, n) of now."""
    valid = valid_of(s, P)
    row[:] = np.nan
    row[L.R_TIME] = s[L.T]
    row[L.R_MODE] = mode_of(s)
    row[L.R_FLAGS] = flags_of(s)
    row[L.R_VALID] = valid
    row[L.R_MODEL] = s[L.MODEL]
    row[L.R_UNDULATION] = s[L.UNDULATION]
    for i in range(3):
        row[L.R_ORIGIN_LATITUDE + i] = s[L.ORIGIN_LATITUDE + i]
    show(s[L.X : L.P], P, valid, row)
    if valid & L.VALID_POSITION != 0:
        row[L.R_PL_H], row[L.R_PL_V] = protection_levels(s, c, P)
    if valid & L.VALID_TILT != 0:
        for i in range(3):
            row[L.R_RATE + i] = s[L.RATE + i]


@called_with(VECTOR, VECTOR, VECTOR)
@kernel
def pose_row(s, c, row):
    """Fill a pose row (POSE_WIDTH,) from a state and the parameters; NaN where nothing is known."""
    if s[L.BEHIND] == 0.0:
        pose_row_with(s, c, L.covariance(s), row)
        return
    n = int(s[L.STATES])
    P = matrix(n, n)
    Phi, phi = matrix(9, TOP), vector(2)
    copy(P, L.covariance(s))
    transition_behind(s, Phi)
    colour_decay(s, s[L.BEHIND], phi)
    predict_covariance(s, c, Phi, phi, P)
    pose_row_with(s, c, P, row)


@kernel
def show(x, P, valid, row):
    """Fill what is known (bits `valid`) of a nominal state x and its covariance P (n, n) into a pose row that has its origin.

    What is too uncertain to be used is not known: a number is never a guess.
    """
    position = valid & L.VALID_POSITION != 0
    velocity = valid & L.VALID_VELOCITY != 0
    attitude = valid & L.VALID_TILT != 0
    yaw = valid & L.VALID_YAW != 0
    if position:
        row[L.R_LATITUDE], row[L.R_LONGITUDE], row[L.R_HEIGHT] = x[LATITUDE], x[LONGITUDE], x[HEIGHT]
        offset(
            x[LATITUDE],
            x[LONGITUDE],
            x[HEIGHT],
            row[L.R_ORIGIN_LATITUDE],
            row[L.R_ORIGIN_LONGITUDE],
            row[L.R_ORIGIN_HEIGHT],
            row[L.R_NED : L.R_NED + 3],
        )
    if velocity:
        for i in range(3):
            row[L.R_V + i] = x[V + i]
            for j in range(3):
                row[L.R_VELOCITY_COVARIANCE + 3 * i + j] = P[VEL + i, VEL + j]
    if attitude:
        euler_angles(x[Q : Q + 4], row[L.R_EULER : L.R_EULER + 3])
        sigma_euler(P, x[Q : Q + 4], row[L.R_EULER : L.R_EULER + 3], row[L.R_SIGMA_EULER : L.R_SIGMA_EULER + 3])
        for i in range(3):
            row[L.R_BG + i] = x[BG + i]
            row[L.R_BA + i] = x[BA + i]
        if yaw:
            for i in range(4):
                row[L.R_Q + i] = x[Q + i]
        else:
            row[L.R_EULER + 2] = np.nan
            row[L.R_SIGMA_EULER + 2] = np.nan
    # what is known of the six: position, tilt, yaw
    for i in range(6):
        for j in range(6):
            known_i = position if i < 3 else (attitude if i < 5 else yaw)
            known_j = position if j < 3 else (attitude if j < 5 else yaw)
            if known_i and known_j:
                a = POS + i if i < 3 else THETA + i - 3
                b = POS + j if j < 3 else THETA + j - 3
                row[L.R_POSE_COVARIANCE + 6 * i + j] = P[a, b]
