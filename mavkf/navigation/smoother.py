"""Fixed-interval smoothing of a session: a second pass with checkpoints, then block by block from the last to the first.

The fold is deterministic, so what a backward pass needs is made again when it is needed: memory grows by a checkpoint for each
BLOCK of events and has the tape of one block, not the states times the steps.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mavkf.models.strapdown import DDELAY
from mavkf.models.vehicle_class import STATES_MOST
from mavkf.navigation import layout as L
from mavkf.navigation import smoothing
from mavkf.navigation import tape as T
from mavkf.navigation.codes import SENSORS
from mavkf.navigation.fusing import SLOWEST_FOR_LEARNING
from mavkf.navigation.hindsight import Hindsight
from mavkf.navigation.parameter import Parameter

Array = NDArray[np.float64]
BLOCK = 1024  # events
ENTRIES = 3_000  # numbers on the tape for an event and its pose
SLACK = 65_536  # and for once: a gap is crossed in up to a hundred steps
ROOM = 512  # rows of what one event tells, which the first pass has told
SECOND_PASS_SHARE = 0.3  # of the work


class Events(Protocol):
    """Events in the order of measurement."""

    def __len__(self) -> int: ...

    def block(self, first: int, last: int) -> Array:
        """Events first..last (m, EVENT_WIDTH)."""


def without_delay(state: Array, c: Array) -> tuple[Array, float]:
    """Take the GNSS delay out of a state before its first event, where a smoother must not estimate it; give parameters, and sigma (s).

    The filter does not estimate the delay with a slow IMU, which shows its own aliasing instead.
    """
    if c[Parameter.IMU_PERIOD] <= SLOWEST_FOR_LEARNING:
        return c, 0.0
    c = c.copy()
    c[Parameter.DELAY_WALK] = 0.0
    L.covariance(state)[DDELAY, DDELAY] = 0.0
    return c, float(c[Parameter.DELAY])


def smooth(
    state: Array,
    events: Events,
    c: Array,
    rate_hz: float,
    hindsight: Hindsight,
    poses: Array,
    progress: Callable[[float], object],
    slot: int = -1,
) -> None:
    """Replace the pose rows (n, POSE_WIDTH) of an offline run by smoothed ones.

    state: (STATE_SIZE,) as it was before the first event, is used up; c: parameters; progress: called with the share that
    is done; slot: output interval of the last row before.
    """
    c, delay = without_delay(state, c)
    held, faults = hindsight.held, hindsight.faults
    marks: list[tuple[Array, int, int]] = []  # state, output interval and pose row before each block
    row = 0
    out = L.buffers(ROOM, ROOM, SENSORS)
    count = len(events)
    starts = range(0, count, BLOCK)
    for first in starts:
        marks.append((state[: L.STATE_SIZE if state[L.SECOND] else L.HALF].copy(), slot, row))
        block = events.block(first, first + BLOCK)
        slot, row = smoothing.fold_block(state, block, slot, row, c, rate_hz, held, faults, poses, out)
        progress(SECOND_PASS_SHARE * first / count)
    out = L.buffers(ROOM, ROOM, SENSORS, T.BEGIN + ENTRIES * BLOCK + SLACK)
    adjoint, Adjoint = np.zeros(STATES_MOST), np.zeros((STATES_MOST, STATES_MOST))
    for first in reversed(starts):
        mark, slot, row = marks.pop()
        state[:] = 0.0
        state[: mark.size] = mark
        smoothing.fold_block(state, events.block(first, first + BLOCK), slot, row, c, rate_hz, held, faults, poses, out)
        smoothing.sweep(out[5], adjoint, Adjoint, poses, delay)
        progress(1.0 - (1.0 - SECOND_PASS_SHARE) * first / count)
