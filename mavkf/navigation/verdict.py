"""What follows from the monitors: the likeliest fault is named, its effect taken out of the estimate, and its sensor distrusted."""

import math

import numpy as np

from mavkf.compiled import INTEGER, NOTHING, VECTOR, compiled_apart, kernel
from mavkf.filters.joseph import invert
from mavkf.models.strapdown import DBA, DBG, retract
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.disturbances import begin_fault, end_fault
from mavkf.navigation.fusing import tell
from mavkf.navigation.heights import doubt_height, heights_agree
from mavkf.navigation.layout import OUT
from mavkf.navigation.monitors import (
    GYRO,
    KIND,
    RAMP,
    VELOCITY,
    effects,
    hypothesis,
    regress,
    stop_monitors,
)
from mavkf.navigation.reset import acquit_position, reset_position
from mavkf.stack import matrix, vector

# By kind: twice the log likelihood ratio at which a fault is believed, and the least size that is worth a name. Chi-square with three
# degrees of freedom exceeds 30 once in 700,000 trials; the IMU's kinds need more, because what is not modelled (scale, vibration, the
# lag of a turn) looks like a bias for a while. m/s, m/s, rad/s, m/s^2.
VERDICTS = np.array([30.0, 40.0, 50.0, 80.0])
ACROSS, ALONG = (
    27.0,
    22.0,
)  # of a drift: of its horizontal and of its vertical part, with two degrees and with one, as unlikely
LEAST = np.array([0.1, 0.4, math.radians(0.1), 0.05])
MOST = np.array([np.inf, np.inf, math.radians(10.0), 6.0])  # no bias of a sensor that works steps further
# By hypothesis: what a kind is rarer than the others, in the same measure. A velocity that begins to lie without a jump is rarer by far
# than a position that begins to drift.
RARER = np.array([0.0] * 6 + [0.0, 20.0, 20.0] + [0.0] * 6)
LEAST_AGE = 1.0  # s of evidence


@kernel
def take_out(s, h, size, covariance):
    """Take the effect of hypothesis h, of this size (3,) and covariance (3, 3), out of the estimate: x <- x - f b, P <- P + f J^-1 f'."""
    P = L.covariance(s)
    f = effects(s)
    n = P.shape[0]
    dx = vector(n)
    spread = matrix(n, 3)
    for i in range(n):
        dx[i] = 0.0
        for j in range(3):
            dx[i] -= f[i, 3 * h + j] * size[j]
            spread[i, j] = 0.0
            for k in range(3):
                spread[i, j] += f[i, 3 * h + k] * covariance[k, j]
    for i in range(n):
        for j in range(n):
            for k in range(3):
                P[i, j] += spread[i, k] * f[j, 3 * h + k]
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = mean
            P[j, i] = mean
    retract(s[L.X : L.P], dx)


@kernel
def horizontal_ratio(size, covariance):
    """How significant the horizontal part of a size (3,) of covariance (3, 3) is: b' C^-1 b of its first two components."""
    part = matrix(2, 2)
    inverse = matrix(2, 2)
    for i in range(2):
        for j in range(2):
            part[i, j] = covariance[i, j]
    if not invert(part, inverse) > 0.0:
        return 0.0
    ratio = 0.0
    for i in range(2):
        for j in range(2):
            ratio += size[i] * inverse[i, j] * size[j]
    return ratio


@compiled_apart(NOTHING, VECTOR, VECTOR, VECTOR, OUT, INTEGER)
def judge_faults(s, e, c, out, b):
    """After a fix of the main receiver: if a fault is likely enough, name it, take its effect out and distrust what has it. b: its book."""
    size, covariance = vector(3), matrix(3, 3)
    best, which = 0.0, -1
    for h in range(L.HYPOTHESES):
        if s[L.T] - s[hypothesis(h)] >= LEAST_AGE:
            ratio = regress(s, h, size, covariance)
            if ratio - RARER[h] > best - (RARER[which] if which >= 0 else 0.0):
                best, which = ratio, h
    if which < 0:
        return
    kind = KIND[which]
    regress(s, which, size, covariance)
    length = math.sqrt(size[0] * size[0] + size[1] * size[1] + size[2] * size[2])
    across, along = horizontal_ratio(size, covariance), size[2] * size[2] / covariance[2, 2]
    found = best >= VERDICTS[kind]
    if kind == RAMP:
        found = across >= ACROSS or along >= ALONG
    if not found or not LEAST[kind] <= length <= MOST[kind]:
        return
    if kind >= GYRO and math.isfinite(s[L.YAW_REFUSED_SINCE]):
        # a heading that two antennas contradict shows in the velocities too, and is not the IMU's doing
        return
    since = s[hypothesis(which)]
    drifts = kind == RAMP and across >= ACROSS
    if (drifts and math.isfinite(s[L.SUSPECT_VELOCITY])) or (kind == VELOCITY and math.isfinite(s[L.SUSPECT_POSITION])):
        # one receiver against one filter, in everything: it is the filter that has lost its way
        doubt_all(s, e, c, out, b)
        return
    if kind == RAMP and not drifts and heights_agree(s, size[2] * (s[L.T] - since)):
        doubt_height(s, out, size[2] * (s[L.T] - since), since)
        return
    take_out(s, which, size, covariance)
    if drifts:
        s[L.SUSPECT_POSITION] = since
        s[L.AGREES_SINCE] = np.nan
        rate = math.hypot(size[0], size[1])
        begin_fault(s, out, NoteCode.GNSS_DRIFT, since, rate * (s[L.T] - since), rate, best)
    elif kind == RAMP:
        s[L.SUSPECT_HEIGHT] = since
        s[L.HEIGHT_AGREES_SINCE] = np.nan
        way = abs(size[2]) * (s[L.T] - since)
        begin_fault(s, out, NoteCode.GNSS_HEIGHT_DRIFT, since, way, size[2], best)
    elif kind == VELOCITY:
        s[L.SUSPECT_VELOCITY] = since
        s[L.AGREES_SINCE] = np.nan
        begin_fault(s, out, NoteCode.GNSS_VELOCITY_WRONG, since, length, 0.0, best)
    else:
        first = DBG if kind == GYRO else DBA
        P = L.covariance(s)
        for i in range(3):
            # a bias that has stepped may not have done so at once
            P[first + i, first + i] += 0.01 * length * length
        code = NoteCode.GYRO_STEP.value if kind == GYRO else NoteCode.ACCELEROMETER_STEP.value
        tell(out, code, 0.0, s[L.T], since, s[L.T], length, 0.0, best)
    stop_monitors(s)
    if kind != RAMP:
        acquit_position(s, e, c, out, b)


@kernel
def doubt_all(s, e, c, out, b):
    """Take position and velocity from the main receiver's fix, and doubt the attitude. b: its book."""
    s[b + L.F_REFUSED_SINCE] = min(s[L.SUSPECT_POSITION], s[L.T]) if math.isfinite(s[L.SUSPECT_POSITION]) else s[L.T]
    reset_position(s, e, c, out, b, True)
    s[L.SUSPECT_VELOCITY] = np.nan
    end_fault(s, out, NoteCode.GNSS_VELOCITY_WRONG)
