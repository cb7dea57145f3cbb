"""GNSS in the fold: a fix of the main receiver or of another, its position and velocity, and what the innovations teach of its noise."""

import math

import numpy as np

from mavkf.compiled import kernel
from mavkf.models import gnss
from mavkf.models.strapdown import (
    DDELAY,
    DGNSS,
    EARTH_FIELD,
    GNSS,
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    POS,
    V,
    offset,
)
from mavkf.navigation import layout as L
from mavkf.navigation.alignment import STILL_SPEED, doubt_stillness
from mavkf.navigation.antenna import mounting
from mavkf.navigation.codes import NoteCode, Reason, Sensor
from mavkf.navigation.covariance import prepare
from mavkf.navigation.disturbances import end_fault
from mavkf.navigation.fusing import SLOWEST_FOR_LEARNING, fuse, fuse_lasting, note
from mavkf.navigation.heights import compare_heights
from mavkf.navigation.learning import LEAST_SCALE, learn, learn_colour, learn_colour_time
from mavkf.navigation.monitors import begin_hypotheses
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.receivers import (
    SILENT,
    book_of,
    coloured_sigma,
    is_main,
    lasting,
    same_fix,
    set_colour,
    white_variance,
)
from mavkf.navigation.reset import refuse_or_reset, reset_position, start_position
from mavkf.navigation.suspicion import (
    SCATTER_MEMORY,
    absolve_position,
    agreement,
    fade_doubt,
    follow_scatter,
    is_frozen,
    out_of_patience,
    surprise,
    weigh_height,
    weigh_surprise,
)
from mavkf.navigation.use_gnss_velocity import fuse_velocity
from mavkf.navigation.use_gnss_yaw import use_gnss_yaw
from mavkf.navigation.verdict import judge_faults
from mavkf.navigation.yaw_bank import use_bank
from mavkf.samples import FIX as FIX_TYPE
from mavkf.samples import (
    HEIGHT_AMSL,
    HEIGHT_ELLIPSOID,
    SOURCE,
    TIME,
    VELOCITY_E,
    VELOCITY_N,
)
from mavkf.samples import LATITUDE as FIX_LATITUDE
from mavkf.samples import LONGITUDE as FIX_LONGITUDE
from mavkf.stack import matrix, vector, zero_matrix

FIX_3D = 3
SPEED_TIME = 5.0  # s
LEAST_COLOUR_SCALE = 1.0  # of what a fix's claim allows


@kernel
def use_gnss(s, e, c, out):
    """Take a fix: what it says of the place, its heading, its position and its velocity."""
    b = book_of(e[SOURCE])
    if not e[FIX_TYPE] >= FIX_3D:
        if e[SOURCE] == s[L.MAIN]:
            s[L.NO_FIX] += 1.0
        return
    if not e[TIME] > s[b + L.F_T] + 1e-6 and math.isfinite(s[b + L.F_T]):
        s[L.DUPLICATES] += 1.0
        return
    prepare(s, e, c, out)
    if not e[TIME] - s[b + L.F_T] <= SILENT:
        s[b + L.F_SINCE] = e[TIME]
    s[b + L.F_T_BEFORE] = s[b + L.F_T]
    s[b + L.F_T] = e[TIME]
    first = not math.isfinite(s[L.T_FIX])
    s[L.T_FIX] = e[TIME]
    main = is_main(s, e, c, out)
    if main and math.isfinite(e[HEIGHT_ELLIPSOID]):
        s[L.UNDULATION] = e[HEIGHT_ELLIPSOID] - e[HEIGHT_AMSL]
    if not math.isfinite(s[L.DECLINATION]):
        set_field(s, e, c)
    if main:
        follow_speed(s, e, b)
    speed = math.hypot(s[L.GNSS_SPEED], s[L.GNSS_SPEED + 1])
    if first and s[L.ALIGNED] != 0.0 and speed > STILL_SPEED + c[Parameter.ACCELERATION] * (s[L.T] - s[L.ALIGN_START]):
        doubt_stillness(s, c)
    use_gnss_yaw(s, e, c, out)
    s[b + L.F_REPEATS] = s[b + L.F_REPEATS] + 1.0 if repeats(s, e, b) else 0.0
    if s[L.POSITION_KNOWN] == 0.0:
        if main:
            start_position(s, e, c, out, b)
    elif main:
        if is_frozen(s, e, b, out):
            return
        compare_heights(s, e[HEIGHT_AMSL], e[TIME] - s[b + L.F_T_BEFORE])
        if c[Parameter.MONITORS] != 0.0:
            begin_hypotheses(s)
        fuse_position(s, e, c, out, b)
        fuse_velocity(s, e, c, out, b)
        use_bank(s, e, c, out, b)
        if s[L.MONITORED] != 0.0:
            judge_faults(s, e, c, out, b)
        fade_doubt(s, e[TIME] - s[b + L.F_T_BEFORE])
    elif same_fix(s, e):
        s[L.DUPLICATES] += 1.0
    else:
        fuse_other_position(s, e, c, out, b)
        fuse_velocity(s, e, c, out, b)
    k = b + L.F_FIX
    s[k], s[k + 1], s[k + 2] = e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL]
    s[k + 3], s[k + 4] = e[VELOCITY_N], e[VELOCITY_E]


