"""A pose row in the units of the outside, and which parts of it are known: in one compiled call, because every pose is published."""

import math

from mavkf.compiled import VECTOR, called_with, kernel
from mavkf.navigation import layout as L

DEGREES = 180.0 / math.pi
# The parts of a pose that are known or not, each as a whole: columns from, to
PARTS = (
    (L.R_LATITUDE, L.R_LATITUDE + 1),
    (L.R_LONGITUDE, L.R_LONGITUDE + 1),
    (L.R_HEIGHT, L.R_HEIGHT + 1),
    (L.R_UNDULATION, L.R_UNDULATION + 1),
    (L.R_ORIGIN_LATITUDE, L.R_ORIGIN_LATITUDE + 3),
    (L.R_NED, L.R_NED + 3),
    (L.R_V, L.R_V + 3),
    (L.R_Q, L.R_Q + 4),
    (L.R_EULER, L.R_EULER + 1),
    (L.R_EULER + 1, L.R_EULER + 2),
    (L.R_EULER + 2, L.R_EULER + 3),
    (L.R_RATE, L.R_RATE + 3),
    (L.R_BG, L.R_BG + 3),
    (L.R_BA, L.R_BA + 3),
    (L.R_POSE_COVARIANCE, L.R_POSE_COVARIANCE + 36),
    (L.R_VELOCITY_COVARIANCE, L.R_VELOCITY_COVARIANCE + 9),
    (L.R_PL_H, L.R_PL_H + 1),
    (L.R_PL_V, L.R_PL_V + 1),
)
(
    LATITUDE,
    LONGITUDE,
    HEIGHT,
    ELLIPSOID,
    ORIGIN,
    NED,
    VELOCITY,
    ATTITUDE,
    ROLL,
    PITCH,
    YAW,
    RATE,
    GYRO_BIAS,
    ACCEL_BIAS,
    POSE_COVARIANCE,
    VELOCITY_COVARIANCE,
    PL_H,
    PL_V,
) = (1 << part for part in range(len(PARTS)))
"""Bits of what `turn_outward` returns."""


@called_with(VECTOR, VECTOR)
@kernel
def turn_outward(row, out):
    """Copy a pose row (POSE_WIDTH,) to `out`, angles in degrees, the ellipsoidal height in place of the undulation.

    Returns which of the PARTS are finite, as bits.
    """
    for k in range(L.POSE_WIDTH):
        out[k] = row[k]
    for k in (L.R_LATITUDE, L.R_LONGITUDE, L.R_ORIGIN_LATITUDE, L.R_ORIGIN_LONGITUDE):
        out[k] *= DEGREES
    for k in range(L.R_EULER, L.R_EULER + 3):
        out[k] *= DEGREES
    out[L.R_UNDULATION] += row[L.R_HEIGHT]
    known = 0
    for part in range(len(PARTS)):
        whole = True
        for k in range(PARTS[part][0], PARTS[part][1]):
            whole = whole and math.isfinite(out[k])
        known |= int(whole) << part
    return known
