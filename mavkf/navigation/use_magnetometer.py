"""The magnetometer in the fold: the first heading, then the field as a vector with the earth's field and the vehicle's own as states."""

import math

import numpy as np

from mavkf.compiled import NOTHING, VECTOR, compiled_apart, kernel
from mavkf.filters.joseph import invert, row_variance
from mavkf.models import magnetometer
from mavkf.models.rotation import rotation_matrix, wrap_angle
from mavkf.models.strapdown import DIRON, EARTH_FIELD, IRON, Q
from mavkf.navigation import layout as L
from mavkf.navigation.alignment import turn_heading
from mavkf.navigation.codes import NoteCode, Reason, Sensor
from mavkf.navigation.covariance import bring_up, prepare
from mavkf.navigation.disturbances import begin_fault, end_fault
from mavkf.navigation.fusing import forget, fuse, note
from mavkf.navigation.layout import OUT
from mavkf.navigation.learning import learn
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.sources import changed
from mavkf.samples import FIELD, SOURCE, TIME
from mavkf.stack import matrix, vector, zero_matrix, zero_vector

PERIOD = 0.08  # s between updates: the field's error is the same in samples closer together
STRENGTH_MINIMUM, STRENGTH_MAXIMUM = (
    1.5e-5,
    9e-5,
)  # T: outside is not the earth's field (0.22 to 0.67 gauss) however disturbed
YAW_START = 0.5  # rad: one sigma of the first heading, before the field as a vector says how good it is
AGE_JITTER = 0.01  # s: how well the age of the field is known
TURN = 1.0  # s: how long a turn lasts
HELD = 0.1  # s: what a slow link shows has been held for up to a period of the sensor; ArduPilot reads it at 10 Hz
LEAST_FIELD_SCALE = 0.7  # a disturbance that lingers is not seen in the innovations, so the noise is only learnt upward
DISTURBED_AFTER = 0.5  # s of refusals, after which it is told
RELEARN_AFTER = 5.0  # s of refusals, after which the vehicle's own field is taken to have changed
SLOW = 0.2  # s between IMU samples: with a slower one it is the heading that is lost when the field disagrees
RELEARN = 5e-6  # T: one sigma of the vehicle's own field after that


@kernel
def remember(s, e):
    """Keep a field as the last one; returns whether it has the very values of the one before."""
    s[L.T_FIELD] = e[TIME]
    same = True
    for i in range(3):
        same = same and s[L.FIELD + i] == e[FIELD + i]
        s[L.FIELD + i] = e[FIELD + i]
    return same


@kernel
def is_passed_over(s, e):
    """Whether a field is too close to the last one that was used: so the most of them are, and need not wait for their IMU sample."""
    if s[L.YAW_KNOWN] == 0.0 or s[L.FIELD_USED] != e[SOURCE] or not e[TIME] < s[L.T_MAGNETOMETER] + PERIOD:
        return False
    if remember(s, e):
        s[L.DUPLICATES] += 1.0
    return True


