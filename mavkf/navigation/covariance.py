"""The covariance over an interval: it follows the estimate when somebody asks for it, not at each sample.

An estimate is needed at every sample; its covariance where a measurement is fused and where a pose is told. In between the transitions of
the steps are multiplied up, which costs a tenth, and their noise is summed.
"""

import math

from mavkf.compiled import kernel
from mavkf.models.strapdown import DBA, DBARO, DBG, DDELAY, DGNSS, GNSS, THETA, TOP, VEL
from mavkf.navigation import layout as L
from mavkf.navigation.monitors import follow_decay, follow_transition
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.tape import is_detailed, is_recording, record_noise, record_transition
from mavkf.navigation.tape_detail import record_snapshot
from mavkf.stack import block, copy, matrix, vector, zero_matrix

RHYTHM = 50.0  # Hz: as often as poses are told; over 20 ms the noise is as good as white


@kernel
def added_noise(s, c, gyro, accel, dt, q):
    """Fill q (n,) with the variances that dt adds: `gyro` (rad^2) and `accel` ((m/s)^2) of the IMU's noise, and the walks of the biases."""
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
    q = vector(P.shape[0])
    added_noise(s, c, gyro, accel, dt, q)
    for i in range(P.shape[0]):
        P[i, i] += q[i]


@kernel
def propagate_covariance(P, Phi):
    """P <- Phi P Phi' where Phi (9, TOP) holds the rows that are not the identity."""
    n = P.shape[0]
    A = zero_matrix(9, n)
    for i in range(9):
        for k in range(TOP):
            p = Phi[i, k]
            if p != 0.0:
                for j in range(n):
                    A[i, j] += p * P[k, j]
    for i in range(9):
        for j in range(9, n):
            P[i, j] = A[i, j]
            P[j, i] = A[i, j]
    for i in range(9):
        for j in range(i, 9):
            total = 0.0
            for k in range(TOP):
                total += A[i, k] * Phi[j, k]
            P[i, j] = total
            P[j, i] = total


@kernel
def colour_decay(s, i, dt):
    """The factor by which axis i of the coloured GNSS error has fallen off after dt: exp(-dt / tau)."""
    return math.exp(-dt / s[L.COLOUR_TIME + i // 2])


@kernel
def decay_colour(s, dt, P):
    """The coloured error in P falls off, and is renewed: phi^2 P + (1 - phi^2) sigma^2."""
    for i in range(3):
        phi = colour_decay(s, i, dt)
        for j in range(P.shape[0]):
            P[DGNSS + i, j] *= phi
        for j in range(P.shape[0]):
            P[j, DGNSS + i] *= phi
        P[DGNSS + i, DGNSS + i] += (1.0 - phi * phi) * s[L.COLOUR + i // 2] ** 2


@kernel
def decay_estimate(s, dt):
    """The estimate of the coloured error falls off, and the effects of faults on it: e <- phi e."""
    for i in range(3):
        phi = colour_decay(s, i, dt)
        s[GNSS + i] *= phi
        if i > 0:
            follow_decay(s, i // 2, phi)


@kernel
def multiply_up(before, Phi, is_first):
    """before <- Phi before, of transitions given by their rows (9, TOP) that are not the identity's."""
    if is_first:
        copy(before, Phi)
        return
    product = matrix(9, TOP)
    for i in range(9):
        for j in range(TOP):
            product[i, j] = Phi[i, j] if j >= 9 else 0.0
        for k in range(9):
            p = Phi[i, k]
            if p != 0.0:
                for j in range(TOP):
                    product[i, j] += p * before[k, j]
    copy(before, product)


@kernel
def predict_covariance(s, c, P):
    """Advance P, which is behind, to the state's time: half of the noise before the transition, half after (second order in time)."""
    dt = s[L.BEHIND]
    gyro, accel = 0.5 * s[L.BEHIND_GYRO], 0.5 * s[L.BEHIND_ACCEL]
    add_noise(s, c, gyro, accel, 0.5 * dt, P)
    propagate_covariance(P, block(s, L.BEHIND_PHI, 9, TOP))
    add_noise(s, c, gyro, accel, 0.5 * dt, P)
    decay_colour(s, dt, P)


@kernel
def record_added(s, c, gyro, accel, dt, decaying, out):
    """Record what `add_noise` adds to the diagonal in dt, and `decay_colour` in the time `decaying` (s, 0: none)."""
    q = vector(int(s[L.STATES]))
    added_noise(s, c, gyro, accel, dt, q)
    for i in range(3):
        phi = colour_decay(s, i, decaying)
        q[DGNSS + i] += (1.0 - phi * phi) * s[L.COLOUR + i // 2] ** 2
    record_noise(out, q.shape[0], q)


@kernel
def bring_up(s, c, out):
    """Bring the covariance to the state's time, if it is behind: who reads or changes it, or changes the estimate, calls this before."""
    dt = s[L.BEHIND]
    if dt == 0.0:
        return
    predict_covariance(s, c, L.covariance(s))
    Phi = block(s, L.BEHIND_PHI, 9, TOP)
    follow_transition(s, Phi)
    if is_recording(out):
        gyro, accel = 0.5 * s[L.BEHIND_GYRO], 0.5 * s[L.BEHIND_ACCEL]
        if is_detailed(out):
            record_added(s, c, gyro, accel, 0.5 * dt, 0.0, out)
        record_transition(s, out, Phi, dt)
        if is_detailed(out):
            record_added(s, c, gyro, accel, 0.5 * dt, dt, out)
    s[L.BEHIND] = 0.0
    s[L.BEHIND_GYRO] = 0.0
    s[L.BEHIND_ACCEL] = 0.0


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
