"""What only a tape in detail has: the state as a measurement finds it, and what a measurement would be anywhere else."""

from mavkf.compiled import kernel
from mavkf.navigation import layout as L
from mavkf.navigation.tape import LENGTH, PROBE, SNAPSHOT, attend, close


@kernel
def record_snapshot(s, e, out):
    """Record the state that a measurement finds, and its event."""
    attend(s, out)
    tape = out[5]
    k = int(tape[LENGTH])
    for i in range(L.HALF):
        tape[k + i] = s[i]
    for i in range(L.EVENT_WIDTH):
        tape[k + L.HALF + i] = e[i]
    close(tape, k + L.HALF + L.EVENT_WIDTH, int(s[L.STATES]), SNAPSHOT)


@kernel
def record_probe(out, sensor, r, H, R):
    """Record what would be fused: number m of components, value of the Sensor, r (m,), H (m, n), R (m, m)."""
    tape = out[5]
    m, n = H.shape
    k = int(tape[LENGTH])
    tape[k], tape[k + 1] = m, sensor
    k += 2
    for a in range(m):
        tape[k + a] = r[a]
        for i in range(n):
            tape[k + m + n * a + i] = H[a, i]
        for b in range(m):
            tape[k + m + m * n + m * a + b] = R[a, b]
    close(tape, k + m + m * n + m * m, n, PROBE)
