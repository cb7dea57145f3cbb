"""One update per sensor: predict the measurement, judge it by its NIS, fuse it, and leave a record either way.

`out` holds the output buffers: innovation rows, note rows, their two counts, the time of the last note of each code, and the numbers of
the events on record: an event that is folded again after a late one does not tell its story twice.
"""

import math

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.joseph import correct, innovation_covariance, invert, quadratic
from mavkf.models.earth import STANDARD_GRAVITY
from mavkf.models.rotation import rotate_left, rotation_matrix, wrap_angle
from mavkf.models.strapdown import (
    BA,
    BARO,
    DBA,
    DBARO,
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    POS,
    THETA,
    VEL,
    N,
    Q,
    V,
    offset,
    retract,
)
from mavkf.navigation import layout as L
from mavkf.navigation.layout import NoteCode, Parameter, Reason, Sensor
from mavkf.samples import (
    FIELD,
    HEIGHT_AMSL,
    HEIGHT_ELLIPSOID,
    PRESSURE,
    SIGMA_HORIZONTAL,
    SIGMA_SPEED,
    SIGMA_VERTICAL,
    SOURCE,
    TIME,
    VELOCITY_D,
    VELOCITY_E,
    VELOCITY_N,
)
from mavkf.samples import FIX as FIX_TYPE
from mavkf.samples import LATITUDE as FIX_LATITUDE
from mavkf.samples import LONGITUDE as FIX_LONGITUDE

FIXES_TO_START = 3
FIX_3D = 3
GRAVITY_PERIOD = 0.1  # s between levelling updates
LEVEL_QUIET = 0.3  # m/s^2: acceleration of a vehicle that seems to be still
LEVEL_MOVING = 1.5  # m/s^2: and of one that is known to move
HEADING_PERIOD = 0.1  # s between heading updates: the field's error is the same in samples closer together
REFERENCE_HORIZONTAL = 2e-5  # T: the horizontal field at which the configured heading noise holds
STRENGTH_MINIMUM, STRENGTH_MAXIMUM = (
    1.5e-5,
    9e-5,
)  # T: outside is not the earth's field (0.22 to 0.67 gauss) however disturbed
YAW_START = 0.15  # rad: one sigma of the first heading from the magnetometer


@compiled
def note(out, code, start, end, size, a, b):
    """Write a note row, unless one of this code was written for this time or a later one (the event is folded again)."""
    notes, counts, written = out[1], out[2], out[3]
    if end > written[code.value] and counts[1] < notes.shape[0]:
        written[code.value] = end
        row = notes[counts[1]]
        row[L.NOTE_CODE] = code.value
        row[L.NOTE_START] = start
        row[L.NOTE_END] = end
        row[L.NOTE_SIZE] = size
        row[L.NOTE_A] = a
        row[L.NOTE_B] = b
        counts[1] += 1


@compiled
def record(out, e, t, sensor, r, S, nis, limit, reason):
    """Write an innovation row, unless this event has left one for this sensor already (it is folded again)."""
    rows, counts, recorded = out[0], out[2], out[4]
    second = 1 if sensor == Sensor.GNSS_VELOCITY else 0
    slot = (2 * int(e[L.EVENT_ID]) + second) % recorded.shape[0]
    if recorded[slot] != e[L.EVENT_ID] and counts[0] < rows.shape[0]:
        recorded[slot] = e[L.EVENT_ID]
        row = rows[counts[0]]
        row[:] = 0.0
        m = r.shape[0]
        row[L.I_TIME] = t
        row[L.I_SENSOR] = sensor.value
        row[L.I_SOURCE] = e[SOURCE]
        row[L.I_SIZE] = m
        for i in range(m):
            row[L.I_R + i] = r[i]
            for j in range(m):
                row[L.I_S + m * i + j] = S[i, j]
        row[L.I_NIS] = nis
        row[L.I_LIMIT] = limit
        row[L.I_FUSED] = 1.0 if reason == Reason.FUSED else 0.0
        row[L.I_REASON] = reason.value
        counts[0] += 1


