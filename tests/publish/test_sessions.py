import json
import os
import queue
import re
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh

from mavkf.errors import EndpointError, MavkfError, UsageError
from mavkf.estimate import Innovation, Pose
from mavkf.publish.publisher import Publisher
from mavkf.publish.records import decode
from mavkf.publish.session import _tell_absent, _tell_stranger, open_session
from mavkf.publish.subscriber import CAPACITY, Inbox, subscribe

from .conftest import Child, listening, make_pose

README = Path(__file__).parents[2] / "README.md"

PUBLISHER = """
import sys, threading
from mavkf.estimate import Pose
from mavkf.publish.publisher import Publisher
from mavkf.publish.session import open_session
with open_session(publishes=True) as session, Publisher(session, sys.argv[1]) as publisher:
    print("open")
    for seq in range(10**9):
        publisher.publish(Pose(vehicle=sys.argv[1], session=0, seq=seq))
        threading.Event().wait(0.02)
"""

WATCHER = """
from mavkf.publish.subscriber import subscribe
subscription = subscribe()
print("open")
for pose in subscription:
    print(pose.vehicle)
"""


def test_the_plain_subscriber_of_the_readme_that_was_first_gets_every_pose_in_order(
    rendezvous: str, start: Callable[..., Child]
) -> None:
    (program,) = re.findall(r"```python\n(import json, zenoh\n.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    child = start(program.replace("tcp/127.0.0.1:7447", rendezvous))
    with open_session(publishes=True) as session, Publisher(session, "1-1", congestion="block") as publisher:
        assert publisher.wait_for_subscriber(20.0)
        for seq in range(5000):
            publisher.publish(make_pose(seq, position_ned_m=(float(seq), 0.0, 0.0)))
        assert [json.loads(child.line())[0] for _ in range(5000)] == list(range(5000))
        assert publisher.counts == {"pose": 5000}


def test_nobody_subscribes(rendezvous: str) -> None:
    with open_session(publishes=True) as session, Publisher(session, "1-1") as publisher:
        assert not publisher.wait_for_subscriber(0.05)


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_late_joiner_query_and_liveliness(rendezvous: str, encoding: str) -> None:
    told: queue.Queue[tuple[str, zenoh.SampleKind]] = queue.Queue()
    with open_session(publishes=True) as session, open_session(publishes=False) as other:
        other.liveliness().declare_subscriber("mavkf/*/alive", lambda s: told.put((str(s.key_expr), s.kind)))
        with Publisher(session, "bee_2", encoding=encoding) as publisher:  # type: ignore[arg-type]
            assert told.get(timeout=10) == ("mavkf/bee_2/alive", zenoh.SampleKind.PUT)
            for seq in range(3):
                publisher.publish(make_pose(seq, "bee_2"))
            publisher.publish(Innovation(vehicle="bee_2", session=0, seq=0, sensor="gnss", fused=True))

            with subscribe() as late, subscribe("bee_2", what="innovation") as innovations:
                assert late.receive(10) == make_pose(2, "bee_2")
                record = innovations.receive(10)
                assert record is not None and record.sensor == "gnss"
                assert late.alive == {"bee_2"}
                publisher.publish(make_pose(3, "bee_2"))
                publisher.publish(make_pose(6, "bee_2"))
                assert [pose.seq for _, pose in zip(range(2), late, strict=False)] == [3, 6]
                assert late.counts == {"received": 3, "garbage": 0, "missed": 2, "dropped": 0}

            for selector, keys in (
                ("mavkf/bee_2/pose", ["pose"]),
                ("mavkf/*/pose", ["pose"]),
                ("mavkf/bee_2/**", ["innovation/gnss", "pose"]),
                ("mavkf/bee_2/status", []),
                ("mavkf/other/pose", []),
            ):
                samples = [reply.ok for reply in other.get(selector, timeout=5) if reply.ok is not None]
                assert sorted(str(sample.key_expr) for sample in samples) == [f"mavkf/bee_2/{key}" for key in keys]
                assert all(str(sample.encoding) == f"application/{encoding}" for sample in samples)
                assert all(sample.timestamp is not None for sample in samples)
            [reply] = other.get("mavkf/*/pose", timeout=5)
            assert reply.ok is not None
            assert decode("pose", reply.ok.payload.to_bytes()) == make_pose(6, "bee_2")
        assert told.get(timeout=10) == ("mavkf/bee_2/alive", zenoh.SampleKind.DELETE)


def test_a_subscriber_that_was_first_hears_of_a_later_publisher(rendezvous: str) -> None:
    with subscribe("1-1") as subscription, open_session(publishes=True) as session, Publisher(session, "1-1") as sender:
        sender.publish(make_pose(41))
        assert subscription.receive(10) == make_pose(41)


def test_a_slow_reader_of_a_blocking_publisher_loses_nothing(rendezvous: str) -> None:
    many = CAPACITY + 4000

    def send(publisher: Publisher) -> None:
        for seq in range(many):
            publisher.publish(Pose(vehicle="1-1", session=0, seq=seq))

    with (
        open_session(publishes=True) as session,
        Publisher(session, "1-1", congestion="block") as publisher,
        subscribe("1-1") as subscription,
    ):
        assert publisher.wait_for_subscriber(10)
        sender = threading.Thread(target=send, args=(publisher,))
        sender.start()
        sender.join(timeout=1.0)  # full by now, or sent: either must do
        assert [pose.seq for _, pose in zip(range(many), subscription, strict=False)] == list(range(many))
        sender.join()
        assert subscription.counts == {"received": many, "garbage": 0, "missed": 0, "dropped": 0}


@dataclass
class Put:
    """As much of a zenoh sample as the inbox looks at."""

    seq: int
    key_expr: str = "mavkf/1-1/pose"
    kind = zenoh.SampleKind.PUT
    congestion_control = zenoh.CongestionControl.DROP

    @property
    def payload(self) -> zenoh.ZBytes:
        return zenoh.ZBytes(str(self.seq).encode())


@pytest.mark.parametrize(("latest_only", "kept"), [(False, CAPACITY), (True, 1)])
def test_a_slow_reader_of_a_live_publisher_keeps_the_newest(latest_only: bool, kept: int) -> None:
    inbox = Inbox(latest_only=latest_only)
    for seq in range(3 * CAPACITY):
        inbox.take(Put(seq))  # type: ignore[arg-type]
    items = iter(lambda: inbox.next(0.0), None)
    assert [int(payload) for _, payload, _ in items] == list(range(3 * CAPACITY))[-kept:]
    assert inbox.counts["dropped"] == 3 * CAPACITY - kept
    for seq in range(3 * CAPACITY):
        inbox.take(Put(seq, key_expr=f"mavkf/{seq}/pose"))  # type: ignore[arg-type]
    assert len(list(iter(lambda: inbox.next(0.0), None))) == CAPACITY


def test_garbage_is_counted(rendezvous: str) -> None:
    with subscribe() as subscription, open_session(publishes=True) as session, Publisher(session, "1-1") as publisher:
        assert publisher.wait_for_subscriber(10)
        for payload in (b"", b"{", b"\xff", b"{\x80}", b"[" * 100_000, b'{"a":' * 100_000):
            session.put("mavkf/1-1/pose", payload, congestion_control=zenoh.CongestionControl.BLOCK)
        publisher.publish(make_pose())
        assert subscription.receive(10) == make_pose()
        assert subscription.counts["garbage"] == 6


def test_iteration_without_with_ends_by_close(rendezvous: str) -> None:
    with open_session(publishes=True) as session, Publisher(session, "1-1") as publisher:
        publisher.publish(make_pose())
        subscription = subscribe("1-1")
        for pose in subscription:
            assert pose == make_pose()
            subscription.close()


FORGETFUL = """
import sys
from mavkf.estimate import Pose
from mavkf.publish.publisher import Publisher
from mavkf.publish.session import open_session
from mavkf.publish.subscriber import subscribe
session = open_session(publishes=True)
publisher = Publisher(session, "1-1")
publisher.publish(Pose(vehicle="1-1", session=0, seq=5))
publisher.wait_for_subscriber(0.01)
subscription = subscribe()
for pose in subscribe():
    break
print(next(subscription).seq + pose.seq)
"""


def test_a_process_that_closes_nothing_ends(rendezvous: str, start: Callable[..., Child]) -> None:
    child = start(FORGETFUL)
    child.wait_for("10")
    assert child.process.wait(timeout=10) == 0


def test_the_rest_find_each_other_when_the_holder_of_the_rendezvous_dies(
    rendezvous: str, start: Callable[..., Child]
) -> None:
    port = f"tcp 0100007F:{int(rendezvous.rsplit(':', 1)[1]):04X}"
    early = start(WATCHER)
    early.wait_for("open")
    first = start(PUBLISHER, "first")
    first.wait_for("open")
    second = start(PUBLISHER, "second")
    second.wait_for("open")
    other = start(WATCHER)
    for watcher in (early, other):
        watcher.wait_for("first")
        watcher.wait_for("second")
    assert port in listening(first.process.pid)
    assert port not in listening(second.process.pid)
    for child in (early, first, second, other):
        assert all(address.startswith("tcp 0100007F:") for address in listening(child.process.pid))
        assert listening(child.process.pid)

    first.kill()
    late = start(WATCHER)
    late.wait_for("second")
    for watcher in (early, other):
        watcher.forget()
        watcher.wait_for("second")
    third = start(PUBLISHER, "third")
    for watcher in (early, other, late):
        watcher.wait_for("third")
    assert port in listening(second.process.pid) | listening(third.process.pid)


def test_an_asked_endpoint_that_is_not_there_is_said_once(rendezvous: str) -> None:
    said: queue.Queue[str] = queue.Queue()
    with open_session(publishes=False, connect=["tcp/127.0.0.1:9", rendezvous], say=said.put):
        assert "tcp/127.0.0.1:9 " in said.get(timeout=10)
        assert rendezvous in said.get(timeout=10)
    with (
        open_session(publishes=True),
        open_session(publishes=False, connect=[rendezvous, "tcp/x.invalid:9"], say=said.put),
    ):
        assert "tcp/x.invalid:9 " in said.get(timeout=10)
        assert said.empty()


@pytest.mark.parametrize(
    "bad", ["", "foo", "tcp/", "tcp/localhost", "tcp/127.0.0.1:70000", "bla/1.2.3.4:7447", "1.2.3.4:7447", "tcp/a b:7"]
)
def test_bad_endpoints_are_named(rendezvous: str, bad: str) -> None:
    with pytest.raises(UsageError, match=r"--connect .*as in tcp/"):
        open_session(publishes=False, connect=[bad])
    with pytest.raises(UsageError, match=r"--listen .*as in tcp/"):
        open_session(publishes=False, listen=[bad])


def test_a_taken_port_to_listen_on_is_an_error(rendezvous: str) -> None:
    with open_session(publishes=True), pytest.raises(EndpointError, match="--listen"):
        open_session(publishes=False, listen=[rendezvous])


def test_a_rendezvous_that_another_program_holds_is_said_with_the_remedy(
    rendezvous: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavkf.publish.session._STRANGER_S", 0.5)
    said: queue.Queue[str] = queue.Queue()
    port = int(rendezvous.rsplit(":", 1)[1])
    stranger = socket.create_server(("127.0.0.1", port))
    with stranger, open_session(publishes=True, say=said.put):
        sentence = said.get(timeout=10)
        stranger.close()
        # zenoh takes the rendezvous itself now; before that it does not close at once
        deadline = time.monotonic() + 10.0
        while f"tcp 0100007F:{port:04X}" not in listening(os.getpid()):
            assert time.monotonic() < deadline
            time.sleep(0.05)
    assert all(part in sentence for part in (rendezvous, "end that program", "MAVKF_RENDEZVOUS"))
    with (
        open_session(publishes=True, say=said.put),
        open_session(publishes=False, say=said.put),
        pytest.raises(queue.Empty),
    ):
        said.get(timeout=1.0)


def test_configuration_files(rendezvous: str, tmp_path: Path) -> None:
    bad, good = tmp_path / "bad.json5", tmp_path / "good.json5"
    bad.write_text('{mode: "bee"}')
    good.write_text(
        json.dumps({"mode": "peer", "scouting": {"multicast": {"enabled": False}}, "listen": {"endpoints": []}})
    )
    for path in (bad, tmp_path / "none.json5"):
        with pytest.raises(UsageError, match=r"--zenoh-config .*json5"):
            open_session(publishes=False, config_file=path)
    with open_session(publishes=True) as session, Publisher(session, "1-1") as publisher:
        publisher.publish(make_pose())
        with subscribe("1-1", config_file=good, connect=[rendezvous]) as subscription:
            assert subscription.receive(10) == make_pose()
            assert all(address.startswith("tcp 0100007F:") for address in listening(os.getpid()))


def test_wrong_arguments(rendezvous: str) -> None:
    for arguments in ({"vehicle": "a/b"}, {"what": "poses"}, {"connect": rendezvous}):
        with pytest.raises(UsageError):
            subscribe(**arguments)  # type: ignore[call-overload]
    with open_session(publishes=True) as session:
        for more in ({"vehicle": "a/b"}, {"encoding": "xml"}, {"congestion": "wait"}):
            with pytest.raises(UsageError):
                Publisher(session, **({"vehicle": "1-1"} | more))  # type: ignore[arg-type]
        with Publisher(session, "1-1") as publisher:
            with pytest.raises(ValueError, match="2-1"):
                publisher.publish(make_pose(vehicle="2-1"))
            with pytest.raises(MavkfError, match="sensor"):
                publisher.publish(Innovation(vehicle="1-1", session=0, seq=0, sensor="a/b", fused=True))


def test_a_session_that_is_being_closed_has_nothing_to_tell() -> None:
    class Closing:
        """What a session is to other threads while one closes it."""

        def is_closed(self) -> bool:
            raise RuntimeError("Already mutably borrowed")

    said: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as taken:
        place = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        _tell_stranger(Closing(), place, said.append)  # type: ignore[arg-type]
        _tell_absent(Closing(), [place], said.append)  # type: ignore[arg-type]
    assert said == []