@kernel
def repeats(s, e, b):
    """Whether a fix has the very same values as the last of its receiver, of which its book b tells."""
    k = b + L.F_FIX
    same = e[FIX_LATITUDE] == s[k] and e[FIX_LONGITUDE] == s[k + 1] and e[HEIGHT_AMSL] == s[k + 2]
    for i in range(2):
        v = e[VELOCITY_N + i]
        same = same and (v == s[k + 3 + i] or (not math.isfinite(v) and not math.isfinite(s[k + 3 + i])))
    return same


@kernel
def follow_speed(s, e, b):
    """Keep the mean of the last seconds' velocity: a boat that drifts is still for its IMU, and moves all the same."""
    dt = e[TIME] - s[b + L.F_T_BEFORE]
    weight = 1.0 - math.exp(-dt / SPEED_TIME) if math.isfinite(dt) else 1.0
    for i in range(2):
        v = e[VELOCITY_N + i]
        s[L.GNSS_SPEED + i] += weight * ((v if math.isfinite(v) else 0.0) - s[L.GNSS_SPEED + i])


@kernel
def set_field(s, e, c):
    """Set the earth's field at a fix: of the model its strength and dip, of the declination what is believed."""
    north, east, down = e[L.FIELD_N], e[L.FIELD_N + 1], e[L.FIELD_N + 2]
    if math.isfinite(c[Parameter.DECLINATION]):
        s[L.DECLINATION] = c[Parameter.DECLINATION]
    elif math.isfinite(north):
        s[L.DECLINATION] = math.atan2(east, north)
    s[L.STRENGTH] = math.sqrt(north * north + east * east + down * down)
    if math.isfinite(north) and math.isfinite(s[L.DECLINATION]):
        horizontal = math.hypot(north, east)
        s[EARTH_FIELD] = horizontal * math.cos(s[L.DECLINATION])
        s[EARTH_FIELD + 1] = horizontal * math.sin(s[L.DECLINATION])
        s[EARTH_FIELD + 2] = down


@kernel
def predict_fix(s, e, r, H):
    """Fill innovation r (3,) and H (3, n) of a fix's position, coloured error and delay included."""
    x = s[L.X : L.P]
    z_hat = vector(3)
    C = matrix(3, 3)
    w = vector(3)
    a = s[L.ACCELERATION : L.ACCELERATION + 3]
    mounting(s, C, w)
    offset(e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL], x[LATITUDE], x[LONGITUDE], x[HEIGHT], r)
    gnss.predict_position(x, a, C, w, z_hat)
    gnss.position_jacobian(x, a, C, w, H)
    for i in range(3):
        r[i] -= z_hat[i]


@kernel
def fused_position(s, out, b):
    """Note that a position of a receiver was fused."""
    if s[L.OUTAGE] != 0.0:
        s[L.OUTAGE] = 0.0
        note(out, NoteCode.GNSS_BACK, s[L.T_POSITION], s[L.T], s[L.T] - s[L.T_POSITION], 0.0, 0.0)
    s[L.T_POSITION] = s[L.T]
    s[b + L.F_T_POSITION] = s[L.T]
    s[L.RECOVERING] = max(0.0, s[L.RECOVERING] - 1.0)


