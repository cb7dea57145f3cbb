"""Recordings that are not MAVLink become sample rows on one clock, in one frame."""

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from benchmarks.accuracy.drive import LOGGING_DELAY, MOUNTING, outages, read_drive
from benchmarks.accuracy.kitti import ORIGIN, euler, to_geodetic
from benchmarks.accuracy.rtklib import arrivals, clock_of, read_solution
from mavkf.config import Config, with_settings
from mavkf.navigation import layout as L
from mavkf.navigation.events import turn_sensors
from mavkf.replay.truth import Truth
from mavkf.samples import ACCEL, FIX, GYRO, KIND, SIGMA_HORIZONTAL, SIGMA_SPEED, SOURCE, TIME, VELOCITY_N, Kind, Source

BEGIN = 1_752_000_000  # GPS time, s since 1970


def write_tag(log: Path, begin: float, ticks: np.ndarray, bytes_there: np.ndarray) -> None:
    head = b"TIMETAG RTKLIB".ljust(60, b"\0") + struct.pack("<IId", 4711, int(begin), begin % 1.0)
    log.with_name(log.name + ".tag").write_bytes(head + np.stack([ticks, bytes_there], 1).astype("<u4").tobytes())


@pytest.mark.parametrize("carriage_returns", [False, True])
def test_the_tag_tells_when_each_line_was_complete(tmp_path: Path, carriage_returns: bool) -> None:
    log = tmp_path / "imu.csv"
    log.write_bytes(b"one\ntwo\nthree\nfour\n")
    extra = np.array([1, 2, 3]) if carriage_returns else 0
    write_tag(log, BEGIN + 0.25, np.array([10, 20, 50]), np.array([4, 9, 14]) + extra + [0, 0, 0])
    if carriage_returns:  # the whole stream is in the tag: 19 bytes of the file and four carriage returns
        write_tag(log, BEGIN + 0.25, np.array([10, 20, 50, 60]), np.array([5, 11, 17, 23]))
        expected = [0.26, 0.27, 0.3, 0.31]
    else:
        expected = [0.26, 0.27, 0.3, np.nan]
    np.testing.assert_allclose(arrivals(log) - BEGIN, expected, atol=1e-6)


def test_a_clock_is_found_below_its_latencies() -> None:
    random = np.random.default_rng(3)
    stamps = 200.0 + np.arange(0.0, 500.0, 0.01)
    latency = random.exponential(0.02, stamps.size)
    arrived = BEGIN + 1.00002 * stamps + latency
    arrived[::7] = np.nan
    offset, rate = clock_of(stamps, arrived)
    assert offset + rate * 400.0 == pytest.approx(BEGIN + 1.00002 * 400.0, abs=1e-3)
    assert rate == pytest.approx(1.00002, abs=3e-6)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """60 s: the IMU accelerates and turns; fixes before the IMU is on, one of them float."""
    ms = 5000 + np.arange(0, 60_000, 10)
    body = np.tile([1.0, 0.0, -1.0], (ms.size, 1))  # g
    turn = np.tile([0.0, 0.0, 10.0], (ms.size, 1))  # deg/s
    lines = [",".join(f"{x:.6f}" for x in [*f, *w]) + f",{t}\n" for f, w, t in zip(body, turn, ms, strict=True)]
    (tmp_path / "imu_0.csv").write_text("".join(lines), encoding="ascii")
    ends = np.cumsum([len(line) for line in lines])
    write_tag(tmp_path / "imu_0.csv", BEGIN, ms - 5000 + 100, ends)
    fixes = ["% head"]
    for i in range(200):
        t = 11.0 + i * 0.25  # BEGIN is 18:40:00
        clock = f"2025/07/08 18:{40 + int(t // 60):02d}:{t % 60:06.3f}"
        numbers = [
            40.0 + 1e-6 * i,
            -105.0,
            1600.0,
            2 if i == 5 else 1,
            20,
            0.01,
            0.01,
            0.02,
            0,
            0,
            0,
            0,
            0,
            0.3,
            0.4,
            0.1,
        ]
        fixes.append(" ".join([clock, *(f"{x:.7f}" for x in [*numbers, 0.05, 0.05, 0.05, 0, 0, 0])]))
    (tmp_path / "gnss_0.pos").write_text("\n".join(fixes) + "\n", encoding="ascii")
    return tmp_path


