"""Each kind of link against a real other end: what comes, what is answered, what happens when the other end goes."""

import errno
import ipaddress
import os
import pty
import random
import socket
import subprocess
import sys
import termios
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import serial
from hypothesis import example, given
from hypothesis import strategies as st

from mavkf.cli.serve import serve as serve_command
from mavkf.errors import EndpointError, LogError, UsageError
from mavkf.publish.session import open_session
from mavkf.service.endpoints import KINDS, Link, network, source
from mavkf.service.endpoints.link import CROWD_HZ, CROWD_S, Crowd, Outlet
from mavkf.service.endpoints.network import is_near, own_networks
from mavkf.service.inbox import CAPACITY, Inbox

from .conftest import Frames, Reader, has_pose_at

PATIENCE_S = 20.0


class Heard:
    """What a link gave and said, to be waited for."""

    def __init__(self) -> None:
        self.chunks: list[tuple[bytes, bool]] = []
        self.said: list[str] = []
        self._changed = threading.Condition()

    def take(self, data: bytes, last: bool) -> None:
        with self._changed:
            self.chunks.append((data, last))
            self._changed.notify_all()

    def say(self, text: str) -> None:
        with self._changed:
            self.said.append(text)
            self._changed.notify_all()

    @property
    def data(self) -> bytes:
        return b"".join(chunk for chunk, _ in self.chunks)

    def wait(self, is_enough: Callable[["Heard"], Any]) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: is_enough(self), PATIENCE_S), (self.chunks, self.said)

    def port(self) -> int:
        self.wait(lambda heard: heard.said)
        return int(self.said[0].rsplit(":", 1)[1])


@contextmanager
def running(text: str) -> Iterator[tuple[Link, Heard]]:
    heard = Heard()
    link = source(text, heard.say)
    assert isinstance(link, Link)
    link.open()
    thread = threading.Thread(target=link.receive, args=(heard.take,))
    thread.start()
    try:
        yield link, heard
    finally:
        link.close()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


def until(work: Callable[[], Any]) -> None:
    """Try again until something is so; for what no event tells."""
    deadline = threading.Event()
    for _ in range(int(PATIENCE_S / 0.02)):
        if work():
            return
        deadline.wait(0.02)
    raise AssertionError("it never was so")


def test_a_udp_listener_answers_everybody_it_heard() -> None:
    with running("udpin:127.0.0.1:0") as (link, heard):
        assert link.is_local is None
        assert not link.send(b"nobody")
        with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket(type=socket.SOCK_DGRAM) as two:
            for peer in (one, two):
                peer.settimeout(PATIENCE_S)
                peer.sendto(b"hello", ("127.0.0.1", heard.port()))
            heard.wait(lambda heard: len(heard.chunks) == 2)
            assert heard.chunks == [(b"hello", True)] * 2
            assert link.is_local is True
            assert link.send(b"answer")
            assert [peer.recv(100) for peer in (one, two)] == [b"answer"] * 2
        assert link.unsent == 1


def test_a_udp_listener_remembers_few_of_many_peers() -> None:
    with running("udpin:127.0.0.1:0") as (link, heard):
        peers = [socket.socket(type=socket.SOCK_DGRAM) for _ in range(40)]
        try:
            for k, peer in enumerate(peers):
                peer.settimeout(0.05)
                peer.sendto(b"x", ("127.0.0.1", heard.port()))
                heard.wait(lambda heard, k=k: len(heard.chunks) == k + 1)
            assert link.send(b"answer")
            peers[-1].settimeout(PATIENCE_S)
            assert peers[-1].recv(100) == b"answer"
            with pytest.raises(TimeoutError):
                peers[0].recv(100)
        finally:
            for peer in peers:
                peer.close()


def test_a_udp_client_speaks_first_and_survives_that_nobody_is_there() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        other.close()
        with running(f"udpout:127.0.0.1:{port}") as (link, heard):
            assert link.speaks_first
            until(lambda: link.is_local)
            link.send(b"refused")
            with socket.socket(type=socket.SOCK_DGRAM) as later:
                later.bind(("127.0.0.1", port))
                later.settimeout(0.05)

                def comes() -> bool:
                    link.send(b"hello")
                    try:
                        data, peer = later.recvfrom(100)
                    except TimeoutError:
                        return False
                    later.sendto(b"answer to " + data, peer)
                    return True

                until(comes)
                heard.wait(lambda heard: (b"answer to hello", True) in heard.chunks)


