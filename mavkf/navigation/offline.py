"""The estimator of one session of a log, in the order of measurement: timed sample rows in, block by block, outputs of the fold out.

    session = OfflineSession(config, rate_hz=50.0)
    for events in session.arrange(rows): ...              # rows in the order of arrival
    for events in session.arrange(rows, last=True): ...
    for output in session.fold(events): ...               # of each of these
    for first, poses in session.again(): ...              # smoothed, or of another form, where one was asked for

What is arranged may be ahead of what is folded, in another thread. Memory does not grow with the session: a second pass reads its events
from a temporary file. `run_offline` does all of it for rows at once.
"""

from collections.abc import Callable, Iterator
from contextlib import closing
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.config import Config
from mavkf.navigation import layout as L
from mavkf.navigation import timeline
from mavkf.navigation.codes import SENSORS
from mavkf.navigation.estimator import BUFFER, Output, SessionEstimator, joined
from mavkf.navigation.events import EventOrder
from mavkf.navigation.hindsight import Surprise, look_back
from mavkf.navigation.setup import Setup
from mavkf.navigation.spool import Spool
from mavkf.navigation.stated import late_words
from mavkf.samples import Source

if TYPE_CHECKING:
    from mavkf.navigation.any_form import FormRun

Array = NDArray[np.float64]


class OfflineSession:
    """Estimation of one session of a log, at most two passes over it."""

    def __init__(
        self,
        config: Config,
        rate_hz: float = 50.0,
        imu: Source | None = None,
        model: str | None = None,
        smoothing: bool = False,
        form: tuple[str, str] | None = None,
    ) -> None:
        """rate_hz, imu, model: as of `SessionEstimator`; smoothing: whether `again` smooths the pose rows by what came later.

        form: names of a form of `mavkf.filters` and an order, of whose filter `again` gives the pose rows instead.
        """
        self._decider = SessionEstimator(config, rate_hz, imu, model)
        self._smoothing, self._form = smoothing, form
        self._surprise = Surprise()
        self._notes: list[Array] = []
        self._slot = -1
        self.hindsight: tuple[str, ...] = ()
        """What smoothing made of the flight, in words."""
        self.form: FormRun | None = None
        """What the other form was."""

    @property
    def setup(self) -> Setup | None:
        """The set-up, once it is decided."""
        setup, late = self._decider.setup, self._decider.late_parameters
        if setup is None or not late:
            return setup
        return msgspec.structs.replace(setup, reasons=(*setup.reasons, late_words(late)))

    @property
    def state(self) -> Array:
        """(STATE_SIZE,) after the events that are folded."""
        return self._decider.state

    @property
    def parameters(self) -> Array:
        """What the fold is told (PARAMETERS,)."""
        return self._decider.parameters

    @property
    def has_sensor(self) -> bool:
        """Whether an IMU or GNSS sample has come: without one there is nothing to estimate."""
        return self._decider.has_sensor

    @property
    def has_second_pass(self) -> bool:
        """Whether `again` gives the pose rows that are wanted."""
        return self._smoothing or self._form is not None

    def arrange(self, rows: Array, *, last: bool = False) -> Iterator[Array]:
        """Take rows (n, ROW_WIDTH) in the order of arrival; give the events (m, EVENT_WIDTH) that can be folded now, in their order.

        last: nothing follows.
        """
        if self.setup is None:
            waited, rows = self._decider.decide(rows)
            if self.setup is None:
                if not last:
                    return
                waited = np.concatenate([waited, *self._decider.waiting])
                self._decider.start(waited)
            self._begin()
            self._tell_late(rows)
            rows = np.concatenate([waited, rows])
        else:
            self._tell_late(rows)
        yield from self._order.push(rows, last=last)

    def fold(self, events: Array) -> Iterator[Output]:
        """Fold events (n, EVENT_WIDTH) that `arrange` gave; the pose rows that come out are a view that is used again."""
        if self.has_second_pass:
            self._events.append(events)
        out = self._out
        i = 0
        while i < len(events):
            out[2][:] = 0
            i, n, self._slot = timeline.run_batch(
                self.state, events, i, self._slot, self.parameters, self._decider.rate, self._poses, out
            )
            output = Output(self._poses[:n], out[0][: out[2][0]].copy(), out[1][: out[2][1]].copy())
            if self._smoothing:
                self._surprise.take(output.innovations)
                self._notes.append(output.notes)
            yield output

    def again(self, progress: Callable[[float], object] = lambda _: None) -> Iterator[tuple[int, Array]]:
        """Go over the session once more, when it is finished: numbers of first rows, and pose rows (n, POSE_WIDTH) for those of before.

        They are a view that is used again. progress: called with the share that is done.
        """
        c, rate = self.parameters, self._decider.rate
        if self._form is not None:  # what few runs need is imported for them
            from mavkf.navigation.form_flight import FormFlight

            flight = FormFlight(self._start, self._events, c, rate, *self._form)
            row = 0
            for poses in flight.poses(progress):
                yield row, poses
                row += len(poses)
            self.form = flight.run
        elif self._smoothing:
            from mavkf.navigation.smoother import smooth

            notes = np.concatenate([np.empty((0, L.NOTE_WIDTH)), *self._notes])
            hindsight = look_back(self.state, c, self._surprise, notes)
            self.hindsight = hindsight.words
            yield from smooth(self._start, self._events, c, rate, hindsight, progress)

    def close(self) -> None:
        """Let go of what a second pass would read."""
        if self.setup is not None:
            self._events.close()

    def _tell_late(self, rows: Array) -> None:
        self._decider.late_parameters.update(self._decider.too_late(rows))

    def _begin(self) -> None:
        assert self._decider.setup is not None
        self._order = EventOrder(self._decider.setup, self._decider.config.timeline.window_s)
        self._events = Spool(L.EVENT_WIDTH)
        self._start = self.state.copy()
        self._out = L.buffers(16 * BUFFER, BUFFER, SENSORS)  # in order, no event is folded twice
        self._poses = np.empty((4 * BUFFER, L.POSE_WIDTH))


class Offline(msgspec.Struct):
    """An offline run: its set-up, what it wrote, the final state, the parameters.

    hindsight: what smoothing made of the flight, in words; form: what another form was, where it made the pose rows.
    """

    setup: Setup
    output: Output
    state: Array
    parameters: Array
    hindsight: tuple[str, ...] = ()
    form: "FormRun | None" = None


def run_offline(
    rows: Array,
    config: Config,
    rate_hz: float = 50.0,
    imu: Source | None = None,
    model: str | None = None,
    smoothing: bool = False,
    form: tuple[str, str] | None = None,
) -> Offline:
    """Estimate a session from all its rows (n, ROW_WIDTH; in the order of arrival, of any age). Arguments as of `OfflineSession`."""
    with closing(OfflineSession(config, rate_hz, imu, model, smoothing, form)) as session:
        parts = [
            Output(output.poses.copy(), output.innovations, output.notes)
            for events in session.arrange(rows, last=True)
            for output in session.fold(events)
        ]
        output = joined(parts)
        for first, poses in session.again():
            output.poses[first : first + len(poses)] = poses
    assert session.setup is not None
    return Offline(session.setup, output, session.state, session.parameters, session.hindsight, session.form)
