"""The covariance over an interval: it follows the estimate when somebody asks for it, not at each sample.

An estimate is needed at every sample; its covariance where a measurement is fused and where a pose is told. In between what its
transition is made of is summed, and the noise.
"""

import math

from mavkf.compiled import NOTHING, VECTOR, compiled_apart, fused_kernel, kernel
from mavkf.models import constant_velocity, strapdown
from mavkf.models.strapdown import DBA, DBARO, DBG, DDELAY, DGNSS, GNSS, POS, SUMS, THETA, TOP, VEL
from mavkf.navigation import layout as L
from mavkf.navigation.layout import OUT
from mavkf.navigation.monitors import follow_decay, follow_transition
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.tape import is_detailed, is_recording, record_noise, record_transition
from mavkf.navigation.tape_detail import record_snapshot
from mavkf.stack import matrix, vector

NOISY = DDELAY + 1  # error states to which time adds variance are among the first of so many
RHYTHM = 50.0  # Hz: as often as poses are told; over 20 ms the noise is as good as white


@kernel
def added_noise(s, c, gyro, accel, dt, q):
    """Fill q (NOISY at least) with the variances that dt adds.

    gyro (rad^2), accel ((m/s)^2): of the IMU's noise; the walks of the biases are added to them.
    """
    q[:] = 0.0
    for i in range(3):
        q[THETA + i] = gyro
        q[VEL + i] = accel
        q[DBG + i] = c[Parameter.GYRO_WALK] ** 2 * s[L.SCALE_WALK] * dt
        q[DBA + i] = c[Parameter.ACCEL_WALK] ** 2 * dt
    q[DBARO] = c[Parameter.BARO_WALK] ** 2 * dt
    q[DDELAY] = c[Parameter.DELAY_WALK] ** 2 * dt


@kernel
def add_noise(s, c, gyro, accel, dt, P):
    """Add the variances of `added_noise` to the diagonal of P."""
    q = vector(NOISY)
    added_noise(s, c, gyro, accel, dt, q)
    for i in range(NOISY):
        P[i, i] += q[i]


@fused_kernel
def propagate_covariance(P, Phi):
    """P <- Phi P Phi' where Phi (9, TOP) holds the rows that are not the identity.

    What neither model couples is not read: attitude does not follow position and the accelerometer's biases, velocity follows the height of
    all positions only, a position only its own velocity and itself.
    """
    n = P.shape[0]
    A = matrix(9, n)
    # written out, so that it is done for several j at once
    for i in range(3):
        t0, t1, t2 = Phi[i, THETA], Phi[i, THETA + 1], Phi[i, THETA + 2]
        v0, v1 = Phi[i, VEL], Phi[i, VEL + 1]
        g0, g1, g2 = Phi[i, DBG], Phi[i, DBG + 1], Phi[i, DBG + 2]
        for j in range(n):
            A[i, j] = ((t0 * P[THETA, j] + t1 * P[THETA + 1, j]) + (t2 * P[THETA + 2, j] + v0 * P[VEL, j])) + (
                (v1 * P[VEL + 1, j] + g0 * P[DBG, j]) + (g1 * P[DBG + 1, j] + g2 * P[DBG + 2, j])
            )
    for i in range(VEL, VEL + 3):
        t0, t1, t2 = Phi[i, THETA], Phi[i, THETA + 1], Phi[i, THETA + 2]
        v0, v1, v2, h = Phi[i, VEL], Phi[i, VEL + 1], Phi[i, VEL + 2], Phi[i, POS + 2]
        g0, g1, g2 = Phi[i, DBG], Phi[i, DBG + 1], Phi[i, DBG + 2]
        b0, b1, b2 = Phi[i, DBA], Phi[i, DBA + 1], Phi[i, DBA + 2]
        for j in range(n):
            A[i, j] = (
                ((t0 * P[THETA, j] + t1 * P[THETA + 1, j]) + (t2 * P[THETA + 2, j] + v0 * P[VEL, j]))
                + ((v1 * P[VEL + 1, j] + v2 * P[VEL + 2, j]) + (h * P[POS + 2, j] + g0 * P[DBG, j]))
                + ((g1 * P[DBG + 1, j] + g2 * P[DBG + 2, j]) + (b0 * P[DBA, j] + b1 * P[DBA + 1, j]))
                + b2 * P[DBA + 2, j]
            )
    for i in range(POS, POS + 3):
        own = VEL + i - POS
        t0, t1, t2 = Phi[i, THETA], Phi[i, THETA + 1], Phi[i, THETA + 2]
        v, p = Phi[i, own], Phi[i, i]
        g0, g1, g2 = Phi[i, DBG], Phi[i, DBG + 1], Phi[i, DBG + 2]
        b0, b1, b2 = Phi[i, DBA], Phi[i, DBA + 1], Phi[i, DBA + 2]
        for j in range(n):
            A[i, j] = (
                ((t0 * P[THETA, j] + t1 * P[THETA + 1, j]) + (t2 * P[THETA + 2, j] + v * P[own, j]))
                + ((p * P[i, j] + g0 * P[DBG, j]) + (g1 * P[DBG + 1, j] + g2 * P[DBG + 2, j]))
                + ((b0 * P[DBA, j] + b1 * P[DBA + 1, j]) + b2 * P[DBA + 2, j])
            )
    for i in range(9):
        for j in range(i, 9):
            total = 0.0
            for k in range(TOP):
                total += A[i, k] * Phi[j, k]
            P[i, j] = total
            P[j, i] = total
        for j in range(9, n):
            P[i, j] = A[i, j]
            P[j, i] = A[i, j]


