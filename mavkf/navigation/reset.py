"""Position and velocity from fixes alone: the first, and those to which the state is reset when it was wrong itself."""

import math

import numpy as np

from mavkf.compiled import kernel
from mavkf.models import gnss
from mavkf.models.strapdown import DGNSS, GNSS, HEIGHT, LATITUDE, LONGITUDE, POS, THETA, VEL, V, move, offset
from mavkf.navigation import layout as L
from mavkf.navigation.antenna import carry_lever, mounting
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.disturbances import begin_fault, end_fault
from mavkf.navigation.fusing import forget, note
from mavkf.navigation.monitors import stop_monitors
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.receivers import (
    become_main,
    claimed,
    other_in_agreement,
    set_colour,
    way_since,
    white_variance,
)
from mavkf.samples import FIX as FIX_TYPE
from mavkf.samples import HEIGHT_AMSL, SIGMA_HORIZONTAL, VELOCITY_D, VELOCITY_E, VELOCITY_N
from mavkf.samples import LATITUDE as FIX_LATITUDE
from mavkf.samples import LONGITUDE as FIX_LONGITUDE
from mavkf.stack import matrix, vector, zero_vector

FIXES_TO_START = 3
UNKNOWN_SPEED = 30.0  # m/s: of a vehicle whose receiver tells no velocity
PATIENCE_WITH_ITSELF = 2.0  # s of fixes refused with their velocities, after which the state is reset to them
TILT_AFTER_SHOCK = 0.1  # rad: one sigma that such a filter's attitude is off besides


@kernel
def speed_of_way(s, e, c, b, v):
    """Fill v (3,) with the mean velocity since the receiver's last fix, of which its book b tells; returns one sigma (m/s) of an axis."""
    dt = way_since(s, e, b, v)
    if dt == 0.0:
        return UNKNOWN_SPEED / 3.0
    # it was so half way back
    lag = 0.5 * dt * c[Parameter.ACCELERATION]
    return math.sqrt(2.0 * white_variance(s, e, c, b, False) / (dt * dt) + lag * lag)


@kernel
def set_position(s, c, e, b):
    """Take position and, where it is given, velocity from a fix, with its covariance: p = fix - l - e - white. b: the receiver's book."""
    x = s[L.X : L.P]
    P = L.covariance(s)
    C = matrix(3, 3)
    w = vector(3)
    place = vector(3)
    speed = vector(3)
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
        forget(s, POS + i, 1, white_variance(s, e, c, b, i == 2) + colour)
        forget(s, DGNSS + i, 1, colour)
        P[POS + i, DGNSS + i] = -colour
        P[DGNSS + i, POS + i] = -colour
        x[GNSS + i] = 0.0
    carry_lever(s, C, w)
    known = math.isfinite(e[VELOCITY_N]) and math.isfinite(e[VELOCITY_E])
    way = zero_vector(3)
    # one second of the vehicle's usual acceleration covers a course that lags
    sigma = 1.0 if known else speed_of_way(s, e, c, b, way)
    x[V] = e[VELOCITY_N] - speed[0] if known else way[0]
    x[V + 1] = e[VELOCITY_E] - speed[1] if known else way[1]
    x[V + 2] = e[VELOCITY_D] - speed[2] if math.isfinite(e[VELOCITY_D]) else 0.0
    for i in range(3):
        forget(s, VEL + i, 1, sigma * sigma)
    P[VEL + 2, VEL + 2] = 1.0 if math.isfinite(e[VELOCITY_D]) else 4.0
    s[L.BAROMETER_KNOWN] = 0.0
    s[L.T_POSITION] = s[L.T]
    s[b + L.F_T_POSITION] = s[L.T]
    s[b + L.F_REFUSED_SINCE] = np.nan
    s[b + L.F_REFUSED_COUNT] = 0.0


@kernel
def agrees(latitude, longitude, height, vn, ve, dt, e, c):
    """Whether a fix lies where an earlier one and the velocity between them say, within what receivers do."""
    d = vector(3)
    offset(e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL], latitude, longitude, height, d)
    mean_n = 0.5 * (vn + e[VELOCITY_N]) if math.isfinite(e[VELOCITY_N]) else 0.0
    mean_e = 0.5 * (ve + e[VELOCITY_E]) if math.isfinite(e[VELOCITY_E]) else 0.0
    sigma = claimed(e, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL])
    # of the difference of two fixes, each off by one sigma on each axis: beyond this once in a hundred thousand
    speed = 2.0 if math.isfinite(e[VELOCITY_N]) else UNKNOWN_SPEED
    tolerance = 5.0 * math.sqrt(2.0) * sigma + 0.5 * c[Parameter.ACCELERATION] * dt * dt + speed * dt
    return math.hypot(d[0] - mean_n * dt, d[1] - mean_e * dt) <= tolerance and abs(d[2]) <= 3.0 * tolerance + 10.0 * dt


