"""A flight in another form and order: a second pass of the fold with a tape in detail, block by block, and `any_form` along it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mavkf.navigation import layout as L
from mavkf.navigation import tape as T
from mavkf.navigation.any_form import AnyForm, FormRun
from mavkf.navigation.codes import SENSORS
from mavkf.navigation.events import SortedEvents
from mavkf.navigation.smoothing import fold_block

Array = NDArray[np.float64]
BLOCK = 64  # events
ENTRIES = 12_000  # numbers on the tape for an event: two transitions, three corrections, a state kept
SLACK = 400_000  # and for once: a gap is crossed in up to a hundred steps, up to PENDING_CAPACITY events wait
ROOM = 512  # rows of what one event tells, which the first pass has told


def fly(
    state: Array,
    events: SortedEvents,
    c: Array,
    rate_hz: float,
    form: str,
    order: str,
    poses: Array,
    progress: Callable[[float], object],
) -> FormRun:
    """Replace the pose rows (n, POSE_WIDTH) of an offline run by those of another form and order.

    state: (STATE_SIZE,) as it was before the first event, is used up; c: parameters; progress: called with the share that is done. Raises
    UsageError for a form or an order that there is not.
    """
    out = L.buffers(ROOM, ROOM, SENSORS, T.BEGIN + ENTRIES * BLOCK + SLACK)
    out[5][T.MODE] = T.DETAILED
    filter_ = AnyForm(form, order, L.covariance(state).copy(), c)
    nothing_held, no_faults = np.empty((0, 2)), np.empty((0, 3))
    slot, row, count = -1, 0, len(events)
    for first in range(0, count, BLOCK):
        block = events.block(first, first + BLOCK)
        slot, row = fold_block(state, block, slot, row, c, rate_hz, nothing_held, no_faults, poses, out)
        filter_.follow(out[5], poses)
        progress(first / count)
    return filter_.run
