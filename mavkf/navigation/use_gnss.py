"""GNSS in the fold: the first position, a fix on a known one, refusals and resets, and what the innovations teach of its noise."""

import math

import numpy as np

from mavkf.compiled import compiled
from mavkf.models import gnss
from mavkf.models.gnss import ANTENNA
from mavkf.models.rotation import rotation_matrix
from mavkf.models.strapdown import (
    DGNSS,
    EARTH_FIELD,
    GNSS,
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    POS,
    THETA,
    VEL,
    Q,
    V,
    move,
    offset,
)
from mavkf.navigation import layout as L
from mavkf.navigation.fusing import forget, fuse, note
from mavkf.navigation.layout import NoteCode, Parameter, Reason, Sensor
from mavkf.navigation.learning import LEAST_IMU_SCALE, LEAST_SCALE, learn, learn_colour, learn_walk
from mavkf.navigation.use_gnss_yaw import use_gnss_yaw
from mavkf.navigation.yaw_bank import use_bank
from mavkf.samples import FIX as FIX_TYPE
from mavkf.samples import (
    HEIGHT_AMSL,
    HEIGHT_ELLIPSOID,
    SIGMA_HORIZONTAL,
    SIGMA_SPEED,
    SIGMA_VERTICAL,
    TIME,
    VELOCITY_D,
    VELOCITY_E,
    VELOCITY_N,
)
from mavkf.samples import LATITUDE as FIX_LATITUDE
from mavkf.samples import LONGITUDE as FIX_LONGITUDE

FIXES_TO_START = 3
FIX_3D = 3
PATIENCE_WITH_ITSELF = 2.0  # s of fixes refused with their velocities, after which the state is reset to them
TILT_AFTER_SHOCK = 0.1  # rad: one sigma that such a filter's attitude is off besides


@compiled
def claimed(e, column, default):
    """One sigma of a fix as the receiver claims it in a column of the row, or the default."""
    sigma = e[column]
    return sigma if sigma > 0.0 else default


@compiled
def unknown_lever(s, c):
    """One sigma (m) of an axis for a lever arm that cannot be laid into n: it stays as it is for as long as the heading does."""
    if s[L.ALIGNED] != 0.0 and s[L.YAW_KNOWN] != 0.0:
        return 0.0
    square = s[ANTENNA] ** 2 + s[ANTENNA + 1] ** 2 + s[ANTENNA + 2] ** 2
    return math.sqrt(0.5 * square + c[Parameter.ANTENNA_SIGMA] ** 2)


@compiled
def set_colour(s, e, c):
    """The least sigma of the coloured error that this fix's claim allows: it cannot be seen in the innovations, so it follows the claim."""
    horizontal = c[Parameter.COLOUR] * claimed(e, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL])
    vertical = c[Parameter.COLOUR_VERTICAL] * claimed(e, SIGMA_VERTICAL, c[Parameter.GNSS_VERTICAL])
    lever = unknown_lever(s, c)
    s[L.COLOUR_FLOOR] = math.sqrt(horizontal * horizontal + lever * lever) if lever > 0.0 else horizontal
    s[L.COLOUR_FLOOR + 1] = math.sqrt(vertical * vertical + lever * lever) if lever > 0.0 else vertical
    for i in range(2):
        s[L.COLOUR + i] = max(s[L.COLOUR + i], s[L.COLOUR_FLOOR + i])
    if lever < s[L.UNKNOWN_LEVER]:
        # from now on the lever arm is no part of the error that lingers
        redraw_colour(s)
    s[L.UNKNOWN_LEVER] = lever


