"""Fixed-interval smoothing of a session: a second pass with checkpoints, then block by block from the last to the first.

The fold is deterministic, so what a backward pass needs is made again when it is needed: in memory is the tape of one block of events,
and what stands at the beginning of each block goes to a file where it becomes much.
"""

from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mavkf.ahead import Ahead
from mavkf.models.order import STATES_MOST
from mavkf.models.strapdown import DDELAY
from mavkf.navigation import layout as L
from mavkf.navigation import smoothing
from mavkf.navigation import tape as T
from mavkf.navigation.codes import SENSORS
from mavkf.navigation.fusing import SLOWEST_FOR_LEARNING
from mavkf.navigation.hindsight import Hindsight
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.spool import Spool

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
    progress: Callable[[float], object],
    slot: int = -1,
) -> Iterator[tuple[int, Array]]:
    """Give the pose rows of an offline run smoothed, block by block from the last to the first.

    Of each block the number of its first row, and the rows (n, POSE_WIDTH), a view that is used again. state: (STATE_SIZE,) as it was
    before the first event, is used up; c: parameters; progress: called with the share that is done; slot: output interval of the last
    row before.
    """
    c, delay = without_delay(state, c)
    held, faults = hindsight.held, hindsight.faults
    out = L.buffers(ROOM, ROOM, SENSORS)
    poses = np.empty((BLOCK, L.POSE_WIDTH))
    count = len(events)
    starts = range(0, count, BLOCK)
    with Spool(L.STATE_SIZE) as marks:  # state before each block
        slots, rows = [], [0]  # output interval before each block, and number of its first row
        for first in starts:
            marks.append(state[None])
            slots.append(slot)
            block = events.block(first, first + BLOCK)
            slot, made = smoothing.fold_block(state, block, slot, 0, c, rate_hz, held, faults, poses, out)
            rows.append(rows[-1] + made)
            progress(SECOND_PASS_SHARE * first / count)
        adjoint, Adjoint = np.zeros(STATES_MOST), np.zeros((STATES_MOST, STATES_MOST))

        def recorded() -> Iterator[tuple[int, Array, Array]]:
            """Number of a block, its tape and its pose rows, in turn on one of two tapes: from the last block to the first."""
            size = T.BEGIN + ENTRIES * BLOCK + SLACK
            places = [(L.buffers(ROOM, ROOM, SENSORS, size), np.empty((BLOCK, L.POSE_WIDTH))) for _ in range(2)]
            for k in reversed(range(len(starts))):
                out, poses = places[k % 2]
                state[:] = marks.block(k, k + 1)[0]
                block = events.block(starts[k], starts[k] + BLOCK)
                made = smoothing.fold_block(state, block, slots[k], 0, c, rate_hz, held, faults, poses, out)[1]
                yield k, out[5], poses[:made]

        with Ahead(recorded()) as blocks:
            for k, tape, poses in blocks:
                smoothing.sweep(tape, adjoint, Adjoint, poses, delay)
                yield rows[k], poses
                progress(1.0 - (1.0 - SECOND_PASS_SHARE) * starts[k] / count)
