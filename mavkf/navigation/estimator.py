"""The estimator of one session of one vehicle: timed sample rows in, pose rows, innovations and notes out.

    estimator = SessionEstimator(config, rate_hz=50.0)
    for output in estimator.push(rows): ...      # live: rows in the order of arrival, as they come
    for output in estimator.finish(): ...        # what was still waiting for the set-up

or, offline, `run_offline(rows, config)`: the same events in the order in which they were measured, in one go.
"""

from collections.abc import Callable, Iterator

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import link_apart
from mavkf.config import Config
from mavkf.models.rotation import quaternion_from_euler, rotation_matrix
from mavkf.navigation import layout as L
from mavkf.navigation import timeline
from mavkf.navigation.codes import SENSORS
from mavkf.navigation.earth_field import earth_field
from mavkf.navigation.hindsight import look_back
from mavkf.navigation.parameter import PARAMETERS
from mavkf.navigation.propagation import begin
from mavkf.navigation.setup import Setup, choose, parameters
from mavkf.navigation.smoother import smooth
from mavkf.samples import (
    ACCEL,
    ARRIVAL,
    FIELD,
    FIX,
    GNSS_SOURCES,
    GYRO,
    IMU_SOURCES,
    KIND,
    LATITUDE,
    LONGITUDE,
    ROW_WIDTH,
    SOURCE,
    TIME,
    Kind,
    Source,
)

Array = NDArray[np.float64]
LONGEST_SETUP = 4  # times the set-up time, where no IMU is heard
HISTORY = 16_384  # events kept for late ones: five seconds at 3 kHz
BUFFER = 1_024
FORWARD_SHARE = 0.3  # of the work of a smoothed run
EARLY = 256  # rows kept from before the first sensor's


class Output(msgspec.Struct):
    """What a run wrote: pose rows (n, POSE_WIDTH), innovation rows (n, INNOVATION_WIDTH), notes (n, NOTE_WIDTH)."""

    poses: Array
    innovations: Array
    notes: Array


def select(rows: Array, setup: Setup) -> NDArray[np.bool_]:
    """Which rows (n, ROW_WIDTH) the fold gets: what is used or may have to be, all receivers, and heartbeats."""
    kind, source = rows[:, KIND], rows[:, SOURCE]
    use = kind == Kind.HEARTBEAT
    for wanted, sources in (
        (Kind.GNSS, GNSS_SOURCES),
        (Kind.IMU, setup.imus),
        (Kind.MAGNETOMETER, setup.magnetometers),
        (Kind.BAROMETER, setup.barometers),
    ):
        use |= (kind == wanted) & np.isin(source, sources)
    chosen_rows: NDArray[np.bool_] = use & np.isfinite(rows[:, TIME])
    return chosen_rows


def turn_sensors(rows: Array, rotation: tuple[float, float, float]) -> None:
    """Turn what the IMU messages hold (n, ROW_WIDTH) from the sensor frame into the body, in place: v_b = C_bs v_s.

    rotation: roll, pitch, yaw (rad) of the sensor frame in the body, ZYX. Right angles are exact, so that whole counts stay whole.
    """
    if not any(rotation):
        return
    q, C = np.empty(4), np.empty((3, 3))
    quaternion_from_euler(*rotation, q)
    rotation_matrix(q, C)
    C = np.round(C, 15)
    for kind, columns in ((Kind.IMU, (GYRO, ACCEL)), (Kind.MAGNETOMETER, (FIELD,))):
        mine = (rows[:, KIND] == kind) & np.isin(rows[:, SOURCE], IMU_SOURCES)
        for k in columns:
            x, y, z = (rows[mine, k + i] for i in range(3))
            for i in range(3):
                # summed one by one: a matrix product's last bit depends on how many rows there are
                rows[mine, k + i] = C[i, 0] * x + C[i, 1] * y + C[i, 2] * z


def to_events(rows: Array, setup: Setup, first_id: int) -> Array:
    """Events (n, EVENT_WIDTH) of selected rows: measured time in TIME, the earth's field beside each fix, running numbers."""
    events = np.full((rows.shape[0], L.EVENT_WIDTH), np.nan)
    events[:, :ROW_WIDTH] = rows
    turn_sensors(events, setup.imu_rotation)
    for kind, delay in (
        (Kind.IMU, setup.imu_delay),
        (Kind.GNSS, setup.gnss_delay),
        (Kind.MAGNETOMETER, setup.magnetometer_delay),
        (Kind.BAROMETER, setup.barometer_delay),
    ):
        events[events[:, KIND] == kind, TIME] -= delay
    events[:, L.EVENT_ID] = np.arange(first_id, first_id + rows.shape[0])
    for i in np.flatnonzero((events[:, KIND] == Kind.GNSS) & (events[:, FIX] >= 3)):
        events[i, L.FIELD_N : L.FIELD_N + 3] = earth_field(
            events[i, LATITUDE], events[i, LONGITUDE], events[i, ARRIVAL]
        )
    return events


