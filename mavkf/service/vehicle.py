"""One vehicle from decoded rows to records: clock, sessions, estimator, status. Live and `replay --as-live` run exactly this.

What comes out depends on the rows and their order alone, not on how they are cut into calls: rows are taken up to where something is due
once a second of the boot clock. When in the second a status is due follows from the arrival of the session's first row, lest those of a
fleet that was switched on together all come at once.
"""

import math
from collections.abc import Iterator

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.config import Config
from mavkf.estimate import Event, Pose, Record, Status
from mavkf.link.clocks import VehicleClock
from mavkf.navigation import layout as L
from mavkf.navigation.counting import BEFORE, NEWEST, SECOND, STATUS, Counts, count_innovations, take_part
from mavkf.navigation.estimator import Output, SessionEstimator, fold_counts
from mavkf.navigation.pose import pose_row
from mavkf.navigation.records import MODES, SENSOR_NAMES, RecordWriter, flag_names, model_name, validity
from mavkf.navigation.stated import late_words
from mavkf.samples import ARRIVAL, KIND, SESSION, TIME, UNIX_US, Kind, Source
from mavkf.service.judgement import Judgement
from mavkf.service.utc import UtcClock

Array = NDArray[np.float64]
LINK_GAP_S = 3.0
KINDS = {Kind.IMU: "imu", Kind.GNSS: "gnss", Kind.MAGNETOMETER: "magnetometer", Kind.BAROMETER: "barometer"}
SYSTEM_TIME = int(Kind.SYSTEM_TIME)
SPREAD = 2_654_435_769
"""2^32 over the golden ratio (Knuth, "The Art of Computer Programming", 3, 6.4): vehicles heard one after another are spread evenly."""
EVERYTHING = (-math.inf, math.inf)


class Step(msgspec.Struct):
    """What came of some rows: arrays of the fold, then a status, an event and smoothed pose rows (n, POSE_WIDTH) where they were due."""

    session: int
    output: Output
    status: Status | None = None
    event: Event | None = None
    smoothed: Array | None = None


