"""The estimator of one session of one vehicle: timed sample rows in, pose rows, innovations and notes out.

    estimator = SessionEstimator(config, rate_hz=50.0)
    for output in estimator.push(rows): ...      # live: rows in the order of arrival, as they come
    for output in estimator.finish(): ...        # what was still waiting for the set-up

or, offline, `run_offline(rows, config)`: the same events in the order in which they were measured, in one go.
"""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import link_apart
from mavkf.config import Config
from mavkf.navigation import layout as L
from mavkf.navigation import timeline
from mavkf.navigation.codes import SENSORS
from mavkf.navigation.events import Arrivals, SortedEvents
from mavkf.navigation.parameter import PARAMETERS
from mavkf.navigation.propagation import begin
from mavkf.navigation.setup import Setup, choose, parameters
from mavkf.samples import KIND, TIME, Kind, Source

if TYPE_CHECKING:
    from mavkf.navigation.any_form import FormRun
    from mavkf.navigation.fixed_lag import FixedLag

Array = NDArray[np.float64]
LONGEST_SETUP = 4  # times the set-up time, where no IMU is heard
HISTORY = 16_384  # events kept for late ones: five seconds at 3 kHz
BUFFER = 1_024
FORWARD_SHARE = 0.3  # of the work of a run with a second pass
BLOCK = 16_384  # events of an offline run that are made at once
EARLY = 256  # rows kept from before the first sensor's


class Output(msgspec.Struct):
    """What a run wrote: pose rows (n, POSE_WIDTH), innovation rows (n, INNOVATION_WIDTH), notes (n, NOTE_WIDTH)."""

    poses: Array
    innovations: Array
    notes: Array


class SessionEstimator:
    """Live estimation of one session: bounded memory, the same outputs however the rows are cut into calls."""

    def __init__(
        self,
        config: Config,
        rate_hz: float = 50.0,
        imu: Source | None = None,
        model: str | None = None,
        lag_s: float = 0.0,
    ) -> None:
        """rate_hz: poses a second of boot time (0: every IMU sample); imu, model: forced choices, as of `choose`.

        lag_s: for `smoothed`, s; 0: nothing is smoothed.
        """
        link_apart()
        self.config, self.rate, self.imu, self.model = config, rate_hz, imu, model
        self.setup: Setup | None = None
        self.state = np.empty(L.STATE_SIZE)
        self.parameters: Array = np.zeros(PARAMETERS)
        self._lag = lag_s
        self._arrivals: Arrivals | None = None
        self._lagging: FixedLag | None = None
        self._waiting: list[Array] = []
        self._first_sensor = np.nan

    @property
    def late(self) -> int:
        """Events dropped because they were older than the window."""
        return 0 if self._arrivals is None else int(self._cursor[timeline.LATE])

    def push(self, rows: Array) -> Iterator[Output]:
        """Take rows (n, ROW_WIDTH) in the order of arrival; yields outputs as they arise, none while the set-up is open."""
        if self.setup is None:
            waited, rows = self._decide(rows)
            if self.setup is None:
                return
            for output in self._run(waited):
                # they are as old as the set-up is long: nobody would want them now, in a burst
                output.poses = output.poses[:0]
                yield output
        yield from self._run(rows)

    def finish(self) -> Iterator[Output]:
        """Decide the set-up with what there is, if it is still open, and run what waited."""
        if self.setup is None and self._waiting:
            waiting = np.concatenate(self._waiting)
            self._waiting = []
            self._start(waiting)
            yield from self._run(waiting)

    def smoothed(self, now: float) -> Array:
        """Pose rows (n, POSE_WIDTH) that the lag makes due at boot time `now` (s), smoothed by what came after them; `now` never falls."""
        return np.empty((0, L.POSE_WIDTH)) if self._lagging is None else self._lagging.rows(now)

    @property
    def has_sensor(self) -> bool:
        """Whether an IMU or GNSS sample has come: without one there is nothing to estimate."""
        return bool(np.isfinite(self._first_sensor))

    def _decide(self, rows: Array) -> tuple[Array, Array]:
        """Keep rows until the set-up's time is over; returns those that waited for it, once it is, and those that came after."""
        for i in range(rows.shape[0]):
            row = rows[i]
            if not self.has_sensor:
                if row[KIND] not in (Kind.IMU, Kind.GNSS):
                    continue
                self._first_sensor = row[TIME]
                # what came long before the first sensor says nothing about it
                before = np.concatenate([*self._waiting, rows[:i]])
                self._waiting = [before[-EARLY:]]
                return self._decide(rows[i:])
            if row[TIME] - self._first_sensor >= self.config.timeline.setup_s:
                seen = np.concatenate([*self._waiting, rows[: i + 1]])
                patient = row[TIME] - self._first_sensor < LONGEST_SETUP * self.config.timeline.setup_s
                if patient and not np.any(seen[:, KIND] == Kind.IMU):
                    continue
                self._waiting = []
                self._start(seen)
                return seen, rows[i + 1 :]
        self._waiting.append(rows.copy())
        if not self.has_sensor:
            self._waiting = [np.concatenate(self._waiting)[-EARLY:]]
        return rows[:0], rows[:0]

    def _start(self, seen: Array) -> None:
        self.setup = choose(seen, self.config, self.imu, self.model)
        self.parameters = parameters(self.config, self.setup)
        begin(self.state, self.parameters)
        if self._lag > 0.0:
            from mavkf.navigation.fixed_lag import FixedLag  # what few services need is imported for them

            self._lagging = FixedLag(self.state, self.parameters, self.rate, self._lag)

    def _allocate(self) -> None:
        self._events, self._snapshots, self._cursor, self._marks = timeline.history(HISTORY)
        self._out = L.buffers(BUFFER, BUFFER, SENSORS * HISTORY)
        self._poses = np.empty((BUFFER, L.POSE_WIDTH))

    def _run(self, rows: Array) -> Iterator[Output]:
        assert self.setup is not None
        if self._arrivals is None:
            self._arrivals = Arrivals(self.setup)
            self._allocate()
        events = self._arrivals.events(rows)
        if self._lagging is not None:
            self._lagging.take(events)
        i = 0
        innovations, notes, counts = self._out[:3]
        while i < events.shape[0]:
            counts[:] = 0
            i, n = timeline.run_live(
                self.state,
                events,
                i,
                self.parameters,
                self.rate,
                self.config.timeline.window_s,
                self._events,
                self._snapshots,
                self._cursor,
                self._marks,
                self._poses,
                self._out,
            )
            yield Output(self._poses[:n].copy(), innovations[: counts[0]].copy(), notes[: counts[1]].copy())


