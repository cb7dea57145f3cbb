"""Smoothing of the fold: forward over a block of events with a tape, then backward over the tape (`filters.bryson_frazier`).

What stands on the tape is what the fold did by its own linear model: error e' = e - K r for a correction, e' = Phi e + w for a
transition. That a correction turns the frame of the attitude error by half of its angle, which the fold's covariance leaves out, the
adjoint leaves out too: it is the adjoint of the recursion that was run. Corrections of the attitude so large that it would matter are a
break on the tape.
"""

import math

import numpy as np

from mavkf.compiled import kernel, long_kernel
from mavkf.filters.bryson_frazier import back_over_correction, back_over_transition, exchange, smoothed
from mavkf.models import telemetry
from mavkf.models.order import STATES_MOST
from mavkf.models.strapdown import BG, DGNSS, POS, TOP, VEL, V, retract
from mavkf.models.telemetry import OMEGA
from mavkf.navigation import layout as L
from mavkf.navigation import tape as T
from mavkf.navigation.covariance import bring_up
from mavkf.navigation.fold import fold
from mavkf.navigation.pose import pose_row, show
from mavkf.navigation.timeline import is_lone_fix, is_sample_in_use, slot_of
from mavkf.samples import TIME
from mavkf.stack import block, copy, matrix, vector

KINEMATIC = 9  # error states of attitude, velocity and position, whose covariance a pose shows
X_SIZE = L.X_SIZE
INTEGRATED = np.arange(TOP)
MOVING = np.array([telemetry.place(m) for m in range(telemetry.M)])


@long_kernel
def fold_block(s, events, slot, count, c, rate, held, faults, poses, out):
    """Fold sorted events (m, EVENT_WIDTH); where `out` has a tape, record them and the poses that fall due, whose rows begin at `count`.

    held, faults: as of `use_hindsight`; the rest as of `timeline.run_batch`. Returns the interval of the last pose and the number of rows.
    """
    recording = T.is_recording(out)
    if recording:
        T.rewind(s, out[5])
    for i in range(events.shape[0]):
        e = events[i]
        lone = is_lone_fix(e, s[L.T_IMU], c)
        out[2][:] = 0
        use_hindsight(s, e[TIME], held, faults)
        if s[L.SECOND] != 0.0:
            use_hindsight(s[L.HALF :], e[TIME], held, faults)
        fold(s, e, c, out)
        if (lone or is_sample_in_use(s, e)) and math.isfinite(s[L.T]):
            now = slot_of(s[L.T], rate)
            if rate == 0.0 or now > slot:
                slot = now
                bring_up(s, c, out)
                if recording:
                    pose_row(s, c, poses[count])
                    T.record_pose(s, out, count)
                count += 1
    bring_up(s, c, out)
    if recording:
        T.attend(s, out)
    return slot, count


@kernel
def use_hindsight(s, t, held, faults):
    """Give one half of the state what is known of the whole flight, before an event at t (s).

    held: (k, 2) places in the state and the values that they have; faults: (k, 3) place of the beginning of a suspicion, and from when to
    when (s) it is known to be justified.
    """
    for k in range(held.shape[0]):
        s[int(held[k, 0])] = held[k, 1]
    for k in range(faults.shape[0]):
        if faults[k, 1] <= t < faults[k, 2]:
            s[int(faults[k, 0])] = faults[k, 1]
            s[L.AGREES_SINCE] = np.nan


