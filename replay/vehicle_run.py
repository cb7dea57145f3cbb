"""One vehicle of a log: its sample rows in, block by block; its sessions out. Offline and as live."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import MavkfError
from mavkf.link.clocks import VehicleClock
from mavkf.navigation import layout as L
from mavkf.navigation.estimator import Output, SessionEstimator, fold_counts, joined
from mavkf.navigation.offline import OfflineSession
from mavkf.navigation.spool import Spool
from mavkf.replay.boot_clock import boot_times
from mavkf.replay.faults import apply_faults
from mavkf.replay.options import Options, Watch
from mavkf.replay.results import SessionResult
from mavkf.replay.tally import Tally
from mavkf.samples import KIND, ROW_WIDTH, SESSION, Kind
from mavkf.service.senders import is_vehicle
from mavkf.service.vehicle import Step, VehicleStream, state_counts, within

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
            self._rows.append(rows.copy())

    def take(self, output: Output) -> None:
        """Take what the fold wrote."""
        self.tally.take(output)
        if self._keep:
            self._outputs.append(Output(output.poses.copy(), output.innovations, output.notes))


class OfflineRun:
    """The sessions of one vehicle, each in the order of measurement."""

    def __init__(self, name: str, options: Options, watch: Watch, *, keep: bool) -> None:
        """name: of the vehicle; the rest as of `VehicleRun`."""
        self._name, self._options, self._watch, self._keep = name, options, watch, keep
        self._number = -1
        self._session: OfflineSession | None = None
        self._past = Past(keep=keep)
        self._results: list[SessionResult] = []

    def push(self, _: Array, timed: Array) -> None:
        """Take rows (n, ROW_WIDTH), and what the boot clock made of them."""
        for number, rows in by_session(timed):
            if number != self._number:
                self._end()
                self._number = number
                self._session = self._begin() if self._options.session in (None, number) else None
            if self._session is not None:
                self._past.take_rows(rows)
                self._take(self._session, self._session.push(rows))

    def finish(self, timed: Array) -> list[SessionResult]:
        """Take what the boot clock had held back, and that nothing follows."""
        self.push(timed, timed)
        self._end()
        return self._results

    def close(self) -> None:
        """Let go of temporary files."""
        if self._session is not None:
            self._session.close()

    def _begin(self) -> OfflineSession:
        self._past = Past(keep=self._keep)
        o = self._options
        return OfflineSession(o.config, o.rate_hz, o.imu, o.model, o.smooth, o.other_filter)

    def _take(self, session: OfflineSession, outputs: Iterator[Output]) -> None:
        for output in outputs:
            self._past.take(output)
            if self._watch.poses is not None and not session.has_second_pass:
                self._watch.poses(self._name, self._number, output.poses)

    def _end(self) -> None:
        session, past = self._session, self._past
        if session is None:
            return
        if not session.has_sensor:
            self._session = None
            return
        self._take(session, session.finish())
        past.tally.finish()
        output = past.output
        if session.has_second_pass:
            self._second_pass(session, output)
        session.close()
        self._session = None
        assert session.setup is not None
        self._results.append(
            SessionResult(
                self._name,
                self._number,
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

    def _second_pass(self, session: OfflineSession, output: Output) -> None:
        """Put the pose rows of the second pass in the place of the first's, and give them out in order."""
        with Spool(L.POSE_WIDTH) as made:
            for first, poses in session.again(lambda share: self._watch.progress("second pass", share)):
                made.put(first, poses)
            for first in range(0, len(made), BLOCK):
                poses = made.block(first, first + BLOCK)
                if self._keep:
                    output.poses[first : first + len(poses)] = poses
                if self._watch.poses is not None:
                    self._watch.poses(self._name, self._number, poses)
                self._past.tally.end = poses[-1]


class LiveRun:
    """The sessions of one vehicle, in the order of arrival, as the service has them."""

    def __init__(self, name: str, options: Options, watch: Watch, *, keep: bool) -> None:
        """name: of the vehicle; the rest as of `VehicleRun`."""
        self._name, self._options, self._watch, self._keep = name, options, watch, keep
        self._stream = VehicleStream(
            name, options.config, options.rate_hz, options.imu, options.model, options.span
        )
        self._past: dict[int, Past] = {}
        self._ends: dict[int, SessionEstimator] = {}

    def push(self, rows: Array, timed: Array) -> None:
        """Take rows (n, ROW_WIDTH), and what the boot clock made of them."""
        self._take_rows(timed)
        self._take(self._stream.push(rows))

    def finish(self, timed: Array) -> list[SessionResult]:
        """Take what the boot clock had held back, and that nothing follows."""
        self._take_rows(timed)
        self._take(self._stream.finish())
        return [self._result(number, end) for number, end in self._ends.items()]

    def close(self) -> None:
        """Nothing is open."""

    def _take_rows(self, timed: Array) -> None:
        for number, rows in by_session(timed):
            if self._options.session in (None, number):
                self._past.setdefault(number, Past(keep=self._keep)).take_rows(rows)

    def _take(self, steps: Iterator[Step]) -> None:
        stream = self._stream
        for step in steps:
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
    """The replay of one sender's rows. Whether it is a vehicle is known at the end, and so is what was wrong with it."""

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

    def push(self, rows: Array) -> None:
        """Take decoded rows (n, ROW_WIDTH) in the order of arrival."""
        self._has_sensor = self._has_sensor or bool(np.isin(rows[:, KIND], (Kind.IMU, Kind.GNSS)).any())
        said = is_vehicle(rows)
        self._said = said if self._said is None else self._said or bool(said)
        if not self._wanted or self._error is not None:
            return
        if self._options.faults:
            self._rows.append(rows)
            return
        try:
            self._take(rows)
        except MavkfError as error:  # a forced choice that it cannot serve: this may be no vehicle
            self._error = error

    def finish(self) -> list[SessionResult]:
        """Take it that nothing follows; give its sessions. Raises UsageError where a forced choice cannot be served."""
        if self._error is not None:
            raise self._error
        if self._rows:
            rows = np.concatenate(self._rows)
            self._rows = []
            self._take(apply_faults(rows, self._options.faults, boot_times(rows, self._window)))
        return self._run.finish(within(self.clock.flush(), self._options.span))

    def close(self) -> None:
        """Let go of temporary files."""
        self._run.close()

    def _take(self, rows: Array) -> None:
        self._run.push(rows, within(self.clock.push(rows), self._options.span))


def by_session(timed: Array) -> Iterator[tuple[int, Array]]:
    """The rows (n, ROW_WIDTH) of each session in turn, whose number never falls."""
    session = timed[:, SESSION]
    ends = [*(np.flatnonzero(np.diff(session)) + 1).tolist(), len(timed)]
    first = 0
    for end in ends:
        if end > first:
            yield int(session[first]), timed[first:end]
        first = end
