"""The tape: what the fold did to estimate and covariance, step by step, for a smoother to go back over.

Where the output buffers have a tape (`layout.buffers`), each transition and each correction of the first half of the state is written
to it with the matrices that were used. Whatever else is done to the state shows as a difference between the state as the last
entry left it and as the next one finds it, so nothing can be forgotten here (`attend`):

    more variance on the diagonal     process noise; a smoother passes it unchanged, so nothing is written
    states cut loose and set anew     LINK with a factor of zero: what comes later says nothing of their old values
    anything else                     BREAK: an estimate changed by other means than its own gain, as by a reset, a fault taken out,
                                      the first heading, another model that leads; a smoother begins anew before it

In a mode of its own (DETAILED) the tape tells all that another filter needs to do the same (`any_form`): transitions are not merged, the
noise added to the diagonal is an entry (NOISE), a correction has its R and sensor, a BREAK the covariance after it, and the state as a
measurement finds it is kept with its event (SNAPSHOT). In another (PROBING) nothing is corrected: what would be fused is written with
its r, H and R (PROBE), so that a measurement can be linearised wherever a copy of the state is put.

Layout: next free place, number of error states, nominal state and covariance as the last entry left them, then entries. An entry is its
content, then the number of error states, the length of the content and its kind, so that it can be read backward.
"""

from mavkf.compiled import FLOAT, INTEGER, MATRIX, NOTHING, VECTOR, compiled_apart, kernel
from mavkf.models.strapdown import BG, DBG, THETA, VEL, V
from mavkf.navigation import layout as L
from mavkf.navigation.layout import OUT
from mavkf.stack import block, copy, matrix, zero_vector

TRANSITION, CORRECTION, LINK, BREAK, POSE, NOISE, SNAPSHOT, PROBE = range(8)
LENGTH, STATES, X = 0, 1, 2
P = X + L.X_SIZE
MODE = P + L.STATES_MOST * L.STATES_MOST
BEGIN = MODE + 1
FOR_SMOOTHING, DETAILED, PROBING = 0.0, 1.0, 2.0  # values of MODE
TAIL = 3  # numbers behind the content of an entry
C_SIZE, C_GAIN, C_R = (
    0,
    1,
    2,
)  # content of a correction: m, which gain, r, S^-1, H, K, and what K lacks of the optimal gain
OPTIMAL, CONSIDERED, KEPT_FROM_MOTION = 0.0, 1.0, 2.0  # gains: all states corrected; all but one; the class's only
T_DECAY, T_PHI = 0, 2  # of a transition: decay of the coloured error, horizontal and vertical; Phi
P_ROW, P_MODEL, P_ACCELERATION, P_X = (
    0,
    1,
    2,
    5,
)  # of a pose: its row, the model, acceleration, nominal state, covariance
P_P = P_X + L.X_SIZE
TURNED = 0.2  # rad: a correction of the attitude beyond which its two sides have not the same linear model


@kernel
def is_recording(out):
    """Whether what is done to the state is recorded."""
    return out[5].shape[0] > 0 and out[2][2] == 0


@kernel
def is_detailed(out):
    """Whether what is recorded is recorded in detail."""
    return is_recording(out) and out[5][MODE] == DETAILED


@kernel
def keep(s, tape):
    """Keep estimate and covariance as they are now."""
    n = int(s[L.STATES])
    tape[STATES] = n
    for i in range(L.X_SIZE):
        tape[X + i] = s[L.X + i]
    for i in range(n * n):
        tape[P + i] = s[L.P + i]


@kernel
def rewind(s, tape):
    """Begin a tape at a state."""
    tape[LENGTH] = BEGIN
    keep(s, tape)


@kernel
def close(tape, k, n, kind):
    """End an entry whose content ends before place k."""
    tape[k] = n
    tape[k + 1] = k - int(tape[LENGTH])
    tape[k + 2] = kind
    tape[LENGTH] = k + TAIL