class SessionEstimator:
    """Live estimation of one session: bounded memory, the same outputs however the rows are cut into calls."""

    def __init__(
        self, config: Config, rate_hz: float = 50.0, imu: Source | None = None, model: str | None = None
    ) -> None:
        """rate_hz: poses a second of boot time (0: every IMU sample); imu, model: forced choices, as of `choose`."""
        link_apart()
        self.config, self.rate, self.imu, self.model = config, rate_hz, imu, model
        self.setup: Setup | None = None
        self.state = np.empty(L.STATE_SIZE)
        self.parameters: Array = np.zeros(PARAMETERS)
        self._waiting: list[Array] = []
        self._first_sensor = np.nan
        self._next_id = 0
        self._cursor = np.zeros(timeline.CURSOR_SIZE, dtype=np.int64)
        self._cursor[timeline.LAST_SLOT] = -1
        self._marks = np.full(timeline.MARKS_SIZE, -np.inf)

    @property
    def late(self) -> int:
        """Events dropped because they were older than the window."""
        return int(self._cursor[timeline.LATE])

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

    def _allocate(self) -> None:
        self._events = np.empty((HISTORY, L.EVENT_WIDTH))
        self._snapshots = np.empty((HISTORY // timeline.STRIDE + 2, L.STATE_SIZE))
        self._out = L.buffers(BUFFER, BUFFER, SENSORS * HISTORY)
        self._poses = np.empty((BUFFER, L.POSE_WIDTH))

    def _run(self, rows: Array) -> Iterator[Output]:
        assert self.setup is not None
        if self._next_id == 0:
            self._allocate()
        chosen = rows[select(rows, self.setup)]
        events = to_events(chosen, self.setup, self._next_id)
        self._next_id += events.shape[0]
        i = 0
        while i < events.shape[0]:
            self._out[2][:] = 0
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
            yield Output(
                self._poses[:n].copy(),
                self._out[0][: self._out[2][0]].copy(),
                self._out[1][: self._out[2][1]].copy(),
            )


def fold_counts(state: Array) -> dict[str, int]:
    """What a state has counted: repeated values, fixes without a position, gaps of the IMU."""
    return {
        "repeated": int(state[L.DUPLICATES]),
        "implausible": int(state[L.IMPLAUSIBLE]),
        "without_fix": int(state[L.NO_FIX]),
        "imu_gaps": int(state[L.GAP_COUNT]),
    }


class Offline(msgspec.Struct):
    """An offline run: its set-up, what it wrote, the final state, the parameters, and what smoothing made of the flight, in words."""

    setup: Setup
    output: Output
    state: Array
    parameters: Array
    hindsight: tuple[str, ...] = ()


def run_offline(
    rows: Array,
    config: Config,
    rate_hz: float = 50.0,
    imu: Source | None = None,
    model: str | None = None,
    progress: Callable[[float], object] | None = None,
    smoothing: bool = False,
) -> Offline:
    """Fold a session's rows (n, ROW_WIDTH; in the order of arrival) in the order in which they were measured.

    progress: called with the share that is done, now and then; smoothing: whether the pose rows are smoothed by what came later.
    """
    decider = SessionEstimator(config, rate_hz, imu, model)
    decider._decide(rows)
    if decider.setup is None:
        decider._start(rows)
    setup = decider.setup
    assert setup is not None
    c = decider.parameters
    events = timeline.in_order(to_events(rows[select(rows, setup)], setup, 0))
    state = decider.state
    start = state.copy()
    part = progress or (lambda _: None)
    share = FORWARD_SHARE if smoothing else 1.0
    out = L.buffers(16 * BUFFER, BUFFER, SENSORS)  # in order, no event is folded twice
    poses = np.empty((16 * BUFFER, L.POSE_WIDTH))
    parts: list[Output] = []
    i, slot = 0, -1
    while i < events.shape[0]:
        out[2][:] = 0
        i, n, slot = timeline.run_batch(state, events, i, slot, c, rate_hz, poses, out)
        part(share * i / events.shape[0])
        parts.append(Output(poses[:n].copy(), out[0][: out[2][0]].copy(), out[1][: out[2][1]].copy()))
    output = joined(parts)
    words: tuple[str, ...] = ()
    if smoothing:
        hindsight = look_back(state, output.innovations, output.notes)
        words = hindsight.words
        smooth(start, events, c, rate_hz, hindsight, output.poses, lambda done: part(share + (1.0 - share) * done))
    return Offline(setup, output, state, c, words)


def joined(parts: list[Output]) -> Output:
    """One output of several, in order."""
    if not parts:
        return Output(np.empty((0, L.POSE_WIDTH)), np.empty((0, L.INNOVATION_WIDTH)), np.empty((0, L.NOTE_WIDTH)))
    return Output(
        np.concatenate([part.poses for part in parts]),
        np.concatenate([part.innovations for part in parts]),
        np.concatenate([part.notes for part in parts]),
    )
