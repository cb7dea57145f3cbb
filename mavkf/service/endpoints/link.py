"""What all links have in common: how they are opened, read, written to and closed."""

import os
import random
import socket
import time
from collections.abc import Callable
from threading import Event, Lock

Take = Callable[[bytes, bool], None]
"""Takes a chunk, and whether it ends what may continue over chunks (a datagram; the end of a connection)."""
Say = Callable[[str], None]

POLL_S = 0.1  # how long a receiver may take to notice that it is closed
CHUNK = 16_384
BACK_OFF_S = (0.2, 5.0)
CROWD_HZ, CROWD_S = 2_000.0, 0.1  # datagrams a second, looked at so often, from where on they may gather
GATHER_S = 1e-3


class Link:
    """A live source of bytes, which most kinds can also be sent to.

    `open`, then `receive` in a thread of its own until `close`; `send` from any one thread meanwhile.

    name:         as on the command line. baud: bits a second of the line, where that is known.
    is_patient:   its bytes wait for whoever sends them while there is no room for them here.
    speaks_first: the other side sends nothing before it has heard something.
    unsent:       messages that could not be sent.
    """

    baud: int | None = None
    is_patient = False
    speaks_first = False

    def __init__(self, name: str, say: Say) -> None:
        """say: takes what the link has to tell while it runs, also from its thread."""
        self.name, self.say = name, say
        self.unsent = 0
        self.has_ended = False
        self.closed = Event()
        self._untaken: socket.socket | None = None  # what `open` has taken and no `receive` has charge of yet

    @property
    def is_local(self) -> bool | None:
        """Whether all who would hear `send` are on this machine or its own network; None while there is nobody."""
        return None

    def open(self) -> None:
        """Take what must be had at once. Raises EndpointError."""

    def receive(self, take: Take) -> None:
        """Give every chunk to `take` until closed, or to the end of what has one (`has_ended`)."""
        raise NotImplementedError

    def send(self, data: bytes) -> bool:
        """Send one whole message without waiting; whether that went. What did not is counted, and lost."""
        went = self._send(data)
        self.unsent += not went
        return went

    def _send(self, data: bytes) -> bool:
        return False

    def close(self) -> None:
        """Make `receive` return soon, and give the device back when it has, or now where it never ran."""
        self.closed.set()
        untaken = self._untaken  # once: the receiver may take it now
        if untaken is not None:
            untaken.close()


class BackOff:
    """Waits between tries: longer each time, and never in step with others who lost the same server."""

    def __init__(self, closed: Event) -> None:
        self._closed = closed
        self.reset()

    def reset(self) -> None:
        """The last try was a success."""
        self._wait = BACK_OFF_S[0]

    def wait(self) -> None:
        """Wait, or until closed."""
        self._closed.wait(self._wait * random.uniform(0.5, 1.0))
        self._wait = min(2.0 * self._wait, BACK_OFF_S[1])


class Crowd:
    """Lets datagrams gather where very many come, so that a receiver does not wake, and take the processor from the work, for each.

    What comes slowly is never held up.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep) -> None:
        """now: a steady clock, s; sleep: waits, s."""
        self._now, self._sleep = now, sleep
        self._since, self._count = now(), 0
        self._is_dense = False

    def came(self, count: int) -> None:
        """Note that so many came at once, and wait a little where that goes on."""
        self._count += count
        past = self._now() - self._since
        if past >= CROWD_S:
            self._is_dense = self._count > CROWD_HZ * past
            self._since, self._count = self._now(), 0
        if self._is_dense:
            self._sleep(GATHER_S)


class Outlet:
    """Writes whole messages to a file descriptor that is not waited for, while another thread may take it away."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._file: int | None = None
        self._rest = b""

    def attach(self, file: int) -> None:
        """Write to this descriptor (non-blocking) from now on."""
        with self._lock:
            self._file, self._rest = file, b""

    def detach(self) -> None:
        """Forget the descriptor; call this before it is closed."""
        with self._lock:
            self._file = None

    def send(self, data: bytes) -> bool:
        """Write a message; of one that was cut by a full buffer the rest goes before the next."""
        with self._lock:
            if self._file is None:
                return False
            try:
                if self._rest:
                    self._rest = self._rest[os.write(self._file, self._rest) :]
                    if self._rest:
                        return False
                self._rest = data[os.write(self._file, data) :]
            except OSError:  # full, or gone; the reading thread sees to what is gone
                return False
            return True


def reason(error: OSError) -> str:
    """What went wrong, in lower case, to stand inside a sentence."""
    return (error.strerror or str(error) or type(error).__name__).lower()
