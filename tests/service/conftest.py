"""What the tests of the service share: a made-up flight, real processes, and a reader of all that is published."""

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from zenoh.handlers import Callback

from mavkf.config import Config
from mavkf.publish.records import encode, key_of
from mavkf.publish.session import open_session
from mavkf.replay.tlog import read_tlog
from mavkf.service.vehicle import VehicleStream
from mavkf.service.warmup import ensure_compiled

BEGIN_US = 1_760_000_000_000_000
SECONDS = 20
MAVKF = (sys.executable, "-m", "mavkf")
Frames = list[tuple[int, bytes]]
Published = dict[str, list[dict[str, Any]]]


@pytest.fixture(scope="session", autouse=True)
def compiled() -> None:
    ensure_compiled(lambda text: print(text, file=sys.__stderr__))


@pytest.fixture(scope="session")
def flight() -> Frames:
    """Twenty seconds at rest as an autopilot tells them, a ground station's heartbeats among them."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    vehicle = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    rng = random.Random(1)

    def noise(size: int) -> int:
        return rng.randint(-size, size)

    frames: Frames = []

    def send(sender: Any, message: Any) -> None:
        frames.append((BEGIN_US + us, message.pack(sender)))
        sender.seq = (sender.seq + 1) % 256

    for k in range(SECONDS * 50):
        us = 1_000_000 + k * 20_000
        imu = (us, noise(5), noise(5), -1000 + noise(5), noise(3), noise(3), noise(3), 220, 10, 430)
        send(vehicle, mavlink.MAVLink_raw_imu_message(*imu))
        if k % 10 == 0:
            fix = (us, 3, 473977418 + noise(10), 85455938 + noise(10), 488_000 + noise(200), 80, 120, 3, 0, 12)
            send(vehicle, mavlink.MAVLink_gps_raw_int_message(*fix))
        if k % 50 == 0:
            send(vehicle, mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
            send(vehicle, mavlink.MAVLink_system_time_message(BEGIN_US + us, us // 1000))
            send(station, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    return frames


def tlog(frames: Frames) -> bytes:
    """The bytes of a log of frames."""
    return b"".join(stamp.to_bytes(8, "big") + frame for stamp, frame in frames)


class Serve:
    """A real `mavkf serve` process; its lines on stderr can be waited for."""

    def __init__(self, *words: str) -> None:
        self.process = subprocess.Popen([*MAVKF, "serve", *words], stderr=subprocess.PIPE, text=True)
        self.lines: list[str] = []

    def line(self, part: str) -> str:
        """Read stderr up to a line that holds `part`, and give that."""
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)
            if part in line:
                return line
        raise AssertionError(f"ended with {self.process.wait()} before it said {part!r}: {''.join(self.lines)}")

    def end(self) -> int:
        """Wait for the end; its exit code."""
        assert self.process.stderr is not None
        with self.process.stderr:
            self.lines.extend(self.process.stderr)
        return self.process.wait(timeout=20)

    def interrupt(self) -> int:
        """Press Ctrl-C; its exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.end()


@pytest.fixture
def serve() -> Iterator[Callable[..., Serve]]:
    started: list[Serve] = []

    def start(*words: object) -> Serve:
        started.append(Serve(*map(str, words)))
        return started[-1]

    yield start
    for one in started:
        if one.process.poll() is None:
            one.process.kill()
            one.end()


class Reader:
    """All that is published, by key, in order; what has come can be waited for."""

    def __init__(self, session: zenoh.Session) -> None:
        self.published: Published = {}
        self._session = session
        self._changed = threading.Condition()
        self._subscriber = session.declare_subscriber("mavkf/**", Callback(self._take, indirect=False))

    def _take(self, sample: zenoh.Sample) -> None:
        with self._changed:
            record = json.loads(sample.payload.to_bytes())
            self.published.setdefault(str(sample.key_expr), []).append(record)
            self._changed.notify_all()

    def wait_for_publisher(self, timeout_s: float = 20.0) -> None:
        """Wait until a service has found this reader: what it published before would be missed."""
        deadline = time.monotonic() + timeout_s
        while not self._session.info.peers_zid():
            assert time.monotonic() < deadline, "no publisher has come"
            time.sleep(0.02)

    def wait(self, is_enough: Callable[[Published], bool], timeout_s: float = 20.0) -> Published:
        with self._changed:
            assert self._changed.wait_for(lambda: is_enough(self.published), timeout_s), count(self.published)
            return self.published


@pytest.fixture
def reader() -> Iterator[Reader]:
    with open_session(publishes=False) as session:
        yield Reader(session)


def count(published: Published) -> dict[str, int]:
    return {key: len(records) for key, records in published.items()}


def expected(path: Path, address: tuple[int, int] = (1, 1)) -> Published:
    """What the rows of a recording give, in file order, through the wire's encoding."""
    stream = VehicleStream(f"{address[0]}-{address[1]}", Config())
    found: Published = {}
    rows = read_tlog(path).rows[address]
    for steps in (stream.push(rows), stream.finish()):
        for step in steps:
            for record in stream.records(step):
                found.setdefault(key_of(record), []).append(json.loads(encode(record)))
    return found


def without_utc(published: Published) -> Published:
    return {
        key: [{name: value for name, value in record.items() if name != "utc_ns"} for record in records]
        for key, records in published.items()
    }


def one_recording(folder: Path) -> Path:
    (path,) = folder.iterdir()
    return path


def has_pose_at(t_boot_s: float, vehicle: str = "1-1") -> Callable[[Published], bool]:
    """Whether a pose of that boot time or later has come."""
    return lambda published: any(
        pose["t_boot_s"] >= t_boot_s for pose in published.get(f"mavkf/{vehicle}/pose", [])[-1:]
    )


FLIGHTS = os.environ.get("MAVKF_FLIGHTS")
