"""One vehicle of a log: its sample rows in, block by block; its sessions out. Offline and as live."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import MavkfError
from mavkf.link.clocks import VehicleClock
from mavkf.navigation import layout as L
from mavkf.navigation.estimator import Output, SessionEstimator, fold_counts, joined
from mavkf.navigation.offline import OfflineSession
from mavkf.navigation.spool import Spool
from mavkf.replay.boot_clock import boot_times, by_session
from mavkf.replay.faults import apply_faults
from mavkf.replay.options import Options, Watch
from mavkf.replay.results import SessionResult
from mavkf.replay.tally import Tally
from mavkf.samples import KIND, ROW_WIDTH, Kind
from mavkf.service.senders import is_vehicle
from mavkf.service.vehicle import VehicleStream, state_counts, within

Array = NDArray[np.float64]
BLOCK = 4096  # pose rows that are read again at once


class Past:
    """What has gone by of one session: its tally, and all of it where that is to be kept."""

    def __init__(self, *, keep: bool) -> None:
        """Nothing has come yet."""
        self.tally = Tally()
        self._keep = keep
        self._rows: list[Array] = []
        self._outputs: list[Output] = []

    @property
    def rows(self) -> Array:
        """Timed sample rows (n, ROW_WIDTH) that were kept."""
        return np.concatenate([np.empty((0, ROW_WIDTH)), *self._rows])

    @property
    def output(self) -> Output:
        """What was kept of what the fold wrote."""
        return joined(self._outputs)

    def take_rows(self, rows: Array) -> None:
        """Take timed sample rows (n, ROW_WIDTH)."""
        self.tally.take_rows(rows)
        if self._keep:
            self._rows.append(rows)

    def take(self, output: Output) -> None:
        """Take what the fold wrote."""
        self.tally.take(output)
        if self._keep:
            self._outputs.append(Output(output.poses.copy(), output.innovations, output.notes))


@dataclass(frozen=True)
class Flight:
    """A session of a log while it is estimated."""

    number: int
    session: OfflineSession
    past: Past


Work = Callable[[], object]
"""What is still to be done about rows that are prepared: in the thread that estimates, in order."""


class OfflineRun:
    """The sessions of one vehicle, each in the order of measurement."""

    def __init__(self, name: str, options: Options, watch: Watch, *, keep: bool) -> None:
        """name: of the vehicle; the rest as of `VehicleRun`."""
        self._name, self._options, self._watch, self._keep = name, options, watch, keep
        self._number = -1
        self._flight: Flight | None = None
        self._open: set[OfflineSession] = set()
        self._results: list[SessionResult] = []

    def prepare(self, _: Array, timed: Array, *, last: bool) -> Iterator[Work]:
        """Take rows (n, ROW_WIDTH), and what the boot clock made of them."""
        for number, rows in by_session(timed):
            if number != self._number:
                yield from self._end()
                self._number = number
                self._flight = self._begin(number) if self._options.session in (None, number) else None
            if self._flight is not None:
                self._flight.past.take_rows(rows)
                yield from self._arrange(self._flight, rows)
        if last:
            yield from self._end()

    def finish(self) -> list[SessionResult]:
        """The sessions, when nothing follows."""
        return self._results

    def close(self) -> None:
        """Let go of temporary files."""
        for session in self._open:
            session.close()

    def _begin(self, number: int) -> Flight:
        o = self._options
        session = OfflineSession(o.config, o.rate_hz, o.imu, o.model, o.smooth, o.other_filter)
        self._open.add(session)
        return Flight(number, session, Past(keep=self._keep))

    def _arrange(self, flight: Flight, rows: Array, *, last: bool = False) -> Iterator[Work]:
        for events in flight.session.arrange(rows, last=last):
            yield partial(self._fold, flight, events)

    def _end(self) -> Iterator[Work]:
        flight = self._flight
        self._flight = None
        if flight is None:
            return
        if flight.session.has_sensor:
            yield from self._arrange(flight, np.empty((0, ROW_WIDTH)), last=True)
            yield partial(self._finish, flight)
        else:
            self._open.discard(flight.session)

    def _fold(self, flight: Flight, events: Array) -> None:
        for output in flight.session.fold(events):
            flight.past.take(output)
            if self._watch.poses is not None and not flight.session.has_second_pass:
                self._watch.poses(self._name, flight.number, output.poses)

    def _finish(self, flight: Flight) -> None:
        session, past = flight.session, flight.past
        past.tally.finish()
        output = past.output
        if session.has_second_pass:
            self._second_pass(flight, output)
        session.close()
        self._open.discard(session)
        assert session.setup is not None
        self._results.append(
            SessionResult(
                self._name,
                flight.number,
                session.setup,
                past.tally,
                past.rows,
                output,
                fold_counts(session.state),
                session.state,
                session.parameters,
                session.hindsight,
                session.form,
            )
        )

    def _second_pass(self, flight: Flight, output: Output) -> None:
        """Put the pose rows of the second pass in the place of the first's, and give them out in order."""
        with Spool(L.POSE_WIDTH) as made:
            for first, poses in flight.session.again(lambda share: self._watch.progress("second pass", share)):
                made.put(first, poses)
            for first in range(0, len(made), BLOCK):
                poses = made.block(first, first + BLOCK)
                if self._keep:
                    output.poses[first : first + len(poses)] = poses
                if self._watch.poses is not None:
                    self._watch.poses(self._name, flight.number, poses)
                flight.past.tally.end = poses[-1]


