"""Byte streams over TCP: from a server, and from who connects to us."""

import select
import socket

from mavkf.service.endpoints.link import CHUNK, POLL_S, BackOff, Link, Outlet, Say, Take, reason
from mavkf.service.endpoints.network import bound, is_near

CONNECT_S = 2.0


class _Stream(Link):
    """One connection at a time."""

    def __init__(self, name: str, host: str, port: int, say: Say) -> None:
        super().__init__(name, say)
        self._host, self._port = host, port
        self._outlet = Outlet()
        self._is_local: bool | None = None

    def _begin(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3)):
            if hasattr(socket, option):  # a peer whose network went away says no goodbye
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
        self._is_local = is_near(str(connection.getpeername()[0]))
        self._outlet.attach(connection.fileno())

    def _end(self, connection: socket.socket, take: Take) -> None:
        self._outlet.detach()
        self._is_local = None
        connection.close()
        take(b"", True)

    @property
    def is_local(self) -> bool | None:
        """Whether the peer is near."""
        return self._is_local

    def _send(self, data: bytes) -> bool:
        return self._outlet.send(data)


class TcpClient(_Stream):
    """A byte stream from a server; one that is not there, or goes, is tried again for ever."""

    def receive(self, take: Take) -> None:
        """Connect, give every chunk to `take`, and again, until closed."""
        back_off = BackOff(self.closed)
        told = False
        while not self.closed.is_set():
            try:
                connection = self._connected()
            except OSError as error:
                if not told:
                    self.say(f"{self.name} does not answer ({reason(error)}); it is tried again until it does")
                    told = True
                back_off.wait()
                continue
            self.say(f"connected to {self.name}")
            if self._read(connection, take):
                back_off.reset()
            self._end(connection, take)
            told = False
            if not self.closed.is_set():
                self.say(f"{self.name} closed the connection; it is tried again")
                back_off.wait()

    def _connected(self) -> socket.socket:
        connection = socket.create_connection((self._host, self._port), timeout=CONNECT_S)
        try:
            self._begin(connection)
        except OSError:  # it left again
            connection.close()
            raise
        return connection

    def _read(self, connection: socket.socket, take: Take) -> bool:
        """Read until the connection or this link is closed; whether anything came."""
        came = False
        while not self.closed.is_set():
            if not select.select([connection], [], [], POLL_S)[0]:
                continue
            chunk = _received(connection)
            if not chunk:
                break
            came = True
            take(chunk, False)
        return came


class TcpListener(_Stream):
    """A byte stream from whoever connects; the newest connection takes the place of the one before."""

    def open(self) -> None:
        """Bind the port. Raises EndpointError."""
        self._listener = self._untaken = bound(self.name, self._host, self._port, socket.SOCK_STREAM)
        self.say(f"listens on tcpin:{self._host}:{self._listener.getsockname()[1]}")

    def receive(self, take: Take) -> None:
        """Take connections, and give every chunk to `take`, until closed."""
        self._untaken = None
        connection: socket.socket | None = None
        with self._listener:
            while not self.closed.is_set():
                watched = [self._listener, *([connection] if connection else [])]
                for ready in select.select(watched, [], [], POLL_S)[0]:
                    if ready is self._listener:
                        connection = self._accept(connection, take)
                    elif ready is connection:
                        chunk = _received(ready)
                        if chunk:
                            take(chunk, False)
                        else:
                            self._end(ready, take)
                            connection = None
                            self.say(f"{self.name}: the connection was closed; another one is waited for")
            if connection is not None:
                self._end(connection, take)

    def _accept(self, before: socket.socket | None, take: Take) -> socket.socket | None:
        try:
            connection, peer = self._listener.accept()
        except OSError:  # it left again
            return before
        if before is not None:
            self._end(before, take)
        try:
            self._begin(connection)
        except OSError:
            connection.close()
            return None
        self.say(f"{self.name}: connected from {peer[0]}:{peer[1]}")
        return connection


def _received(connection: socket.socket) -> bytes | None:
    """A chunk; nothing at the end, or where the connection broke."""
    try:
        return connection.recv(CHUNK)
    except OSError:
        return None