def fold_counts(state: Array) -> dict[str, int]:
    """What a state has counted: repeated values, fixes without a position, gaps of the IMU."""
    return {
        "repeated": int(state[L.DUPLICATES]),
        "implausible": int(state[L.IMPLAUSIBLE]),
        "without_fix": int(state[L.NO_FIX]),
        "imu_gaps": int(state[L.GAP_COUNT]),
    }


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
    progress: Callable[[float], object] | None = None,
    smoothing: bool = False,
    form: tuple[str, str] | None = None,
) -> Offline:
    """Fold a session's rows (n, ROW_WIDTH; in the order of arrival) in the order in which they were measured.

    progress: called with the share that is done, now and then; smoothing: whether the pose rows are smoothed by what came later;
    form: names of a form of `mavkf.filters` and an order, whose pose rows are wanted instead (then not smoothed).
    """
    decider = SessionEstimator(config, rate_hz, imu, model)
    decider._decide(rows)
    if decider.setup is None:
        decider._start(rows)
    setup = decider.setup
    assert setup is not None
    c = decider.parameters
    events = SortedEvents(rows, setup)
    state = decider.state
    start = state.copy()
    part = progress or (lambda _: None)
    share = FORWARD_SHARE if smoothing or form else 1.0
    out = L.buffers(16 * BUFFER, BUFFER, SENSORS)  # in order, no event is folded twice
    poses = np.empty((len(events), L.POSE_WIDTH))  # most of it is never touched, where rows are thinned
    parts: list[Output] = []
    count, slot = 0, -1
    for first in range(0, len(events), BLOCK):
        block = events.block(first, first + BLOCK)
        i = 0
        while i < block.shape[0]:
            out[2][:] = 0
            i, n, slot = timeline.run_batch(state, block, i, slot, c, rate_hz, poses[count:], out)
            count += n
            parts.append(Output(poses[:0], out[0][: out[2][0]].copy(), out[1][: out[2][1]].copy()))
        part(share * min(1.0, (first + BLOCK) / len(events)))
    output = joined(parts)
    output.poses = poses[:count]
    words: tuple[str, ...] = ()
    flown: FormRun | None = None

    def second(done: float) -> object:
        return part(share + (1.0 - share) * done)

    if form is not None:  # what few runs need is imported for them
        from mavkf.navigation.form_flight import fly

        flown = fly(start, events, c, rate_hz, *form, output.poses, second)
    elif smoothing:
        from mavkf.navigation.hindsight import look_back
        from mavkf.navigation.smoother import smooth

        hindsight = look_back(state, output.innovations, output.notes)
        words = hindsight.words
        smooth(start, events, c, rate_hz, hindsight, output.poses, second)
    return Offline(setup, output, state, c, words, flown)


def joined(parts: list[Output]) -> Output:
    """One output of several, in order."""
    if not parts:
        return Output(np.empty((0, L.POSE_WIDTH)), np.empty((0, L.INNOVATION_WIDTH)), np.empty((0, L.NOTE_WIDTH)))
    return Output(
        np.concatenate([part.poses for part in parts]),
        np.concatenate([part.innovations for part in parts]),
        np.concatenate([part.notes for part in parts]),
    )
