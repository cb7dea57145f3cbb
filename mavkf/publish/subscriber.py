"""The other end: the published records as an iterator, for any process.

for pose in mavkf.subscribe("1-1"):
    print(pose.lat_deg, pose.lon_deg)
"""

import threading
import weakref
from collections import Counter, deque
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Literal, Self, TypeVar, cast, overload

import msgspec
import zenoh
from zenoh.handlers import Callback

from mavkf.errors import UsageError
from mavkf.estimate import Event, Innovation, Pose, Record, SmoothedPose, Status
from mavkf.publish.records import What, check_choice, check_name, decode
from mavkf.publish.session import open_session

R = TypeVar("R", bound=Record)

CAPACITY = 4096
"""Records kept for a reader that is busy, and keys kept for counting gaps: a flood must not grow the memory."""


class Inbox:
    """Where zenoh's threads leave payloads for the reader; bounded.

    When it is full the oldest record of a live publisher is dropped and counted; a publisher that blocks (replay) is
    made to wait instead, so that nothing is lost on the way from its put to this reader.
    """

    def __init__(self, *, latest_only: bool) -> None:
        self.counts: Counter[str] = Counter()
        self.alive: set[str] = set()
        self.closed = False
        self.changed = threading.Condition()
        self._latest_only = latest_only
        self._waiting: deque[tuple[str, bytes, bool]] = deque()
        self._newest: dict[str, tuple[bytes, bool]] = {}

    def take(self, sample: zenoh.Sample, *, asked: bool = False) -> None:
        """Keep a sample, or the answer to what was asked; called in a thread of zenoh's."""
        if sample.kind != zenoh.SampleKind.PUT:
            return
        key, item = str(sample.key_expr), (sample.payload.to_bytes(), asked)
        with self.changed:
            if self._latest_only:
                if key in self._newest or len(self._newest) >= CAPACITY:
                    self.counts["dropped"] += 1
                if key in self._newest or len(self._newest) < CAPACITY:
                    self._newest[key] = item
            else:
                if sample.congestion_control == zenoh.CongestionControl.BLOCK and not asked:
                    self.changed.wait_for(lambda: self.closed or len(self._waiting) < CAPACITY)
                elif len(self._waiting) >= CAPACITY:
                    self._waiting.popleft()
                    self.counts["dropped"] += 1
                self._waiting.append((key, *item))
            self.changed.notify_all()

    def next(self, timeout_s: float | None) -> tuple[str, bytes, bool] | None:
        """Give the oldest waiting key, payload and whether it was asked for; None when closed or after `timeout_s`."""
        with self.changed:
            if not self.changed.wait_for(lambda: self.closed or self._waiting or self._newest, timeout_s):
                return None
            if self._waiting:
                if len(self._waiting) >= CAPACITY:
                    self.changed.notify_all()  # a blocked publisher may go on
                return self._waiting.popleft()
            if self._newest:
                key = next(iter(self._newest))
                return key, *self._newest.pop(key)
            return None

    def close(self) -> None:
        """Let go whoever waits."""
        with self.changed:
            self.closed = True
            self.changed.notify_all()


def _end(inbox: Inbox, session: zenoh.Session) -> None:
    inbox.close()
    session.close()  # type: ignore[no-untyped-call]


