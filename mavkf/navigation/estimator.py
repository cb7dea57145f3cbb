"""The estimator of one session of one vehicle: timed sample rows in, pose rows, innovations and notes out.

    estimator = SessionEstimator(config, rate_hz=50.0)
    for output in estimator.push(rows): ...      # live: rows in the order of arrival, as they come
    for output in estimator.finish(): ...        # what was still waiting for the set-up

Offline, in the order in which they were measured, `mavkf.navigation.offline` does it.
"""

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import link_apart
from mavkf.config import Config
from mavkf.navigation import history
from mavkf.navigation import layout as L
from mavkf.navigation.events import Arrivals
from mavkf.navigation.parameter import PARAMETERS
from mavkf.navigation.propagation import begin
from mavkf.navigation.setup import Setup, choose, parameters
from mavkf.navigation.stated import too_late
from mavkf.samples import KIND, TIME, Kind, Source

if TYPE_CHECKING:
    from mavkf.navigation.fixed_lag import FixedLag

Array = NDArray[np.float64]
LONGEST_SETUP = 4  # times the set-up time, where no IMU is heard
HISTORY = 16_384  # events kept for late ones: five seconds at 3 kHz
BUFFER = 1_024
EARLY = 256  # rows kept from before the first sensor's
PARAMETER_KIND = int(Kind.PARAMETER)


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
        self.late_parameters: Counter[str] = Counter()
        """Those of the autopilot, by name, that came after the set-up and would have changed it."""
        self._lag = lag_s
        self._arrivals: Arrivals | None = None
        self._lagging: FixedLag | None = None
        self.waiting: list[Array] = []
        self._first_sensor = np.nan

    @property
    def late(self) -> int:
        """Events dropped because they were older than the window."""
        return 0 if self._arrivals is None else int(self._cursor[history.LATE])

    def push(self, rows: Array) -> Iterator[Output]:
        """Take rows (n, ROW_WIDTH) in the order of arrival; yields outputs as they arise, none while the set-up is open."""
        if self.setup is None:
            waited, rows = self.decide(rows)
            if self.setup is None:
                return
            for output in self._run(waited):
                # they are as old as the set-up is long: nobody would want them now, in a burst
                output.poses = output.poses[:0]
                yield output
        if (rows[:, KIND] == PARAMETER_KIND).any():
            self.late_parameters.update(self.too_late(rows))
        yield from self._run(rows)

    def finish(self) -> Iterator[Output]:
        """Decide the set-up with what there is, if it is still open, and run what waited."""
        if self.setup is None and self.waiting:
            waiting = np.concatenate(self.waiting)
            self.waiting = []
            self.start(waiting)
            yield from self._run(waiting)

    def smoothed(self, now: float) -> Array:
        """Pose rows (n, POSE_WIDTH) that the lag makes due at boot time `now` (s), smoothed by what came after them; `now` never falls."""
        return np.empty((0, L.POSE_WIDTH)) if self._lagging is None else self._lagging.rows(now)

    @property
    def has_sensor(self) -> bool:
        """Whether an IMU or GNSS sample has come: without one there is nothing to estimate."""
        return bool(np.isfinite(self._first_sensor))

    def too_late(self, rows: Array) -> list[str]:
        """The names of parameters among rows (n, ROW_WIDTH) after the set-up that would have changed it."""
        setup = self.setup
        assert setup is not None
        return too_late(rows, setup.stated, self.config.vehicle, setup.gnss, setup.magnetometer)

    def decide(self, rows: Array) -> tuple[Array, Array]:
        """Keep rows until the set-up's time is over; returns those that waited for it, once it is, and those that came after."""
        for i in range(rows.shape[0]):
            row = rows[i]
            if not self.has_sensor:
                if row[KIND] not in (Kind.IMU, Kind.GNSS):
                    continue
                self._first_sensor = row[TIME]
                # what came long before the first sensor says nothing about it
                before = np.concatenate([*self.waiting, rows[:i]])
                self.waiting = [before[-EARLY:]]
                return self.decide(rows[i:])
            if row[TIME] - self._first_sensor >= self.config.timeline.setup_s:
                seen = np.concatenate([*self.waiting, rows[: i + 1]])
                patient = row[TIME] - self._first_sensor < LONGEST_SETUP * self.config.timeline.setup_s
                if patient and not np.any(seen[:, KIND] == Kind.IMU):
                    continue
                self.waiting = []
                self.start(seen)
                return seen, rows[i + 1 :]
        self.waiting.append(rows.copy())
        if not self.has_sensor:
            self.waiting = [np.concatenate(self.waiting)[-EARLY:]]
        return rows[:0], rows[:0]

    def start(self, seen: Array) -> None:
        """Decide the set-up from the rows (n, ROW_WIDTH) that were seen. Raises UsageError where a forced choice cannot be served."""
        self.setup = choose(seen, self.config, self.imu, self.model)
        self.parameters = parameters(self.config, self.setup)
        begin(self.state, self.parameters)
        if self._lag > 0.0:
            from mavkf.navigation.fixed_lag import FixedLag  # what few services need is imported for them

            self._lagging = FixedLag(self.state, self.parameters, self.rate, self._lag)

    def _allocate(self) -> None:
        self._events, self._snapshots, self._cursor, self._marks = history.history(HISTORY)
        self._out = L.buffers(BUFFER, BUFFER, HISTORY)
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
            i, n = history.run_live(
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


def joined(parts: list[Output]) -> Output:
    """One output of several, in order."""
    if not parts:
        return Output(np.empty((0, L.POSE_WIDTH)), np.empty((0, L.INNOVATION_WIDTH)), np.empty((0, L.NOTE_WIDTH)))
    return Output(
        np.concatenate([part.poses for part in parts]),
        np.concatenate([part.innovations for part in parts]),
        np.concatenate([part.notes for part in parts]),
    )