@kernel
def differs(s, tape, n):
    """Whether estimate or covariance are not what was kept, of the same number n of error states."""
    count = 0
    for i in range(L.X_SIZE):
        count += 1 if s[L.X + i] != tape[X + i] else 0
    for i in range(n * n):
        count += 1 if s[L.P + i] != tape[P + i] else 0
    return count > 0


@kernel
def error_of(i):
    """The error state that belongs to number i of the nominal state."""
    if i < V:
        return min(THETA + i, THETA + 2)
    return VEL + i - V if i < BG else DBG + i - BG


@compiled_apart(NOTHING, VECTOR, OUT)
def attend(s, out):
    """Write down what was done to the state since the last entry."""
    tape = out[5]
    n, before = int(s[L.STATES]), int(tape[STATES])
    if n == before and not differs(s, tape, n):
        return
    both = min(n, before)
    Pn = L.covariance(s)
    Pb = block(tape, P, before, before)
    moved = zero_vector(L.STATES_MOST)
    for i in range(L.X_SIZE):
        if s[L.X + i] != tape[X + i]:
            moved[error_of(i)] = 1.0
    cut = zero_vector(L.STATES_MOST)
    for i in range(n):
        changed, alone = moved[i] != 0.0 or i >= both, True
        for j in range(n):
            if j == i:
                changed = changed or (i < both and Pn[i, i] < Pb[i, i])
            else:
                alone = alone and Pn[i, j] == 0.0
                changed = changed or (i < both and j < both and Pn[i, j] != Pb[i, j])
        cut[i] = 1.0 if changed and alone else 0.0
    broken = False
    for i in range(n):
        if cut[i] != 0.0:
            continue
        broken = broken or moved[i] != 0.0 or i >= both or Pn[i, i] < Pb[i, i]
        for j in range(both):
            broken = broken or (i < both and j != i and cut[j] == 0.0 and Pn[i, j] != Pb[i, j])
    if broken:
        k = int(tape[LENGTH])
        if tape[MODE] == DETAILED:
            for i in range(n * n):
                tape[k + i] = s[L.P + i]
            k += n * n
        close(tape, k, n, BREAK)
    else:
        q = zero_vector(n)
        noisy = False
        for i in range(n):
            if cut[i] != 0.0:
                write_link(tape, n, i, i, 0.0, Pn[i, i])
            else:
                q[i] = Pn[i, i] - Pb[i, i]
                noisy = noisy or q[i] > 0.0
        if tape[MODE] == DETAILED and noisy:
            record_noise(out, n, q)
    keep(s, tape)


@kernel
def write_link(tape, n, to, of, factor, variance):
    """Write that error state `to` has become factor times error state `of` and something independent of this variance."""
    k = int(tape[LENGTH])
    tape[k], tape[k + 1], tape[k + 2], tape[k + 3] = to, of, factor, variance
    close(tape, k + 4, n, LINK)


@kernel
def record_noise(out, n, q):
    """Record noise that was added: q (n,) to the diagonal, or all of a matrix (its numbers in a row) to the states that move."""
    tape = out[5]
    k = int(tape[LENGTH])
    for i in range(q.shape[0]):
        tape[k + i] = q[i]
    close(tape, k + q.shape[0], n, NOISE)


@compiled_apart(NOTHING, VECTOR, OUT, INTEGER, INTEGER, FLOAT)
def record_link(s, out, to, of, factor):
    """Record that error state `to` has become factor times error state `of` and something independent; `attend` was called before."""
    tape = out[5]
    before = tape[P + of * (int(tape[STATES]) + 1)]
    variance = L.covariance(s)[to, to] - factor * factor * before
    write_link(tape, int(s[L.STATES]), to, of, factor, variance)
    keep(s, tape)


