"""Raw MAVLink frames on a zenoh key, as mavlink-server publishes them on `mavlink_raw/out`."""

from collections.abc import Callable

import zenoh
from zenoh.handlers import Callback

from mavkf.errors import UsageError
from mavkf.service.endpoints.link import Link, Say, Take

OUT, IN = "out", "in"


class ZenohKey(Link):
    """The samples of a key, each one or more whole frames; answers go to the key's sibling `in` where it ends in `out`."""

    def __init__(self, name: str, key: str, session: Callable[[], zenoh.Session], say: Say) -> None:
        """session: opens a session of this link's own, with which it reaches the rest of the world."""
        super().__init__(name, say)
        try:
            self._key = zenoh.KeyExpr.autocanonize(key)
        except zenoh.ZError:
            raise UsageError(f"{name}: {key!r} is no zenoh key, as in zenoh:mavlink_raw/out") from None
        self._open_session = session
        head, _, tail = key.rpartition("/")
        self._answers = f"{head}/{IN}" if head and tail == OUT and "*" not in key else None
        self._publisher: zenoh.Publisher | None = None

    def open(self) -> None:
        """Open the session. Raises EndpointError."""
        self._session = self._open_session()

    def receive(self, take: Take) -> None:
        """Give every sample to `take` until closed."""
        with self._session as session:
            if self._answers is not None:
                self._publisher = session.declare_publisher(
                    self._answers, encoding=zenoh.Encoding("application/octet-stream;mavlink")
                )

            def hear(sample: zenoh.Sample) -> None:
                take(sample.payload.to_bytes(), True)

            subscriber = session.declare_subscriber(self._key, Callback(hear, indirect=False))
            self.closed.wait()
            self._publisher = None
            subscriber.undeclare()

    @property
    def is_local(self) -> bool | None:
        """Never: what lies between is not known."""
        return False if self._publisher is not None else None

    def _send(self, data: bytes) -> bool:
        publisher = self._publisher
        if publisher is None:
            return False
        try:
            publisher.put(data)
        except zenoh.ZError:  # closed meanwhile
            return False
        return True
