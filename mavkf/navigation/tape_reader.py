"""What stands on a tape in detail, as Python values (layout: `tape`)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavkf.models import telemetry
from mavkf.models.strapdown import DGNSS, TOP
from mavkf.navigation import layout as L
from mavkf.navigation import tape as T

Array = NDArray[np.float64]
_MOVING = np.array([telemetry.place(m) for m in range(telemetry.M)])


@dataclass(frozen=True)
class Entry:
    """One entry: its kind, the number n of error states, and its content, a view of the tape."""

    kind: int
    n: int
    content: Array


@dataclass(frozen=True)
class Correction:
    """A correction of the fold: r (m,), H (m, n), its gain K (n, m), R (m, m), the sensor, and which states are left alone (n,)."""

    r: Array
    H: Array
    K: Array
    R: Array
    sensor: int
    considered: NDArray[np.bool_]


@dataclass(frozen=True)
class Probe:
    """What would be fused elsewhere: the sensor, r (m,) and H (m, n)."""

    sensor: int
    r: Array
    H: Array


def entries(tape: Array) -> list[Entry]:
    """The entries of a tape, in the order in which they were written."""
    found = []
    end = int(tape[T.LENGTH])
    while end > T.BEGIN:
        n, size, kind = (int(tape[end - k]) for k in (3, 2, 1))
        end -= T.TAIL + size
        found.append(Entry(kind, n, tape[end : end + size]))
    return found[::-1]


def correction(entry: Entry) -> Correction:
    """The content of a CORRECTION."""
    m, n, content = int(entry.content[T.C_SIZE]), entry.n, entry.content[T.C_R :]
    r, _, H, K, rest = np.split(content, np.cumsum((m, m * m, m * n, m * n)))
    K = K.reshape(n, m)
    considered = np.zeros(n, dtype=bool)
    if entry.content[T.C_GAIN] != T.OPTIMAL:
        lacking, rest = rest[: m * n].reshape(n, m), rest[m * n :]
        considered = np.all(K == 0.0, axis=1) & np.any(lacking != 0.0, axis=1)
    return Correction(r, H.reshape(m, n), K, rest[: m * m].reshape(m, m), int(rest[m * m]), considered)


def probe_of(entry: Entry) -> Probe:
    """The content of a PROBE."""
    m, n = int(entry.content[0]), entry.n
    r, H, _ = np.split(entry.content[2:], np.cumsum((m, m * n)))
    return Probe(int(entry.content[1]), r.copy(), H.reshape(m, n).copy())


def transition(entry: Entry) -> Array:
    """Phi (n, n) of a TRANSITION: what moves, and the coloured error that falls off."""
    Phi = np.eye(entry.n)
    content = entry.content[T.T_PHI :]
    if content.size == 9 * TOP:
        Phi[:9, :TOP] = content.reshape(9, TOP)
    else:
        Phi[np.ix_(_MOVING, _MOVING)] = content.reshape(telemetry.M, telemetry.M)
    for i in range(3):
        Phi[DGNSS + i, DGNSS + i] = entry.content[T.T_DECAY + i // 2]
    return Phi


def noise(entry: Entry) -> Array:
    """The covariance (n, n) of a NOISE."""
    n = entry.n
    if entry.content.size == n:
        return np.diag(entry.content)
    Q = np.zeros((n, n))
    Q[np.ix_(_MOVING, _MOVING)] = entry.content.reshape(telemetry.M, telemetry.M)
    return Q


def snapshot(entry: Entry) -> tuple[Array, Array]:
    """The state (HALF,) and the event (EVENT_WIDTH,) of a SNAPSHOT."""
    return entry.content[: L.HALF], entry.content[L.HALF :]
