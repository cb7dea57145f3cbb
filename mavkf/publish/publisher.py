"""What one vehicle publishes: its records, their latest values on request, and that it is alive."""

import threading
from collections import Counter
from types import TracebackType
from typing import Literal, Self

import zenoh
from zenoh.handlers import Callback

from mavkf.estimate import Innovation, Record
from mavkf.publish.records import ENCODERS, ENCODINGS, Encoding, check_choice, check_name, finite, name_of

Congestion = Literal["drop", "block"]

_CONTROL = {"drop": zenoh.CongestionControl.DROP, "block": zenoh.CongestionControl.BLOCK}


class Publisher:
    """Publishes the records of one vehicle on `mavkf/<vehicle>/...`; use it in a `with`, or close it.

    A query on a key, wildcards included, is answered with the latest record of each key that it names. (zenoh's own
    AdvancedPublisher answers only its own kind of subscriber, and cannot tell whether anybody listens.)

    Not for several threads at once.
    """

    def __init__(
        self,
        session: zenoh.Session,
        vehicle: str,
        encoding: Encoding = "json",
        congestion: Congestion = "drop",
    ) -> None:
        """Declare the keys of a vehicle.

        Args:
            session: of `open_session`; stays open when this closes.
            vehicle: `<sysid>-<compid>` or a name of letters, digits, '_' and '-'.
            encoding: of the payloads.
            congestion: what a slow reader costs: "drop" loses its records (live), "block" waits for it (replay).

        Raises:
            UsageError: a name or choice is wrong.

        """
        self.vehicle = check_name(vehicle)
        self.counts: Counter[str] = Counter()
        """Records put, by key below the vehicle ("pose", "innovation/gnss"); "not_finite": those that held a NaN."""
        check_choice("encoding", encoding, Encoding)
        check_choice("congestion", congestion, Congestion)
        self._session = session
        self._encoding, self._encode = ENCODINGS[encoding], ENCODERS[encoding]
        self._control = _CONTROL[congestion]
        self._root = f"mavkf/{vehicle}/"
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._latest: dict[str, tuple[bytes, zenoh.Timestamp]] = {}
        for name in ("pose", "status", "event"):
            self._declare(name)
        # Not in a Python thread: the interpreter would wait for it at its end if nobody closes this.
        # Answers before the token, so that whoever sees the vehicle alive can ask for its latest values.
        self._queryable = session.declare_queryable(self._root + "**", Callback(self._answer, indirect=False))
        self._token = session.liveliness().declare_token(self._root + "alive")

    def publish(self, record: Record) -> None:
        """Put a record on its key.

        Raises:
            ValueError: it is of another vehicle.
            UsageError: its sensor's name cannot be part of a key.

        """
        name = name_of(record)
        if record.vehicle != self.vehicle:
            raise ValueError(f"a record of vehicle {record.vehicle} given to the publisher of {self.vehicle}")
        publisher = self._publishers.get(name)
        if publisher is None:  # only innovations are left to their first record
            if isinstance(record, Innovation):
                check_name(record.sensor, role="sensor")
            publisher = self._declare(name)
        clean = finite(record)
        if clean is not record:
            self.counts["not_finite"] += 1
        payload = self._encode(clean)
        timestamp = self._session.new_timestamp()
        publisher.put(payload, timestamp=timestamp)
        self._latest[name] = (payload, timestamp)  # after the put: an answer must not overtake it
        self.counts[name] += 1

    def wait_for_subscriber(self, timeout_s: float | None = None) -> bool:
        """Wait until somebody subscribes to the pose; False when `timeout_s` passed before. No polling."""
        found = threading.Event()

        def note(status: zenoh.MatchingStatus) -> None:
            if status.matching:
                found.set()

        pose = self._publishers["pose"]
        with pose.declare_matching_listener(Callback(note, indirect=False)):
            status: zenoh.MatchingStatus = pose.matching_status  # type: ignore[assignment]  # the stub says bool
            return status.matching or found.wait(timeout_s)

    def close(self) -> None:
        """Say that the vehicle is gone and withdraw its keys; the session stays open."""
        self._token.undeclare()  # type: ignore[no-untyped-call]
        self._queryable.undeclare()  # type: ignore[no-untyped-call]
        for publisher in self._publishers.values():
            publisher.undeclare()  # type: ignore[no-untyped-call]
        self._publishers.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _declare(self, name: str) -> zenoh.Publisher:
        publisher = self._session.declare_publisher(
            self._root + name, encoding=self._encoding, congestion_control=self._control
        )
        self._publishers[name] = publisher
        return publisher

    def _answer(self, query: zenoh.Query) -> None:
        """Reply with the latest of each key that matches; called in a thread of zenoh's."""
        with query:
            for name, (payload, timestamp) in list(self._latest.items()):
                key = self._root + name
                if query.key_expr.intersects(key):
                    query.reply(key, payload, encoding=self._encoding, timestamp=timestamp)