@long_kernel
def sweep(tape, adjoint, Adjoint, poses, delay):
    """Go back over a tape, from lambda (STATES_MOST,) and Lambda (STATES_MOST, STATES_MOST) behind it to those before; smooth its poses.

    delay: s, one sigma of a GNSS delay that is not estimated.
    """
    end, states = int(tape[T.LENGTH]), STATES_MOST
    while end > T.BEGIN:
        n, size, kind = int(tape[end - 3]), int(tape[end - 2]), int(tape[end - 1])
        k = end - T.TAIL - size
        end = k
        # what the state did not have before says nothing of it
        forget(adjoint, Adjoint, n, states)
        states = n
        low = adjoint[:n]
        if kind == T.POSE:
            smooth_row(tape, k, n, low, Adjoint, poses[int(tape[k + T.P_ROW])], delay)
        elif kind == T.TRANSITION:
            for i in range(3):
                link(low, Adjoint, DGNSS + i, DGNSS + i, tape[k + T.T_DECAY + i // 2])
            Phi = tape[k + T.T_PHI : k + size]
            if Phi.shape[0] == 9 * TOP:
                back_over_transition(low, Adjoint, block(Phi, 0, 9, TOP), INTEGRATED)
            else:
                back_over_transition(low, Adjoint, block(Phi, 0, telemetry.M, telemetry.M), MOVING)
        elif kind == T.CORRECTION:
            over_correction(tape, k, n, low, Adjoint)
        elif kind == T.LINK:
            link(low, Adjoint, int(tape[k]), int(tape[k + 1]), tape[k + 2])
        else:
            forget(adjoint, Adjoint, 0, states)


@kernel
def forget(adjoint, Adjoint, n, states):
    """Have nothing said of the error states from number n on, of as many states."""
    for i in range(n, states):
        adjoint[i] = 0.0
        for j in range(states):
            Adjoint[i, j] = 0.0
            Adjoint[j, i] = 0.0


@kernel
def link(adjoint, Adjoint, to, of, factor):
    """Go back over a state `to` that has become factor times the state `of`, and noise: lambda_of += factor lambda_to, lambda_to = 0."""
    n = adjoint.shape[0]
    value = adjoint[to]
    adjoint[to] = 0.0
    adjoint[of] += factor * value
    row = vector(n)
    for j in range(n):
        row[j] = Adjoint[to, j]
        Adjoint[to, j] = 0.0
        Adjoint[j, to] = 0.0
    own = row[to]
    row[to] = 0.0
    for j in range(n):
        Adjoint[of, j] += factor * row[j]
        Adjoint[j, of] += factor * row[j]
    Adjoint[of, of] += factor * factor * own


@kernel
def over_correction(tape, k, n, adjoint, Adjoint):
    """Go back over a correction whose content begins at place k."""
    m = int(tape[k + T.C_SIZE])
    gain = tape[k + T.C_GAIN]
    k += T.C_R
    r = tape[k : k + m]
    k += m
    inverse = block(tape, k, m, m)
    k += m * m
    H = block(tape, k, m, n)
    k += m * n
    K = block(tape, k, n, m)
    if gain == T.OPTIMAL:
        back_over_correction(adjoint, Adjoint, r, inverse, H, K)
        return
    k += m * n
    D, whole = block(tape, k, n, m), matrix(n, m)
    for i in range(n):
        for a in range(m):
            whole[i, a] = K[i, a] + D[i, a]
    done = exchange(adjoint, Adjoint, r, inverse, D, 1.0)
    if gain == T.KEPT_FROM_MOTION:
        # what the filter has kept from the motion tells the smoother nothing of it either: the measurement is taken out
        done = done and exchange(adjoint, Adjoint, r, inverse, whole, -1.0)
    else:
        back_over_correction(adjoint, Adjoint, r, inverse, H, whole)
    if not done:
        forget(adjoint, Adjoint, 0, n)


@kernel
def cover_delay(P, v, a, sigma):
    """Add to P what a delay of one sigma (s) would shift, that was not estimated: position by v delta, velocity by a delta."""
    for i in range(3):
        for j in range(3):
            P[POS + i, POS + j] += sigma * sigma * v[i] * v[j]
            P[VEL + i, VEL + j] += sigma * sigma * a[i] * a[j]
            P[POS + i, VEL + j] += sigma * sigma * v[i] * a[j]
            P[VEL + j, POS + i] = P[POS + i, VEL + j]


@kernel
def smooth_row(tape, k, n, adjoint, Adjoint, row, delay):
    """Put what is smoothed into a pose row of the filter: what was valid stays so; mode, flags and protection levels are the filter's."""
    x, dx, P_smoothed = vector(X_SIZE), vector(n), matrix(KINEMATIC, KINEMATIC)
    copy(x, tape[k + T.P_X : k + T.P_P])
    P = block(tape, k + T.P_P, n, n)
    smoothed(P, adjoint, Adjoint, dx, P_smoothed)
    retract(x, dx)
    cover_delay(P_smoothed, x[V : V + 3], tape[k + T.P_ACCELERATION : k + T.P_X], delay)
    for i in range(3):
        if tape[k + T.P_MODEL] == L.TELEMETRY:
            row[L.R_RATE + i] += x[OMEGA + i] - tape[k + T.P_X + OMEGA + i]
        else:
            row[L.R_RATE + i] -= x[BG + i] - tape[k + T.P_X + BG + i]
    show(x, P_smoothed, int(row[L.R_VALID]), row)
