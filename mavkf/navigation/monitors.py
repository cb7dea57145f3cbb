"""Monitors of faults: how a fault of each kind, begun at each of several times, would show in the innovations and shift the estimate.

The generalised likelihood ratio test of Willsky and Jones, "A generalized likelihood ratio approach to the detection and estimation of
jumps in linear systems", IEEE Transactions on Automatic Control 21(1), 1976. A fault of size b that the filter does not know of shifts its
estimate by f b and its innovations by G b, where with the filter's own matrices

    f <- Phi f        G = D - H f        f <- f + K G

and D is how the fault shows in the measurement itself. By linear regression on the innovations r of covariance S

    J = J_0 + sum G' S^-1 G        c = sum G' S^-1 r        b = J^-1 c        l = c' J^-1 c

l is twice the logarithm of the likelihood ratio, of as many degrees of freedom as b has components. J_0 says how large such faults are.
A fault of the IMU is a step of its true bias, which the estimate lacks: f begins at -1 there, and D is zero.

Since effects are carried along with the filter's own gain, what they say holds for whatever it fuses or considers.
"""

import math

import numpy as np

from mavkf.compiled import compiled, fused_kernel, kernel
from mavkf.models.strapdown import DBA, DBG, DGNSS, POS, THETA, TOP, VEL
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.samples import SOURCE
from mavkf.stack import block, copy, matrix, vector

# Position that runs away; velocity, gyro and accelerometer off by a constant
RAMP, VELOCITY, GYRO, ACCELEROMETER = 0, 1, 2, 3
KINDS = 4
FAULT_SIGMA = np.array([5.0, 10.0, 0.1, 2.0])  # how large such faults are: m/s, m/s, rad/s, m/s^2
# For each hypothesis its kind, and when it begins anew: at phase, phase + every, ... on the boot clock (s). A fast fault shows within
# seconds of its start, a slow drift of the position in a minute.
KIND = np.array([RAMP] * 6 + [VELOCITY] * 3 + [GYRO] * 3 + [ACCELEROMETER] * 3)
EVERY = np.array([20.0] * 4 + [60.0] * 2 + [1e9, 12.0, 12.0] + [12.0] * 6)
PHASE = np.array([0.0, 5.0, 10.0, 15.0, 0.0, 30.0] + [0.0, 0.0, 6.0] + [0.0, 4.0, 8.0] * 2)
SUDDEN = 6  # the hypothesis of a velocity that lies from the fix on at which it surprised
SURPRISE = 4.0  # NIS per degree of freedom that begins it anew
SUDDEN_AGE, SUDDEN_RATIO = 12.0, 12.0  # s; or where it does not follow anything likely
COLUMNS = L.COLUMNS
# NIS beyond which an innovation counts no more than one of this size: an outlier is no evidence of what lasts
CLIP = 20.0


@kernel
def can_judge(s):
    """Whether the model is one that the monitors follow, and the innovations are the sensors' rather than the sampling's."""
    return s[L.MODEL] == L.STRAPDOWN and s[L.PERIOD] <= L.SLOW and s[L.RECOVERING] == 0.0 and s[L.POSITION_KNOWN] != 0.0


@kernel
def hypothesis(h):
    """Where hypothesis h is in the state."""
    return L.MONITORS + h * L.HYPOTHESIS


@compiled
def effects(s):
    """The shifts f (STATES, COLUMNS) of the estimate by unit faults, as a view: columns 3 h to 3 h + 2 are those of hypothesis h."""
    return block(s, L.EFFECTS, int(s[L.STATES]), L.COLUMNS)


@kernel
def stop_monitors(s):
    """Forget all hypotheses: the estimate was changed by other means than its own gain."""
    s[L.MONITORED] = 0.0
    for h in range(L.HYPOTHESES):
        s[hypothesis(h)] = np.nan


@kernel
def carry_nothing(s):
    """The effects stand at the state's time."""
    k = L.SINCE_UPDATE
    for i in range(9):
        for j in range(TOP):
            s[k + TOP * i + j] = 1.0 if i == j else 0.0
    s[k + 9 * TOP] = 1.0
    s[k + 9 * TOP + 1] = 1.0