@kernel
def colour_decay(s, dt, phi):
    """Fill phi (2,) with the factors by which the coloured GNSS error has fallen off after dt: exp(-dt / tau), horizontal and vertical."""
    for k in range(2):
        phi[k] = math.exp(-dt / s[L.COLOUR_TIME + k])


@kernel
def decay_colour(s, phi, P):
    """The coloured error in P falls off by phi (2,), horizontal and vertical, and is renewed: phi^2 P + (1 - phi^2) sigma^2."""
    for i in range(3):
        k = i // 2
        for j in range(P.shape[0]):
            P[DGNSS + i, j] *= phi[k]
        for j in range(P.shape[0]):
            P[j, DGNSS + i] *= phi[k]
        P[DGNSS + i, DGNSS + i] += (1.0 - phi[k] * phi[k]) * s[L.COLOUR + k] ** 2


@kernel
def decay_estimate(s, phi):
    """The estimate of the coloured error falls off by phi (2,), horizontal and vertical, and the effects of faults on it: e <- phi e."""
    s[GNSS] *= phi[0]
    s[GNSS + 1] *= phi[0]
    s[GNSS + 2] *= phi[1]
    follow_decay(s, 0, phi[0])
    follow_decay(s, 1, phi[1])


@kernel
def transition_behind(s, Phi):
    """Fill Phi (9, TOP) with the transition of the time by which the covariance is behind, in which neither model nor rest have changed."""
    sums = s[L.BEHIND_SUMS : L.BEHIND_SUMS + SUMS]
    if s[L.MODEL] == L.STRAPDOWN:
        strapdown.transition(s[L.X : L.P], sums, s[L.BEHIND], Phi)
    else:
        constant_velocity.transition(s[L.X : L.P], sums, s[L.BEHIND], Phi)
    if s[L.RESTING] != 0.0:
        # the gyro was not asked, so its bias did no harm
        for i in range(9):
            for j in range(3):
                Phi[i, DBG + j] = 0.0


@kernel
def predict_covariance(s, c, Phi, phi, P):
    """Advance P by the time it is behind: half of the noise before, half after (second order in time).

    Phi: the transition of that time; phi: of `colour_decay`.
    """
    dt = s[L.BEHIND]
    gyro, accel = 0.5 * s[L.BEHIND_GYRO], 0.5 * s[L.BEHIND_ACCEL]
    add_noise(s, c, gyro, accel, 0.5 * dt, P)
    propagate_covariance(P, Phi)
    add_noise(s, c, gyro, accel, 0.5 * dt, P)
    decay_colour(s, phi, P)


@kernel
def record_added(s, c, gyro, accel, dt, decaying, out):
    """Record what `add_noise` adds to the diagonal in dt, and `decay_colour` in the time `decaying` (s, 0: none)."""
    q = vector(int(s[L.STATES]))
    added_noise(s, c, gyro, accel, dt, q)
    phi = vector(2)
    colour_decay(s, decaying, phi)
    for i in range(3):
        q[DGNSS + i] += (1.0 - phi[i // 2] * phi[i // 2]) * s[L.COLOUR + i // 2] ** 2
    record_noise(out, q.shape[0], q)


@compiled_apart(NOTHING, VECTOR, VECTOR, OUT)
def bring_up(s, c, out):
    """Bring the covariance to the state's time, if it is behind: who reads or changes it, or changes the estimate, calls this before."""
    dt = s[L.BEHIND]
    if dt == 0.0:
        return
    Phi, phi = matrix(9, TOP), vector(2)
    transition_behind(s, Phi)
    colour_decay(s, dt, phi)
    predict_covariance(s, c, Phi, phi, L.covariance(s))
    decay_estimate(s, phi)
    follow_transition(s, Phi)
    if is_recording(out):
        gyro, accel = 0.5 * s[L.BEHIND_GYRO], 0.5 * s[L.BEHIND_ACCEL]
        if is_detailed(out):
            record_added(s, c, gyro, accel, 0.5 * dt, 0.0, out)
        record_transition(s, out, Phi, phi)
        if is_detailed(out):
            record_added(s, c, gyro, accel, 0.5 * dt, dt, out)
    s[L.BEHIND] = 0.0
    s[L.BEHIND_GYRO] = 0.0
    s[L.BEHIND_ACCEL] = 0.0
    s[L.BEHIND_SUMS : L.BEHIND_SUMS + SUMS] = 0.0


@kernel
def bring_up_in_turn(s, c, out):
    """After an IMU sample: bring the covariance up at least RHYTHM times a second, whoever looks."""
    interval = math.floor(s[L.T] * RHYTHM + 1e-6)
    if interval > s[L.BROUGHT_UP]:
        s[L.BROUGHT_UP] = interval
        bring_up(s, c, out)


@kernel
def prepare(s, e, c, out):
    """Before a measurement is compared with the state: bring the covariance up, and record what the measurement finds."""
    bring_up(s, c, out)
    if is_detailed(out):
        record_snapshot(s, e, out)
