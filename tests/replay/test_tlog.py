"""Recorded flights, read by mavkf and by pymavlink; and what becomes of files that are no logs."""

import json
import os
import random
import struct
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavkf.cli.info import info
from mavkf.errors import LogError
from mavkf.link.layouts import message_dtype
from mavkf.replay.tlog import Log, TlogReader, read_tlog
from mavkf.samples import ARRIVAL, KIND, SOURCE, Kind, Source

FLIGHTS = os.environ.get("MAVKF_FLIGHTS")
LOGS = sorted(Path(FLIGHTS).rglob("*.tlog")) if FLIGHTS else []
WHOLE, PREFIX = 3_000_000, 600_000
"""Bytes: pymavlink, which reads about 2 MB a second, reads flights up to the one whole, of larger ones the beginning."""
T0 = 1_600_000_000_000_000

READER = """
import pickle, sys
from pymavlink import mavutil
log = mavutil.mavlogfile(sys.argv[1], robust_parsing=True)
out = []
while (m := log.recv_msg()) is not None:
    if m.get_type() != "BAD_DATA" and not m.get_type().startswith("UNKNOWN"):
        values = [getattr(m, n) for n in m.ordered_fieldnames]
        out.append((m.get_srcSystem(), m.get_srcComponent(), m.get_type(), round(m._timestamp * 1e6), values))
pickle.dump(out, sys.stdout.buffer)
"""

Message = tuple[int, int, str, int, list[Any]]


def by_pymavlink(path: Path) -> list[Message]:
    import pickle

    environment = os.environ | {"MAVLINK20": "1", "MAVLINK_DIALECT": "all"}
    done = subprocess.run([sys.executable, "-c", READER, str(path)], env=environment, capture_output=True, check=True)
    return list(pickle.loads(done.stdout))


def by_mavkf(log: Log) -> list[Message]:
    """The same of mavkf, in file order."""
    found: list[tuple[int, Message]] = []
    for (system, component), counts in log.message_counts.items():
        for name in (count.name for count in counts):
            messages, stamps = log.messages(system, component, name)
            f = log.frames
            mine = (f["system"] == system) & (f["component"] == component) & (f["message"] == ids()[name])
            for place, one, stamp in zip(np.flatnonzero(mine), messages, stamps, strict=True):
                values = [v.tolist() if isinstance(v, np.ndarray) else v for v in one.tolist()]
                found.append((int(place), (system, component, name, int(stamp), values)))
    return [message for _, message in sorted(found, key=lambda pair: pair[0])]


def ids() -> dict[str, int]:
    return {message.msgname: number for number, message in dialect.mavlink_map.items()}


def key(message: Message, *, stamp: bool = True) -> tuple[Any, ...]:
    """A message to compare by: NaN equals NaN, text is what stands before its first zero."""
    values = []
    for value in message[4]:
        text = value.encode() if isinstance(value, str) else value
        values.append(text.split(b"\0")[0] if isinstance(text, bytes) else repr(text))
    return (*message[: 4 if stamp else 3], *values)


pytestmark = pytest.mark.filterwarnings("error")
needs_flights = pytest.mark.skipif(not LOGS, reason="MAVKF_FLIGHTS does not name a folder of recorded flights (*.tlog)")


@needs_flights
def test_there_are_flights() -> None:
    assert len(LOGS) >= 10


@needs_flights
@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.stem[:30])
def test_the_beginning_of_each_flight_is_what_pymavlink_reads(path: Path, tmp_path: Path) -> None:
    whole = path.stat().st_size <= WHOLE or "lossy" in path.stem
    with path.open("rb") as file:
        beginning = file.read() if whole else file.read(PREFIX)
    part = tmp_path / "part.tlog"
    part.write_bytes(beginning)
    log = read_tlog(part)
    mine, theirs = by_mavkf(log), by_pymavlink(part)
    damage = log.damage
    if damage.bad_crc or damage.stray_bytes:
        missing = Counter(key(m, stamp=False) for m in theirs) - Counter(key(m, stamp=False) for m in mine)
        assert not missing
        assert len(mine) >= len(theirs)
    else:
        assert [key(m) for m in mine] == [key(m) for m in theirs]


@needs_flights
@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.stem[:30])
def test_each_flight_whole(path: Path) -> None:
    told: list[float] = []
    log = read_tlog(path, told.append)
    damage = log.damage
    parts = damage.frame_bytes + damage.bad_bytes + damage.unknown_bytes + damage.stray_bytes + damage.tail_bytes
    assert parts == log.size == path.stat().st_size
    assert told[-1] == 1.0
    assert sum(count.count for counts in log.message_counts.values() for count in counts) == len(log.frames)
    assert crc_holds(log, random.Random(1).sample(range(len(log.frames)), 200))
    for rows in log.rows.values():
        assert (np.diff(rows[:, ARRIVAL]) >= -1e6).all()


