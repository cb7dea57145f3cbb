"""A flight in another form and order: a second pass of the fold with a tape in detail, block by block, and `any_form` along it."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from mavkf.navigation import layout as L
from mavkf.navigation import tape as T
from mavkf.navigation.any_form import AnyForm, FormRun
from mavkf.navigation.codes import SENSORS
from mavkf.navigation.smoother import Events
from mavkf.navigation.smoothing import fold_block

Array = NDArray[np.float64]
BLOCK = 64  # events
ENTRIES = 12_000  # numbers on the tape for an event: two transitions, three corrections, a state kept
SLACK = 400_000  # and for once: a gap is crossed in up to a hundred steps, up to PENDING_CAPACITY events wait
ROOM = 512  # rows of what one event tells, which the first pass has told


class FormFlight:
    """A flight in a form and order: `run` says what it has cost so far."""

    def __init__(self, state: Array, events: Events, c: Array, rate_hz: float, form: str, order: str) -> None:
        """state: (STATE_SIZE,) as it was before the first event, is used up; c: parameters.

        Raises UsageError for a form or an order that there is not.
        """
        self._state, self._events, self._c, self._rate = state, events, c, rate_hz
        self._filter = AnyForm(form, order, L.covariance(state).copy(), c)

    @property
    def run(self) -> FormRun:
        """What it has been so far."""
        return self._filter.run

    def poses(self, progress: Callable[[float], object]) -> Iterator[Array]:
        """Its pose rows (n, POSE_WIDTH), in order, a view that is used again. progress: called with the share that is done."""
        out = L.buffers(ROOM, ROOM, SENSORS, T.BEGIN + ENTRIES * BLOCK + SLACK)
        out[5][T.MODE] = T.DETAILED
        nothing_held, no_faults = np.empty((0, 2)), np.empty((0, 3))
        poses = np.empty((BLOCK, L.POSE_WIDTH))
        slot, count = -1, len(self._events)
        for first in range(0, count, BLOCK):
            block = self._events.block(first, first + BLOCK)
            slot, made = fold_block(
                self._state, block, slot, 0, self._c, self._rate, nothing_held, no_faults, poses, out
            )
            self._filter.follow(out[5], poses)
            yield poses[:made]
            progress(first / count)
