"""The velocity of a fix in the fold: fused, suspected, or taken for the state where it is the filter that is wrong."""

import math

import numpy as np

from mavkf.compiled import INTEGER, NOTHING, VECTOR, compiled_apart, kernel
from mavkf.models import gnss
from mavkf.models.strapdown import DDELAY, VEL, V
from mavkf.navigation import layout as L
from mavkf.navigation.antenna import mounting
from mavkf.navigation.codes import NoteCode, Reason, Sensor
from mavkf.navigation.disturbances import begin_fault, end_fault
from mavkf.navigation.fusing import forget, fuse, note
from mavkf.navigation.layout import OUT
from mavkf.navigation.learning import LEAST_IMU_SCALE, LEAST_SCALE, learn, learn_walk
from mavkf.navigation.monitors import stop_monitors, surprised
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.receivers import claimed, lasting
from mavkf.navigation.reset import FIXES_TO_START, PATIENCE_WITH_ITSELF, acquit_position, doubt_attitude
from mavkf.navigation.suspicion import absolve_velocity, agreement, out_of_patience, surprise
from mavkf.samples import SIGMA_SPEED, SOURCE, TIME, VELOCITY_D, VELOCITY_E, VELOCITY_N
from mavkf.stack import matrix, vector, zero_matrix

ACCELERATION_LASTS = 1.0  # s
ASTRAY = 0.12  # share of the way that a filter which fuses the positions shows of its own error
PATIENCE_WITH_VELOCITY = 4.0  # s of velocities refused that the positions contradict


@kernel
def follow_astray(s, b, r):
    """After a velocity was refused by r (m/s), of which horizontally two: keep account of whether the positions go where it points.

    Had the filter lost the velocity, the positions would by now be off by r times the time; a filter that fuses them lags behind that.
    b: the receiver's book.
    """
    since = s[L.T] - s[b + L.F_T_VELOCITY]
    for i in range(2):
        s[b + L.F_ASTRAY] += r[i] * s[b + L.F_INNOVATION + i]
        s[b + L.F_ASTRAY + 1] += r[i] * r[i] * since


@kernel
def position_contradicts(s, b):
    """Whether the receiver's positions do not go where its refused velocities point. b: its book."""
    return s[b + L.F_ASTRAY] < ASTRAY * s[b + L.F_ASTRAY + 1]


