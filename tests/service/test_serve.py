"""`mavkf serve` as a process: what it publishes, what it records, how it begins and ends."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mavkf.cli import main
from mavkf.replay.tlog import read_tlog

from .conftest import (
    BEGIN_US,
    FLIGHTS,
    SECONDS,
    Frames,
    Reader,
    Serve,
    count,
    expected,
    has_pose_at,
    one_recording,
    tlog,
    without_utc,
)

Start = Callable[..., Serve]
END_S = SECONDS + 0.9  # boot time just before the last sample

SUBSCRIBER = """
import json, sys, zenoh
config = zenoh.Config()
config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("connect/exit_on_failure", "false")
config.insert_json5("connect/timeout_ms", "-1")
with zenoh.open(config) as session, session.declare_subscriber("mavkf/*/pose") as poses:
    for _ in range(int(sys.argv[2])):
        print(poses.recv().payload.to_string())
"""


def test_a_log_reaches_a_plain_subscriber_whole_and_in_order(
    flight: Frames, serve: Start, rendezvous: str, tmp_path: Path
) -> None:
    log = tmp_path / "flight.tlog"
    log.write_bytes(tlog(flight))
    wanted = expected(log)["mavkf/1-1/pose"]
    output = tmp_path / "poses.jsonl"
    with output.open("w") as file:  # a pipe would fill, and hold up everything
        subscriber = subprocess.Popen([sys.executable, "-c", SUBSCRIBER, rendezvous, str(len(wanted))], stdout=file)
    try:
        process = serve(log, "--speed", 0, "--wait-subscriber", 20)
        assert process.end() == 0, process.lines
        assert subscriber.wait(timeout=20) == 0
    finally:
        subscriber.kill()
        subscriber.wait()
    poses = [json.loads(line) for line in output.read_text().splitlines()]
    assert [pose["seq"] for pose in poses] == list(range(len(wanted)))
    assert len(wanted) > 40 * (SECONDS - 6)
    assert without_utc({"": poses}) == without_utc({"": wanted})
    assert all(abs(pose["utc_ns"] * 1e-9 - BEGIN_US * 1e-6 - pose["t_boot_s"]) < 0.01 for pose in poses[-10:])


def test_a_log_is_paced_by_its_stamps_and_a_pause_is_skipped(flight: Frames, serve: Start, tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    paused = [(stamp + 3600_000_000 * (stamp > BEGIN_US + 5_000_000), frame) for stamp, frame in flight]
    log.write_bytes(tlog(paused))
    process = serve(log, "--speed", 10)
    process.line("jump")
    begin = time.monotonic()
    assert process.end() == 0
    assert 1.5 < time.monotonic() - begin < 10.0


@pytest.fixture
def udp(flight: Frames, serve: Start, reader: Reader, tmp_path: Path) -> Iterator[tuple[Serve, Callable[[], None]]]:
    """A service that listens, and what sends it the flight."""
    process = serve("udpin:127.0.0.1:0", "--record", tmp_path)
    port = int(process.line("listens on").rsplit(":", 1)[1])
    reader.wait_for_publisher()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))

        def send() -> None:
            for _, frame in flight:
                sender.send(frame)
                time.sleep(0.0005)  # the pace of the sender: forty times that of the flight

        yield process, send


def agree(reader: Reader, recording: Path, vehicle: tuple[int, int] = (1, 1)) -> None:
    """What was published is what the recording gives: every record of every kind, in order."""
    wanted = without_utc(expected(recording, vehicle))
    assert {"pose", "status", "event", "innovation"} <= {key.split("/")[2] for key in wanted}
    reader.wait(lambda published: count(published) == count(wanted))
    assert without_utc(reader.published) == wanted


def test_udp_gives_what_its_recording_gives(
    udp: tuple[Serve, Callable[[], None]], reader: Reader, flight: Frames, tmp_path: Path
) -> None:
    process, send = udp
    send()
    reader.wait(has_pose_at(END_S))
    assert process.interrupt() == 130
    recording = one_recording(tmp_path)
    assert [frame for _, frame in records(recording)] == [frame for _, frame in flight]
    agree(reader, recording)
    assert any("IMU RAW_IMU at 50 Hz" in line for line in process.lines)


def records(path: Path) -> list[tuple[int, bytes]]:
    log = read_tlog(path)
    begins = log.frames["offset"] - 10
    return [
        (int(stamp), log.data[begin : begin + size].tobytes())
        for stamp, begin, size in zip(log.frames["stamp"], begins, log.frames["size"], strict=True)
    ]


def test_tcp_cut_anywhere_gives_what_its_recording_gives(
    serve: Start, reader: Reader, flight: Frames, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(20)
        process = serve(f"tcp:127.0.0.1:{server.getsockname()[1]}", "--record", tmp_path)
        reader.wait_for_publisher()
        data = b"".join(frame for _, frame in flight)
        half = len(data) // 2 + 5  # in the midst of a frame, where the first connection ends
        for part in (data[:half], data[half:]):
            connection, _ = server.accept()
            with connection:
                for at in range(0, len(part), 97):
                    connection.sendall(part[at : at + 97])
                    time.sleep(0.0003)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(4096):  # what it was asked for: to leave it unread would take back what was sent
                    pass
        reader.wait(has_pose_at(END_S))
        assert process.interrupt() == 130
    assert len(flight) - 3 < len(records(one_recording(tmp_path))) < len(flight)
    agree(reader, one_recording(tmp_path))
    assert any("1 unfinished" in line or "stray" in line for line in process.lines)


def test_tcp_that_comes_later_is_waited_for(serve: Start, reader: Reader, flight: Frames) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.settimeout(20)
        address = taken.getsockname()
        process = serve(f"tcp:127.0.0.1:{address[1]}")
        process.line("does not answer")
        reader.wait_for_publisher()
        taken.listen(1)
        connection, _ = taken.accept()
        with connection:
            connection.sendall(b"".join(frame for _, frame in flight))
            reader.wait(has_pose_at(END_S - 1.0))
        assert process.interrupt() == 130
    assert sum("does not answer" in line for line in process.lines) == 1


@pytest.mark.skipif(not FLIGHTS, reason="MAVKF_FLIGHTS does not name the folder of recorded flights")
def test_a_recorded_flight_over_udp_gives_what_its_recording_gives(
    serve: Start, reader: Reader, tmp_path: Path
) -> None:
    assert FLIGHTS is not None
    process = serve("udpin:127.0.0.1:0", "--record", tmp_path, "--quiet")
    port = listening_port(process.process.pid)
    reader.wait_for_publisher()
    player = Path(FLIGHTS).parent / "tools" / "play_tlog.py"
    words = (Path(FLIGHTS) / "ap01_copter_highrate.tlog", "--udp", f"127.0.0.1:{port}", "--speed", 8, "--to", 60)
    played = subprocess.run([sys.executable, player, *map(str, words)], capture_output=True, text=True, check=True)
    sent = json.loads(played.stdout.splitlines()[-1])["sent"]
    assert process.interrupt() == 130
    log = read_tlog(one_recording(tmp_path))
    assert len(log.frames) >= 0.999 * sent
    agree(reader, log.path, log.vehicles()[0])


def listening_port(pid: int) -> int:
    """The UDP port that a process listens on, once it does."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        sockets = {os.readlink(link) for link in Path(f"/proc/{pid}/fd").iterdir() if link.is_symlink()}
        for row in Path("/proc/net/udp").read_text().splitlines()[1:]:
            columns = row.split()
            if f"socket:[{columns[9]}]" in sockets:
                return int(columns[1].split(":")[1], 16)
        time.sleep(0.05)
    raise AssertionError("no port")


