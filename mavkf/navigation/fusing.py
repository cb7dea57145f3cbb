"""Judging and fusing one measurement, and the record that it leaves either way.

`out` are the output buffers of `layout.buffers`: an event that is folded again after a late one does not tell its story twice.
"""

import math

import numpy as np

from mavkf.compiled import BOOLEAN, FLOAT, INTEGER, MATRIX, NOTHING, VECTOR, compiled_apart, kernel
from mavkf.filters.joseph import correct, innovation_covariance, invert, quadratic
from mavkf.models.order import DANTENNA, DCLASS
from mavkf.models.strapdown import DDELAY, retract
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NOTE_CODES, SENSORS, Reason, Sensor
from mavkf.navigation.layout import OUT
from mavkf.navigation.monitors import watch
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.tape import (
    CONSIDERED,
    KEPT_FROM_MOTION,
    MODE,
    OPTIMAL,
    PROBING,
    attend,
    is_recording,
    record_correction,
)
from mavkf.navigation.tape_detail import record_probe
from mavkf.samples import SOURCE
from mavkf.stack import copy, matrix, vector, zero_matrix

SLOWEST_FOR_LEARNING = 0.05  # s between IMU samples, above which its own errors look like a delay or a wander of GNSS


@kernel
def note(out, code, start, end, size, a, b):
    """Write a note row of what was found at its end, unless one of this code was written for this time or later (it is folded again)."""
    tell(out, code.value, 0.0, end, start, end, size, a, b)


@compiled_apart(NOTHING, OUT, INTEGER, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT)
def tell(out, code, apart, t, start, end, size, a, b):
    """Write a note row at time t, as `note` does; what lasts has no end yet (NaN).

    code: value of a NoteCode; apart: s that another note of its kind (begin or end) must be later than the last.
    """
    notes, counts, written = out[1], out[2], out[3]
    slot = code if math.isfinite(end) else NOTE_CODES + code
    if counts[2] == 0 and t > written[slot] + apart and counts[1] < notes.shape[0]:
        written[slot] = t
        row = notes[counts[1]]
        row[L.NOTE_CODE] = code
        row[L.NOTE_TIME] = t
        row[L.NOTE_START] = start
        row[L.NOTE_END] = end
        row[L.NOTE_SIZE] = size
        row[L.NOTE_A] = a
        row[L.NOTE_B] = b
        counts[1] += 1


@kernel
def record(out, e, t, sensor, r, S, nis, limit, reason):
    """Write an innovation row, unless this event has left one for this sensor already (it is folded again).

    sensor, reason: values of their enumerations.
    """
    rows, counts, recorded = out[0], out[2], out[4]
    number = int(e[L.EVENT_ID])
    slot = number % recorded.shape[0]
    left = int(recorded[slot]) if recorded[slot] >= 0.0 else 0
    if left >> SENSORS != number:
        left = number << SENSORS  # the record was another event's
    if counts[2] == 0 and not left >> sensor & 1 and counts[0] < rows.shape[0]:
        recorded[slot] = left | 1 << sensor
        row = rows[counts[0]]
        row[:] = 0.0
        m = r.shape[0]
        row[L.I_TIME] = t
        row[L.I_SENSOR] = sensor
        row[L.I_SOURCE] = e[SOURCE]
        row[L.I_SIZE] = m
        for i in range(m):
            row[L.I_R + i] = r[i]
            for j in range(m):
                row[L.I_S + m * i + j] = S[i, j]
        row[L.I_NIS] = nis
        row[L.I_LIMIT] = limit
        row[L.I_FUSED] = 1.0 if reason == Reason.FUSED.value else 0.0
        row[L.I_REASON] = reason
        counts[0] += 1


@kernel
def fuse(s, e, c, out, sensor, r, H, R, suspect):
    """Judge and fuse one vector; returns its NIS, or -1 where it was not fused.

    r: (m,), H: (m, n), R: (m, m); `suspect`: a Reason against it, or Reason.FUSED.
    """
    return judge_and_correct(s, e, c, out, sensor.value, r, H, R, R, False, suspect.value)