@compiled_apart(NOTHING, VECTOR, VECTOR, VECTOR, OUT)
def use_magnetometer(s, e, c, out):
    """Fuse a field that has changed; before yaw is known the bearing of the levelled field gives it."""
    if s[L.ALIGNED] == 0.0 or c[Parameter.USE_MAGNETOMETER] == 0.0:
        return
    if changed(s, e, out, NoteCode.MAGNETOMETER_CHANGED, L.FIELD_USED, s[L.T_FIELD]):
        # another instrument: what the vehicle does to it is not known
        bring_up(s, c, out)
        for i in range(3):
            s[IRON + i] = 0.0
        forget(s, DIRON, 3, c[Parameter.IRON] ** 2)
        s[L.SCALE_FIELD] = 1.0
        s[L.FIELD_REFUSED_SINCE] = np.nan
    mx, my, mz = e[FIELD], e[FIELD + 1], e[FIELD + 2]
    # a held value is older than its stamp says; only the first heading may come from one, for want of a better
    if remember(s, e) and s[L.YAW_KNOWN] != 0.0:
        s[L.DUPLICATES] += 1.0
        return
    if not math.isfinite(s[L.DECLINATION]) or s[L.T] < s[L.T_MAGNETOMETER] + PERIOD:
        return
    prepare(s, e, c, out)
    strength = math.sqrt(mx * mx + my * my + mz * mz)
    disturbed = not STRENGTH_MINIMUM < strength < STRENGTH_MAXIMUM
    x = s[L.X : L.P]
    C = matrix(3, 3)
    rotation_matrix(x[Q : Q + 4], C)
    if s[L.YAW_KNOWN] == 0.0:
        if disturbed or not first_heading(s, C, mx, my, mz, out):
            return
        rotation_matrix(x[Q : Q + 4], C)
    z_hat = vector(3)
    r = vector(3)
    H = matrix(3, int(s[L.STATES]))
    R = zero_matrix(3, 3)
    magnetometer.predict(x, C, z_hat)
    magnetometer.jacobian(x, C, H)
    turning = 0.0
    for i in range(3):
        r[i] = e[FIELD + i] - z_hat[i]
        turning += s[L.RATE + i] ** 2 if math.isfinite(s[L.RATE + i]) else 0.0
        turning += 0.25 * s[L.LAST_DIFFERENCE + i] ** 2  # it may have turned faster between the samples
    expected = s[L.STRENGTH] if math.isfinite(s[L.STRENGTH]) else strength
    # a field of the wrong strength has a wrong direction too; a turning vehicle shows the direction of a while ago
    white = c[Parameter.MAGNETOMETER] ** 2 * s[L.SCALE_FIELD]
    # what is wrong with the age stays so while a turn lasts: as white noise it counts once a turn, not once a sample
    since = min(max(s[L.T] - s[L.T_MAGNETOMETER], PERIOD), TURN)
    age = (AGE_JITTER**2 + min(s[L.PERIOD], HELD) ** 2 / 12.0) * TURN / since
    variance = white + age * strength * strength * turning + (0.3 * (strength - expected)) ** 2
    P = L.covariance(s)
    total = 0.0
    for i in range(3):
        R[i, i] = variance
        total += variance + row_variance(P, H, i)
    s[L.T_MAGNETOMETER] = s[L.T]
    nis = fuse(s, e, c, out, Sensor.MAGNETOMETER, r, H, R, Reason.DISTURBED if disturbed else Reason.FUSED)
    size = math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    if nis >= 0.0:
        s[L.FIELD_REFUSED_SINCE] = np.nan
        end_fault(s, out, NoteCode.MAGNETIC_DISTURBANCE)
        s[L.SCALE_FIELD] = learn(s[L.SCALE_FIELD], nis, 3, 3.0 * white / total, LEAST_FIELD_SCALE)
    elif not math.isfinite(s[L.FIELD_REFUSED_SINCE]):
        s[L.FIELD_REFUSED_SINCE] = s[L.T]
    elif s[L.T] - s[L.FIELD_REFUSED_SINCE] <= RELEARN_AFTER or disturbed:
        if s[L.T] - s[L.FIELD_REFUSED_SINCE] >= DISTURBED_AFTER:
            begin_fault(s, out, NoteCode.MAGNETIC_DISTURBANCE, s[L.FIELD_REFUSED_SINCE], size, 0.0, 0.0)
    else:
        since_when = s[L.FIELD_REFUSED_SINCE]
        s[L.FIELD_REFUSED_SINCE] = np.nan
        if s[L.PERIOD] > SLOW:
            first_heading(s, C, mx - x[IRON], my - x[IRON + 1], mz - x[IRON + 2], out)
            return
        end_fault(s, out, NoteCode.MAGNETIC_DISTURBANCE)
        note(out, NoteCode.MAGNETOMETER_RELEARNT, since_when, s[L.T], size, 0.0, 0.0)
        relearn_iron(s, r)


@kernel
def relearn_iron(s, r):
    """Take r (3,), T, for a change of the vehicle's own field, or for one that it has only now got rid of: nothing tells which.

    In the second case all that rests on its old value was wrong by dx = P_xi P_ii^-1 r, and its new one is by r: one error of
    covariance (dx, r)(dx, r)'. A heading that nothing but the field has told is then as uncertain as it would be wrong; one that the
    motion has confirmed hardly hangs on it.
    """
    P = L.covariance(s)
    own = matrix(3, 3)
    inverse = matrix(3, 3)
    for i in range(3):
        for j in range(3):
            own[i, j] = P[DIRON + i, DIRON + j]
    dx = zero_vector(P.shape[0])
    if invert(own, inverse) > 0.0:
        for i in range(3):
            w = inverse[i, 0] * r[0] + inverse[i, 1] * r[1] + inverse[i, 2] * r[2]
            for k in range(P.shape[0]):
                dx[k] += P[k, DIRON + i] * w
    for i in range(3):
        s[IRON + i] += r[i]
        dx[DIRON + i] = r[i]
    forget(s, DIRON, 3, RELEARN**2)
    for k in range(P.shape[0]):
        for m in range(P.shape[0]):
            P[k, m] += dx[k] * dx[m]


@kernel
def first_heading(s, C, mx, my, mz, out):
    """Turn the attitude so that the levelled field points along the declination; returns whether that could be done."""
    x = s[L.X : L.P]
    north = C[0, 0] * mx + C[0, 1] * my + C[0, 2] * mz
    east = C[1, 0] * mx + C[1, 1] * my + C[1, 2] * mz
    down = C[2, 0] * mx + C[2, 1] * my + C[2, 2] * mz
    horizontal = math.hypot(north, east)
    strength = math.hypot(horizontal, down)
    if horizontal < 0.05 * strength:
        return False  # the field points into the ground
    turn = wrap_angle(s[L.DECLINATION] - math.atan2(east, north))
    turn_heading(s, turn, YAW_START**2)
    if not math.isfinite(s[L.STRENGTH]):
        # no model of the field (the declination was given): what is measured is all that is known
        x[EARTH_FIELD] = horizontal * math.cos(s[L.DECLINATION])
        x[EARTH_FIELD + 1] = horizontal * math.sin(s[L.DECLINATION])
        x[EARTH_FIELD + 2] = down
    note(out, NoteCode.YAW_ALIGNED, s[L.T], s[L.T], abs(turn), s[L.DECLINATION], strength)
    return True