@compiled
def fuse(s, e, c, out, sensor, r, H, R, suspect):
    """Judge and fuse one vector; returns whether it was fused. r: (m,), H: (m, N), R: (m, m); `suspect`: a Reason against it."""
    m = r.shape[0]
    P = s[L.P : L.P + N * N].reshape((N, N))
    PHt = np.empty((N, m))
    S = np.empty((m, m))
    inverse = np.empty((m, m))
    innovation_covariance(P, H, R, PHt, S)
    limit = c[Parameter.LIMIT_1 + m - 1]
    nis = np.nan
    reason = suspect
    if not invert(S, inverse):
        reason = Reason.SINGULAR
    else:
        nis = quadratic(inverse, r)
        # a NaN fails the comparison and is refused like an outlier
        if reason == Reason.FUSED and not nis <= limit:
            reason = Reason.GATE
    record(out, e, s[L.T], sensor, r, S, nis, limit, reason)
    if reason != Reason.FUSED:
        return False
    dx = np.empty(N)
    correct(P, H, R, PHt, inverse, r, dx)
    retract(s[L.X : L.P], dx)
    return True


@compiled
def forget(s, first, count, variance):
    """Cut error states first..first+count loose from all others and give each this variance."""
    P = s[L.P : L.P + N * N].reshape((N, N))
    for i in range(first, first + count):
        for j in range(N):
            P[i, j] = 0.0
            P[j, i] = 0.0
        P[i, i] = variance


@compiled
def position_variance(e, c, column, default):
    """Variance (m^2) of a fix from what the receiver claims in a column of the row, with the configured floor."""
    claimed = e[column]
    sigma = claimed if claimed > 0.0 else default
    return max(sigma, c[Parameter.GNSS_FLOOR]) ** 2


@compiled
def set_position(s, c, e):
    """Take position and, where it is given, velocity from a fix, with the fix's covariance."""
    x = s[L.X : L.P]
    P = s[L.P : L.P + N * N].reshape((N, N))
    x[LATITUDE] = e[FIX_LATITUDE]
    x[LONGITUDE] = e[FIX_LONGITUDE]
    x[HEIGHT] = e[HEIGHT_AMSL]
    forget(s, POS, 2, position_variance(e, c, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL]))
    forget(s, POS + 2, 1, position_variance(e, c, SIGMA_VERTICAL, c[Parameter.GNSS_VERTICAL]))
    known = math.isfinite(e[VELOCITY_N]) and math.isfinite(e[VELOCITY_E])
    x[V] = e[VELOCITY_N] if known else 0.0
    x[V + 1] = e[VELOCITY_E] if known else 0.0
    x[V + 2] = e[VELOCITY_D] if math.isfinite(e[VELOCITY_D]) else 0.0
    # one second of the vehicle's usual acceleration covers a course that lags
    forget(s, VEL, 3, (1.0 if known else 10.0) ** 2)
    if math.isfinite(e[VELOCITY_D]):
        P[VEL + 2, VEL + 2] = 1.0
    else:
        P[VEL + 2, VEL + 2] = 4.0
    s[L.BAROMETER_KNOWN] = 0.0
    s[L.T_POSITION] = s[L.T]
    s[L.REFUSED_SINCE] = np.nan
    s[L.REFUSED_COUNT] = 0.0


@compiled
def agrees(latitude, longitude, height, vn, ve, dt, e, c):
    """Whether a fix lies where an earlier one and the velocity between them say, within what receivers do."""
    d = np.empty(3)
    offset(e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL], latitude, longitude, height, d)
    mean_n = 0.5 * (vn + e[VELOCITY_N]) if math.isfinite(e[VELOCITY_N]) else 0.0
    mean_e = 0.5 * (ve + e[VELOCITY_E]) if math.isfinite(e[VELOCITY_E]) else 0.0
    sigma = math.sqrt(position_variance(e, c, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL]))
    tolerance = 3.0 * sigma + 0.5 * c[Parameter.ACCELERATION] * dt * dt + 2.0 * dt
    return math.hypot(d[0] - mean_n * dt, d[1] - mean_e * dt) <= tolerance and abs(d[2]) <= 3.0 * tolerance + 10.0 * dt


@compiled
def start_position(s, e, c, out):
    """Count fixes that agree with each other; with enough of them position and velocity begin. Returns whether they did."""
    dt = s[L.T] - s[L.T_PREVIOUS_FIX]
    lat, lon, h = s[L.FIX], s[L.FIX + 1], s[L.FIX + 2]
    vn = e[VELOCITY_N] if math.isfinite(e[VELOCITY_N]) else 0.0
    ve = e[VELOCITY_E] if math.isfinite(e[VELOCITY_E]) else 0.0
    if s[L.FIX_COUNT] > 0 and dt < 5.0 and agrees(lat, lon, h, vn, ve, dt, e, c):
        s[L.FIX_COUNT] += 1.0
    else:
        s[L.FIX_COUNT] = 1.0
    if s[L.FIX_COUNT] < FIXES_TO_START:
        return False
    set_position(s, c, e)
    s[L.POSITION_KNOWN] = 1.0
    if not math.isfinite(s[L.ORIGIN_LATITUDE]):
        s[L.ORIGIN_LATITUDE] = e[FIX_LATITUDE]
        s[L.ORIGIN_LONGITUDE] = e[FIX_LONGITUDE]
        s[L.ORIGIN_HEIGHT] = e[HEIGHT_AMSL]
    sigma = math.sqrt(position_variance(e, c, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL]))
    note(out, NoteCode.POSITION_FOUND, s[L.T], s[L.T], sigma, s[L.FIX_COUNT], e[FIX_TYPE])
    return True