def test_ctrl_c_leaves_at_once_with_a_whole_recording(
    udp: tuple[Serve, Callable[[], None]], reader: Reader, flight: Frames, tmp_path: Path
) -> None:
    process, send = udp
    send()
    reader.wait(has_pose_at(END_S))
    begin = time.monotonic()
    assert process.interrupt() == 130
    assert time.monotonic() - begin < 1.0
    assert len(records(one_recording(tmp_path))) == len(flight)


def test_ctrl_c_leaves_a_subscriber_that_does_not_read(
    flight: Frames, serve: Start, rendezvous: str, tmp_path: Path
) -> None:
    log = tmp_path / "flight.tlog"
    log.write_bytes(tlog(flight * 12))  # twelve boots: more poses than the kernel buffers
    words = [sys.executable, "-c", SUBSCRIBER, rendezvous, "1000"]
    subscriber = subprocess.Popen(words, stdout=subprocess.PIPE)  # nobody empties the pipe
    try:
        process = serve(log, "--speed", 0, "--wait-subscriber", 20)
        process.line("model strapdown begins")
        until_idle(process.process.pid)
        begin = time.monotonic()
        assert process.interrupt() == 130
        assert time.monotonic() - begin < 1.2
    finally:
        subscriber.kill()
        subscriber.communicate()
    assert "does not read" in process.lines[-1]


