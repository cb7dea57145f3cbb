"""Fixed-interval smoothing of a session: checkpoints forward, then block by block from the last to the first.

The fold is deterministic, so what a backward pass needs is made again when it is needed: memory grows with a checkpoint for each
BLOCK of events and with the tape of one block, not with the states times the steps.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mavkf.navigation import layout as L
from mavkf.navigation import smoothing
from mavkf.navigation import tape as T
from mavkf.navigation.codes import SENSORS

Array = NDArray[np.float64]
BLOCK = 1024  # events
ENTRIES = 3_000  # numbers on the tape for an event and its pose
SLACK = 65_536  # and for once: a gap is crossed in up to a hundred steps
ROOM = 512  # rows of what one event tells, which is told by the first pass


def smooth(
    state: Array,
    events: Array,
    c: Array,
    rate_hz: float,
    poses: Array,
    progress: Callable[[float], object] | None = None,
) -> None:
    """Replace the pose rows (n, POSE_WIDTH) of an offline run by smoothed ones.

    state: (STATE_SIZE,) as it was before the first event; events: (m, EVENT_WIDTH), sorted; c: parameters; progress: called with the
    share that is done.
    """
    marks: list[tuple[Array, int, int]] = []  # state, output interval and pose row before each block
    slot, row = -1, 0
    silent = L.buffers(ROOM, ROOM, SENSORS)
    starts = range(0, events.shape[0], BLOCK)
    for first in starts:
        marks.append((state[: L.STATE_SIZE if state[L.SECOND] else L.HALF].copy(), slot, row))
        last = min(first + BLOCK, events.shape[0])
        slot, row = smoothing.fold_block(state, events, first, last, slot, row, c, rate_hz, poses, silent)
    out = L.buffers(ROOM, ROOM, SENSORS, T.BEGIN + ENTRIES * BLOCK + SLACK)
    adjoint, Adjoint = np.zeros(L.STATES_MOST), np.zeros((L.STATES_MOST, L.STATES_MOST))
    for first in reversed(starts):
        mark, slot, row = marks.pop()
        state[:] = 0.0
        state[: mark.size] = mark
        last = min(first + BLOCK, events.shape[0])
        smoothing.fold_block(state, events, first, last, slot, row, c, rate_hz, poses, out)
        smoothing.sweep(out[5], adjoint, Adjoint, poses)
        if progress is not None:
            progress(1.0 - first / events.shape[0])