class Subscription(Generic[R]):
    """Iterates over the records of some kinds as they come, for ever; a context manager. Made by `subscribe`."""

    def __init__(self, session: zenoh.Session, vehicle: str, what: Sequence[What], *, latest_only: bool) -> None:
        self._inbox = inbox = Inbox(latest_only=latest_only)  # callbacks hold the inbox, never this object
        self._last: dict[str, tuple[int, int]] = {}
        # Also when the reader drops this object, or the process ends: an open session would hang the interpreter.
        self._end = weakref.finalize(self, _end, inbox, session)
        tails = ["innovation/*" if each == "innovation" else each for each in what]
        # Called in the threads that read the links: an answer cannot overtake what was sent before it, and there are no
        # Python threads that the interpreter would wait for at its end.
        for tail in tails:
            session.declare_subscriber(f"mavkf/{vehicle}/{tail}", Callback(inbox.take, indirect=False))

        def hear(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                inbox.take(reply.ok, asked=True)

        def greet(token: zenoh.Sample) -> None:
            """Ask a vehicle that has appeared for what it said last."""
            name = str(token.key_expr).split("/")[1]
            with inbox.changed:
                (inbox.alive.add if token.kind == zenoh.SampleKind.PUT else inbox.alive.discard)(name)
            for tail in tails if token.kind == zenoh.SampleKind.PUT else ():
                session.get(f"mavkf/{name}/{tail}", Callback(hear, indirect=False))

        session.liveliness().declare_subscriber(f"mavkf/{vehicle}/alive", Callback(greet, indirect=False), history=True)

    @property
    def counts(self) -> dict[str, int]:
        """What happened to the records.

        received: given to the reader. garbage: payloads that are no such record. missed: gaps in `seq`.
        dropped: thrown away here because the reader was slow (with `latest_only`: replaced by a newer one).
        """
        names = ("received", "garbage", "missed", "dropped")
        return {name: self._inbox.counts[name] for name in names}

    @property
    def alive(self) -> frozenset[str]:
        """The vehicles whose publishers are there now."""
        with self._inbox.changed:
            return frozenset(self._inbox.alive)

    def receive(self, timeout_s: float | None = None) -> R | None:
        """Wait for the next record; None when closed or after `timeout_s`."""
        while (item := self._inbox.next(timeout_s)) is not None:
            key, payload, asked = item
            try:
                record = decode(key.split("/")[2], payload)
            except (msgspec.MsgspecError, RecursionError):
                self._inbox.counts["garbage"] += 1
                continue
            if self._is_new(key, record, asked):
                self._inbox.counts["received"] += 1
                return cast(R, record)
        return None

    def close(self) -> None:
        """End the subscription and its session; the iteration ends."""
        self._end()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> R:
        record = self.receive()
        if record is None:
            raise StopIteration
        return record

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _is_new(self, key: str, record: Record, asked: bool) -> bool:
        """Count what is missing before a record; False for an answer that is no newer than what came by itself."""
        last = self._last.get(key)
        if last is not None and last[0] == record.session:
            if asked and record.seq <= last[1]:
                return False
            self._inbox.counts["missed"] += max(record.seq - last[1] - 1, 0)
        if last is not None or len(self._last) < CAPACITY:
            self._last[key] = (record.session, record.seq)
        return True


@overload
def subscribe(
    vehicle: str = "*",
    *,
    what: Literal["pose"] = "pose",
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config_file: Path | None = None,
    latest_only: bool = False,
) -> Subscription[Pose]: ...
@overload
def subscribe(
    vehicle: str = "*",
    *,
    what: Literal["pose/smoothed"],
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config_file: Path | None = None,
    latest_only: bool = False,
) -> Subscription[SmoothedPose]: ...
@overload
def subscribe(
    vehicle: str = "*",
    *,
    what: Literal["status"],
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config_file: Path | None = None,
    latest_only: bool = False,
) -> Subscription[Status]: ...
@overload
def subscribe(
    vehicle: str = "*",
    *,
    what: Literal["event"],
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config_file: Path | None = None,
    latest_only: bool = False,
) -> Subscription[Event]: ...
@overload
def subscribe(
    vehicle: str = "*",
    *,
    what: Literal["innovation"],
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config_file: Path | None = None,
    latest_only: bool = False,
) -> Subscription[Innovation]: ...
@overload
def subscribe(
    vehicle: str = "*",
    *,
    what: What | Sequence[What],
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config_file: Path | None = None,
    latest_only: bool = False,
) -> Subscription[Record]: ...
def subscribe(
    vehicle: str = "*",
    *,
    what: What | Sequence[What] = "pose",
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config_file: Path | None = None,
    latest_only: bool = False,
) -> Subscription[Any]:
    """Subscribe to what mavkf publishes on this machine, or where `connect` says; works before anything publishes.

    Args:
        vehicle: `<sysid>-<compid>` or its name; "*" for all.
        what: "pose", "pose/smoothed", "status", "event" or "innovation", or several of them.
        connect: zenoh endpoints to go to, such as "tcp/192.168.1.5:7447".
        listen: zenoh endpoints to be reached at.
        config_file: a zenoh configuration to use instead of the project's own.
        latest_only: a slow reader gets the newest record of each key instead of all.

    Raises:
        UsageError: an argument is wrong.
        EndpointError: an endpoint cannot be opened.

    """
    if vehicle != "*":
        check_name(vehicle)
    kinds: Sequence[What] = (what,) if isinstance(what, str) else what
    for kind in kinds:
        check_choice("what", kind, What)
    if isinstance(connect, str) or isinstance(listen, str):
        raise UsageError('connect and listen are lists of endpoints, as in ["tcp/192.168.1.5:7447"]')
    session = open_session(publishes=False, connect=connect, listen=listen, config_file=config_file)
    return Subscription(session, vehicle, kinds, latest_only=latest_only)
