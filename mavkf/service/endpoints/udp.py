"""Datagrams: a port that others send to, and a port of others that is spoken to first."""

import select
import socket
import time

from mavkf.service.endpoints.link import POLL_S, BackOff, Crowd, Link, Say, Take, reason
from mavkf.service.endpoints.network import bound, is_near

DATAGRAM = 65_535
RECEIVE_BUFFER = 4 << 20  # bytes the kernel keeps for us while another program has the processor
PAUSE_S = 0.01  # after an error, lest one that lasts takes all of the processor
MOST_PEERS = 8
AT_ONCE = 256  # datagrams read before they are handed on
FORGET_S = 30.0


class UdpListener(Link):
    """Datagrams that others send to an address of this machine; port 0 takes a free one. Answers go to whoever sent lately."""

    def __init__(self, name: str, host: str, port: int, say: Say) -> None:
        super().__init__(name, say)
        self._host, self._port = host, port
        self._peers: dict[tuple[str, int], float] = {}  # when each was heard, the latest last
        self._near: dict[str, bool] = {}

    def open(self) -> None:
        """Bind the port. Raises EndpointError."""
        self._socket = self._untaken = bound(self.name, self._host, self._port, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self.say(f"listens on udpin:{self._host}:{self._socket.getsockname()[1]}")

    def receive(self, take: Take) -> None:
        """Give every datagram to `take` until closed."""
        self._untaken = None
        crowd = Crowd()
        with self._socket:
            while not self.closed.is_set():
                if not select.select([self._socket], [], [], POLL_S)[0]:
                    continue
                came: list[tuple[bytes, tuple[str, int]]] = []
                try:
                    while len(came) < AT_ONCE:
                        came.append(self._socket.recvfrom(DATAGRAM))
                except BlockingIOError:  # that was all
                    pass
                except OSError:  # an answer of the network to a datagram of ours, or the network is down
                    self.closed.wait(PAUSE_S)
                for peer in {peer for _, peer in came}:
                    self._note(peer)
                for data, _ in came:
                    take(data, True)
                crowd.came(len(came))

    def _note(self, peer: tuple[str, int]) -> None:
        """Remember a peer; whole dictionaries are exchanged, because another thread reads them."""
        now = time.monotonic()
        peers = {other: at for other, at in self._peers.items() if other != peer and now - at < FORGET_S}
        while len(peers) >= MOST_PEERS:
            del peers[next(iter(peers))]
        if peers.keys() | {peer} != self._peers.keys():
            self._near = {other[0]: is_near(other[0]) for other in (*peers, peer)}
        self._peers = {**peers, peer: now}

    @property
    def is_local(self) -> bool | None:
        """Whether all who sent lately are near."""
        near = list(self._near.values())
        return all(near) if near else None

    def _send(self, data: bytes) -> bool:
        went = False
        for peer in self._peers:
            try:
                went = self._socket.sendto(data, peer) == len(data) or went
            except OSError:
                continue
        return went


class UdpClient(Link):
    """Datagrams from a host and port that answers once it is spoken to."""

    speaks_first = True

    def __init__(self, name: str, host: str, port: int, say: Say) -> None:
        super().__init__(name, say)
        self._host, self._port = host, port
        self._socket: socket.socket | None = None
        self._is_local: bool | None = None

    def receive(self, take: Take) -> None:
        """Give every answer to `take` until closed; a host that has no address or no route yet is tried for ever."""
        back_off = BackOff(self.closed)
        told = False
        while not self.closed.is_set():
            try:
                made = self._connected()
            except OSError as error:
                if not told:
                    self.say(f"{self.name} cannot be reached ({reason(error)}); it is tried again until it can")
                    told = True
                back_off.wait()
                continue
            made.setblocking(False)
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            self._is_local = is_near(str(made.getpeername()[0]))
            self._socket = made
            with made:
                self._read(made, take)

    def _connected(self) -> socket.socket:
        family, kind, protocol, _, address = socket.getaddrinfo(self._host, self._port, type=socket.SOCK_DGRAM)[0]
        made = socket.socket(family, kind, protocol)
        try:
            made.connect(address)
        except OSError:  # there is no route
            made.close()
            raise
        return made

    def _read(self, made: socket.socket, take: Take) -> None:
        crowd = Crowd()
        while not self.closed.is_set():
            if not select.select([made], [], [], POLL_S)[0]:
                continue
            came: list[bytes] = []
            try:
                while len(came) < AT_ONCE:
                    came.append(made.recv(DATAGRAM))
            except BlockingIOError:  # that was all
                pass
            except OSError:  # nobody is there yet
                self.closed.wait(PAUSE_S)
            for data in came:
                take(data, True)
            crowd.came(len(came))

    @property
    def is_local(self) -> bool | None:
        """Whether the host is near."""
        return self._is_local

    def _send(self, data: bytes) -> bool:
        try:
            return self._socket is not None and self._socket.send(data) == len(data)
        except OSError:
            return False