def until_idle(pid: int) -> None:
    """Wait until a process has used no processor time for 0.4 s: zenoh gives no sign of a full queue."""
    used, since = -1, time.monotonic()
    while time.monotonic() - since < 0.4:
        now = sum(map(int, Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[11:13]))
        if now != used:
            used, since = now, time.monotonic()
        time.sleep(0.05)


def test_sigterm_is_a_clean_end(serve: Start) -> None:
    process = serve("udpin:127.0.0.1:0")
    process.line("listens on")
    process.process.send_signal(signal.SIGTERM)
    assert process.end() == 0


def test_ctrl_c_before_the_set_up_publishes_what_a_replay_does(
    serve: Start, reader: Reader, flight: Frames, tmp_path: Path
) -> None:
    process = serve("udpin:127.0.0.1:0", "--record", tmp_path)
    port = int(process.line("listens on").rsplit(":", 1)[1])
    reader.wait_for_publisher()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))
        for _, frame in flight[:180]:  # three seconds, two less than the set-up takes
            sender.send(frame)
    # a status comes once a second, at any part of it
    reader.wait(lambda published: any(s["t_boot_s"] >= 3.0 for s in published.get("mavkf/1-1/status", [])))
    assert not reader.published.get("mavkf/1-1/pose")
    assert process.interrupt() == 130
    agree(reader, one_recording(tmp_path))
    assert reader.published["mavkf/1-1/pose"]


def test_a_killed_service_leaves_a_readable_recording(
    udp: tuple[Serve, Callable[[], None]], reader: Reader, flight: Frames, tmp_path: Path
) -> None:
    process, send = udp
    send()
    reader.wait(has_pose_at(END_S))
    process.process.kill()
    process.end()
    found = [frame for _, frame in records(one_recording(tmp_path))]
    assert len(found) > 0
    assert found == [frame for _, frame in flight][: len(found)]