@compiled_apart(NOTHING, VECTOR, OUT, MATRIX, VECTOR)
def record_transition(s, out, Phi, phi):
    """Record a transition, and the decay phi (2,) of the coloured error in that time; `attend` was called before.

    Phi: the rows (9, TOP) of `strapdown.transition`, or (M, M) of the telemetry model's states that move. Where the last entry is of
    the same kind, it becomes the transition over both, unless the tape is in detail.
    """
    tape = out[5]
    n, k = int(s[L.STATES]), int(tape[LENGTH])
    a, b = Phi.shape
    size = T_PHI + a * b
    if (
        tape[MODE] == FOR_SMOOTHING
        and k > BEGIN
        and tape[k - 1] == TRANSITION
        and tape[k - 2] == size
        and tape[k - 3] == n
    ):
        k -= TAIL + size
        before = matrix(a, b)
        copy(before, block(tape, k + T_PHI, a, b))
        for axis in range(2):
            tape[k + T_DECAY + axis] *= phi[axis]
        after = block(tape, k + T_PHI, a, b)
        for i in range(a):
            for j in range(b):
                after[i, j] = Phi[i, j] if j >= a else 0.0
            for m in range(a):
                for j in range(b):
                    after[i, j] += Phi[i, m] * before[m, j]
    else:
        for axis in range(2):
            tape[k + T_DECAY + axis] = phi[axis]
        for i in range(a):
            for j in range(b):
                tape[k + T_PHI + b * i + j] = Phi[i, j]
        close(tape, k + size, n, TRANSITION)
    keep(s, tape)


@compiled_apart(NOTHING, VECTOR, OUT, VECTOR, MATRIX, MATRIX, MATRIX, MATRIX, VECTOR, FLOAT, MATRIX, INTEGER)
def record_correction(s, out, r, H, inverse, K, PHt, dx, gain, R, sensor):
    """Record a correction by the gain K (n, m) and innovation r (m,); `attend` was called before.

    H: (m, n), inverse: S^-1 (m, m), PHt: P H' (n, m) before, dx: (n,); gain: which one it is; R: (m, m) and the value of
    the Sensor, for a tape in detail.
    """
    tape = out[5]
    m, n = H.shape
    k = int(tape[LENGTH])
    tape[k + C_SIZE], tape[k + C_GAIN] = m, gain
    k += C_R
    for a in range(m):
        tape[k + a] = r[a]
    k += m
    for a in range(m):
        for b in range(m):
            tape[k + m * a + b] = inverse[a, b]
    k += m * m
    for a in range(m):
        for i in range(n):
            tape[k + n * a + i] = H[a, i]
            tape[k + n * m + m * i + a] = K[i, a]
    k += 2 * n * m
    if gain != OPTIMAL:
        for i in range(n):
            for a in range(m):
                full = 0.0
                for b in range(m):
                    full += PHt[i, b] * inverse[b, a]
                tape[k + m * i + a] = full - K[i, a]
        k += n * m
    if tape[MODE] == DETAILED:
        for a in range(m):
            for b in range(m):
                tape[k + m * a + b] = R[a, b]
        tape[k + m * m] = sensor
        close(tape, k + m * m + 1, n, CORRECTION)
        keep(s, tape)
        return
    close(tape, k, n, CORRECTION)
    if dx[THETA] ** 2 + dx[THETA + 1] ** 2 + dx[THETA + 2] ** 2 > TURNED**2:
        close(tape, int(tape[LENGTH]), n, BREAK)
    keep(s, tape)


@kernel
def record_pose(s, out, row):
    """Record estimate and covariance, for row number `row` of the output."""
    attend(s, out)
    tape = out[5]
    n = int(s[L.STATES])
    k = int(tape[LENGTH])
    tape[k + P_ROW], tape[k + P_MODEL] = row, s[L.MODEL]
    for i in range(3):
        tape[k + P_ACCELERATION + i] = s[L.ACCELERATION + i]
    for i in range(L.X_SIZE):
        tape[k + P_X + i] = s[L.X + i]
    for i in range(n * n):
        tape[k + P_P + i] = s[L.P + i]
    close(tape, k + P_P + n * n, n, POSE)