@kernel
def fuse_lasting(s, e, c, out, sensor, r, H, R, R_lasting):
    """Judge one vector by R and fuse it with R_lasting: its errors last, so that many together tell less than each alone."""
    return judge_and_correct(s, e, c, out, sensor.value, r, H, R, R_lasting, True, Reason.FUSED.value)


@compiled_apart(FLOAT, VECTOR, VECTOR, VECTOR, OUT, INTEGER, VECTOR, MATRIX, MATRIX, MATRIX, BOOLEAN, INTEGER)
def judge_and_correct(s, e, c, out, sensor, r, H, R, R_lasting, lasts, suspect):
    """What `fuse` and `fuse_lasting` do; lasts: whether R_lasting is not R; sensor and suspect: values of a Sensor and a Reason."""
    if is_recording(out) and out[5][MODE] == PROBING:
        record_probe(out, sensor, r, H, R_lasting)
        return 0.0
    m = r.shape[0]
    P = L.covariance(s)
    n = P.shape[0]
    PHt = matrix(n, m)
    S = matrix(m, m)
    inverse = matrix(m, m)
    innovation_covariance(P, H, R, PHt, S)
    limit = c[Parameter.LIMIT_1 + m - 1]
    nis = np.nan
    reason = suspect
    determinant = invert(S, inverse)
    if not determinant > 0.0:
        reason = Reason.SINGULAR.value
    else:
        nis = quadratic(inverse, r)
        # a NaN fails the comparison and is refused like an outlier
        if reason == Reason.FUSED.value and not nis <= limit:
            reason = Reason.GATE.value
        if sensor <= Sensor.BAROMETER.value:
            # what is refused counts as if it had just been let in
            s[L.LIKELIHOOD] -= 0.5 * (min(nis, limit) + math.log(determinant))
    record(out, e, s[L.T], sensor, r, S, nis, limit, reason)
    K = zero_matrix(n, m)
    if reason != Reason.FUSED.value:
        if reason == Reason.GATE.value and sensor == Sensor.GNSS_VELOCITY.value and math.isfinite(nis):
            # a filter that an IMU has led astray refuses velocities: they tell what is wrong all the same
            watch(s, e, sensor, r, H, inverse, K, nis, True)
        return -1.0
    if lasts:
        innovation_covariance(P, H, R_lasting, PHt, S)
        if not invert(S, inverse) > 0.0:
            return -1.0
    dx = vector(n)
    # a delay is seen only where the motion between samples is: a slow IMU shows its own aliasing instead
    considered = DDELAY if s[L.PERIOD] > SLOWEST_FOR_LEARNING else -1
    recording = is_recording(out)
    if recording:
        attend(s, out)
    only_class = s[L.CORRECT_CLASS] != 0.0
    first, last = (DCLASS, DANTENNA) if only_class else (0, n)
    correct(P, PHt, S, inverse, r, dx, K, matrix(6, n), considered, first, last)
    watch(s, e, sensor, r, H, inverse, K, nis, sensor <= Sensor.BAROMETER.value and not lasts)
    retract(s[L.X : L.P], dx)
    if recording:
        gain = KEPT_FROM_MOTION if only_class else (CONSIDERED if considered >= 0 else OPTIMAL)
        record_correction(s, out, r, H, inverse, K, PHt, dx, gain, R_lasting, sensor)
    return nis


@kernel
def forget(s, first, count, variance):
    """Cut error states first..first+count loose from all others and give each this variance."""
    P = L.covariance(s)
    for i in range(first, first + count):
        for j in range(P.shape[0]):
            P[i, j] = 0.0
            P[j, i] = 0.0
        P[i, i] = variance


@kernel
def widen(s, n):
    """Give the covariance n rows; the new ones are zero."""
    before = int(s[L.STATES])
    old = matrix(before, before)
    copy(old, L.covariance(s))
    s[L.STATES] = n
    P = L.covariance(s)
    P[:, :] = 0.0
    for i in range(old.shape[0]):
        for j in range(old.shape[0]):
            P[i, j] = old[i, j]
