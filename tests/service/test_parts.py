"""The parts of the service alone: inbox, playback, recorder, fleet."""

from pathlib import Path

import numpy as np
import pytest

from mavkf.link.framing import FrameStream
from mavkf.replay.tlog import read_tlog
from mavkf.service import inbox as inbox_module
from mavkf.service.inbox import Inbox
from mavkf.service.playback import due_times, merge
from mavkf.service.recorder import Recorder

from .conftest import Frames, tlog


def test_stamps_never_fall_and_no_two_links_share_one() -> None:
    clock = iter([100, 100, 100, 90, 200, 150, 150])
    box = Inbox(lambda _: None, lambda: next(clock))
    for link in (0, 0, 1, 1, 0, 0, 1):
        box.put(link, b"x", True)
    assert [chunk.arrival_us for chunk in box.get(0.0)] == [100, 100, 101, 101, 200, 200, 201]


def test_a_full_inbox_counts_what_it_drops_and_says_so_once_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inbox_module, "CAPACITY", 3 * (inbox_module.OVERHEAD + 1))
    now = 10_000_000
    said: list[str] = []
    box = Inbox(said.append, lambda: now)
    for _ in range(10):
        box.put(0, b"x", True)
    assert box.dropped == 7
    assert len(said) == 1
    now += 1_000_000
    box.put(0, b"x", True)
    assert len(said) == 2
    assert "7 chunks" in said[1]
    assert len(box.get(0.0)) == 3
    assert box.get(0.0) == []
    box.put(0, b"x", True)
    assert len(box.get(0.0)) == 1


def test_due_times_skip_pauses_and_steps_back() -> None:
    stamps = np.array([10, 11, 12, 112, 113, 50, 51, 56], np.int64) * 1_000_000
    due, skipped = due_times(stamps, 2.0)
    assert due.tolist() == [0.0, 0.5, 1.0, 1.0, 1.5, 1.5, 2.0, 4.5]
    assert skipped.tolist() == [3, 5]
    assert due_times(stamps, 0.0)[0].tolist() == [0.0] * 8


def test_logs_are_merged_by_stamp_ties_in_argument_order(flight: Frames, tmp_path: Path) -> None:
    paths = [tmp_path / "a.tlog", tmp_path / "b.tlog"]
    for k, path in enumerate(paths):
        path.write_bytes(tlog(flight[k:100:2]))
    data, frames, log = merge([read_tlog(path) for path in paths])
    found = [(int(f["stamp"]), data[f["offset"] - 10 :][: f["size"]].tobytes()) for f in frames]
    order = sorted(range(100), key=lambda i: (flight[i][0], i % 2, i))
    assert found == [flight[i] for i in order]
    assert log.tolist() == [i % 2 for i in order]


def test_a_recording_is_readable_a_second_later_without_being_closed(flight: Frames, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "new", "udpin:127.0.0.1:14550", lambda _: None)
    stream = FrameStream()
    for stamp, frame in flight:
        data, frames = stream.push(b"noise" + frame, stamp, last=True)
        recorder.write(data, frames)
    written = recorder.path.read_bytes()
    assert recorder.path.name.endswith("-udpin-127.0.0.1-14550.tlog")
    whole = tlog([record for record in flight if record[0] <= flight[-1][0] - 1_000_000])
    assert written.startswith(whole)
    recorder.close()
    assert recorder.path.read_bytes() == tlog(flight)


def test_two_recordings_of_one_second_have_two_names(tmp_path: Path) -> None:
    recorders = [Recorder(tmp_path, "udpin:127.0.0.1:1", lambda _: None) for _ in range(2)]
    assert len({recorder.path for recorder in recorders}) == 2
    for recorder in recorders:
        recorder.close()


def test_a_full_disk_ends_the_recording_and_not_the_service(flight: Frames, tmp_path: Path) -> None:
    said: list[str] = []
    recorder = Recorder(tmp_path, "link", said.append)
    recorder._file.close()
    recorder._file = Path("/dev/full").open("wb", buffering=64)  # noqa: SIM115
    data, frames = FrameStream().push(flight[0][1], flight[0][0], last=True)
    for _ in range(3):
        recorder.write(data, frames)
    recorder.close()
    assert len(said) == 1
    assert "the estimate goes on" in said[0]
