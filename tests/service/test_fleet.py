"""The vehicles that are heard: which senders are some, and what becomes of those that fall silent; without sockets and zenoh."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mavkf.config import Config
from mavkf.estimate import Event, Record
from mavkf.link.framing import FrameStream
from mavkf.publish.records import encode, key_of
from mavkf.replay.tlog import read_tlog
from mavkf.service import fleet as fleet_module
from mavkf.service.fleet import FORGET_S, GONE_S, STALE_S, Fleet, Options
from mavkf.service.senders import NO_AUTOPILOT, NO_VEHICLES, is_autopilot
from mavkf.service.vehicle import VehicleStream

from .conftest import BEGIN_US, Frames, Published, expected, tlog, without_utc


class Publisher:
    """Keeps what is published."""

    opened: list["Publisher"]

    def __init__(self, _: object, vehicle: str, __: object, ___: object) -> None:
        self.vehicle, self.records, self.is_closed = vehicle, list[Record](), False
        self.opened.append(self)

    def publish(self, record: Record) -> None:
        assert not self.is_closed
        self.records.append(record)

    def close(self) -> None:
        self.is_closed = True


class Bench:
    """A fleet, a clock that is set by hand, and what was published and said."""

    def __init__(self, **options: Any) -> None:
        self.now = 100.0
        self.said: list[str] = []
        self.parts = 0
        self.fleet = Fleet(None, Options(**options), self.said.append, lambda: self.now)  # type: ignore[arg-type]
        self.fleet.when_ended = self._end_part

    def _end_part(self) -> None:
        self.parts += 1

    def send(self, frames: Frames, each: int = 7) -> None:
        """Give frames, some at a time."""
        stream = FrameStream()
        for i in range(0, len(frames), each):
            found = [stream.push(frame, stamp, last=True) for stamp, frame in frames[i : i + each]]
            sizes = np.cumsum([0, *(data.size for data, _ in found)])
            for (_, its), base in zip(found, sizes, strict=False):
                its["offset"] += base
            self.fleet.take(np.concatenate([data for data, _ in found]), np.concatenate([its for _, its in found]))

    def wait(self, seconds: float) -> None:
        """Let time pass without a word."""
        end = self.now + seconds
        while self.now < end:
            self.now = min(self.now + 0.5, end)
            self.fleet.look_after()

    @property
    def published(self) -> Published:
        found: Published = {}
        for publisher in Publisher.opened:
            for record in publisher.records:
                found.setdefault(key_of(record), []).append(json.loads(encode(record)))
        return found

    def events(self) -> list[Event]:
        return [r for publisher in Publisher.opened for r in publisher.records if isinstance(r, Event)]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    Publisher.opened = []
    monkeypatch.setattr(fleet_module, "Publisher", Publisher)
    return Bench()


def heard(published: Published) -> Published:
    """Without what the service said of its own while nothing was heard."""
    return {key: [record for record in records if record.get("silent_s") is None] for key, records in published.items()}


def wanted(frames: Frames, folder: Path) -> Published:
    path = folder / "frames.tlog"
    path.write_bytes(tlog(frames))
    return without_utc(expected(path))


def test_what_is_no_vehicle_is_what_mavlink_says() -> None:
    words = (
        "GCS ONBOARD_CONTROLLER GIMBAL ADSB CAMERA CHARGING_STATION FLARM SERVO ODID BATTERY PARACHUTE LOG OSD IMU GPS "
        "WINCH ILLUMINATOR GRIPPER"
    )
    assert {getattr(mavlink, f"MAV_TYPE_{word}") for word in words.split()} == NO_VEHICLES
    assert mavlink.MAV_AUTOPILOT_INVALID == NO_AUTOPILOT
    flying = [v for v, e in mavlink.enums["MAV_TYPE"].items() if any(w in e.name for w in ("ROTOR", "WING", "VTOL"))]
    assert all(is_autopilot(kind, 3) for kind in flying)


def beat(kind: int, autopilot: int, seq: int = 0, system: int = 1) -> bytes:
    sender = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
    sender.seq = seq
    return bytes(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3).pack(sender))


@pytest.mark.parametrize(
    ("beats", "is_vehicle"),
    [
        ([], True),
        ([(2, 12)], True),
        ([(6, 8)], False),
        ([(30, 8)], False),
        ([(18, 8)], False),
        ([(26, 3)], False),
        ([(2, 8)], False),
        ([(2, 3), (6, 8)], True),
        ([(6, 8), (2, 3)], True),
    ],
)
def test_a_log_and_a_link_agree_on_what_is_a_vehicle(
    beats: list[tuple[int, int]], is_vehicle: bool, bench: Bench, flight: Frames, tmp_path: Path
) -> None:
    samples = [record for record in flight if record[1][7:10] != b"\0\0\0"][:200]
    frames = [(BEGIN_US, beat(*said)) for said in beats] + samples
    bench.send(frames)
    assert (bench.published.get("mavkf/1-1/status") is not None) is is_vehicle
    path = tmp_path / "log.tlog"
    path.write_bytes(tlog(frames))
    assert (read_tlog(path).vehicles() == [(1, 1)]) is is_vehicle


def test_silence_is_told_and_changes_nothing_that_comes_after(bench: Bench, flight: Frames, tmp_path: Path) -> None:
    frames = [record for record in flight if record[1][5 if record[1][0] == 0xFD else 3] == 1]
    half = len(frames) // 2
    bench.send(frames[:half])
    bench.wait(STALE_S + 4.0)
    (publisher,) = Publisher.opened
    stale = [record for record in bench.published["mavkf/1-1/status"] if record["silent_s"] is not None]
    assert [record["silent_s"] for record in stale] == pytest.approx([3.0, 4.0, 5.0, 6.0, 7.0])
    last = bench.published["mavkf/1-1/status"][-6]
    assert stale[-1] == last | {"silent_s": stale[-1]["silent_s"]}
    assert not publisher.is_closed
    bench.wait(GONE_S)
    assert publisher.is_closed
    bench.send(frames[half:])
    bench.fleet.finish()
    assert len(Publisher.opened) == 2
    assert without_utc(heard(bench.published)) == wanted(frames, tmp_path)
    for part in ("is silent", "is gone", "is heard again after 37 s"):
        assert sum(part in text for text in bench.said) == 1
    assert bench.parts == 0


def test_a_vehicle_that_was_forgotten_begins_anew_and_so_does_its_recording(
    bench: Bench, flight: Frames, tmp_path: Path
) -> None:
    frames = [record for record in flight if record[1][5 if record[1][0] == 0xFD else 3] == 1]
    bench.send(frames)
    bench.wait(FORGET_S)
    assert not bench.fleet.vehicles
    assert all(publisher.is_closed for publisher in Publisher.opened)
    assert bench.parts == 1
    bench.send(frames)
    bench.fleet.finish()
    one = wanted(frames, tmp_path)
    found = without_utc(heard(bench.published))
    forgotten = found["mavkf/1-1/event"].pop(len(one["mavkf/1-1/event"]))
    assert (forgotten["kind"], forgotten["session"]) == ("forgotten", 0)
    again = {key: [record | {"session": 1} for record in records] for key, records in one.items()}
    assert found == {key: one[key] + again[key] for key in one}


def test_a_reset_is_an_event_and_a_new_session_that_replays_by_itself(
    bench: Bench, flight: Frames, tmp_path: Path
) -> None:
    frames = [record for record in flight if record[1][5 if record[1][0] == 0xFD else 3] == 1]
    bench.send(frames[:700])
    bench.fleet.reset(bench.fleet.vehicles[1, 1], Config())
    assert bench.parts == 1
    bench.send(frames[700:])
    bench.fleet.finish()
    one, other = wanted(frames[:700], tmp_path), wanted(frames[700:], tmp_path)
    found = without_utc(bench.published)
    assert found["mavkf/1-1/event"].pop(len(one["mavkf/1-1/event"]))["kind"] == "reset"
    again = {key: [record | {"session": 1} for record in records] for key, records in other.items()}
    assert len(again["mavkf/1-1/pose"]) > 100
    assert found == {key: one[key] + again[key] for key in one}


def test_made_up_senders_neither_push_out_nor_bar_a_real_one(
    bench: Bench, flight: Frames, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(fleet_module, "MOST", 8)
    frames = [record for record in flight if record[1][5 if record[1][0] == 0xFD else 3] == 1]
    imu = mavlink.MAVLink_raw_imu_message(1_000_000, 0, 0, -1000, 0, 0, 0, 0, 0, 0)
    made_up = [imu.pack(mavlink.MAVLink(None, 2 + k % 200, 1 + k // 200)) for k in range(len(frames))]
    flood = [
        record
        for (stamp, frame), other in zip(frames, made_up, strict=True)
        for record in ((stamp, other), (stamp, frame))
    ]
    bench.send([(BEGIN_US, other) for other in made_up[:50]])
    bench.send(flood)
    bench.fleet.finish()
    assert len(bench.fleet.vehicles) == 8
    found = {key: records for key, records in without_utc(bench.published).items() if "/1-1/" in key}
    assert found == wanted(frames, tmp_path)
    assert sum("more than 8 senders" in text for text in bench.said) == 1


def test_a_gap_of_the_link_is_an_event_however_the_rows_are_cut(flight: Frames, tmp_path: Path) -> None:
    frames = [record for record in flight if not 8_000_000 <= record[0] - BEGIN_US < 13_000_000]
    path = tmp_path / "gap.tlog"
    path.write_bytes(tlog(frames))
    rows = read_tlog(path).rows[1, 1]
    found = []
    for each in (1, 13, len(rows)):
        stream = VehicleStream("1-1", Config())
        records = []
        for i in range(0, len(rows), each):
            for step in stream.push(rows[i : i + each]):
                records += [msgspec.structs.replace(record, utc_ns=None) for record in stream.records(step)]
        found.append(sorted(records, key=lambda record: (key_of(record), record.seq)))
    assert found[0] == found[1] == found[2]
    (gap,) = [record for record in found[0] if isinstance(record, Event) and record.kind == "link_gap"]
    assert gap.size == pytest.approx(5.0, abs=0.05)
    assert gap.t_start_s is not None and gap.t_end_s is not None
    assert gap.t_end_s - gap.t_start_s == gap.size


def test_when_it_is_late_outputs_are_left_out_and_keep_their_numbers(
    bench: Bench, flight: Frames, tmp_path: Path
) -> None:
    frames = [record for record in flight if record[1][5 if record[1][0] == 0xFD else 3] == 1]
    bench.send(frames[:500])
    bench.fleet.is_late = True
    bench.send(frames[500:800], each=100)
    bench.fleet.is_late = False
    bench.send(frames[800:])
    bench.fleet.finish()
    everything, found = wanted(frames, tmp_path), without_utc(bench.published)
    assert found["mavkf/1-1/status"] == everything["mavkf/1-1/status"]
    assert found["mavkf/1-1/event"] == everything["mavkf/1-1/event"]
    missing = {"pose": 0, "innovation": 0}
    for key, records in everything.items():
        there = {record["seq"] for record in found[key]}
        assert found[key] == [record for record in records if record["seq"] in there]
        what = key.split("/")[2]
        if what in missing:
            missing[what] += len(records) - len(there)
    assert missing == dict(bench.fleet.unpublished)
    assert missing["pose"] > 150 and missing["innovation"] > 100
    numbers = [record["seq"] for record in found["mavkf/1-1/pose"]]
    assert max(np.diff(numbers)) <= 100  # the newest of each call came