class VehicleStream:
    """The estimate of one vehicle from its rows in the order of arrival."""

    def __init__(
        self,
        vehicle: str,
        config: Config,
        rate_hz: float = 50.0,
        imu: Source | None = None,
        model: str | None = None,
        span: tuple[float, float] = EVERYTHING,
        first_session: int = 0,
        lag_s: float = 0.0,
    ) -> None:
        """vehicle: its name in keys; rate_hz, imu, model: as of `SessionEstimator`; span: boot times (s) to use.

        first_session: the number of the first session, where there were others before; lag_s: s after which smoothed poses come, 0: none.
        """
        self.span, self.first_session, self._lag = span, first_session, lag_s
        self.config, self.rate, self.imu, self.model = config, rate_hz, imu, model
        self.clock = VehicleClock(config.timeline.window_s)
        self.writer = RecordWriter(vehicle)
        self.session = -1
        self.estimator: SessionEstimator | None = None
        self._known = False  # it was a vehicle in a session before
        self._phase = 0.0  # s after each full second at which a status is due
        self._begin(-1)

    def _begin(self, session: int) -> None:
        self.session = session
        self.utc = UtcClock()
        self.writer.utc = self.utc
        self._tally = Counts()
        self._poses: int | None = None  # nothing has come of the estimator yet
        self._status_time = math.nan
        self._status_counts: dict[str, int] = {}
        self._judgement = Judgement()
        self._late_told = False
        if session >= 0:
            self.estimator = SessionEstimator(self.config, self.rate, self.imu, self.model, self._lag)

    @property
    def is_vehicle(self) -> bool:
        """Whether this component has sent an IMU or GNSS sample in this session; before, nothing comes out."""
        return self.estimator is not None and self.estimator.has_sensor

    def push(self, rows: Array) -> Iterator[Step]:
        """Take decoded rows (n, ROW_WIDTH) of this vehicle in the order of arrival."""
        yield from self._timed(within(self.clock.push(rows), self.span))

    def finish(self) -> Iterator[Step]:
        """Take it that nothing more will come."""
        yield from self._timed(within(self.clock.flush(), self.span))
        yield from self._end_session()

    def _end_session(self) -> Iterator[Step]:
        if self.estimator is None or not self.is_vehicle:
            return
        for output in self.estimator.finish():
            yield self._step(output)
        if self._lag > 0.0:
            yield Step(self.session, _nothing(), smoothed=self._smoothed(self._newest + self._lag))

    def _smoothed(self, now: float) -> Array | None:
        return self.estimator.smoothed(now) if self._lag > 0.0 and self.estimator is not None else None

    @property
    def _newest(self) -> float:
        """The newest boot time of the session, s; -inf: none."""
        return float(self._tally.times[NEWEST])

    def _timed(self, rows: Array) -> Iterator[Step]:
        if self.first_session:
            rows[:, SESSION] += self.first_session
        i = 0
        while i < rows.shape[0]:
            session = int(rows[i, SESSION])
            if session != self.session:
                yield from self._change_session(session, float(rows[i, TIME]), float(rows[i, ARRIVAL]))
            tally, first = self._tally, i
            i, due = take_part(rows, i, self._phase, tally.times, tally.kinds, tally.newest)
            part = rows[first:i]
            if part[0, KIND] == SYSTEM_TIME:
                self.utc.update(float(part[0, TIME]), float(part[0, UNIX_US]))
            assert self.estimator is not None
            for output in self.estimator.push(part):
                yield self._step(output)
            if due and self.is_vehicle:
                before, newest = map(float, tally.times[[BEFORE, NEWEST]])
                status = self._status() if due & STATUS else None
                gap = newest - before  # so large a step always enters another second
                event = self._gap(before, gap) if gap > LINK_GAP_S else self._late_parameters()
                smoothed = self._smoothed(newest) if due & SECOND else None
                if status is not None or event is not None or smoothed is not None:
                    yield Step(session, _nothing(), status, event, smoothed)

    def _change_session(self, session: int, t: float, arrival: float) -> Iterator[Step]:
        """Begin a session; t, arrival: boot time (s) of its first row, and when that arrived (microseconds UTC)."""
        before = self._newest
        self._known |= self.is_vehicle
        yield from self._end_session()
        self._begin(session)
        self._phase = int(arrival) * SPREAD % 2**32 / 2**32 if math.isfinite(arrival) else 0.0
        if self._known:
            event = Event(
                **self.writer.head("event", session, t),
                kind="reboot",
                t_start_s=t,
                t_end_s=t,
                size=before - t,
                evidence={"clock_before_s": before, "clock_after_s": t},
                text=f"the vehicle rebooted: its clock fell from {before:.1f} s to {t:.1f} s",
            )
            yield Step(session, _nothing(), event=event)

    def _gap(self, before: float, gap: float) -> Event:
        text = f"nothing came for {gap:.1f} s of the vehicle's clock"
        return self.event("link_gap", text, before, size=gap)

    def _late_parameters(self) -> Event | None:
        """Once in a session, that parameters of the autopilot came too late for it."""
        names = self.estimator.late_parameters if self.estimator is not None else None
        if not names or self._late_told:
            return None
        self._late_told = True
        return self.event("parameters_late", late_words(names))

    def event(self, kind: str, text: str, start: float | None = None, size: float | None = None) -> Event:
        """An event of now that the fold cannot tell; start: boot time (s) at which it began, None: now."""
        now = self._newest
        return Event(
            **self.writer.head("event", self.session, now),
            kind=kind,
            t_start_s=now if start is None else start,
            t_end_s=now,
            size=size,
            text=text,
        )

    def _step(self, output: Output) -> Step:
        self._poses = (self._poses or 0) + len(output.poses)
        if len(output.innovations):
            self._judgement.take(output.innovations)
            count_innovations(output.innovations, self._tally.sensors)
        return Step(self.session, output)

    def _counts(self) -> dict[str, int]:
        """What came and went in this session, by name; what never came has none."""
        kinds, sensors = self._tally.kinds.tolist(), self._tally.sensors.tolist()
        counts = {name: kinds[kind] for kind, name in KINDS.items() if kinds[kind]}
        if self._poses is not None:
            counts["poses"] = self._poses
        for name, (fused, refused) in zip(SENSOR_NAMES, sensors, strict=True):
            if fused or refused:
                counts |= {name + "_fused": fused, name + "_refused": refused}
        return counts

    def _status(self) -> Status:
        assert self.estimator is not None
        row = np.zeros(L.POSE_WIDTH)
        if self.estimator.setup is not None:
            pose_row(self.estimator.state, self.estimator.parameters, row)
        else:
            row[L.R_LATITUDE] = math.nan
        now, counts = self._newest, self._counts()
        elapsed = now - self._status_time
        rates = {
            name: (counts.get(name, 0) - self._status_counts.get(name, 0)) / elapsed if elapsed > 0.0 else None
            for name in [*KINDS.values(), "poses"]
        }
        last = self._tally.newest.tolist()
        setup = self.estimator.setup
        judged = self._judgement.report(now, row, self.estimator.state, setup.imu_rate_hz) if setup is not None else {}
        self._status_time, self._status_counts = now, counts
        return Status(
            **self.writer.head("status", self.session, now),
            mode=MODES[int(row[L.R_MODE])],
            flags=flag_names(row[L.R_FLAGS]),
            valid=validity(row[L.R_VALID]),
            model=model_name(row),
            rates_hz=rates,
            counts=counts | state_counts(self.estimator),
            age_s={name: now - last[kind] if math.isfinite(last[kind]) else None for kind, name in KINDS.items()},
            **judged,
        )

    def records(self, step: Step, *, is_late: bool = False) -> Iterator[Record]:
        """The records of a step, in the order in which they are published.

        is_late: leave out the innovations, and all poses but the newest; they keep their numbers, so a reader sees what is missing.
        """
        for row in step.output.innovations:
            if is_late:
                self.writer.head("innovation/" + SENSOR_NAMES[int(row[L.I_SENSOR])], step.session, None)
            else:
                yield self.writer.innovation(row, step.session)
        for row in step.output.notes:
            yield self.writer.event(row, step.session)
        if is_late:
            for _ in step.output.poses[:-1]:
                self.writer.head("pose", step.session, None)
            for row in step.output.poses[-1:]:
                yield self.writer.pose(row, step.session)
        else:
            yield from self.poses(step)
        if step.status is not None:
            yield step.status
        if step.event is not None:
            yield step.event
        for row in () if step.smoothed is None else step.smoothed:
            yield self.writer.smoothed_pose(row, step.session)

    def poses(self, step: Step) -> Iterator[Pose]:
        """The pose records of a step."""
        for row in step.output.poses:
            yield self.writer.pose(row, step.session)


def state_counts(estimator: SessionEstimator) -> dict[str, int]:
    """What the estimator has counted: samples and parameters too late, repeated values, fixes without a position, gaps of the IMU."""
    if estimator.setup is None:
        return {}
    late = {"late": estimator.late, "parameters_late": estimator.late_parameters.total()}
    return late | fold_counts(estimator.state)


def within(rows: Array, span: tuple[float, float]) -> Array:
    """The rows whose TIME lies in a span (s), ends included."""
    if span == EVERYTHING:
        return rows
    return rows[(rows[:, TIME] >= span[0]) & (rows[:, TIME] <= span[1])]


def _nothing() -> Output:
    return Output(np.empty((0, L.POSE_WIDTH)), np.empty((0, L.INNOVATION_WIDTH)), np.empty((0, L.NOTE_WIDTH)))
