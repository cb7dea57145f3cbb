"""Where telemetry comes from: one registry, one syntax.

    udpin:HOST:PORT    listen for datagrams
    tcp:HOST:PORT      connect to a server, for ever
    anything else      the path of a log

A link is opened by `open`, then `receive` runs in a thread of its own until `close`. What it gives away has no stamp yet:
the `Inbox` takes the arrival stamp, once.
"""

import errno
import re
import socket
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Protocol

from mavkf.errors import EndpointError, LogError, UsageError

Take = Callable[[bytes, bool], None]
"""Takes a chunk, and whether it ends what may continue over chunks (a datagram; the end of a connection)."""
Say = Callable[[str], None]

POLL_S = 0.1  # how long a receiver may take to notice that it is closed
DATAGRAM = 65_535
CHUNK = 16_384
RECEIVE_BUFFER = 4 << 20  # bytes the kernel keeps for us while another program has the processor
BACK_OFF_S = (0.2, 5.0)
_HOST_PORT = re.compile(r"(\[(?P<six>[0-9A-Fa-f:.%\w]+)\]|(?P<host>[^:\s\[\]]+)):(?P<port>\d{1,5})")
_SCHEME = re.compile(r"(?P<scheme>[a-z][a-z0-9]*):(?P<rest>.*)")


class Link(Protocol):
    """A live source."""

    name: str

    def open(self) -> None:
        """Take what must be had at once. Raises EndpointError."""

    def receive(self, take: Take) -> None:
        """Give every chunk to `take` until closed; runs in a thread of its own."""

    def close(self) -> None:
        """Make `receive` return soon, and give the device back when it has."""


class UdpListener:
    """Datagrams that others send to an address of this machine; port 0 takes a free one."""

    def __init__(self, name: str, host: str, port: int, say: Say) -> None:
        self.name, self._host, self._port, self._say = name, host, port, say
        self._closed = Event()

    def open(self) -> None:
        """Bind the port. Raises EndpointError."""
        self._socket = None
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(self._host, self._port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            self._socket.bind(address)
        except OSError as error:
            if self._socket is not None:
                self._socket.close()
            raise EndpointError(f"{self.name} {_remedy(error)}") from None
        self._socket.settimeout(POLL_S)
        port = self._socket.getsockname()[1]
        self._say(f"listens on udpin:{self._host}:{port}")

    def receive(self, take: Take) -> None:
        """Give every datagram to `take` until closed."""
        assert self._socket is not None
        with self._socket:
            while not self._closed.is_set():
                try:
                    take(self._socket.recv(DATAGRAM), True)
                except TimeoutError:
                    continue
                except (
                    ConnectionError
                ):  # an answer of the network to a datagram of ours; nothing that was received is lost
                    continue

    def close(self) -> None:
        """End `receive`."""
        self._closed.set()


class TcpClient:
    """A byte stream from a server; one that is not there, or goes, is tried again for ever."""

    def __init__(self, name: str, host: str, port: int, say: Say) -> None:
        self.name, self._host, self._port, self._say = name, host, port, say
        self._closed = Event()

    def open(self) -> None:
        """Nothing has to be had at once: the server may come later."""

    def receive(self, take: Take) -> None:
        """Connect, give every chunk to `take`, and again, until closed."""
        wait, told = BACK_OFF_S[0], False
        while not self._closed.is_set():
            try:
                connection = socket.create_connection((self._host, self._port), timeout=2.0)
            except OSError as error:
                if not told:
                    self._say(f"{self.name} does not answer ({_reason(error)}); it is tried again until it does")
                    told = True
                self._closed.wait(wait)
                wait = min(2.0 * wait, BACK_OFF_S[1])
                continue
            self._say(f"connected to {self.name}")
            with connection:
                if self._read(connection, take):
                    wait = BACK_OFF_S[0]
            take(b"", True)
            told = False
            if not self._closed.is_set():
                self._say(f"{self.name} closed the connection; it is tried again")
                self._closed.wait(wait)
                wait = min(2.0 * wait, BACK_OFF_S[1])

    def _read(self, connection: socket.socket, take: Take) -> bool:
        """Read until the connection or this link is closed; whether anything came."""
        connection.settimeout(POLL_S)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3)):
            if hasattr(socket, option):  # a server whose network went away says no goodbye
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
        came = False
        while not self._closed.is_set():
            try:
                chunk = connection.recv(CHUNK)
            except TimeoutError:
                continue
            except OSError:
                break
            if not chunk:
                break
            came = True
            take(chunk, False)
        return came

    def close(self) -> None:
        """End `receive`."""
        self._closed.set()


SCHEMES: dict[str, Callable[[str, str, Say], Link]] = {
    "udpin": lambda name, rest, say: UdpListener(name, *_host_port(name, rest), say),
    "tcp": lambda name, rest, say: TcpClient(name, *_host_port(name, rest), say),
}
"""Makes the link of a scheme from its whole name and what follows the colon."""


def source(text: str, say: Say) -> Link | Path:
    """Give the link or the log that a SOURCE of the command line means; nothing is opened.

    say: takes what the link has to tell while it runs, also from its thread.

    Raises UsageError for an unknown scheme or a malformed address, LogError for a log that is not there.
    """
    match = _SCHEME.fullmatch(text)
    if match and not Path(text).exists():
        make = SCHEMES.get(match["scheme"])
        if make is None:
            known = ", ".join(f"{scheme}:host:port" for scheme in SCHEMES)
            raise UsageError(f"{text}: there is no source {match['scheme']}:, only {known} or the path of a log")
        return make(text, match["rest"], say)
    if not Path(text).exists():
        raise LogError(
            f"{text} does not exist; check the name and the folder, or give udpin:host:port or tcp:host:port"
        )
    return Path(text)


def _host_port(name: str, rest: str) -> tuple[str, int]:
    match = _HOST_PORT.fullmatch(rest)
    if match is None or int(match["port"]) > 65_535:
        raise UsageError(f"{name}: expected host:port after the colon, as in {name.partition(':')[0]}:127.0.0.1:14550")
    return match["six"] or match["host"], int(match["port"])


def _reason(error: OSError) -> str:
    return (error.strerror or str(error) or type(error).__name__).lower()


def _remedy(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "is taken by another program (a ground station, or a second mavkf): end that one or choose another port"
    if error.errno == errno.EADDRNOTAVAIL:
        return "is no address of this machine: use 127.0.0.1, or 0.0.0.0 for all of its addresses"
    if error.errno == errno.EACCES:
        return "may not be opened by this user: choose a port above 1023"
    return f"cannot be opened ({_reason(error)}): check host and port"
