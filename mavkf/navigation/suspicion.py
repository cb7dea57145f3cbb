"""A receiver under suspicion: its fixes are judged but not fused, until they agree with what the other sensors say, or patience ends.

A fault was found in its positions or velocities while the rest of the vehicle contradicts it. Dead reckoning goes on with what is left, its
covariance grows, and what is suspected is believed again as soon as it agrees with the state for a while: a healthy receiver is never
locked out. After `integrity.suspicion_s` nobody can tell any more who is right: the state is reset to the receiver, which is told, and half
of what the two differed by stays in the protection level as a doubt.
"""

import math

import numpy as np

from mavkf.compiled import kernel
from mavkf.filters.joseph import innovation_covariance, invert, quadratic, row_variance
from mavkf.models.strapdown import POS, VEL, V
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.disturbances import begin_fault, end_fault
from mavkf.navigation.monitors import stop_monitors
from mavkf.navigation.parameter import Parameter
from mavkf.samples import TIME, VELOCITY_E, VELOCITY_N
from mavkf.stack import matrix

AGREES = 1.5  # NIS per degree of freedom
AGREE_TIME = 1.0  # s of fixes that agree
FROZEN_AFTER = 1.0  # s of fixes that repeat each other while the vehicle moves
FROZEN_COUNT = 3.0
MOVING = 1.0  # m/s beyond three sigma: a fix changes by more than its last digit from one to the next
SCATTERED = 4.0  # positions refused of late that did not agree with each other
SCATTER_MEMORY = 0.9  # of a count of them, from fix to fix
NOISY, QUIET = 9.0, 4.0  # times the claimed variance: three sigma, and two
MOST_SURPRISE = 4.0  # of the NIS against its limit: twice as many sigma
UNTOLD = 1e3  # m: one sigma of a height that is not believed
DOUBT_TIME = 300.0  # s in which a doubt fades


@kernel
def surprise(P, H, R, r):
    """NIS of an innovation r (m,); infinite where S is not positive definite. P: (n, n), H: (m, n), R: (m, m)."""
    m = r.shape[0]
    PHt = matrix(P.shape[0], m)
    S = matrix(m, m)
    inverse = matrix(m, m)
    innovation_covariance(P, H, R, PHt, S)
    return quadratic(inverse, r) if invert(S, inverse) > 0.0 else np.inf


@kernel
def weigh_surprise(P, H, R, r, limit):
    """Raise R (3, 3) of a fix without velocity that lies a little beyond the gate, so that it is fused with less weight, not refused.

    Such a receiver has no second witness: whether a surprise is the fix's doing or the filter's is not known, and a filter that has
    refused one fix is further off at the next. S times NIS / limit has just the limit (Huber, "Robust Estimation of a Location
    Parameter", Annals of Mathematical Statistics 35(1), 1964); what lies beyond MOST_SURPRISE is the fix's doing.
    """
    PHt = matrix(P.shape[0], 3)
    S = matrix(3, 3)
    inverse = matrix(3, 3)
    innovation_covariance(P, H, R, PHt, S)
    if not invert(S, inverse) > 0.0:
        return
    nis = quadratic(inverse, r)
    if limit < nis <= MOST_SURPRISE * limit:
        for i in range(3):
            for j in range(3):
                R[i, j] += (1.0001 * nis / limit - 1.0) * S[i, j]


@kernel
def agreement(s, since, nis, m):
    """Whether what is suspected has agreed with the state for long enough, given the NIS of m degrees of freedom of its newest.

    since: where the start of that time is kept.
    """
    if not nis <= AGREES * m:
        s[since] = np.nan
        return False
    if not math.isfinite(s[since]):
        s[since] = s[L.T]
    return s[L.T] - s[since] >= AGREE_TIME


@kernel
def weigh_height(s, c, out, P, H, R, r):
    """Let a fix whose height is suspected tell the horizontal position alone (R (3, 3) raised), until its height agrees again."""
    if not math.isfinite(s[L.SUSPECT_HEIGHT]):
        return
    variance = R[2, 2] + row_variance(P, H, 2)
    agrees = agreement(s, L.HEIGHT_AGREES_SINCE, r[2] * r[2] / variance, 1)
    if agrees or out_of_patience(s, c, s[L.SUSPECT_HEIGHT]):
        if not agrees:
            # nobody can tell any more: the height is the receiver's again, and as uncertain as the two differ
            P[POS + 2, POS + 2] += r[2] * r[2]
            s[L.BAROMETER_KNOWN] = 0.0
            s[L.DOUBT] = max(s[L.DOUBT], 0.5 * abs(r[2]))
        s[L.SUSPECT_HEIGHT] = np.nan
        end_fault(s, out, NoteCode.GNSS_HEIGHT_DRIFT)
        stop_monitors(s)
    else:
        R[2, 2] += UNTOLD**2 + r[2] * r[2]


@kernel
def absolve_position(s, out):
    """Believe the main receiver's positions again."""
    s[L.SUSPECT_POSITION] = np.nan
    s[L.AGREES_SINCE] = np.nan
    end_fault(s, out, NoteCode.GNSS_DRIFT)
    stop_monitors(s)


@kernel
def absolve_velocity(s, out):
    """Believe the main receiver's velocities again."""
    s[L.SUSPECT_VELOCITY] = np.nan
    s[L.AGREES_SINCE] = np.nan
    end_fault(s, out, NoteCode.GNSS_VELOCITY_WRONG)
    stop_monitors(s)


@kernel
def out_of_patience(s, c, since):
    """Whether something has been suspected for too long (since: s, NaN: it is not)."""
    return s[L.T] - since > c[Parameter.SUSPICION]


@kernel
def speed_beyond_doubt(s):
    """Horizontal speed (m/s) less three sigma of it."""
    P = L.covariance(s)
    return math.hypot(s[V], s[V + 1]) - 3.0 * math.sqrt(P[VEL, VEL] + P[VEL + 1, VEL + 1])


@kernel
def is_frozen(s, e, b, out):
    """Whether a fix only repeats the one before while the vehicle moves: no news, and after a while a fault. b: the receiver's book."""
    if s[b + L.F_REPEATS] == 0.0:
        end_fault(s, out, NoteCode.GNSS_FROZEN)
        return False
    claims = math.hypot(e[VELOCITY_N], e[VELOCITY_E])
    if not (claims > MOVING or speed_beyond_doubt(s) > MOVING):
        return False
    lasted = s[b + L.F_REPEATS] * (e[TIME] - s[b + L.F_T_BEFORE])
    if s[b + L.F_REPEATS] >= FROZEN_COUNT and lasted >= FROZEN_AFTER:
        begin_fault(s, out, NoteCode.GNSS_FROZEN, s[L.T] - lasted, s[b + L.F_REPEATS], 0.0, 0.0)
    else:
        s[L.DUPLICATES] += 1.0
    return True


@kernel
def follow_scatter(s, out, b, size):
    """After a position of the main receiver was judged: jamming shows in positions that scatter more than claimed. b: its book.

    size: m, of the innovation, horizontal.
    """
    scale = s[b + L.F_SCALE_POSITION]
    if s[L.SCATTER] >= SCATTERED or scale >= NOISY:
        begin_fault(s, out, NoteCode.GNSS_JAMMED, s[L.T], size, s[L.SCATTER], math.sqrt(scale))
    elif s[L.SCATTER] < 1.0 and scale < QUIET:
        end_fault(s, out, NoteCode.GNSS_JAMMED)


@kernel
def fade_doubt(s, dt):
    """Let a doubt about the position fade over dt (s)."""
    s[L.DOUBT] *= math.exp(-dt / DOUBT_TIME)