@compiled
def refuse_or_reset(s, e, c, out):
    """Keep account of refused positions; when they have agreed with each other for long enough, take the state to them."""
    vn = e[VELOCITY_N] if math.isfinite(e[VELOCITY_N]) else 0.0
    ve = e[VELOCITY_E] if math.isfinite(e[VELOCITY_E]) else 0.0
    k = L.REFUSED
    dt = s[L.T] - s[L.T_PREVIOUS_FIX]
    if not (s[L.REFUSED_COUNT] > 0 and agrees(s[k], s[k + 1], s[k + 2], s[k + 3], s[k + 4], dt, e, c)):
        s[L.REFUSED_SINCE] = s[L.T]
        s[L.REFUSED_COUNT] = 0.0
    s[L.REFUSED_COUNT] += 1.0
    s[k], s[k + 1], s[k + 2], s[k + 3], s[k + 4] = e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL], vn, ve
    if s[L.T] - s[L.REFUSED_SINCE] >= c[Parameter.RESET] and s[L.REFUSED_COUNT] >= FIXES_TO_START:
        d = np.empty(3)
        offset(e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL], s[LATITUDE], s[LONGITUDE], s[HEIGHT], d)
        size = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        note(out, NoteCode.POSITION_RESET, s[L.REFUSED_SINCE], s[L.T], size, s[L.REFUSED_COUNT], d[2])
        set_position(s, c, e)


@compiled
def use_gnss(s, e, c, out):
    """Fuse a fix: its position as a vector of three, its velocity as one of two or three."""
    if not e[FIX_TYPE] >= FIX_3D:
        s[L.NO_FIX] += 1.0
        return
    if not e[TIME] > s[L.T_FIX] + 1e-6 and math.isfinite(s[L.T_FIX]):
        s[L.DUPLICATES] += 1.0
        return
    s[L.T_PREVIOUS_FIX] = s[L.T_FIX]
    s[L.T_FIX] = e[TIME]
    if math.isfinite(e[HEIGHT_ELLIPSOID]):
        s[L.UNDULATION] = e[HEIGHT_ELLIPSOID] - e[HEIGHT_AMSL]
    if not math.isfinite(s[L.DECLINATION]):
        north, east, down = e[L.FIELD_N], e[L.FIELD_N + 1], e[L.FIELD_N + 2]
        if math.isfinite(c[Parameter.DECLINATION]):
            s[L.DECLINATION] = c[Parameter.DECLINATION]
        elif math.isfinite(north):
            s[L.DECLINATION] = math.atan2(east, north)
        s[L.STRENGTH] = math.sqrt(north * north + east * east + down * down)
    if s[L.POSITION_KNOWN] == 0.0:
        start_position(s, e, c, out)
    else:
        fuse_fix(s, e, c, out)
    s[L.FIX], s[L.FIX + 1], s[L.FIX + 2] = e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL]