@pytest.mark.parametrize(
    ("words", "code", "named"),
    [
        ("", 2, ["source", "udpin"]),
        (
            "udp:127.0.0.1:14550",
            2,
            ["udp:", "udpin:HOST:PORT", "tcp:HOST:PORT", "serial:PATH:BAUD", "zenoh:KEY", "stdin"],
        ),
        ("udpin:127.0.0.1", 2, ["udpin:127.0.0.1", "host:port"]),
        ("udpin:127.0.0.1:70000", 2, ["70000", "host:port"]),
        ("serial:/dev/ttyACM0", 2, ["serial:/dev/ttyACM0", "path:baud"]),
        ("serial:/dev/ttyACM0:fast", 2, ["fast", "path:baud"]),
        ("serial:/dev/no-such:57600", 1, ["/dev/no-such", "does not exist", "/dev/serial/by-id"]),
        ("zenoh:a//b", 2, ["a//b", "zenoh:mavlink_raw/out"]),
        ("tcpin:192.0.2.1:0", 1, ["192.0.2.1", "address of this machine"]),
        ("udpin:192.0.2.1:0", 1, ["192.0.2.1", "address of this machine"]),
        ("missing.tlog", 1, ["missing.tlog", "does not exist"]),
        ("{log} udpin:127.0.0.1:0", 2, ["log", "live", "two commands"]),
        ("udpin:127.0.0.1:0 --wait-subscriber 1", 2, ["--wait-subscriber", "logs"]),
        ("udpin:127.0.0.1:0 --link-share 2", 2, ["--link-share", "at most 1"]),
        ("udpin:127.0.0.1:0 --source-component 256", 2, ["--source-component", "255"]),
        ("udpin:127.0.0.1:0 --allow 1,300", 2, ["--allow", "300", "1,2"]),
        ("udpin:127.0.0.1:0 --allow-unsigned", 2, ["--allow-unsigned", "--signing-key"]),
        ("udpout:127.0.0.1:14550 --no-request", 2, ["--no-request", "udpin:"]),
        ("{log} --request", 2, ["--request", "live"]),
        ("{log} --allow 1", 2, ["--allow", "live"]),
        ("udpin:127.0.0.1:0 --imu COMPASS", 2, ["COMPASS", "RAW_IMU"]),
        ("udpin:127.0.0.1:0 --model best", 2, ["best", "strapdown"]),
        ("udpin:127.0.0.1:0 --rate=-1", 2, ["--rate", "second"]),
        ("{log} --speed=-1", 2, ["--speed", "0"]),
        ("{log} --encoding xml", 2, ["xml", "json"]),
        ("{log} --vehicle-name alpha", 2, ["alpha", "1-1=alpha"]),
        ("{log} --vehicle-name 1-1=a/b", 2, ["a/b", "letters"]),
        ("{log} --set noise.gyro=fast", 2, ["fast"]),
        ("{log} --imu HIL_SENSOR --speed 0", 2, ["HIL_SENSOR", "RAW_IMU"]),
        ("{log} --record {log}", 1, ["--record", "folder"]),
        ("{empty}", 1, ["no MAVLink frame"]),
        ("{beats} --speed 0", 1, ["no component sends IMU or GNSS"]),
    ],
)
def test_what_cannot_be_served_is_one_sentence(
    words: str, code: int, named: list[str], flight: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {"log": tmp_path / "log.tlog", "empty": tmp_path / "empty.tlog", "beats": tmp_path / "beats.tlog"}
    names["log"].write_bytes(tlog(flight))
    names["empty"].write_bytes(b"nothing here")
    names["beats"].write_bytes(tlog([record for record in flight if record[1][7:10] == b"\0\0\0"]))
    assert main(["serve", *words.format(**names).split(), "--quiet"]) == code
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith("mavkf: ")
    assert all(word in message for word in named)


def test_a_port_in_use_is_one_sentence_with_the_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        port = holder.getsockname()[1]
        assert main(["serve", f"udpin:127.0.0.1:{port}", "--record", str(tmp_path)]) == 1
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert f"udpin:127.0.0.1:{port} is taken" in message
    assert "choose another port" in message
    assert not list(tmp_path.iterdir()), "a recording of nothing was left behind"


def test_a_service_ends_at_once_while_another_holds_the_rendezvous(serve: Start) -> None:
    first, second = serve("udpin:127.0.0.1:0"), serve("udpin:127.0.0.1:0")
    for one in (first, second):
        one.line("listens on")
    time.sleep(1.0)  # both have tried for the rendezvous, which nothing tells; less would be easier, not flaky
    for one in (second, first):
        begin = time.monotonic()
        assert one.interrupt() == 130
        assert time.monotonic() - begin < 3.0
        assert not any("Traceback" in line for line in one.lines)


def test_nobody_who_subscribes_is_said_and_the_log_served_under_its_name(
    flight: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.tlog"
    log.write_bytes(tlog(flight[:600]))
    words: list[Any] = ["serve", log, "--speed", 0, "--wait-subscriber", 0.1, "--vehicle-name", "1-1=alpha"]
    assert main([str(word) for word in words]) == 0
    message = capsys.readouterr().err
    assert "nobody subscribed to mavkf/alpha/pose within 0.1 s" in message
    assert message.count("IMU RAW_IMU at 50 Hz") == 1