@compiled
def redraw_colour(s):
    """Begin the coloured error anew, with its least sigma and free of all else."""
    for i in range(3):
        s[L.COLOUR + i // 2] = s[L.COLOUR_FLOOR + i // 2]
        s[GNSS + i] = 0.0
        forget(s, DGNSS + i, 1, s[L.COLOUR + i // 2] ** 2)


@compiled
def white_variance(s, e, c, vertical):
    """Variance (m^2) of the white part of a fix: what is claimed, scaled by what was learnt, not below the floor."""
    if vertical:
        sigma = claimed(e, SIGMA_VERTICAL, c[Parameter.GNSS_VERTICAL])
        return max(sigma * sigma * s[L.SCALE_POSITION + 1], c[Parameter.GNSS_FLOOR] ** 2)
    sigma = claimed(e, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL])
    return max(sigma * sigma * s[L.SCALE_POSITION], c[Parameter.GNSS_FLOOR] ** 2)


@compiled
def mounting(s, C, w):
    """Fill C (3, 3) with C_nb and w (3,) with omega_b; zeros where no lever arm can be laid into n: heading or rate are not known."""
    for i in range(3):
        w[i] = 0.0
        for j in range(3):
            C[i, j] = 0.0
    if s[L.ALIGNED] != 0.0 and s[L.YAW_KNOWN] != 0.0:
        rotation_matrix(s[Q : Q + 4], C)
        for i in range(3):
            w[i] = s[L.RATE + i] if math.isfinite(s[L.RATE + i]) else 0.0


@compiled
def carry_lever(s, C, w):
    """Position errors (3) that were just cut loose get the part that comes from attitude and lever arm: dp = -H_l dx."""
    P = L.covariance(s)
    H = np.empty((3, P.shape[0]))
    gnss.lever_jacobian(s[L.X : L.P], C, w, 1.0, 0.0, H)
    for i in range(3):
        for j in range(P.shape[0]):
            if j < POS or j >= POS + 3:
                total = 0.0
                for k in range(P.shape[0]):
                    total -= H[i, k] * P[k, j]
                P[POS + i, j] += total
                P[j, POS + i] = P[POS + i, j]
    for i in range(3):
        for m in range(i, 3):
            for k in range(P.shape[0]):
                if k < POS or k >= POS + 3:
                    P[POS + i, POS + m] -= H[m, k] * P[POS + i, k]
            P[POS + m, POS + i] = P[POS + i, POS + m]


@compiled
def set_position(s, c, e):
    """Take position and, where it is given, velocity from a fix, with the fix's covariance: p = fix - l - e - white."""
    x = s[L.X : L.P]
    P = L.covariance(s)
    C = np.empty((3, 3))
    w = np.empty(3)
    place = np.empty(3)
    speed = np.empty(3)
    mounting(s, C, w)
    for i in range(3):
        place[i], speed[i] = gnss.lever(x, C, w, i)
    x[LATITUDE] = e[FIX_LATITUDE]
    x[LONGITUDE] = e[FIX_LONGITUDE]
    x[HEIGHT] = e[HEIGHT_AMSL]
    move(x, -place[0], -place[1], -place[2])
    set_colour(s, e, c)
    for i in range(3):
        colour = s[L.COLOUR + i // 2] ** 2
        forget(s, POS + i, 1, white_variance(s, e, c, i == 2) + colour)
        forget(s, DGNSS + i, 1, colour)
        P[POS + i, DGNSS + i] = -colour
        P[DGNSS + i, POS + i] = -colour
        x[GNSS + i] = 0.0
    carry_lever(s, C, w)
    known = math.isfinite(e[VELOCITY_N]) and math.isfinite(e[VELOCITY_E])
    x[V] = e[VELOCITY_N] - speed[0] if known else 0.0
    x[V + 1] = e[VELOCITY_E] - speed[1] if known else 0.0
    x[V + 2] = e[VELOCITY_D] - speed[2] if math.isfinite(e[VELOCITY_D]) else 0.0
    # one second of the vehicle's usual acceleration covers a course that lags
    for i in range(3):
        forget(s, VEL + i, 1, (1.0 if known else 10.0) ** 2)
    P[VEL + 2, VEL + 2] = 1.0 if math.isfinite(e[VELOCITY_D]) else 4.0
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
    sigma = claimed(e, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL])
    # of the difference of two fixes, each off by one sigma on each axis: beyond this once in a hundred thousand
    tolerance = 5.0 * math.sqrt(2.0) * sigma + 0.5 * c[Parameter.ACCELERATION] * dt * dt + 2.0 * dt
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
    sigma = claimed(e, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL])
    note(out, NoteCode.POSITION_FOUND, s[L.T], s[L.T], sigma, s[L.FIX_COUNT], e[FIX_TYPE])
    return True


@compiled
def doubt_attitude(s):
    """What threw the velocity off has thrown the attitude off too."""
    P = L.covariance(s)
    for i in range(3):
        P[THETA + i, THETA + i] += TILT_AFTER_SHOCK**2


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
    # fixes whose velocity is refused as well have a filter against them that is wrong itself: a shock, a wild manoeuvre
    wrong = not s[L.T_VELOCITY] >= s[L.REFUSED_SINCE]
    patience = min(c[Parameter.RESET], PATIENCE_WITH_ITSELF) if wrong else c[Parameter.RESET]
    if s[L.T] - s[L.REFUSED_SINCE] >= patience and s[L.REFUSED_COUNT] >= FIXES_TO_START:
        d = np.empty(3)
        offset(e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL], s[LATITUDE], s[LONGITUDE], s[HEIGHT], d)
        size = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        note(out, NoteCode.POSITION_RESET, s[L.REFUSED_SINCE], s[L.T], size, s[L.REFUSED_COUNT], d[2])
        set_position(s, c, e)
        if wrong:
            doubt_attitude(s)


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
        if math.isfinite(north) and math.isfinite(s[L.DECLINATION]):
            # of the model the strength and the dip, of the declination what is believed
            horizontal = math.hypot(north, east)
            s[EARTH_FIELD] = horizontal * math.cos(s[L.DECLINATION])
            s[EARTH_FIELD + 1] = horizontal * math.sin(s[L.DECLINATION])
            s[EARTH_FIELD + 2] = down
    use_gnss_yaw(s, e, c, out)
    if s[L.POSITION_KNOWN] == 0.0:
        start_position(s, e, c, out)
    else:
        fuse_fix(s, e, c, out)
        use_bank(s, e, c, out)
    s[L.FIX], s[L.FIX + 1], s[L.FIX + 2] = e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL]