@compiled
def fuse_fix(s, e, c, out):
    """The two updates of a fix on a known position."""
    x = s[L.X : L.P]
    r = np.empty(3)
    H = np.zeros((3, N))
    R = np.zeros((3, 3))
    offset(e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL], x[LATITUDE], x[LONGITUDE], x[HEIGHT], r)
    for i in range(3):
        H[i, POS + i] = 1.0
    R[0, 0] = position_variance(e, c, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL])
    R[1, 1] = R[0, 0]
    R[2, 2] = position_variance(e, c, SIGMA_VERTICAL, c[Parameter.GNSS_VERTICAL])
    if fuse(s, e, c, out, Sensor.GNSS_POSITION, r, H, R, Reason.FUSED):
        if s[L.OUTAGE] != 0.0:
            s[L.OUTAGE] = 0.0
            note(out, NoteCode.GNSS_BACK, s[L.T_POSITION], s[L.T], s[L.T] - s[L.T_POSITION], 0.0, 0.0)
        s[L.T_POSITION] = s[L.T]
        s[L.REFUSED_SINCE] = np.nan
        s[L.REFUSED_COUNT] = 0.0
    else:
        refuse_or_reset(s, e, c, out)
    vn, ve, vd = e[VELOCITY_N], e[VELOCITY_E], e[VELOCITY_D]
    if not (math.isfinite(vn) and math.isfinite(ve)):
        return
    m = 3 if math.isfinite(vd) else 2
    sigma = max(e[SIGMA_SPEED] if e[SIGMA_SPEED] > 0.0 else c[Parameter.SPEED], c[Parameter.SPEED_FLOOR])
    speed = math.hypot(vn, ve)
    # a slow receiver does not know its course, and some hold the last one
    across = (c[Parameter.COURSE] / (1.0 + speed)) ** 2
    un, ue = (vn / speed, ve / speed) if speed > 0.0 else (0.0, 0.0)
    R[:, :] = 0.0
    R[0, 0] = sigma * sigma + across * (1.0 - un * un)
    R[1, 1] = sigma * sigma + across * (1.0 - ue * ue)
    R[0, 1] = -across * un * ue
    R[1, 0] = R[0, 1]
    R[2, 2] = (1.5 * sigma) ** 2
    H[:, :] = 0.0
    for i in range(3):
        H[i, VEL + i] = 1.0
    r[0] = vn - x[V]
    r[1] = ve - x[V + 1]
    r[2] = vd - x[V + 2]
    if fuse(s, e, c, out, Sensor.GNSS_VELOCITY, r[:m], H[:m], R[:m, :m].copy(), Reason.FUSED):
        s[L.T_VELOCITY] = s[L.T]


@compiled
def pressure_height(pressure):
    """Height (m) in the International Standard Atmosphere of a static pressure (Pa), below 11 km (ISO 2533)."""
    return 44330.769 * (1.0 - (pressure / 101325.0) ** 0.190263)


@compiled
def use_barometer(s, e, c, out):
    """Fuse a pressure as a height with a slowly wandering bias."""
    if s[L.POSITION_KNOWN] == 0.0 or c[Parameter.USE_BAROMETER] == 0.0:
        return
    if e[PRESSURE] <= 0.0 or (math.isfinite(s[L.T_BAROMETER]) and not s[L.T] > s[L.T_BAROMETER] + 1e-6):
        s[L.DUPLICATES] += 1.0
        return
    x = s[L.X : L.P]
    P = s[L.P : L.P + N * N].reshape((N, N))
    height = pressure_height(e[PRESSURE])
    s[L.T_BAROMETER] = s[L.T]
    sigma = c[Parameter.BARO]
    if s[L.BAROMETER_KNOWN] == 0.0:
        # bias = pressure height - height: it carries the error of the height it is measured against (dp is down)
        x[BARO] = height - x[HEIGHT]
        for j in range(N):
            P[DBARO, j] = P[POS + 2, j]
            P[j, DBARO] = P[DBARO, j]
        P[DBARO, DBARO] = P[POS + 2, POS + 2] + sigma * sigma
        P[DBARO, POS + 2] = P[POS + 2, POS + 2]
        P[POS + 2, DBARO] = P[POS + 2, POS + 2]
        s[L.BAROMETER_KNOWN] = 1.0
        return
    r = np.empty(1)
    H = np.zeros((1, N))
    R = np.empty((1, 1))
    r[0] = height - (x[HEIGHT] + x[BARO])
    H[0, POS + 2] = -1.0
    H[0, DBARO] = 1.0
    R[0, 0] = sigma * sigma
    fuse(s, e, c, out, Sensor.BAROMETER, r, H, R, Reason.FUSED)


