"""What `mavkf watch` has seen of each vehicle."""

import time
from collections import deque

from mavkf.estimate import Event, Innovation, Pose, Record, Status

EVENTS = 8
STALE_S = 3.0


class Row:
    """A vehicle's newest records, when they came (seconds of this machine's steady clock), and how many poses come a second."""

    def __init__(self, vehicle: str, now: float) -> None:
        self.vehicle, self.came = vehicle, now
        self.pose: Pose | None = None
        self.status: Status | None = None
        self.innovations: dict[str, Innovation] = {}
        self.events: deque[Event] = deque(maxlen=EVENTS)
        self.rate_hz = 0.0
        self._mark: tuple[float, int, int] | None = None

    def take(self, record: Record, now: float) -> None:
        """Note a newer record."""
        if isinstance(record, Pose):
            self._measure(record, now)
            self.pose, self.came = record, now
        elif isinstance(record, Innovation):
            self.innovations[record.sensor] = record
        elif isinstance(record, Event):
            self.events.append(record)
        else:
            self.status = record
            if record.silent_s is None:
                self.came = now

    def _measure(self, pose: Pose, now: float) -> None:
        """Follow the rate by `seq`, so poses that were skipped count."""
        then, session, seq = self._mark or (now, pose.session, pose.seq)
        if session != pose.session:
            self.rate_hz = 0.0
        elif now - then >= 1.0:
            self.rate_hz = max(pose.seq - seq, 0) / (now - then)
        elif self._mark is not None:
            return
        self._mark = (now, pose.session, pose.seq)

    def age_s(self, now: float) -> float:
        """How long nothing has come of the vehicle."""
        return now - self.came

    def words(self, now: float) -> str:
        """How it is, in a word or two, the worst first."""
        if self.age_s(now) >= STALE_S:
            return f"silent for {self.age_s(now):.0f} s"
        newest = self.pose or self.status
        if newest is None:
            return ""
        flags = " ".join(newest.flags)
        wrong = self.wrong()
        return f"{flags} {wrong[0]}?".strip() if wrong else flags

    def wrong(self) -> list[str]:
        """The sensors of which the status says that something is wrong."""
        innovations = self.status.innovations if self.status else {}
        return [name for name, each in innovations.items() if each.sentence]


class Seen:
    """The vehicles that were seen."""

    def __init__(self) -> None:
        self.rows: dict[str, Row] = {}
        self.poses = 0

    def take(self, record: Record) -> Row:
        """Note a record."""
        now = time.monotonic()
        row = self.rows.get(record.vehicle)
        if row is None:
            row = self.rows[record.vehicle] = Row(record.vehicle, now)
        row.take(record, now)
        self.poses += isinstance(record, Pose)
        return row