@kernel
def begin_one(s, h):
    """Begin hypothesis h at the state's time."""
    b = hypothesis(h)
    f = effects(s)
    for i in range(L.HYPOTHESIS):
        s[b + i] = 0.0
    s[b + L.H_SINCE] = s[L.T]
    for a in range(3):
        for i in range(f.shape[0]):
            f[i, 3 * h + a] = 0.0
        s[b + L.H_J + 4 * a] = 1.0 / FAULT_SIGMA[KIND[h]] ** 2
        if KIND[h] >= GYRO:
            f[(DBG if KIND[h] == GYRO else DBA) + a, 3 * h + a] = -1.0


@kernel
def surprised(s, nis, m):
    """Before a velocity of the main receiver is fused: let it be the first of a lie, where its NIS of m degrees surprises.

    A velocity that lies and a position that drifts look alike but for the moment at which they begin.
    """
    if s[L.MONITORED] == 0.0 or not nis > SURPRISE * m:
        return
    size, covariance = vector(3), matrix(3, 3)
    if s[L.T] - s[hypothesis(SUDDEN)] > SUDDEN_AGE or regress(s, SUDDEN, size, covariance) < SUDDEN_RATIO:
        carry_effects(s)
        begin_one(s, SUDDEN)


@kernel
def begin_hypotheses(s):
    """At a fix: begin each hypothesis whose time has come, or all where none is followed; forget them where nothing can be judged."""
    if not can_judge(s):
        if s[L.MONITORED] != 0.0:
            stop_monitors(s)
        return
    if s[L.MONITORED] != 0.0:
        carry_effects(s)
    carry_nothing(s)
    s[L.MONITORED] = 1.0
    for h in range(L.HYPOTHESES):
        b = hypothesis(h)
        since = s[b + L.H_SINCE]
        if math.isfinite(since) and math.floor((since - PHASE[h]) / EVERY[h]) == math.floor(
            (s[L.T] - PHASE[h]) / EVERY[h]
        ):
            continue
        begin_one(s, h)


@fused_kernel
def follow_transition(s, Phi):
    """Add one step's transition (9, TOP) to what the effects have still to be carried along.

    What neither model couples is not read: see `covariance.propagate_covariance`.
    """
    if s[L.MONITORED] == 0.0:
        return
    whole = block(s, L.SINCE_UPDATE, 9, TOP)
    before = matrix(9, TOP)
    copy(before, whole)
    # written out, so that it is done for several j at once
    for i in range(3):
        t0, t1, t2 = Phi[i, THETA], Phi[i, THETA + 1], Phi[i, THETA + 2]
        v0, v1 = Phi[i, VEL], Phi[i, VEL + 1]
        for j in range(TOP):
            whole[i, j] = ((t0 * before[0, j] + t1 * before[1, j]) + (t2 * before[2, j] + v0 * before[VEL, j])) + (
                v1 * before[VEL + 1, j]
            )
    for i in range(VEL, VEL + 3):
        t0, t1, t2 = Phi[i, THETA], Phi[i, THETA + 1], Phi[i, THETA + 2]
        v0, v1, v2, h = Phi[i, VEL], Phi[i, VEL + 1], Phi[i, VEL + 2], Phi[i, POS + 2]
        for j in range(TOP):
            whole[i, j] = ((t0 * before[0, j] + t1 * before[1, j]) + (t2 * before[2, j] + v0 * before[VEL, j])) + (
                (v1 * before[VEL + 1, j] + v2 * before[VEL + 2, j]) + h * before[POS + 2, j]
            )
    for i in range(POS, POS + 3):
        own = VEL + i - POS
        t0, t1, t2 = Phi[i, THETA], Phi[i, THETA + 1], Phi[i, THETA + 2]
        v, p = Phi[i, own], Phi[i, i]
        for j in range(TOP):
            whole[i, j] = ((t0 * before[0, j] + t1 * before[1, j]) + (t2 * before[2, j] + v * before[own, j])) + (
                p * before[i, j]
            )
    for i in range(9):
        for j in range(9, TOP):
            whole[i, j] += Phi[i, j]


@kernel
def follow_decay(s, axis, phi):
    """Let the effects on the coloured error decay by phi; axis: 0 horizontal, 1 vertical."""
    s[L.SINCE_UPDATE + 9 * TOP + axis] *= phi