@kernel
def start_position(s, e, c, out, b):
    """Count fixes that agree with each other; with enough of them position and velocity begin. Returns whether they did."""
    dt = s[L.T] - s[b + L.F_T_BEFORE]
    k = b + L.F_FIX
    lat, lon, h = s[k], s[k + 1], s[k + 2]
    vn = e[VELOCITY_N] if math.isfinite(e[VELOCITY_N]) else 0.0
    ve = e[VELOCITY_E] if math.isfinite(e[VELOCITY_E]) else 0.0
    if s[b + L.F_COUNT] > 0 and dt < 5.0 and agrees(lat, lon, h, vn, ve, dt, e, c):
        s[b + L.F_COUNT] += 1.0
    else:
        s[b + L.F_COUNT] = 1.0
    if s[b + L.F_COUNT] < FIXES_TO_START:
        return False
    set_position(s, c, e, b)
    s[L.POSITION_KNOWN] = 1.0
    if not math.isfinite(s[L.ORIGIN_LATITUDE]):
        s[L.ORIGIN_LATITUDE] = e[FIX_LATITUDE]
        s[L.ORIGIN_LONGITUDE] = e[FIX_LONGITUDE]
        s[L.ORIGIN_HEIGHT] = e[HEIGHT_AMSL]
    sigma = claimed(e, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL])
    note(out, NoteCode.POSITION_FOUND, s[L.T], s[L.T], sigma, s[b + L.F_COUNT], e[FIX_TYPE])
    return True


@kernel
def doubt_attitude(s):
    """What threw the velocity off has thrown the attitude off too."""
    P = L.covariance(s)
    for i in range(3):
        P[THETA + i, THETA + i] += TILT_AFTER_SHOCK**2


@kernel
def acquit_position(s, e, c, out, b):
    """If the main receiver's positions are suspected, believe them again at this fix: something else was found to be wrong. b: its book."""
    if math.isfinite(s[L.SUSPECT_POSITION]):
        s[b + L.F_REFUSED_SINCE] = s[L.SUSPECT_POSITION]
        reset_position(s, e, c, out, b, False)
        s[L.DOUBT] = 0.0


@kernel
def refuse_or_reset(s, e, c, out, b, size):
    """Keep account of refused positions; when they have agreed with each other for long enough, take the state to them.

    size: m, of the innovation; b: the receiver's book.
    """
    vn = e[VELOCITY_N] if math.isfinite(e[VELOCITY_N]) else 0.0
    ve = e[VELOCITY_E] if math.isfinite(e[VELOCITY_E]) else 0.0
    k = b + L.F_REFUSED
    dt = s[L.T] - s[b + L.F_T_BEFORE]
    if not (s[b + L.F_REFUSED_COUNT] > 0 and agrees(s[k], s[k + 1], s[k + 2], s[k + 3], s[k + 4], dt, e, c)):
        s[L.SCATTER] += 1.0 if s[b + L.F_REFUSED_COUNT] > 0 else 0.0
        s[b + L.F_REFUSED_SINCE] = s[L.T]
        s[b + L.F_REFUSED_COUNT] = 0.0
    s[b + L.F_REFUSED_COUNT] += 1.0
    s[k], s[k + 1], s[k + 2], s[k + 3], s[k + 4] = e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL], vn, ve
    # fixes whose velocity is refused as well have a filter against them that is wrong itself: a shock, a wild manoeuvre
    told = math.isfinite(e[VELOCITY_N]) and math.isfinite(e[VELOCITY_E])
    wrong = told and not s[b + L.F_T_VELOCITY] >= s[b + L.F_REFUSED_SINCE]
    patience = c[Parameter.RESET]
    if wrong:
        patience = min(patience, PATIENCE_WITH_ITSELF)
    else:
        if told and c[Parameter.MONITORS] != 0.0 and other_in_agreement(s) < 0:
            # its velocities are fused, and they say that the state is right; no other receiver can tell
            patience = c[Parameter.SUSPICION]
        if s[b + L.F_REFUSED_COUNT] >= FIXES_TO_START:
            begin_fault(s, out, NoteCode.GNSS_JUMP, s[b + L.F_REFUSED_SINCE], size, s[b + L.F_REFUSED_COUNT], 0.0)
    if s[L.T] - s[b + L.F_REFUSED_SINCE] >= patience and s[b + L.F_REFUSED_COUNT] >= FIXES_TO_START:
        other = other_in_agreement(s)
        if other >= 0:
            # another receiver says that the state is right
            become_main(s, c, out, other, s[b + L.F_REFUSED_SINCE])
            end_fault(s, out, NoteCode.GNSS_JUMP)
            stop_monitors(s)
            return
        reset_position(s, e, c, out, b, wrong)


@kernel
def reset_position(s, e, c, out, b, wrong):
    """Take the state to a fix, and tell it; wrong: whether the filter lost its velocity too. b: the receiver's book."""
    d = vector(3)
    offset(e[FIX_LATITUDE], e[FIX_LONGITUDE], e[HEIGHT_AMSL], s[LATITUDE], s[LONGITUDE], s[HEIGHT], d)
    size = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    note(out, NoteCode.POSITION_RESET, s[b + L.F_REFUSED_SINCE], s[L.T], size, s[b + L.F_REFUSED_COUNT], d[2])
    set_position(s, c, e, b)
    end_fault(s, out, NoteCode.GNSS_JUMP)
    end_fault(s, out, NoteCode.GNSS_DRIFT)
    end_fault(s, out, NoteCode.GNSS_HEIGHT_DRIFT)
    s[L.SUSPECT_POSITION] = np.nan
    s[L.SUSPECT_HEIGHT] = np.nan
    s[L.AGREES_SINCE] = np.nan
    stop_monitors(s)
    if wrong:
        doubt_attitude(s)
    else:
        s[L.DOUBT] = max(s[L.DOUBT], 0.5 * size)