@pytest.mark.parametrize("text", ["udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"])
def test_a_port_that_was_opened_and_never_read_is_given_back(text: str) -> None:
    heard = Heard()
    link = source(text, heard.say)
    assert isinstance(link, Link)
    link.open()
    kind = socket.SOCK_DGRAM if text.startswith("udp") else socket.SOCK_STREAM
    with socket.socket(type=kind) as other, pytest.raises(OSError, match="in use"):
        other.bind(("127.0.0.1", heard.port()))
    link.close()
    with socket.socket(type=kind) as other:
        other.bind(("127.0.0.1", heard.port()))


def test_a_udp_client_without_a_route_leaves_no_socket_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[socket.socket] = []

    class Unroutable(socket.socket):
        def connect(self, _: object) -> None:
            made.append(self)
            raise OSError(101, "Network is unreachable")

    monkeypatch.setattr("mavkf.service.endpoints.udp.socket.socket", Unroutable)
    with running("udpout:127.0.0.1:9") as (_, heard):
        heard.wait(lambda heard: any("cannot be reached" in line for line in heard.said))
        until(lambda: len(made) > 1)
    assert all(one.fileno() == -1 for one in made)


def test_a_tcp_client_writes_and_never_waits_for_who_does_not_read() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        with running(f"tcp:127.0.0.1:{server.getsockname()[1]}") as (link, heard):
            connection, _ = server.accept()
            with connection:
                connection.settimeout(PATIENCE_S)
                heard.wait(lambda heard: heard.said)
                assert link.is_local is True
                message = bytes(range(256)) * 16
                count = 0
                while link.send(message):  # until every buffer is full
                    count += 1
                assert link.unsent == 1
                wanted = (count) * len(message)
                data = b""
                while len(data) < wanted - len(message):
                    data += connection.recv(1 << 20)
                assert link.send(message)  # what was cut is finished first
                wanted += len(message)
                while len(data) < wanted:
                    data += connection.recv(1 << 20)
                assert data == message * (count + 1)
            heard.wait(lambda heard: any("tried again" in text for text in heard.said))
            assert not link.send(b"x")


def test_a_message_that_was_cut_is_finished_before_the_next() -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    outlet, message = Outlet(), bytes(range(250)) * 40
    assert not outlet.send(message)
    outlet.attach(writing)
    sent = 0
    while outlet.send(message):
        sent += 1
    data = b""
    for _ in range(3):
        data += os.read(reading, 1 << 20)
        sent += outlet.send(message)
    outlet.detach()
    assert not outlet.send(message)
    os.close(writing)
    while more := os.read(reading, 1 << 20):
        data += more
    os.close(reading)
    assert data == message * sent
    assert sent * len(message) % 65536


def test_a_tcp_listener_takes_the_newest_connection() -> None:
    with running("tcpin:127.0.0.1:0") as (link, heard):
        address = ("127.0.0.1", heard.port())
        with socket.create_connection(address) as first:
            first.sendall(b"first")
            heard.wait(lambda heard: heard.data == b"first")
            with socket.create_connection(address) as second:
                second.settimeout(PATIENCE_S)
                second.sendall(b"second")
                heard.wait(lambda heard: heard.data == b"firstsecond")
                assert (b"", True) in heard.chunks  # what the first had begun is finished
                assert link.send(b"answer")
                assert second.recv(100) == b"answer"
        heard.wait(lambda heard: any("another one" in text for text in heard.said))
        with socket.create_connection(address) as third:
            third.sendall(b"third")
            heard.wait(lambda heard: heard.data.endswith(b"third"))


@pytest.fixture
def line(tmp_path: Path) -> Iterator[tuple[int, Path]]:
    """A serial line: the far end's file, and a path that a device appears at."""
    far, near = pty.openpty()
    path = tmp_path / "ttyTEST"
    path.symlink_to(os.ttyname(near))
    os.close(near)
    yield far, path
    os.close(far)