@compiled
def use_magnetometer(s, e, c, out):
    """Fuse the bearing of the levelled field as a heading; the first one sets the yaw.

    Bearing of m_n = C_nb m_b against the declination D: r = D - atan2(m_E, m_N), H = [-m_D m_N, -m_D m_E, m_h^2] / m_h^2 on dtheta.
    """
    if s[L.ALIGNED] == 0.0 or c[Parameter.USE_MAGNETOMETER] == 0.0:
        return
    mx, my, mz = e[FIELD], e[FIELD + 1], e[FIELD + 2]
    k = L.FIELD
    s[L.T_FIELD] = e[TIME]
    # a held value is older than its stamp says; only the first heading may come from one, for want of a better
    if s[L.YAW_KNOWN] != 0.0 and mx == s[k] and my == s[k + 1] and mz == s[k + 2]:
        s[L.DUPLICATES] += 1.0
        return
    s[k], s[k + 1], s[k + 2] = mx, my, mz
    if not math.isfinite(s[L.DECLINATION]) or s[L.T] < s[L.T_MAGNETOMETER] + HEADING_PERIOD - 1e-6:
        return
    x = s[L.X : L.P]
    C = np.empty((3, 3))
    rotation_matrix(x[Q : Q + 4], C)
    north = C[0, 0] * mx + C[0, 1] * my + C[0, 2] * mz
    east = C[1, 0] * mx + C[1, 1] * my + C[1, 2] * mz
    down = C[2, 0] * mx + C[2, 1] * my + C[2, 2] * mz
    horizontal2 = north * north + east * east
    strength = math.sqrt(horizontal2 + down * down)
    expected = s[L.STRENGTH] if math.isfinite(s[L.STRENGTH]) else strength
    r = np.empty(1)
    r[0] = wrap_angle(s[L.DECLINATION] - math.atan2(east, north))
    disturbed = not STRENGTH_MINIMUM < strength < STRENGTH_MAXIMUM or horizontal2 < (0.05 * strength) ** 2
    suspect = Reason.DISTURBED if disturbed else Reason.FUSED
    # a field of the wrong strength is a field with a wrong direction too
    wrong = (strength - expected) / expected
    sigma2 = (c[Parameter.HEADING] ** 2 + wrong * wrong) * REFERENCE_HORIZONTAL**2 / horizontal2
    if s[L.YAW_KNOWN] == 0.0:
        if disturbed or sigma2 > 0.25:
            return
        rotate_left(x[Q : Q + 4], 0.0, 0.0, r[0])
        forget(s, THETA + 2, 1, max(YAW_START**2, sigma2))
        s[L.YAW_KNOWN] = 1.0
        s[L.T_MAGNETOMETER] = s[L.T]
        note(out, NoteCode.YAW_ALIGNED, s[L.T], s[L.T], abs(r[0]), s[L.DECLINATION], strength)
        return
    H = np.zeros((1, N))
    R = np.empty((1, 1))
    H[0, THETA] = -down * north / horizontal2
    H[0, THETA + 1] = -down * east / horizontal2
    H[0, THETA + 2] = 1.0
    R[0, 0] = sigma2
    fuse(s, e, c, out, Sensor.MAGNETOMETER, r, H, R, suspect)
    s[L.T_MAGNETOMETER] = s[L.T]


@compiled
def level(s, e, c, out):
    """Level by gravity while the velocity is not carried by the accelerometer: the specific force is -g but for the acceleration.

    r = (C_nb f_b) horizontal, f_n about (0, 0, -g), so H = [f_n x] on dtheta. The unknown acceleration lasts, so its variance is
    spread over its time constant.
    """
    x = s[L.X : L.P]
    if not s[L.T] >= s[L.T_GRAVITY] + GRAVITY_PERIOD - 1e-6 and math.isfinite(s[L.T_GRAVITY]):
        return
    since = s[L.T] - s[L.T_GRAVITY] if math.isfinite(s[L.T_GRAVITY]) else GRAVITY_PERIOD
    s[L.T_GRAVITY] = s[L.T]
    C = np.empty((3, 3))
    rotation_matrix(x[Q : Q + 4], C)
    f = np.empty(3)
    for i in range(3):
        f[i] = s[L.IMU + 3 + i] - x[BA + i]
    size = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    r = np.empty(2)
    for i in range(2):
        r[i] = C[i, 0] * f[0] + C[i, 1] * f[1] + C[i, 2] * f[2]
    H = np.zeros((2, N))
    H[0, THETA + 1] = STANDARD_GRAVITY
    H[1, THETA] = -STANDARD_GRAVITY
    for i in range(2):
        for j in range(3):
            H[i, DBA + j] = C[i, j]
    moving = s[L.POSITION_KNOWN] != 0.0 and math.hypot(x[V], x[V + 1]) > 1.0
    variance = LEVEL_QUIET**2 + (size - STANDARD_GRAVITY) ** 2 + s[L.DIFFERENCE_ACCEL]
    if moving:
        variance += LEVEL_MOVING**2
    R = np.zeros((2, 2))
    R[0, 0] = variance * max(1.0, c[Parameter.ACCELERATION_TIME] / max(since, 1e-3))
    R[1, 1] = R[0, 0]
    fuse(s, e, c, out, Sensor.GRAVITY, r, H, R, Reason.FUSED)