@compiled_apart(NOTHING, VECTOR, VECTOR, VECTOR, OUT, INTEGER)
def fuse_velocity(s, e, c, out, b):
    """Fuse the velocity of a fix, as a vector of two or, where the message has the vertical one, three. b: the receiver's book."""
    x = s[L.X : L.P]
    P = L.covariance(s)
    vn, ve, vd = e[VELOCITY_N], e[VELOCITY_E], e[VELOCITY_D]
    if not (math.isfinite(vn) and math.isfinite(ve)):
        return
    m = 3 if math.isfinite(vd) else 2
    r = vector(3)
    z_hat = vector(3)
    H = matrix(3, P.shape[0])
    R = zero_matrix(3, 3)
    C = matrix(3, 3)
    w = vector(3)
    a = s[L.ACCELERATION : L.ACCELERATION + 3]
    sigma = claimed(e, SIGMA_SPEED, c[Parameter.SPEED])
    main = e[SOURCE] == s[L.MAIN]
    # the claim is for white noise; part of the error lingers from fix to fix, so it has a floor
    variance = max(sigma * sigma * s[b + L.F_SCALE_VELOCITY], c[Parameter.SPEED_FLOOR] ** 2)
    vertical = 2.25 * variance
    if main and s[L.KNOWN_SPEED] > 0.0 and sigma <= c[Parameter.SPEED]:
        # in the second pass of a smoother, but for a fix that says of itself that it is a bad one
        variance = min(variance, s[L.KNOWN_SPEED] ** 2)
    speed = math.hypot(vn, ve)
    # a slow receiver does not know its course, and some hold the last one
    across = (c[Parameter.COURSE] / (1.0 + speed)) ** 2
    un, ue = (vn / speed, ve / speed) if speed > 0.0 else (0.0, 0.0)
    R[0, 0] = variance + across * (1.0 - un * un)
    R[1, 1] = variance + across * (1.0 - ue * ue)
    R[0, 1] = -across * un * ue
    R[1, 0] = R[0, 1]
    R[2, 2] = vertical
    mounting(s, C, w)
    gnss.predict_velocity(x, a, C, w, z_hat)
    gnss.velocity_jacobian(x, a, C, w, H)
    r[0] = vn - z_hat[0]
    r[1] = ve - z_hat[1]
    r[2] = vd - z_hat[2]
    if not main:
        # its delay is its own: a a' sigma_delay^2, for as long as an acceleration lasts
        dt = e[TIME] - s[b + L.F_T_BEFORE]
        times = lasting(dt, ACCELERATION_LASTS) if math.isfinite(dt) else 1.0
        for i in range(3):
            H[i, DDELAY] = 0.0
            for j in range(3):
                R[i, j] += times * c[Parameter.DELAY] ** 2 * a[i] * a[j]
    # the part that is measured
    R_m = matrix(m, m)
    for i in range(m):
        for j in range(m):
            R_m[i, j] = R[i, j]
    share = variance / (variance + 0.5 * (P[VEL, VEL] + P[VEL + 1, VEL + 1]))
    suspected = main and math.isfinite(s[L.SUSPECT_VELOCITY])
    if main:
        nis = surprise(P, H[:m], R_m, r[:m])
        surprised(s, nis, m)
        if suspected and agreement(s, L.AGREES_SINCE, nis, m):
            absolve_velocity(s, out)
            suspected = False
    reason = Reason.SUSPECTED if suspected else Reason.FUSED
    nis = fuse(s, e, c, out, Sensor.GNSS_VELOCITY, r[:m], H[:m], R_m, reason)
    if nis >= 0.0:
        s[b + L.F_T_VELOCITY] = s[L.T]
        s[b + L.F_SCALE_VELOCITY] = learn(s[b + L.F_SCALE_VELOCITY], nis, m, share, LEAST_SCALE)
        s[b + L.F_VELOCITY_REFUSED] = 0.0
        s[b + L.F_ASTRAY], s[b + L.F_ASTRAY + 1] = 0.0, 0.0
        if main and s[L.MODEL] != L.CONSTANT_VELOCITY:
            learn_walk(s, r, variance + 0.5 * (P[VEL, VEL] + P[VEL + 1, VEL + 1]))
            s[L.SCALE_IMU] = learn(s[L.SCALE_IMU], nis, m, 1.0 - share, LEAST_IMU_SCALE)
        return
    s[b + L.F_VELOCITY_REFUSED] += 1.0
    if not main:
        return
    size = math.sqrt(r[0] * r[0] + r[1] * r[1])
    follow_astray(s, b, r)
    long = s[L.T] - s[b + L.F_T_VELOCITY] >= PATIENCE_WITH_ITSELF and s[b + L.F_VELOCITY_REFUSED] >= FIXES_TO_START
    if suspected:
        long = out_of_patience(s, c, s[L.SUSPECT_VELOCITY])
    elif long and c[Parameter.MONITORS] != 0.0 and position_contradicts(s, b):
        # the fixes' own way does not go where their velocity points
        if s[L.T] - s[b + L.F_T_VELOCITY] < PATIENCE_WITH_VELOCITY:
            return
        s[L.SUSPECT_VELOCITY] = s[b + L.F_T_VELOCITY]
        s[L.AGREES_SINCE] = np.nan
        begin_fault(s, out, NoteCode.GNSS_VELOCITY_WRONG, s[b + L.F_T_VELOCITY], size, 0.0, nis)
        return
    if long:
        note(out, NoteCode.VELOCITY_RESET, s[b + L.F_T_VELOCITY], s[L.T], size, s[b + L.F_VELOCITY_REFUSED], 0.0)
        s[L.SUSPECT_VELOCITY] = np.nan
        end_fault(s, out, NoteCode.GNSS_VELOCITY_WRONG)
        stop_monitors(s)
        acquit_position(s, e, c, out, b)
        for i in range(m):
            x[V + i] += r[i]
            forget(s, VEL + i, 1, R[i, i] + 1.0)
        doubt_attitude(s)
        s[b + L.F_VELOCITY_REFUSED] = 0.0
