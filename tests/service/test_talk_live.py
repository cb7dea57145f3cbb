"""The service as a process and a scripted autopilot: asked, signed, allowed, heard over two links, and left as it was found."""

import hashlib
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mavkf.cli import main
from mavkf.service.signing import stamp_of

from ._autopilot import Autopilot
from .conftest import SECONDS, Frames, Reader, Serve, count, has_pose_at, one_recording, without_utc

Start = Callable[..., Serve]
KEY = hashlib.sha256(b"a secret").hexdigest()
SPEED = 8.0  # of the autopilot's life: more seconds of flight in a short test


@contextmanager
def flown(autopilot: Autopilot, server: socket.socket, other: Callable[[], bytes] = bytes) -> Iterator[None]:
    """The autopilot serves one connection; bytes of `other` come between its frames."""
    done = threading.Event()

    def live() -> None:
        connection, _ = server.accept()
        connection.settimeout(0.02)
        begin = time.monotonic()
        with connection:
            while not done.is_set():
                connection.sendall(b"".join(autopilot.advance((time.monotonic() - begin) * SPEED)) + other())
                try:
                    heard = connection.recv(4096)
                except TimeoutError:
                    continue
                if not heard:
                    return
                autopilot.hear(heard)

    server.settimeout(20)
    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join(20)


def poses_of(recordings: list[Path], output: Path) -> list[dict[str, Any]]:
    assert main(["replay", *map(str, recordings), "--jsonl", str(output)]) == 0
    return [json.loads(line) for line in output.read_text().splitlines()]


def assert_same_poses(reader: Reader, recordings: list[Path], output: Path) -> None:
    wanted = {"mavkf/1-1/pose": poses_of(recordings, output)}
    published = reader.wait(
        lambda published: count(published).get("mavkf/1-1/pose", 0) >= len(wanted["mavkf/1-1/pose"])
    )
    assert {key for key in published if key.endswith("/pose")} == set(wanted)
    assert without_utc({key: published[key] for key in wanted}) == without_utc(wanted)
    assert len(wanted["mavkf/1-1/pose"]) > 20  # a busy machine has fewer in the same time


def test_a_shy_signed_autopilot_is_asked_believed_and_left_as_it_was(
    serve: Start, reader: Reader, tmp_path: Path
) -> None:
    shy = Autopilot(intervals_us={"GPS2_RAW": 1_000_000}, parameters={"GPS1_POS_X": 0.2, "INS_POS1_X": -0.1})
    signing = shy.wire.signing
    signing.secret_key, signing.sign_outgoing = bytes.fromhex(KEY), True
    signing.timestamp = stamp_of(time.time_ns() // 1000)
    shy.ear.signing.secret_key = bytes.fromhex(KEY)
    stranger, forger = Autopilot(system=9), Autopilot(intervals_us={"RAW_IMU": 20_000, "GPS_RAW_INT": 200_000})
    stranger.wire.signing = signing
    begin = time.monotonic()

    def others() -> bytes:
        t = time.monotonic() - begin
        return b"".join(forger.advance(t) + stranger.advance(t))

    with socket.create_server(("127.0.0.1", 0)) as server, flown(shy, server, others):
        source = f"tcp:127.0.0.1:{server.getsockname()[1]}"
        process = serve(source, "--record", tmp_path / "recorded", "--signing-key", KEY, "--allow", "1,7")
        reader.wait(has_pose_at(20.0))
        assert shy.intervals["HIGHRES_IMU"] == 10_000
        assert process.interrupt() == 130
    assert any("its parameters say GPS1_POS_X 0.2, INS_POS1_X -0.1" in line for line in process.lines)
    assert any("model strapdown begins" in line for line in process.lines)
    assert {name: interval for name, interval in shy.intervals.items() if interval > 0} == shy.default
    assert shy.ear.signing.badsig_count == 0
    assert any("without a signature were refused" in line for line in process.lines)
    assert any("systems that are not allowed (9)" in line for line in process.lines)
    assert_same_poses(reader, [one_recording(tmp_path / "recorded")], tmp_path / "poses.jsonl")


def test_one_vehicle_over_two_links_is_one_vehicle(
    serve: Start, reader: Reader, flight: Frames, tmp_path: Path
) -> None:
    process = serve("udpin:127.0.0.1:0", "tcpin:127.0.0.1:0", "--record", tmp_path / "recorded", "--no-request")
    ports = [int(process.line(kind).rsplit(":", 1)[1]) for kind in ("udpin", "tcpin")]
    reader.wait_for_publisher()
    with (
        socket.socket(type=socket.SOCK_DGRAM) as udp,
        socket.create_connection(("127.0.0.1", ports[1])) as tcp,
    ):
        for _, frame in flight:
            udp.sendto(frame, ("127.0.0.1", ports[0]))
            tcp.sendall(frame)
            time.sleep(0.0005)
        reader.wait(has_pose_at(20.5))
        assert process.interrupt() == 130
    told = next(line for line in process.lines if "frames came over a second link too" in line)
    assert 0.9 * len(flight) < int(told.split()[1]) <= len(flight)
    recordings = sorted((tmp_path / "recorded").iterdir())
    assert len(recordings) == 2
    assert_same_poses(reader, recordings, tmp_path / "poses.jsonl")
    assert len(reader.published["mavkf/1-1/pose"]) < 50 * SECONDS
