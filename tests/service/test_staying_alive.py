"""A service through what happens to links: cut connections, gaps, reboots, an endless flood; and its recordings through bad disks."""

import json
import os
import signal
import socket
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mavkf.estimate import Pose
from mavkf.link.framing import FrameStream
from mavkf.publish.records import encode, key_of
from mavkf.replay.tlog import read_tlog
from mavkf.service import fleet as fleet_module
from mavkf.service import recorder as recorder_module
from mavkf.service import server, worker
from mavkf.service.belief import Belief
from mavkf.service.endpoints.link import Link, Take
from mavkf.service.fleet import Options
from mavkf.service.inbox import Inbox
from mavkf.service.playback import merge
from mavkf.service.recorder import Recorder, label_of
from mavkf.service.talk import Manners

from .conftest import BEGIN_US, SECONDS, Frames, Reader, Serve, expected, has_pose_at, one_recording, tlog
from .test_fleet import Publisher
from .test_serve import agree

END_S = SECONDS + 0.9


def between(flight: Frames, begin: float, end: float) -> bytes:
    """The frames of seconds of the recording."""
    return b"".join(frame for stamp, frame in flight if begin <= (stamp - BEGIN_US) * 1e-6 < end)


def test_a_player_that_is_killed_five_times(
    serve: Callable[..., Serve], reader: Reader, flight: Frames, tmp_path: Path
) -> None:
    half_a_frame = between(flight, 9.5, 9.6)[:21]
    parts = [
        between(flight, 0.0, 9.5) + half_a_frame,
        between(flight, 9.5, 11.0),  # where it was
        between(flight, 13.0, 15.0) + half_a_frame,  # two seconds later
        between(flight, 19.0, 30.0),  # four
        between(flight, 0.0, 14.0),  # a reboot
        between(flight, 14.0, 30.0),
    ]
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(20)
        process = serve(f"tcp:127.0.0.1:{server.getsockname()[1]}", "--record", tmp_path)
        reader.wait_for_publisher()
        for part in parts:
            connection, _ = server.accept()
            with connection:
                connection.sendall(part)
        reader.wait(lambda published: any(p["session"] == 1 for p in published.get("mavkf/1-1/pose", [])[-1:]))
        reader.wait(has_pose_at(END_S))
        begin = time.monotonic()
        process.process.send_signal(signal.SIGTERM)
        assert process.end() == 0
        assert time.monotonic() - begin < 1.0
    agree(reader, one_recording(tmp_path))
    events = reader.published["mavkf/1-1/event"]
    assert [(e["kind"], round(e["size"], 1)) for e in events if e["kind"] == "link_gap"] == [("link_gap", 4.0)]
    gaps = [(round(e["t_start_s"]), round(e["t_end_s"])) for e in events if e["kind"] in ("imu_gap", "link_gap")]
    assert {(11, 13), (15, 19)} <= set(gaps)
    assert [e["session"] for e in events if e["kind"] == "reboot"] == [1]
    poses = reader.published["mavkf/1-1/pose"]
    for resumed in (9.5, 13.0, 19.0):
        assert any(resumed < p["t_boot_s"] < resumed + 2.0 and p["valid"]["tilt"] for p in poses if p["session"] == 0)
    assert min(p["t_boot_s"] for p in poses if p["session"] == 1 and p["valid"]["tilt"]) < 10.0


class Flood(Link):
    """A link over which everything comes at once."""

    def __init__(self, frames: Frames) -> None:
        super().__init__("flood", lambda _: None)
        self._frames = frames

    def receive(self, take: Take) -> None:
        for _, frame in self._frames:
            take(frame, True)
        self.has_ended = True