@needs_flights
def test_messages_that_are_not_asked_for_give_no_rows_and_the_others_the_same() -> None:
    path = next(path for path in LOGS if path.stem.startswith("ap02"))
    asked = [Source.GPS_RAW_INT, Source.SCALED_PRESSURE, Source.HIL_GPS]
    reader, found = TlogReader(path, asked), []
    for block in reader:
        found += list(block.rows.items())
    log = read_tlog(path)
    assert {address for address, _ in found} == {(1, 1)}
    every = log.rows[1, 1]
    expected = every[np.isin(every[:, SOURCE], asked)]
    np.testing.assert_array_equal(np.concatenate([rows for _, rows in found]), expected)
    assert {Kind.GNSS, Kind.BAROMETER} == set(expected[:, KIND]) and reader.damage == log.damage


def crc_holds(log: Log, places: list[int]) -> bool:
    """Whether frames hold by pymavlink's own CRC."""
    from pymavlink.generator.mavcrc import x25crc

    for place in places:
        f = log.frames[place]
        end = int(f["offset"]) + int(f["length"])
        start = int(f["offset"]) - (9 if f["version"] == 2 else 5)
        body = log.data[start:end].tobytes() + bytes([dialect.mavlink_map[int(f["message"])].crc_extra])
        if x25crc(body).crc != int.from_bytes(log.data[end : end + 2].tobytes(), "little"):
            return False
    return True


def attitude(i: int, system: int = 1) -> bytes:
    mav = dialect.MAVLink(None, srcSystem=system, srcComponent=1)
    mav.seq = i % 256
    return bytes(dialect.MAVLink_attitude_message(1000 + i, 0.1, 0.2, 0.3 * i, 0.0, 0.0, 0.5).pack(mav))


def record(stamp: int, frame: bytes) -> bytes:
    return struct.pack(">Q", stamp) + frame


def test_no_frame_is_lost_to_damage_that_pymavlink_finds(tmp_path: Path) -> None:
    chance = random.Random(7)
    raw = bytearray(b"".join(record(T0 + 10_000 * i, attitude(i)) for i in range(3000)))
    for _ in range(60):
        raw[chance.randrange(len(raw))] ^= 1 << chance.randrange(8)
    for _ in range(20):
        at = chance.randrange(len(raw))
        raw[at:at] = chance.randbytes(chance.randrange(1, 40))
        at = chance.randrange(len(raw))
        del raw[at : at + chance.randrange(1, 40)]
    path = tmp_path / "damaged.tlog"
    path.write_bytes(bytes(raw))
    log = read_tlog(path)
    true = {key((1, 1, "ATTITUDE", 0, list(v)), stamp=False) for v in messages_of(range(3000))}
    mine = [key(m, stamp=False) for m in by_mavkf(log)]
    theirs = [key(m, stamp=False) for m in by_pymavlink(path)]
    assert len(mine) >= len(theirs)
    assert set(mine) <= true
    assert set(theirs) & true <= set(mine)
    stamps = log.frames["stamp"]
    assert (np.abs(stamps - (T0 + 15_000_000)) < 20_000_000).all()
    assert log.damage.bad_stamps > 0


def messages_of(numbers: range) -> list[tuple[Any, ...]]:
    raw = b"".join(attitude(i)[10:-2].ljust(28, b"\0") for i in numbers)
    return [tuple(v) for v in np.frombuffer(raw, message_dtype("ATTITUDE")).tolist()]


def encoded(system: int, component: int, message: Any) -> bytes:
    return bytes(message.pack(dialect.MAVLink(None, srcSystem=system, srcComponent=component)))


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """A log of a vehicle with IMU, a vehicle with GNSS only, a ground station with GNSS, and a camera."""
    beat = dialect.MAVLink_heartbeat_message
    gps = dialect.MAVLink_gps_raw_int_message(5_000_000, 3, 1, 2, 3, 4, 5, 6, 7, 8)
    frames = [
        encoded(1, 1, beat(2, 3, 81, 0, 4, 3)),
        encoded(1, 1, dialect.MAVLink_raw_imu_message(5_000_000, 0, 0, -1000, 0, 0, 0, 0, 0, 0)),
        encoded(1, 1, attitude_message()),
        encoded(9, 2, gps),
        encoded(255, 190, beat(6, 8, 0, 0, 4, 3)),
        encoded(255, 190, gps),
        encoded(1, 100, beat(30, 8, 0, 0, 4, 3)),
    ]
    path = tmp_path / "fleet.tlog"
    path.write_bytes(b"".join(record(T0 + 500_000 * i, f) for i, f in enumerate(frames)))
    return path