@fused_kernel
def carry_effects(s):
    """Carry all effects along to the state's time."""
    Phi = block(s, L.SINCE_UPDATE, 9, TOP)
    f = effects(s)
    top = matrix(9, COLUMNS)
    for i in range(9):
        for column in range(COLUMNS):
            top[i, column] = 0.0
        for j in range(TOP):
            p = Phi[i, j]
            if p != 0.0:
                for column in range(COLUMNS):
                    top[i, column] += p * f[j, column]
    for i in range(9):
        for column in range(COLUMNS):
            f[i, column] = top[i, column]
    for i in range(3):
        phi = s[L.SINCE_UPDATE + 9 * TOP + i // 2]
        for column in range(COLUMNS):
            f[DGNSS + i, column] *= phi
    carry_nothing(s)


@fused_kernel
def shown_by(s, e, sensor, H, G):
    """Fill G (m, COLUMNS) with what unit faults do to the innovation of a sensor (value of a Sensor): D - H f. H: (m, n)."""
    m, n = H.shape
    f = effects(s)
    for a in range(m):
        for column in range(COLUMNS):
            G[a, column] = 0.0
        for i in range(n):
            h = H[a, i]
            if h != 0.0:
                for column in range(COLUMNS):
                    G[a, column] -= h * f[i, column]
    if e[SOURCE] != s[L.MAIN]:
        return
    if sensor == Sensor.GNSS_POSITION.value:
        for h in range(L.HYPOTHESES):
            if KIND[h] == RAMP:
                for a in range(m):
                    G[a, 3 * h + a + 3 - m] += s[L.T] - s[hypothesis(h)]  # one component: the height alone
    elif sensor == Sensor.GNSS_VELOCITY.value:
        for h in range(L.HYPOTHESES):
            if KIND[h] == VELOCITY:
                for a in range(m):
                    G[a, 3 * h + a] += 1.0


@fused_kernel
def watch(s, e, sensor, r, H, inverse, K, nis, tells):
    """Take one fused measurement into all hypotheses: innovation r (m,), H (m, n), S^-1 (m, m), gain K (n, m), sensor: value of a Sensor.

    tells: whether the innovation is evidence; the effects follow the gain in any case.
    """
    if s[L.MONITORED] == 0.0:
        return
    carry_effects(s)
    m, n = H.shape
    weight = 1.0 if nis <= CLIP else CLIP / nis
    G = matrix(3, COLUMNS)
    W = matrix(3, COLUMNS)
    shown_by(s, e, sensor, H, G)
    if tells:
        for a in range(m):
            for column in range(COLUMNS):
                W[a, column] = 0.0
            for k in range(m):
                w = weight * inverse[a, k]
                for column in range(COLUMNS):
                    W[a, column] += w * G[k, column]
        for h in range(L.HYPOTHESES):
            b = hypothesis(h)
            for i in range(3):
                for a in range(m):
                    s[b + L.H_C + i] += W[a, 3 * h + i] * r[a]
                    for j in range(3):
                        s[b + L.H_J + 3 * i + j] += G[a, 3 * h + i] * W[a, 3 * h + j]
    f = effects(s)
    for i in range(n):
        for a in range(m):
            gain = K[i, a]
            if gain != 0.0:
                for column in range(COLUMNS):
                    f[i, column] += gain * G[a, column]


@kernel
def invert_by_cofactors(J, inverse):
    """Inverse of a symmetric matrix (3, 3); returns its determinant. J_0 keeps J far from singular, so that this is as good as a root."""
    a, b, c = J[0, 0], J[0, 1], J[0, 2]
    d, e, f = J[1, 1], J[1, 2], J[2, 2]
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * p + b * q + c * r
    scale = 1.0 / determinant
    inverse[0, 0] = scale * p
    inverse[0, 1] = inverse[1, 0] = scale * q
    inverse[0, 2] = inverse[2, 0] = scale * r
    inverse[1, 1] = scale * (a * f - c * c)
    inverse[1, 2] = inverse[2, 1] = scale * (b * c - a * e)
    inverse[2, 2] = scale * (a * d - b * b)
    return determinant


@kernel
def regress(s, h, size, covariance):
    """Fill the likeliest size b (3,) of hypothesis h and its covariance J^-1 (3, 3); returns l, or 0 where there is nothing to tell."""
    b = hypothesis(h)
    J = block(s, b + L.H_J, 3, 3)
    if not math.isfinite(s[b]) or not invert_by_cofactors(J, covariance) > 0.0:
        return 0.0
    ratio = 0.0
    for i in range(3):
        size[i] = 0.0
        for j in range(3):
            size[i] += covariance[i, j] * s[b + L.H_C + j]
        ratio += size[i] * s[b + L.H_C + i]
    return ratio