def test_overload_costs_outputs_before_measurements(
    flight: Frames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All is recorded and estimated; what is published is right, and what is not is said."""
    Publisher.opened = []
    monkeypatch.setattr(fleet_module, "Publisher", Publisher)
    monkeypatch.setattr(worker, "LATE_US", 0)
    monkeypatch.setattr(worker, "CAUGHT_UP_US", 0)
    said: list[str] = []
    server.serve_links(
        [Flood(flight)],
        None,  # type: ignore[arg-type]
        Options(),
        say=said.append,
        stopped=lambda: False,
        belief=Belief(),
        manners=Manners(request=False),
        record=server.Records(tmp_path),
    )
    recording = one_recording(tmp_path)
    assert len(read_tlog(recording).frames) == len(flight)
    everything = {(key, record["seq"]): record for key, records in expected(recording).items() for record in records}
    records = [record for publisher in Publisher.opened for record in publisher.records]
    found = {(key_of(record), record.seq): json.loads(encode(record)) for record in records}
    assert len(found) == len(records)
    assert found == {name: everything[name] for name in found}
    missing = Counter(key.split("/")[2] for key, _ in everything.keys() - found.keys())
    assert set(missing) == {"pose", "innovation"}
    assert len([record for record in records if isinstance(record, Pose)]) >= 3
    assert sum("too slow for what arrives" in text for text in said) == 1
    assert f"{missing['pose']} poses and {missing['innovation']} innovations were not published" in said[-1]


def test_stamps_say_how_late_the_worker_is() -> None:
    clock = iter([1_000_000, 1_200_000, 1_900_000, 1_900_001])
    box = Inbox(lambda _: None, lambda: next(clock))
    for _ in range(3):
        box.put(0, b"x", True)
    box.get(0.0)
    assert box.lag_us == 900_000
    box.get(0.0)
    assert box.lag_us == 0
    box.put(0, b"x", True)
    assert [chunk.arrival_us for chunk in box.get(0.0)] == [1_900_001]
    assert box.lag_us == 0


def frames_of(flight: Frames, recorder: Recorder) -> None:
    stream = FrameStream()
    for stamp, frame in flight:
        recorder.write(*stream.push(frame, stamp, last=True))


@pytest.mark.parametrize(("part_bytes", "part_s"), [(15_000.0, np.inf), (np.inf, 4.0)])
def test_a_recording_in_parts_is_the_recording(
    part_bytes: float, part_s: float, flight: Frames, tmp_path: Path
) -> None:
    recorder = Recorder(tmp_path, "udpin:127.0.0.1:14550", lambda _: None, part_bytes, part_s)
    frames_of(flight, recorder)
    recorder.close()
    parts = sorted(tmp_path.iterdir(), key=lambda path: int.from_bytes(path.read_bytes()[:8]))
    assert len(parts) > 3
    assert b"".join(part.read_bytes() for part in parts) == tlog(flight)
    for part in parts[:-1]:
        stamps = read_tlog(part).frames["stamp"]
        assert part.stat().st_size < part_bytes + 400
        assert stamps[-1] - stamps[0] < (part_s + 0.2) * 1e6
    assert {label_of(part) for part in parts} == {"udpin-127.0.0.1-14550"}


def test_parts_of_one_link_are_no_second_link(flight: Frames, tmp_path: Path) -> None:
    """The same frame in two parts came twice; over another link it is the same frame."""
    frame = flight[:1]
    names = ("20260101T000000Z-udpin-1", "20260101T000001Z.2-udpin-1", "20260101T000000Z-udpin-2")
    paths = [tmp_path / f"{name}.tlog" for name in names]
    for path in paths:
        path.write_bytes(tlog(frame))
    assert len(merge([read_tlog(path) for path in paths[:2]]).frames) == 2
    assert len(merge([read_tlog(path) for path in paths[::2]]).frames) == 1


def test_a_disk_that_recovers_is_recorded_to_again(
    flight: Frames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "AGAIN_US", 2_000_000)
    said: list[str] = []
    recorder = Recorder(tmp_path, "link", said.append)
    recorder._file.close()
    recorder._file = Path("/dev/full").open("wb", buffering=64)  # noqa: SIM115
    frames_of(flight, recorder)
    recorder.close()
    assert "delete old recordings" in said[0]
    assert "goes on" in said[1]
    assert len(said) == 2
    rest = [record for record in flight if record[0] >= flight[0][0] + 2_000_000]
    assert recorder.path.read_bytes() == tlog(rest)


def test_a_disk_with_little_room_is_said_once(flight: Frames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "LITTLE_BYTES", 1 << 62)
    said: list[str] = []
    recorder = Recorder(tmp_path, "link", said.append)
    frames_of(flight, recorder)
    recorder.close()
    assert len(said) == 1
    assert f"delete old ones in {tmp_path}" in said[0]


def test_a_recording_is_synced_once_a_second(flight: Frames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    monkeypatch.setattr(recorder_module._Syncer, "sync", lambda _, file: synced.append(os.fstat(file).st_size))
    recorder = Recorder(tmp_path, "link", lambda _: None)
    frames_of(flight, recorder)
    assert len(synced) == SECONDS
    assert synced == sorted(synced)
    assert synced[-1] > 0.9 * len(tlog(flight))
    recorder.close()