@kernel
def fuse_position(s, e, c, out, b):
    """Fuse the position of the main receiver, whose coloured error is a state. b: its book."""
    P = L.covariance(s)
    r = vector(3)
    H = matrix(3, P.shape[0])
    R = zero_matrix(3, 3)
    S = vector(3)
    set_colour(s, e, c)
    predict_fix(s, e, r, H)
    for i in range(3):
        R[i, i] = white_variance(s, e, c, b, i == 2)
        # the variance of one axis, near enough for learning: position and coloured error are what matters
        S[i] = R[i, i] + P[POS + i, POS + i] + P[DGNSS + i, DGNSS + i] + 2.0 * P[POS + i, DGNSS + i]
    if not (math.isfinite(e[VELOCITY_N]) and math.isfinite(e[VELOCITY_E])):
        weigh_surprise(P, H, R, r, c[Parameter.LIMIT_3])
    for i in range(3):
        s[b + L.F_INNOVATION + i] = r[i]
    weigh_height(s, c, out, P, H, R, r)
    if math.isfinite(s[L.SUSPECT_POSITION]):
        if not agreement(s, L.AGREES_SINCE, surprise(P, H, R, r), 3):
            fuse(s, e, c, out, Sensor.GNSS_POSITION, r, H, R, Reason.SUSPECTED)
            # what was found drifts horizontally
            R_down = matrix(1, 1)
            R_down[0, 0] = R[2, 2]
            fuse(s, e, c, out, Sensor.GNSS_POSITION, r[2:], H[2:], R_down, Reason.FUSED)
            if out_of_patience(s, c, s[L.SUSPECT_POSITION]):
                s[b + L.F_REFUSED_SINCE] = s[L.SUSPECT_POSITION]
                reset_position(s, e, c, out, b, False)
            return
        absolve_position(s, out)
    nis = fuse(s, e, c, out, Sensor.GNSS_POSITION, r, H, R, Reason.FUSED)
    s[L.SCATTER] *= SCATTER_MEMORY
    if nis < 0.0:
        refuse_or_reset(s, e, c, out, b, math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]))
        follow_scatter(s, out, b, math.hypot(r[0], r[1]))
        return
    fused_position(s, out, b)
    end_fault(s, out, NoteCode.GNSS_JUMP)
    follow_scatter(s, out, b, math.hypot(r[0], r[1]))
    s[b + L.F_REFUSED_SINCE] = np.nan
    s[b + L.F_REFUSED_COUNT] = 0.0
    k = b + L.F_SCALE_POSITION
    horizontal = 0.5 * (r[0] * r[0] / S[0] + r[1] * r[1] / S[1])
    s[k] = learn(s[k], horizontal, 1, R[0, 0] / S[0], LEAST_SCALE)
    if not math.isfinite(s[L.SUSPECT_HEIGHT]):
        s[k + 1] = learn(s[k + 1], r[2] * r[2] / S[2], 1, R[2, 2] / S[2], LEAST_SCALE)
    if s[L.PERIOD] <= SLOWEST_FOR_LEARNING:
        since = min(e[TIME] - s[b + L.F_T_BEFORE], 2.0) if math.isfinite(s[b + L.F_T_BEFORE]) else 0.0
        learn_colour_time(s, c, horizontal, 0.5 * (S[0] + S[1]), 0, since)
        learn_colour(s, r, S, 0, 0, 2)
        if not math.isfinite(s[L.SUSPECT_HEIGHT]):
            learn_colour_time(s, c, r[2] * r[2] / S[2], S[2], 1, since)
            learn_colour(s, r, S, 1, 2, 1)


@kernel
def fuse_other_position(s, e, c, out, b):
    """Fuse the position of another receiver: judged by what one fix may be off, weighed by how little many of them together tell.

    Its coloured error has no state, and its delay is the main receiver's only within what is known beforehand: v v' sigma_delay^2.
    """
    P = L.covariance(s)
    r = vector(3)
    H = matrix(3, P.shape[0])
    R = zero_matrix(3, 3)
    R_lasting = zero_matrix(3, 3)
    predict_fix(s, e, r, H)
    # the first counts as one, and each later one as what is new in it
    dt = e[TIME] - s[b + L.F_T_BEFORE]
    times = lasting(dt, c[Parameter.COLOUR_TIME]) if math.isfinite(s[b + L.F_T_POSITION]) else 1.0
    lingering, total = 0.0, 0.0
    for i in range(3):
        r[i] += s[GNSS + i]  # the other's coloured error is not this one's
        H[i, DGNSS + i] = 0.0
        H[i, DDELAY] = 0.0
        sigma = coloured_sigma(e, c, i == 2)
        for j in range(3):
            linger = c[Parameter.DELAY] ** 2 * s[V + i] * s[V + j]
            if i == j:
                linger += sigma * sigma * s[b + L.F_SCALE_COLOUR]
                R[i, i] = white_variance(s, e, c, b, i == 2)
                lingering += linger
                total += linger + R[i, i] + P[POS + i, POS + i]
            R_lasting[i, j] = R[i, j] + times * linger
            R[i, j] += linger
    nis = fuse_lasting(s, e, c, out, Sensor.GNSS_POSITION, r, H, R, R_lasting)
    if nis >= 0.0:
        fused_position(s, out, b)
        s[b + L.F_SCALE_COLOUR] = learn(s[b + L.F_SCALE_COLOUR], nis, 3, lingering / total, LEAST_COLOUR_SCALE)