def attitude_message() -> Any:
    return dialect.MAVLink_attitude_message(5000, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_what_a_log_says(fleet: Path) -> None:
    log = read_tlog(fleet)
    assert log.vehicles() == [(1, 1), (9, 2)]
    assert log.duration_s == pytest.approx(3.0)
    assert log.first_us == T0
    assert {(c.name, c.count) for c in log.message_counts[1, 1]} == {("HEARTBEAT", 1), ("RAW_IMU", 1), ("ATTITUDE", 1)}
    assert list(log.rows[1, 1][:, KIND]) == [Kind.HEARTBEAT, Kind.IMU]
    attitudes, stamps = log.messages(1, 1, "ATTITUDE")
    assert (attitudes["roll"].tolist(), stamps.tolist()) == ([0.5], [T0 + 1_000_000])
    assert len(log.messages(1, 1, "SIM_STATE")[0]) == 0
    with pytest.raises(KeyError):
        log.messages(1, 1, "NO_SUCH_MESSAGE")


def test_info_of_a_log_for_people_and_machines(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert info(fleet) == 0
    shown = capsys.readouterr()
    for words in (
        "Vehicle 1/1  quadrotor, ArduPilot",
        "Vehicle 9/2",
        "Also heard: 1/100 camera",
        "255/190 ground station",
    ):
        assert words in shown.out
    assert "no damage" in shown.out
    assert info(fleet, json=True) == 0
    summary = json.loads(capsys.readouterr().out)
    first, second = summary["vehicles"]
    assert (first["system"], first["component"], first["type"], first["autopilot"]) == (1, 1, "quadrotor", "ArduPilot")
    (session,) = first["sessions"]
    assert session["sensors"] == [{"sensor": "IMU", "message": "RAW_IMU", "samples": 1, "rate_hz": None}]
    (receiver,) = second["sessions"][0]["receivers"]
    assert (receiver["fix_3d_share"], receiver["first_fix_boot_s"], receiver["satellites"]) == (1.0, 5.0, [8, 8])
    assert summary["duration_s"] == 3.0
    assert summary["start_utc"] == "2020-09-13T12:26:40+00:00"


def test_info_counts_sessions_gaps_and_fixes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def imu(t: float) -> bytes:
        return encoded(1, 1, dialect.MAVLink_raw_imu_message(int(t * 1e6), 0, 0, -1000, 0, 0, 0, 0, 0, 0))

    def gps(t: float, fix: int) -> bytes:
        return encoded(1, 1, dialect.MAVLink_gps_raw_int_message(int(t * 1e6), fix, 1, 2, 3, 4, 5, 6, 7, 8))

    before = [imu(100 + 0.1 * i) for i in range(20)] + [imu(110.0), gps(110.1, 1), gps(110.2, 3)]
    after = [imu(2 + 0.1 * i) for i in range(11)]
    path = tmp_path / "two.tlog"
    path.write_bytes(b"".join(record(T0 + i, f) for i, f in enumerate(before + after)))
    info(path, json=True)
    (vehicle,) = json.loads(capsys.readouterr().out)["vehicles"]
    first, second = vehicle["sessions"]
    assert vehicle["reboots"] == 1
    assert (first["boot_start_s"], first["boot_end_s"], first["gaps"], first["longest_gap_s"]) == (100.0, 110.2, 1, 8.1)
    assert (second["boot_start_s"], second["boot_end_s"], second["gaps"]) == (2.0, 3.0, 0)
    assert second["sensors"] == [{"sensor": "IMU", "message": "RAW_IMU", "samples": 11, "rate_hz": 10.0}]
    assert (first["receivers"][0]["fix_3d_share"], first["receivers"][0]["first_fix_boot_s"]) == (0.5, 110.2)


def test_info_of_a_log_without_a_vehicle(tmp_path: Path) -> None:
    path = tmp_path / "ground.tlog"
    path.write_bytes(record(T0, encoded(255, 190, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))))
    with pytest.raises(LogError, match=r"holds 1 messages of 255/190.*vehicle"):
        info(path)


def test_bare_frames_have_no_arrival(tmp_path: Path) -> None:
    path = tmp_path / "link.rlog"
    path.write_bytes(b"".join(attitude(i) for i in range(10)))
    log = read_tlog(path)
    assert (len(log.frames), log.first_us, log.damage.bad_stamps) == (10, 0, 10)


def test_files_that_are_no_logs(tmp_path: Path) -> None:
    empty, text = tmp_path / "empty.tlog", tmp_path / "text.tlog"
    empty.touch()
    text.write_text("time,roll\n" * 50)
    for path, words in (
        (tmp_path / "nothing.tlog", "does not exist"),
        (tmp_path, "folder"),
        (empty, "empty"),
        (text, "no MAVLink frame"),
        (text / "below.tlog", "cannot be read"),
    ):
        with pytest.raises(LogError, match=words) as caught:
            read_tlog(path)
        assert str(path) in str(caught.value)


def test_a_log_that_may_not_be_read(fleet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(np, "memmap", refuse)  # the tests may run as root, who may read everything
    with pytest.raises(LogError, match="may not be read"):
        read_tlog(fleet)
