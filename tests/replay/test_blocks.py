"""A log goes by in blocks: what comes of it does not depend on their size, nor on what is kept."""

import errno
import io
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavkf.ahead import Ahead
from mavkf.config import Config
from mavkf.errors import LogError, UsageError
from mavkf.link.clocks import VehicleClock
from mavkf.navigation import layout as L
from mavkf.navigation.events import EventOrder
from mavkf.navigation.setup import choose
from mavkf.navigation.spool import IN_MEMORY, Spool
from mavkf.replay.export import CsvFile
from mavkf.replay.options import Options, Watch
from mavkf.replay.run import run
from mavkf.replay.simulation import simulate
from mavkf.replay.summary import summarise
from mavkf.replay.tlog import read_tlog
from mavkf.samples import CLOCK, KIND, TIME, Clock, Kind, Source

from ..link import _wire

WINDOW = Config().timeline.window_s


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two vehicles in one log, the second with a reboot: its clock begins anew."""
    folder = tmp_path_factory.mktemp("blocks")
    simulate(folder / "one.tlog", seed=3, duration_s=60.0, imu_hz=50.0)
    simulate(folder / "two.tlog", seed=4, duration_s=60.0, imu_hz=50.0, address=(2, 1))
    records = []
    for name, later_us in (("one.tlog", 0), ("two.tlog", 50_000_000), ("two.tlog", 150_000_000)):
        log = read_tlog(folder / name)
        for frame in log.frames:
            stamp = int(frame["stamp"]) + later_us
            whole = log.data[frame["offset"] - 10 : frame["offset"] - 10 + frame["size"]]
            records.append((stamp, stamp.to_bytes(8, "big") + whole.tobytes()))
    path = folder / "both.tlog"
    path.write_bytes(b"".join(record for _, record in sorted(records, key=lambda each: each[0])))
    return path


def csv(log: Path, path: Path, options: Options) -> tuple[bytes, dict]:
    with CsvFile(path) as table:
        result = run(log, options, Watch(poses=table.take), keep=False)
        table.finish(dict.fromkeys(session.vehicle for session in result.sessions))
    summary = summarise(result)
    del summary["time"]
    return path.read_bytes(), summary


@pytest.mark.parametrize(
    "options", [Options(), Options(as_live=True), Options(smooth=True)], ids=["", "live", "smooth"]
)
def test_nothing_depends_on_the_size_of_blocks(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: Options
) -> None:
    whole, told = csv(log, tmp_path / "whole.csv", options)
    monkeypatch.setattr("mavkf.link.framing.BLOCK", 333)
    monkeypatch.setattr("mavkf.navigation.events.BLOCK", 101)
    pieces, told_in_pieces = csv(log, tmp_path / "pieces.csv", options)
    assert pieces == whole
    assert [line.split(b",")[:2] for line in whole.splitlines()[1::1500]][:1] == [[b"1-1", b"0"]]
    assert {tuple(line.split(b",")[:2]) for line in whole.splitlines()[1:]} == {
        (b"1-1", b"0"),
        (b"2-1", b"0"),
        (b"2-1", b"1"),
    }
    for one, other in zip(told["sessions"], told_in_pieces["sessions"], strict=True):
        for name in ("setup", "counts", "rates_hz", "coverage", "end", "events", "warnings"):
            assert one[name] == other[name], name


@pytest.mark.parametrize("options", [Options(), Options(smooth=True)], ids=["", "smooth"])
def test_what_is_kept_is_what_goes_by(log: Path, options: Options) -> None:
    parts: dict[tuple[str, int], list[np.ndarray]] = {}

    def take(vehicle: str, session: int, poses: np.ndarray) -> None:
        parts.setdefault((vehicle, session), []).append(poses.copy())

    kept = run(log, options, Watch(poses=take)).sessions
    assert [(session.vehicle, session.session) for session in kept] == [("1-1", 0), ("2-1", 0), ("2-1", 1)]
    for session in kept:
        poses = np.concatenate(parts[session.vehicle, session.session])
        np.testing.assert_array_equal(session.output.poses, poses)
        assert session.tally.poses == len(poses) and len(session.rows) > len(poses)
        np.testing.assert_array_equal(session.tally.end[L.R_TIME], poses[-1, L.R_TIME])
    assert all(not len(session.rows) for session in run(log, options, keep=False).sessions)


@pytest.fixture(scope="module")
def timed(log: Path) -> np.ndarray:
    clock = VehicleClock(WINDOW)
    rows = read_tlog(log).rows[1, 1]
    return np.concatenate([clock.push(rows), clock.flush()])


@given(cuts=st.lists(st.integers(1, 6000), max_size=12).map(sorted), seed=st.integers(0, 5))
def test_events_come_in_order_however_late_they_are(timed: np.ndarray, cuts: list[int], seed: int) -> None:
    """Rows delayed by up to the window: in pieces as all at once, with the same running numbers."""
    delay = np.random.default_rng(seed).uniform(0.0, WINDOW - 1e-3, len(timed))
    rows = timed[np.argsort(timed[:, TIME] + delay, kind="stable")]
    setup = choose(timed[:2000], Config())
    (whole,) = EventOrder(setup, WINDOW).push(rows, last=True)
    pieces = EventOrder(setup, WINDOW)
    parts = [events for part in np.split(rows, cuts) for events in pieces.push(part)]
    parts += list(pieces.push(rows[:0], last=True))
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert np.all(np.diff(whole[:, TIME]) >= 0.0)


def test_what_cannot_come_before_is_not_waited_for(timed: np.ndarray) -> None:
    order = EventOrder(choose(timed[:2000], Config()), WINDOW)
    waiting = 0
    for first in range(0, len(timed), 100):
        some = timed[first : first + 100]
        waiting += len(some) - sum(len(events) for events in order.push(some))
        assert waiting < 2.0 * WINDOW * len(timed) / 60.0


def test_a_spool_gives_what_was_put_in_memory_and_in_a_file() -> None:
    rows = np.random.default_rng(1).normal(size=(IN_MEMORY // 80 + 1000, 10))
    with Spool(10) as spool:
        for first in range(0, len(rows), 7000):
            spool.append(rows[first : first + 7000])
        spool.put(20_000, rows[:3000])
        expected = rows.copy()
        expected[20_000:23_000] = rows[:3000]
        assert len(spool) == len(rows)
        np.testing.assert_array_equal(spool.block(0, len(rows)), expected)
        np.testing.assert_array_equal(spool.block(19_990, 23_010), expected[19_990:23_010])
        assert len(spool.block(len(rows) - 5, len(rows) + 100)) == 5


def test_the_next_is_made_while_this_one_is_worked_on() -> None:
    made, used = threading.Event(), []

    def source() -> Iterator[int]:
        yield 1
        made.set()
        yield 2

    with Ahead(source()) as items:
        for item in items:
            used.append(item)
            assert made.wait(10.0)
    assert used == [1, 2]


def test_what_the_other_thread_raises_is_raised_here() -> None:
    def source() -> Iterator[int]:
        yield 1
        raise LogError("broken")

    with pytest.raises(LogError, match="broken"), Ahead(source()) as items:
        for _ in items:
            time.sleep(0.01)


@pytest.mark.parametrize("as_live", [False, True])
def test_what_a_vehicle_lacks_is_an_error_in_whatever_thread_it_is_found(log: Path, as_live: bool) -> None:
    with pytest.raises(UsageError, match="SCALED_IMU3"):
        run(log, Options(imu=Source.SCALED_IMU3, as_live=as_live))


def test_a_generator_that_is_not_needed_any_more_is_closed() -> None:
    closed = []

    def source() -> Iterator[int]:
        try:
            yield 1
            yield 2
            yield 3
        finally:
            closed.append(True)

    kept = source()  # no other reference goes
    with pytest.raises(LogError), Ahead(kept) as items:
        for _ in items:
            raise LogError("broken")
    assert closed == [True]


def test_events_come_in_order_where_unix_time_is_ahead_of_the_boot_clock(timed: np.ndarray) -> None:
    rows = timed.copy()
    fixes = rows[:, KIND] == Kind.GNSS
    delay = np.where(fixes, 0.0, np.random.default_rng(2).uniform(0.0, WINDOW - 1e-3, len(rows)))
    rows[fixes, CLOCK] = Clock.UNIX_US
    rows = rows[np.argsort(timed[:, TIME] + delay, kind="stable")]
    rows[rows[:, KIND] == Kind.GNSS, TIME] += 0.9 * WINDOW  # as the clock lets it
    order = EventOrder(choose(timed[:2000], Config()), WINDOW)
    parts = [events for first in range(0, len(rows), 50) for events in order.push(rows[first : first + 50])]
    assert np.all(np.diff(np.concatenate(parts)[:, TIME]) >= 0.0)


def as_other(log: Path, path: Path) -> None:
    """The log with a companion's heartbeats in place of an autopilot's."""
    content = read_tlog(log)
    beats = _wire.frame("HEARTBEAT", system=1, component=191, type=18, autopilot=8)
    records = []
    for each in content.frames:
        begin = each["offset"] - 10
        whole = content.data[begin : begin + each["size"]].tobytes()
        records.append(_wire.record(int(each["stamp"]), beats if each["message"] == 0 else whole))
    path.write_bytes(b"".join(records))


@pytest.mark.parametrize("as_live", [False, True])
def test_who_says_that_it_is_no_vehicle_is_not_told_of(log: Path, tmp_path: Path, as_live: bool) -> None:
    simulate(tmp_path / "whole.tlog", seed=5, duration_s=60.0, imu_hz=50.0, address=(1, 191))
    as_other(tmp_path / "whole.tlog", tmp_path / "other.tlog")
    heard = set()
    watch = Watch(step=lambda stream, step: heard.add(stream.writer.vehicle))
    with pytest.raises(LogError, match="no vehicle"):
        run(tmp_path / "other.tlog", Options(as_live=as_live), watch)
    assert not heard


class Full(io.BytesIO):
    """A file on a disk that is full."""

    def write(self, data: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    def close(self) -> None:
        super().close()
        raise OSError(errno.ENOSPC, "No space left on device")


def test_no_room_for_temporary_files_is_told(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.SpooledTemporaryFile", lambda size: Full())
    with pytest.raises(UsageError, match="TMPDIR"):
        run(log, Options(smooth=True))
    monkeypatch.undo()
    monkeypatch.setattr("mavkf.replay.export.tempfile", SimpleNamespace(TemporaryFile=Full))
    with pytest.raises(UsageError, match="TMPDIR"):
        csv(log, tmp_path / "estimate.csv", Options())


def test_what_cannot_be_written_is_told_and_what_was_there_stays_until_then(log: Path, tmp_path: Path) -> None:
    if Path("/dev/full").exists():
        with pytest.raises(UsageError, match="/dev/full"):
            csv(log, Path("/dev/full"), Options())
    path = tmp_path / "estimate.csv"
    path.write_text("before\n" * 100_000)
    with pytest.raises(UsageError, match="9-9"):
        csv(log, path, Options(vehicle="9-9"))
    assert path.read_text() == "before\n" * 100_000
    assert csv(log, path, Options())[0].startswith(b"vehicle,session")