@compiled
def fuse_fix(s, e, c, out):
    """The two updates of a fix on a known position."""
    x = s[L.X : L.P]
    P = L.covariance(s)
    r = np.empty(3)
    z_hat = np.empty(3)
    H = np.empty((3, P.shape[0]))
    R = np.zeros((3, 3))
    S = np.empty(3)
    C = np.empty((3, 3))
    w = np.empty(3)
    a = s[L.ACCELERATION : L.ACCELERATION + 3]
    mounting(s, C, w)
    set_colour(s, e, c)
    offset(e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL], x[LATITUDE], x[LONGITUDE], x[HEIGHT], r)
    gnss.predict_position(x, a, C, w, z_hat)
    gnss.position_jacobian(x, a, C, w, H)
    for i in range(3):
        r[i] -= z_hat[i]
        R[i, i] = white_variance(s, e, c, i == 2)
        # the variance of one axis, near enough for learning: position and coloured error are what matters
        S[i] = R[i, i] + P[POS + i, POS + i] + P[DGNSS + i, DGNSS + i] + 2.0 * P[POS + i, DGNSS + i]
    nis = fuse(s, e, c, out, Sensor.GNSS_POSITION, r, H, R, Reason.FUSED)
    if nis >= 0.0:
        if s[L.OUTAGE] != 0.0:
            s[L.OUTAGE] = 0.0
            note(out, NoteCode.GNSS_BACK, s[L.T_POSITION], s[L.T], s[L.T] - s[L.T_POSITION], 0.0, 0.0)
        s[L.T_POSITION] = s[L.T]
        s[L.RECOVERING] = max(0.0, s[L.RECOVERING] - 1.0)
        s[L.REFUSED_SINCE] = np.nan
        s[L.REFUSED_COUNT] = 0.0
        horizontal = 0.5 * (r[0] * r[0] / S[0] + r[1] * r[1] / S[1])
        s[L.SCALE_POSITION] = learn(s[L.SCALE_POSITION], horizontal, 1, R[0, 0] / S[0], LEAST_SCALE)
        s[L.SCALE_POSITION + 1] = learn(s[L.SCALE_POSITION + 1], r[2] * r[2] / S[2], 1, R[2, 2] / S[2], LEAST_SCALE)
        learn_colour(s, r, S, 0, 0, 2)
        learn_colour(s, r, S, 1, 2, 1)
    else:
        refuse_or_reset(s, e, c, out)
    fuse_velocity(s, e, c, out)


