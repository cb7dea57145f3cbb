"""Orders beyond the first for measurements of the fold: h and H at other points than its estimate, by `probe`.

Points are error states about the fold's estimate, x boxplus delta. A Jacobian of the fold is by a turn on the left of where it stands; by
delta it is H J(delta), where exp(delta + e) = exp(J e) exp(delta) (J the left Jacobian of SO(3): Sola, Deray and Atchuthan, "A micro Lie
theory for state estimation in robotics", arXiv:1812.01537, eq. 145).

Hessians are central differences of that Jacobian, made symmetric, with a step of STEP sigma of each state: what they are for are moments
over a few sigma. h is quadratic over such a step but for 1 % of what the second order is worth.
"""

import numpy as np
from numpy.typing import NDArray

from mavkf.models.rotation import quaternion_exp, quaternion_log, quaternion_product
from mavkf.navigation import layout as L
from mavkf.navigation import tape as T
from mavkf.navigation.codes import SENSORS
from mavkf.navigation.probe import probe
from mavkf.navigation.tape_reader import Probe, entries, probe_of

Array = NDArray[np.float64]
STEP = 0.1  # sigma
ROOM = 64  # probes of one event, numbers of each below
SMALL = 1e-6  # rad


def composed(first: Array, then: Array) -> Array:
    """The error state of moving by `first` (n,) and after it by `then` (n,): turns are composed, all else is a sum."""
    a, b, q, total = np.empty(4), np.empty(4), np.empty(4), first + then
    quaternion_exp(first[0], first[1], first[2], a)
    quaternion_exp(then[0], then[1], then[2], b)
    quaternion_product(b, a, q)
    quaternion_log(q, total[:3])
    return np.asarray(total)


def left_jacobian(theta: Array) -> Array:
    """J (3, 3) of a rotation vector theta (3,), rad: exp(theta + e) = exp(J e) exp(theta)."""
    x, y, z = theta
    W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = float(np.linalg.norm(theta))
    if angle < SMALL:
        return np.asarray(np.eye(3) + 0.5 * W)
    return np.asarray(np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * W + (angle - np.sin(angle)) / angle**3 * (W @ W))


class Measurement:
    """The measurement of one event: what it is at any point, whichever of its vectors is asked for."""

    def __init__(self, state: Array, event: Array, c: Array) -> None:
        """state: (HALF,) as the measurement found it; event: (EVENT_WIDTH,); c: parameters."""
        self._state, self._event, self._c = state.copy(), event.copy(), c
        self._copy = np.empty(L.HALF)
        n = int(state[L.STATES])
        self._out = L.buffers(ROOM, ROOM, SENSORS, T.BEGIN + ROOM * 4 * (n + 8))
        self.moved = np.zeros(n)
        """What the fold has corrected since (n,)."""
        self._used: dict[tuple[int, int], int] = {}

    def next(self, sensor: int, m: int) -> int:
        """Which of the vectors of this sensor and size comes now."""
        key = sensor, m
        self._used[key] = self._used.get(key, -1) + 1
        return self._used[key]

    def at(self, delta: Array, sensor: int, m: int, number: int) -> Probe | None:
        """r (m,) and H (m, n) by delta at the fold's present estimate moved by delta (n,); None where nothing would be fused there."""
        probe(self._state, self._event, self._c, composed(self.moved, delta), self._copy, self._out)
        found = [
            vector
            for vector in map(probe_of, filter(lambda entry: entry.kind == T.PROBE, entries(self._out[5])))
            if vector.sensor == sensor and len(vector.r) == m
        ]
        if number >= len(found) or found[number].H.shape[1] != len(delta):
            return None
        here = found[number]
        here.H[:, :3] = here.H[:, :3] @ left_jacobian(delta[:3])
        return here

    def hessians(self, delta: Array, sigma: Array, sensor: int, m: int, number: int) -> Array:
        """Hessians (m, n, n) at delta (n,), for errors of size sigma (n,); zero by a state that is known exactly."""
        n = len(delta)
        found = np.zeros((m, n, n))
        for j in np.flatnonzero(sigma > 0.0):
            step = np.zeros(n)
            step[j] = STEP * sigma[j]
            ahead, behind = (self.at(delta + way * step, sensor, m, number) for way in (1.0, -1.0))
            if ahead is not None and behind is not None:
                found[:, :, j] = (ahead.H - behind.H) / (2.0 * step[j])
        return np.asarray(0.5 * (found + found.transpose(0, 2, 1)))