def test_a_serial_port_carries_both_ways_and_comes_back(line: tuple[int, Path]) -> None:
    far, path = line
    with running(f"serial:{path}:57600") as (link, heard):
        assert link.baud == 57600
        assert termios.tcgetattr(far)[4] == termios.B57600
        os.write(far, bytes(range(256)))
        heard.wait(lambda heard: len(heard.data) == 256)
        assert heard.data == bytes(range(256))
        assert link.is_local is False
        assert link.send(b"answer")
        assert os.read(far, 100) == b"answer"
        again, near = pty.openpty()
        path.unlink()
        path.symlink_to(os.ttyname(near))
        os.close(near)
        os.close(os.dup(far))
        os.dup2(os.open(os.devnull, os.O_RDWR), far)  # the cable is pulled
        heard.wait(lambda heard: any("vanished" in text for text in heard.said))
        heard.wait(lambda heard: any("is there again" in text for text in heard.said))
        os.write(again, b"back")
        heard.wait(lambda heard: heard.data.endswith(b"back"))
    os.close(again)


def test_a_serial_port_in_use_is_named_with_the_remedy(line: tuple[int, Path]) -> None:
    with (
        serial.Serial(str(line[1]), 57600, exclusive=True),
        pytest.raises(EndpointError, match=r"used by another program: `fuser -v \S+ttyTEST`.*ModemManager"),
        running(f"serial:{line[1]}:57600"),
    ):
        pass


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.EACCES, "usermod -a -G dialout"),
        (errno.EBUSY, "ModemManager"),
        (errno.ENOENT, "/dev/serial/by-id"),
        (errno.ENOTTY, "check path and baud"),
    ],
)
def test_what_keeps_a_serial_port_shut_has_its_remedy(
    number: int, remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(number, "could not open port")

    monkeypatch.setattr(serial, "Serial", refuse)
    link = source("serial:/dev/ttyACM9:57600", print)
    assert isinstance(link, Link)
    with pytest.raises(EndpointError, match=remedy):
        link.open()


def test_without_pyserial_its_name_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    link = source("serial:/dev/ttyACM9:57600", print)
    assert isinstance(link, Link)
    with pytest.raises(EndpointError, match=r"pip install 'mavkf\[serial\]'"):
        link.open()


def test_a_serial_path_may_have_colons() -> None:
    link = source("serial:/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0:921600", print)
    assert isinstance(link, Link)
    assert link.baud == 921600


@pytest.mark.parametrize("text", ["serial:57600", "serial:/dev/x:0", "serial:/dev/x:", "serial:/dev/x:99999999999"])
def test_a_wrong_baud_rate_is_a_usage_error(text: str) -> None:
    with pytest.raises(UsageError, match="path:baud"):
        source(text, print)


@pytest.mark.usefixtures("rendezvous")
def test_a_zenoh_key_is_read_and_its_sibling_answered() -> None:
    with open_session(publishes=True) as world, running("zenoh:mavlink_raw/out") as (link, heard):
        answers = world.declare_subscriber("mavlink_raw/in")
        out = world.declare_publisher("mavlink_raw/out")

        def comes() -> bool:
            out.put(b"frame")
            return bool(heard.chunks)

        until(comes)
        assert heard.chunks[0] == (b"frame", True)
        assert link.is_local is False
        until(
            lambda: link.send(b"answer") and (sample := answers.try_recv()) and sample.payload.to_bytes() == b"answer"
        )


@pytest.mark.usefixtures("rendezvous")
def test_a_zenoh_key_that_has_no_sibling_only_listens() -> None:
    with running("zenoh:elsewhere/frames") as (link, _):
        assert link.is_local is None
        assert not link.send(b"x")


def test_standard_input_ends_the_service(flight: Frames, reader: Reader) -> None:
    data = b"".join(frame for _, frame in flight)
    words = [sys.executable, "-m", "mavkf", "serve", "stdin", "--quiet"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            reader.wait_for_publisher()
            _, errors = process.communicate(data, timeout=PATIENCE_S)
            assert process.returncode == 0, errors
        finally:
            process.kill()
    reader.wait(has_pose_at(20.9))


def test_a_patient_chunk_waits_for_room_and_is_let_go_at_the_end() -> None:
    box = Inbox(lambda _: None)
    big = bytes(CAPACITY // 2)
    box.put(0, big, False)
    waiting = threading.Thread(target=box.put, args=(0, big, False), kwargs={"patient": True})
    waiting.start()
    waiting.join(0.05)
    assert waiting.is_alive()
    assert len(box.get(0.0)) == 1
    waiting.join(PATIENCE_S)
    assert len(box.get(0.0)) == 1
    assert box.dropped == 0
    box.put(0, big, False)
    late = threading.Thread(target=box.put, args=(0, big, False), kwargs={"patient": True})
    late.start()
    box.close()
    late.join(PATIENCE_S)
    assert not late.is_alive()


@pytest.mark.parametrize(
    ("host", "near"),
    [
        ("127.0.0.1", True),
        ("::1", True),
        ("::ffff:127.0.0.1", True),
        ("fe80::1%eth0", True),
        ("8.8.8.8", False),
        ("10.99.99.99", False),
        ("172.30.1.9", True),
        ("172.30.2.9", False),
        ("2001:db8::1", False),
        ("not-an-address", False),
    ],
)
def test_near_is_this_machine_and_its_own_private_networks(
    host: str, near: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network, "own_networks", lambda: map(ipaddress.IPv4Network, ["172.30.1.0/24", "8.8.8.0/24"]))
    assert is_near(host) is near


def test_this_machines_own_networks_are_known() -> None:
    assert any(network.is_loopback and network.prefixlen == 8 for network in own_networks())


@given(
    st.builds(
        str.__add__,
        st.sampled_from(["", *(f"{kind}:" for kind in KINDS), "udpin:127.0.0.1:", "serial:/dev/x:"]),
        st.text(),
    )
)
@example("x" * 5000)
@example("udpin:[::1]:14550")
def test_any_words_make_a_source_or_one_sentence(text: str) -> None:
    try:
        made = source(text, print)
    except (UsageError, LogError) as error:
        assert "\n" not in str(error).replace(text, "")
    else:
        assert isinstance(made, Link | Path)


@pytest.mark.parametrize("kind", ["tcp", "tcpin", "serial"])
def test_a_stream_arrives_as_it_was_sent(kind: str, line: tuple[int, Path]) -> None:
    far, path = line
    data = random.Random(1).randbytes(200_000)
    with ExitStack() as ends:
        server = ends.enter_context(socket.create_server(("127.0.0.1", 0)))
        server.settimeout(PATIENCE_S)
        text = {
            "tcp": f"tcp:127.0.0.1:{server.getsockname()[1]}",
            "tcpin": "tcpin:127.0.0.1:0",
            "serial": f"serial:{path}:921600",
        }[kind]
        _, heard = ends.enter_context(running(text))
        if kind == "serial":
            write = partial(os.write, far)
        elif kind == "tcp":
            write = ends.enter_context(server.accept()[0]).send
        else:
            write = ends.enter_context(socket.create_connection(("127.0.0.1", heard.port()))).send
        at = 0
        while at < len(data):
            at += write(data[at : at + 1 + at % 3001])
        heard.wait(lambda heard: sum(len(chunk) for chunk, _ in heard.chunks) == len(data))
        assert heard.data == data


def test_help_names_every_kind() -> None:
    text = " ".join((serve_command.__doc__ or "").split())
    for kind in KINDS.values():
        assert f"{kind.syntax} ({kind.meaning}" in text


@pytest.mark.parametrize(("rate_hz", "is_dense"), [(0.5 * CROWD_HZ, False), (2.0 * CROWD_HZ, True)])
def test_only_where_very_many_come_they_gather(rate_hz: float, is_dense: bool) -> None:
    now, slept = [10.0], []
    crowd = Crowd(lambda: now[0], slept.append)
    for _ in range(round(3.0 * CROWD_S * rate_hz)):
        now[0] += 1.0 / rate_hz
        crowd.came(1)
    assert bool(slept) is is_dense
    now[0] += 1.0  # silence, then one: that the crowd is over is known at once
    slept.clear()
    crowd.came(1)
    assert not slept


def test_datagrams_that_wait_are_all_given_in_their_order() -> None:
    sent = [b"%d" % k for k in range(600)]
    with running("udpin:127.0.0.1:0") as (_, heard), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        port = heard.port()
        for one in sent:
            other.sendto(one, ("127.0.0.1", port))
        heard.wait(lambda heard: len(heard.chunks) >= len(sent))
    assert heard.chunks == [(one, True) for one in sent]