@compiled
def fuse_velocity(s, e, c, out):
    """Fuse the velocity of a fix, as a vector of two or, where the message has the vertical one, three."""
    x = s[L.X : L.P]
    P = L.covariance(s)
    vn, ve, vd = e[VELOCITY_N], e[VELOCITY_E], e[VELOCITY_D]
    if not (math.isfinite(vn) and math.isfinite(ve)):
        return
    m = 3 if math.isfinite(vd) else 2
    r = np.empty(3)
    z_hat = np.empty(3)
    H = np.empty((3, P.shape[0]))
    R = np.zeros((3, 3))
    C = np.empty((3, 3))
    w = np.empty(3)
    a = s[L.ACCELERATION : L.ACCELERATION + 3]
    sigma = claimed(e, SIGMA_SPEED, c[Parameter.SPEED])
    # the claim is for white noise; part of the error lingers from fix to fix, so it has a floor
    variance = max(sigma * sigma * s[L.SCALE_VELOCITY], c[Parameter.SPEED_FLOOR] ** 2)
    speed = math.hypot(vn, ve)
    # a slow receiver does not know its course, and some hold the last one
    across = (c[Parameter.COURSE] / (1.0 + speed)) ** 2
    un, ue = (vn / speed, ve / speed) if speed > 0.0 else (0.0, 0.0)
    R[0, 0] = variance + across * (1.0 - un * un)
    R[1, 1] = variance + across * (1.0 - ue * ue)
    R[0, 1] = -across * un * ue
    R[1, 0] = R[0, 1]
    R[2, 2] = 2.25 * variance
    mounting(s, C, w)
    gnss.predict_velocity(x, a, C, w, z_hat)
    gnss.velocity_jacobian(x, a, C, w, H)
    r[0] = vn - z_hat[0]
    r[1] = ve - z_hat[1]
    r[2] = vd - z_hat[2]
    share = variance / (variance + 0.5 * (P[VEL, VEL] + P[VEL + 1, VEL + 1]))
    nis = fuse(s, e, c, out, Sensor.GNSS_VELOCITY, r[:m], H[:m], R[:m, :m].copy(), Reason.FUSED)
    if nis >= 0.0:
        s[L.T_VELOCITY] = s[L.T]
        s[L.SCALE_VELOCITY] = learn(s[L.SCALE_VELOCITY], nis, m, share, LEAST_SCALE)
        s[L.VELOCITY_REFUSED] = 0.0
        if s[L.MODEL] != L.CONSTANT_VELOCITY:
            learn_walk(s, r, variance + 0.5 * (P[VEL, VEL] + P[VEL + 1, VEL + 1]))
            s[L.SCALE_IMU] = learn(s[L.SCALE_IMU], nis, m, 1.0 - share, LEAST_IMU_SCALE)
        return
    s[L.VELOCITY_REFUSED] += 1.0
    if s[L.T] - s[L.T_VELOCITY] >= PATIENCE_WITH_ITSELF and s[L.VELOCITY_REFUSED] >= FIXES_TO_START:
        size = math.sqrt(r[0] * r[0] + r[1] * r[1])
        note(out, NoteCode.VELOCITY_RESET, s[L.T_VELOCITY], s[L.T], size, s[L.VELOCITY_REFUSED], 0.0)
        for i in range(m):
            x[V + i] += r[i]
            forget(s, VEL + i, 1, R[i, i] + 1.0)
        doubt_attitude(s)
        s[L.VELOCITY_REFUSED] = 0.0