class LiveRun:
    """The sessions of one vehicle, in the order of arrival, as the service has them."""

    def __init__(self, name: str, options: Options, watch: Watch, *, keep: bool) -> None:
        """name: of the vehicle; the rest as of `VehicleRun`."""
        self._name, self._options, self._watch, self._keep = name, options, watch, keep
        self._stream = VehicleStream(name, options.config, options.rate_hz, options.imu, options.model, options.span)
        self._past: dict[int, Past] = {}
        self._ends: dict[int, SessionEstimator] = {}

    def finish(self) -> list[SessionResult]:
        """The sessions, when nothing follows."""
        return [self._result(number, end) for number, end in self._ends.items()]

    def prepare(self, rows: Array, timed: Array, *, last: bool) -> Iterator[Work]:
        """Take rows (n, ROW_WIDTH), and what the boot clock made of them."""
        for number, mine in by_session(timed):
            if self._options.session in (None, number):
                self._past.setdefault(number, Past(keep=self._keep)).take_rows(mine)
        yield partial(self._push, rows, last)

    def close(self) -> None:
        """Nothing is open."""

    def _push(self, rows: Array, last: bool) -> None:
        stream = self._stream
        for step in chain(stream.push(rows), stream.finish() if last else ()):
            if step.session not in self._past:
                continue
            self._past[step.session].take(step.output)
            estimator = stream.estimator
            if estimator is not None and estimator.setup is not None and step.session == stream.session:
                self._ends[step.session] = estimator
            if self._watch.step is not None:
                self._watch.step(stream, step)
            if self._watch.poses is not None:
                self._watch.poses(self._name, step.session, step.output.poses)

    def _result(self, number: int, end: SessionEstimator) -> SessionResult:
        past = self._past[number]
        past.tally.finish()
        assert end.setup is not None
        return SessionResult(
            self._name,
            number,
            end.setup,
            past.tally,
            past.rows,
            past.output,
            state_counts(end),
            end.state,
            end.parameters,
        )


class VehicleRun:
    """The replay of one sender's rows. Whether it is a vehicle is known at the end, and so is what was wrong with it.

    What `prepare` does, and the work that it gives, may be done by two threads, the first ahead of the other.
    """

    def __init__(self, name: str, options: Options, watch: Watch, *, keep: bool, wanted: bool) -> None:
        """name: as in keys; keep: whether rows and outputs are wanted at the end; wanted: whether anything is to be estimated."""
        self.name = name
        self._options, self._wanted = options, wanted
        self._window = options.config.timeline.window_s
        self.clock = VehicleClock(self._window)
        self._run = (LiveRun if options.as_live else OfflineRun)(name, options, watch, keep=keep)
        self._rows: list[Array] = []  # where faults are to be put into them: their places are known at the end
        self._has_sensor = False
        self._said: bool | None = None
        self._error: MavkfError | None = None

    @property
    def is_vehicle(self) -> bool:
        """Whether it has sent IMU or GNSS samples and has not said that it is something else only."""
        return self._has_sensor and self._said is not False

    def prepare(self, rows: Array) -> list[Work]:
        """Take decoded rows (n, ROW_WIDTH) in the order of arrival; give what is to be done about them."""
        self._has_sensor = self._has_sensor or bool(np.isin(rows[:, KIND], (Kind.IMU, Kind.GNSS)).any())
        said = is_vehicle(rows)
        self._said = said if self._said is None else self._said or bool(said)
        if not self._wanted:
            return []
        if self._options.faults:
            self._rows.append(rows)
            return []
        if self._options.as_live and self._said is False:  # the service does not follow it either
            return []
        return self._prepare(rows)

    def work(self, works: Iterable[Work]) -> None:
        """Do what is to be done."""
        try:
            for each in works if self._error is None else ():
                each()
        except MavkfError as error:
            if self._said:
                raise
            self._error = error  # a forced choice that it cannot serve: this may be no vehicle

    def finish(self) -> list[SessionResult]:
        """Take it that nothing follows; give the sessions. Raises UsageError where a forced choice cannot be served."""
        rows = np.concatenate([np.empty((0, ROW_WIDTH)), *self._rows])
        if self._options.faults:
            rows = apply_faults(rows, self._options.faults, boot_times(rows, self._window))
        self.work(self._prepare(rows, last=True))
        if self._error is not None:
            raise self._error
        return self._run.finish()

    def close(self) -> None:
        """Let go of temporary files."""
        self._run.close()

    def _prepare(self, rows: Array, *, last: bool = False) -> list[Work]:
        timed = self.clock.push(rows)
        if last:
            timed = np.concatenate([timed, self.clock.flush()])
        works: list[Work] = []
        try:
            works.extend(self._run.prepare(rows, within(timed, self._options.span), last=last))
        except MavkfError as error:
            self._error = self._error or error
        return works
