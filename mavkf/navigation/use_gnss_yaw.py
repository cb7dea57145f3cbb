"""The heading of a receiver with two antennas in the fold: the first heading at once where there is none yet, later a measurement."""

import math

import numpy as np

from mavkf.compiled import NOTHING, VECTOR, compiled_apart, kernel
from mavkf.models import gnss
from mavkf.models.rotation import rotation_matrix, wrap_angle
from mavkf.models.strapdown import Q
from mavkf.navigation import layout as L
from mavkf.navigation.alignment import turn_heading
from mavkf.navigation.codes import NoteCode, Reason, Sensor
from mavkf.navigation.fusing import fuse, note
from mavkf.navigation.layout import OUT
from mavkf.navigation.parameter import Parameter
from mavkf.samples import GNSS_YAW
from mavkf.stack import matrix, vector

STEEP = math.cos(math.radians(75.0))  # cosine of the pitch beyond which a nose that points up or down has no heading
COMPASS_LOST = 2.0  # s without a magnetometer, after which nothing speaks for a heading against the receiver


@compiled_apart(NOTHING, VECTOR, VECTOR, VECTOR, OUT)
def use_gnss_yaw(s, e, c, out):
    """Fuse the heading of a fix, where it has one.

    No message has its accuracy (`hdg_acc` of GPS_RAW_INT is that of the track), so that is a setting. Headings refused for
    as long as positions must be before a reset are believed in the end, but not against a magnetometer that is there: of the two,
    the receiver with its antennas the wrong way round is wrong for good.
    """
    if s[L.ALIGNED] == 0.0 or c[Parameter.USE_GNSS_YAW] == 0.0 or not math.isfinite(e[GNSS_YAW]):
        return
    C = matrix(3, 3)
    r = vector(1)
    R = matrix(1, 1)
    H = matrix(1, int(s[L.STATES]))
    rotation_matrix(s[Q : Q + 4], C)
    r[0] = wrap_angle(e[GNSS_YAW] - gnss.predict_yaw(C))
    R[0, 0] = c[Parameter.GNSS_YAW] ** 2
    steep = math.hypot(C[0, 0], C[1, 0]) < STEEP
    if s[L.YAW_KNOWN] == 0.0:
        if not steep:
            align_heading(s, r[0], R[0, 0], out)
        return
    if steep:
        # there the derivative runs away
        for j in range(H.shape[1]):
            H[0, j] = 0.0
    else:
        gnss.yaw_jacobian(C, H)
    nis = fuse(s, e, c, out, Sensor.GNSS_YAW, r, H, R, Reason.DISTURBED if steep else Reason.FUSED)
    if nis >= 0.0 or steep:
        s[L.YAW_REFUSED_SINCE] = np.nan
    elif not math.isfinite(s[L.YAW_REFUSED_SINCE]):
        s[L.YAW_REFUSED_SINCE] = s[L.T]
    elif s[L.T] - s[L.YAW_REFUSED_SINCE] >= c[Parameter.RESET] and not s[L.T] - s[L.T_FIELD] < COMPASS_LOST:
        align_heading(s, r[0], R[0, 0], out)


@kernel
def align_heading(s, turn, variance, out):
    """Turn the attitude by an angle (rad) to a heading of this variance (rad^2), free of all else."""
    turn_heading(s, turn, variance)
    s[L.YAW_REFUSED_SINCE] = np.nan
    note(out, NoteCode.YAW_FROM_GNSS, s[L.T], s[L.T], abs(turn), math.sqrt(variance), 0.0)