def test_the_drive_is_read_on_one_clock(recording: Path) -> None:
    assert pytest.approx(BEGIN + 11.0) == read_solution(recording / "gnss_0.pos").t[0]
    drive = read_drive(recording, 3.0)
    imu, gnss = (drive.rows[drive.rows[:, KIND] == kind] for kind in (Kind.IMU, Kind.GNSS))
    np.testing.assert_allclose(
        imu[:, ACCEL : ACCEL + 3], np.tile([9.80665, 0.0, -9.80665], (imu.shape[0], 1)), atol=1e-4
    )
    np.testing.assert_allclose(
        np.degrees(imu[:, GYRO : GYRO + 3]), np.tile([0.0, 0.0, 10.0], (imu.shape[0], 1)), atol=1e-4
    )
    # the first IMU line came 0.1 s after BEGIN; the first fix 11 s after BEGIN
    assert gnss[0, TIME] - imu[0, TIME] == pytest.approx(10.9 + LOGGING_DELAY, abs=2e-3)
    np.testing.assert_allclose(gnss[:, VELOCITY_N : VELOCITY_N + 3], np.tile([0.3, 0.4, -0.1], (200, 1)))
    np.testing.assert_allclose(gnss[:, [SIGMA_HORIZONTAL, SIGMA_SPEED]], np.tile([0.01, 0.05], (200, 1)))
    assert list(gnss[:7, FIX]) == [6, 6, 6, 6, 6, 5, 6]
    np.testing.assert_allclose(drive.fixes.time_boot_s, gnss[:, TIME], atol=1e-6)


def test_the_imu_hangs_upside_down_and_backwards() -> None:
    event = np.full((1, L.EVENT_WIDTH), np.nan)
    event[0, [KIND, SOURCE]] = Kind.IMU, Source.RAW_IMU
    event[0, ACCEL : ACCEL + 3] = [0.116, 0.006, 1.004]  # what it shows while the car stands, g
    event[0, GYRO : GYRO + 3] = [0.0, 0.0, -0.3]
    roll, pitch, yaw = with_settings(Config(), MOUNTING).vehicle.imu_rotation_deg
    turn_sensors(event, (math.radians(roll), math.radians(pitch), math.radians(yaw)))
    np.testing.assert_allclose(event[0, ACCEL : ACCEL + 3], [0.0, 0.0, -1.01], atol=0.01)
    assert event[0, GYRO + 2] == pytest.approx(0.3, abs=0.01)


def test_outages_begin_after_40_s_and_leave_the_end_alone() -> None:
    t = 3.0 + np.arange(0.0, 548.0, 0.25)
    windows = outages(Truth(t, t, t, t, np.zeros((t.size, 3)), np.zeros((t.size, 3))))
    assert windows[0] == (43.0, 58.0) and windows[1][0] == 88.0
    assert len(windows) == 11 and windows[-1][1] <= t[-1] - 30.0


def test_east_north_up_becomes_geodetic() -> None:
    latitude, longitude, height = to_geodetic(np.array([[0.0, 0.0, 5.0], [100.0, 0.0, 0.0], [0.0, 100.0, 0.0]]))
    np.testing.assert_allclose([latitude[0], longitude[0], height[0]], [*ORIGIN, 5.0], atol=1e-8)
    assert (longitude[1] - ORIGIN[1]) * np.cos(ORIGIN[0]) * 6_390_000.0 == pytest.approx(100.0, abs=0.1)
    assert (latitude[2] - ORIGIN[0]) * 6_372_000.0 == pytest.approx(100.0, abs=0.1)


def test_a_car_that_looks_east_has_a_yaw_of_ninety_degrees() -> None:
    half = np.sqrt(0.5)
    looks = euler(np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, half, half], [0.0, -np.sin(0.05), 0.0, np.cos(0.05)]]))
    np.testing.assert_allclose(np.degrees(looks[0]), [0.0, 0.0, 90.0], atol=1e-9)  # forward is east
    np.testing.assert_allclose(np.degrees(looks[1]), [0.0, 0.0, 0.0], atol=1e-9)  # forward is north
    # forward-left-up turned by -0.1 rad about left: the nose goes up
    np.testing.assert_allclose(looks[2], [0.0, 0.1, np.pi / 2], atol=1e-9)
