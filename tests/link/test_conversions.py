"""Each message, encoded by pymavlink from known values, as sample rows in SI units."""

import struct
from math import nan, pi
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavkf.link.decode import DecodeCounts, decode
from mavkf.link.framing import scan_records
from mavkf.link.gather import gather
from mavkf.link.layouts import message_dtype, message_ids
from mavkf.samples import ROW_WIDTH, AutopilotParameter, Clock, Kind, Source

from ._wire import CLASSES, array, frame, rows_of

G = 9.80665
DEG = pi / 180
BOOT = 123_456_789
UNIX = 1_700_000_000_000_000


def body(row: np.ndarray) -> np.ndarray:
    """The values of a row, from column 8 on."""
    return row[8:]


def expect(row: np.ndarray, values: list[float]) -> None:
    np.testing.assert_allclose(body(row), values + [nan] * (ROW_WIDTH - 8 - len(values)), rtol=1e-6, atol=1e-12)


def head(row: np.ndarray) -> tuple[float, ...]:
    return tuple(row[i] for i in (0, 1, 3, 4, 5))


INTEGER = dict(xacc=1000, yacc=-20, zacc=-980, xgyro=1500, ygyro=-7, zgyro=3, xmag=224, ymag=-80, zmag=530)


@pytest.mark.parametrize("name", ["RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"])
@pytest.mark.parametrize("version", [1, 2])
def test_integer_imu(name: str, version: int) -> None:
    usec = name == "RAW_IMU"
    time = {"time_usec": BOOT} if usec else {"time_boot_ms": 4_000_000_123}
    rows = rows_of(frame(name, version=version, sequence=9, temperature=2550, **time, **INTEGER))
    stamp, clock = (BOOT, Clock.BOOT_US) if usec else (4_000_000_123_000, Clock.BOOT_MS)
    assert [head(r) for r in rows] == [(stamp, clock, kind, Source[name], 9) for kind in (Kind.MAGNETOMETER, Kind.IMU)]
    expect(rows[0], [224e-7, -80e-7, 530e-7])
    expect(rows[1], [1.5, -0.007, 0.003, G, -0.02 * G, -0.98 * G, 25.5, 1e-3, 1e-3 * G])


def test_integer_imu_without_magnetometer_or_temperature() -> None:
    (row,) = rows_of(frame("RAW_IMU", time_usec=BOOT, zacc=-1000))
    assert row[3] == Kind.IMU
    expect(row, [0, 0, 0, 0, 0, -G, nan, 1e-3, 1e-3 * G])


FLOAT = dict(xacc=0.5, yacc=-1.5, zacc=-9.8, xgyro=0.01, ygyro=-0.02, zgyro=0.03)
FLOAT |= dict(
    xmag=0.2, ymag=-0.1, zmag=0.4, abs_pressure=955.5, diff_pressure=1.5, pressure_alt=490.0, temperature=31.5
)
FLOAT_IMU = [0.01, -0.02, 0.03, 0.5, -1.5, -9.8, 31.5, 0, 0]
ALL = (Kind.MAGNETOMETER, Kind.BAROMETER, Kind.IMU)


@pytest.mark.parametrize("name", ["HIGHRES_IMU", "HIL_SENSOR"])
def test_float_imu(name: str) -> None:
    rows = rows_of(frame(name, time_usec=BOOT, **FLOAT))
    assert [head(r)[:4] for r in rows] == [(BOOT, Clock.BOOT_US, kind, Source[name]) for kind in ALL]
    expect(rows[0], [0.2e-4, -0.1e-4, 0.4e-4])
    expect(rows[1], [95550, 31.5, 150])
    expect(rows[2], FLOAT_IMU)


@pytest.mark.parametrize(
    ("updated", "kinds"),
    [
        (0x1FFF, ALL),
        (0x3F, (Kind.IMU,)),
        (0x1FF, (Kind.MAGNETOMETER, Kind.IMU)),
        (0x1A3F, (Kind.BAROMETER, Kind.IMU)),
        (0x1C0, (Kind.MAGNETOMETER,)),
        (0x07, ()),
        (1 << 31, ()),
    ],
)
def test_only_what_is_updated_gives_rows(updated: int, kinds: tuple[Kind, ...]) -> None:
    raw = frame("HIL_SENSOR", time_usec=BOOT, fields_updated=updated, **FLOAT) + frame("HEARTBEAT")
    assert [r[3] for r in rows_of(raw)] == [*kinds, Kind.HEARTBEAT]


def test_differential_pressure_only_when_updated() -> None:
    rows = rows_of(frame("HIGHRES_IMU", time_usec=BOOT, fields_updated=0x1FFF & ~0x400, **FLOAT))
    expect(rows[1], [95550, 31.5])


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e6])
def test_magnetometer_of_highres_imu_in_gauss_milligauss_or_microgauss(scale: float) -> None:
    field = dict(xmag=0.224 * scale, ymag=0.08 * scale, zmag=-0.529 * scale)
    rows = rows_of(frame("HIGHRES_IMU", time_usec=BOOT, **(FLOAT | field)))
    expect(rows[0], [0.224e-4, 0.08e-4, -0.529e-4])


@pytest.mark.parametrize("name", ["RAW_IMU", "HIGHRES_IMU", "HIL_SENSOR"])
def test_other_instances_are_counted_and_left_out(name: str) -> None:
    counts = DecodeCounts()
    values = INTEGER if name == "RAW_IMU" else FLOAT
    raw = array(frame(name, time_usec=BOOT, id=1, **values))
    assert decode(raw, scan_records(raw, stamped=False)[0], counts) == {}
    assert counts.other_instances == 1


@pytest.mark.parametrize(
    ("field", "kinds", "refused"),
    [
        ("xgyro", (Kind.MAGNETOMETER, Kind.BAROMETER), 1),
        ("zacc", (Kind.MAGNETOMETER, Kind.BAROMETER), 1),
        ("ymag", (Kind.BAROMETER, Kind.IMU), 1),
        ("abs_pressure", (Kind.MAGNETOMETER, Kind.IMU), 1),
        ("temperature", ALL, 0),
        ("diff_pressure", ALL, 0),
    ],
)
@pytest.mark.parametrize("value", [nan, float("inf"), -float("inf")])
def test_values_that_are_not_finite_are_counted_and_left_out(
    field: str, kinds: tuple[Kind, ...], refused: int, value: float
) -> None:
    counts = DecodeCounts()
    raw = array(frame("HIGHRES_IMU", time_usec=BOOT, **(FLOAT | {field: value})))
    rows = decode(raw, scan_records(raw, stamped=False)[0], counts)[1, 1]
    assert tuple(rows[:, 3]) == kinds
    assert counts.not_finite == refused
    assert not np.isinf(rows).any()


@pytest.mark.parametrize("name", ["SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3"])
def test_scaled_pressure(name: str) -> None:
    (row,) = rows_of(frame(name, time_boot_ms=77, press_abs=945.25, press_diff=-0.5, temperature=-250))
    assert head(row)[:4] == (77_000, Clock.BOOT_MS, Kind.BAROMETER, Source[name])
    expect(row, [94525, -2.5, -50])


@pytest.mark.parametrize("pressure", [0.0, -1.0, nan])
def test_an_unknown_pressure_gives_no_row(pressure: float) -> None:
    raw = frame("SCALED_PRESSURE", time_boot_ms=77, press_abs=pressure) + frame("HEARTBEAT")
    assert [r[3] for r in rows_of(raw)] == [Kind.HEARTBEAT]


GPS: dict[str, Any] = dict(time_usec=BOOT, fix_type=3, lat=-353_632_620, lon=1_491_652_370, alt=584_090)
GPS |= dict(eph=121, epv=200, vel=1000, cog=3000, satellites_visible=10)
GPS |= dict(alt_ellipsoid=603_456, h_acc=300, v_acc=450, vel_acc=120, hdg_acc=5, yaw=9000)
PLACE = [3, -35.363262 * DEG, 149.165237 * DEG, 584.09]


@pytest.mark.parametrize("name", ["GPS_RAW_INT", "GPS2_RAW"])
def test_gps_raw(name: str) -> None:
    (row,) = rows_of(frame(name, **GPS))
    assert head(row)[:4] == (BOOT, Clock.BOOT_US, Kind.GNSS, Source[name])
    velocity = [10 * np.cos(30 * DEG), 10 * np.sin(30 * DEG), nan]
    expect(row, [*PLACE, 603.456, *velocity, 0.3, 0.45, 0.12, 10, 1.21, 2.0, 90 * DEG])


def test_what_gps_raw_does_not_know_is_nan() -> None:
    unknown = dict(eph=65535, epv=65535, vel=65535, cog=65535, satellites_visible=255)
    unknown |= dict(alt_ellipsoid=0, h_acc=0, v_acc=0, vel_acc=0, yaw=0)
    (row,) = rows_of(frame("GPS_RAW_INT", **(GPS | unknown)))
    expect(row, PLACE)


def test_gps_raw_of_mavlink_1_has_no_extensions() -> None:
    raw = bytearray(frame("GPS_RAW_INT", **GPS))
    assert raw[1] == 52
    # As sent by MAVLink 1, the payload ends after satellites_visible; the CRC follows from it.
    from pymavlink.generator.mavcrc import x25crc

    short = b"\xfe" + bytes([30, 0, 1, 1, 24]) + bytes(raw[10:40])
    short += x25crc(short[1:] + bytes([CLASSES["GPS_RAW_INT"].crc_extra])).crc.to_bytes(2, "little")
    (row,) = rows_of(short)
    velocity = [10 * np.cos(30 * DEG), 10 * np.sin(30 * DEG)]
    expect(row, [*PLACE, nan, *velocity, nan, nan, nan, nan, 10, 1.21, 2.0])


@pytest.mark.parametrize(
    ("vel", "cog", "velocity"), [(0, 65535, [0.0, 0.0]), (500, 65535, [nan, nan]), (65535, 0, [nan, nan])]
)
def test_velocity_with_unknown_course_or_speed(vel: int, cog: int, velocity: list[float]) -> None:
    (row,) = rows_of(frame("GPS_RAW_INT", **(GPS | dict(vel=vel, cog=cog))))
    np.testing.assert_array_equal(row[13:15], velocity)


@pytest.mark.parametrize(("yaw", "expected"), [(0, nan), (65535, nan), (36000, 0.0), (1, 0.01 * DEG), (40000, nan)])
def test_yaw_of_a_dual_antenna(yaw: int, expected: float) -> None:
    for name in ("GPS_RAW_INT", "GPS2_RAW", "HIL_GPS", "GPS_INPUT"):
        fields = {k: v for k, v in (GPS | dict(yaw=yaw)).items() if k in CLASSES[name].fieldnames}
        (row,) = rows_of(frame(name, **fields))
        np.testing.assert_allclose(row[22], expected)


def test_unix_and_missing_times() -> None:
    (unix,) = rows_of(frame("GPS_RAW_INT", **(GPS | dict(time_usec=UNIX))))
    assert tuple(unix[:2]) == (UNIX, Clock.UNIX_US)
    (missing,) = rows_of(frame("GPS_RAW_INT", **(GPS | dict(time_usec=0))))
    assert np.isnan(missing[0])
    assert missing[1] == Clock.NONE


def test_without_a_fix_there_is_no_time_of_measurement() -> None:
    (row,) = rows_of(frame("GPS_RAW_INT", **(GPS | dict(fix_type=1))))
    assert np.isnan(row[0])
    assert row[1] == Clock.NONE
    assert row[8] == 1


HIL = dict(time_usec=BOOT, fix_type=4, lat=-353_632_620, lon=1_491_652_370, alt=584_090, eph=121, epv=200, vel=100)
HIL |= dict(vn=-150, ve=275, vd=-3, cog=1, satellites_visible=7, yaw=18000)


def test_hil_gps() -> None:
    (row,) = rows_of(frame("HIL_GPS", **HIL))
    assert head(row)[:4] == (BOOT, Clock.BOOT_US, Kind.GNSS, Source.HIL_GPS)
    expect(row, [4, *PLACE[1:], nan, -1.5, 2.75, -0.03, nan, nan, nan, 7, 1.21, 2.0, pi])


def test_hil_gps_of_unknown_velocity() -> None:
    (row,) = rows_of(frame("HIL_GPS", **(HIL | dict(vel=65535, eph=65535, epv=65535, satellites_visible=255, yaw=0))))
    expect(row, [4, *PLACE[1:]])


INPUT: dict[str, Any] = dict(
    time_usec=UNIX, fix_type=3, lat=-353_632_620, lon=1_491_652_370, alt=584.5, hdop=1.5, vdop=2.5
)
INPUT |= dict(vn=1.0, ve=-2.0, vd=0.25, speed_accuracy=0.125, horiz_accuracy=0.5, vert_accuracy=0.75)
INPUT |= dict(satellites_visible=12, yaw=27000)
INPUT_ROW = [*PLACE[:3], 584.5, nan, 1.0, -2.0, 0.25, 0.5, 0.75, 0.125, 12, 1.5, 2.5, 1.5 * pi]


def test_gps_input() -> None:
    (row,) = rows_of(frame("GPS_INPUT", **INPUT))
    assert head(row)[:4] == (UNIX, Clock.UNIX_US, Kind.GNSS, Source.GPS_INPUT)
    expect(row, INPUT_ROW)


@pytest.mark.parametrize(
    ("flag", "places"), [(1, [3]), (2, [12]), (4, [13]), (8, [5, 6]), (16, [7]), (32, [10]), (64, [8]), (128, [9])]
)
def test_what_gps_input_ignores_is_nan(flag: int, places: list[int]) -> None:
    values = list(INPUT_ROW)
    for place in places:
        values[place] = nan
    (row,) = rows_of(frame("GPS_INPUT", ignore_flags=flag, **INPUT))
    expect(row, values)


@pytest.mark.parametrize("field", ["alt", "vn", "ve", "vd"])
def test_gps_input_that_is_not_finite(field: str) -> None:
    counts = DecodeCounts()
    raw = array(frame("GPS_INPUT", **(INPUT | {field: nan})))
    assert decode(raw, scan_records(raw, stamped=False)[0], counts) == {}
    assert counts.not_finite == 1


def test_system_time() -> None:
    known, unknown = rows_of(
        frame("SYSTEM_TIME", time_unix_usec=UNIX, time_boot_ms=9) + frame("SYSTEM_TIME", time_boot_ms=10)
    )
    assert head(known)[:4] == (9_000, Clock.BOOT_MS, Kind.SYSTEM_TIME, Source.SYSTEM_TIME)
    assert known[8] == UNIX
    assert np.isnan(unknown[8])


def parameter(name: str, value: float, kind: int) -> bytes:
    return frame("PARAM_VALUE", param_id=name.encode(), param_value=value, param_type=kind, param_count=900)


@pytest.mark.parametrize("name", [parameter.name for parameter in AutopilotParameter])
def test_parameters_that_are_read(name: str) -> None:
    (row,) = rows_of(parameter(name, -0.25, 9))
    assert head(row)[1:4] == (Clock.NONE, Kind.PARAMETER, Source.PARAM_VALUE)
    assert np.isnan(row[0])
    expect(row, [AutopilotParameter[name], -0.25])


@pytest.mark.parametrize("whole", [0, 1, 5, 110, 250, -1, -30_000, 8_388_607])
@pytest.mark.parametrize("kind", [1, 2, 3, 4, 5, 6])
def test_whole_parameters_by_value_and_by_their_bytes(whole: int, kind: int) -> None:
    (in_bytes,) = struct.unpack("<f", struct.pack("<i", whole))
    for value in (float(whole), in_bytes):
        raw = parameter("GPS1_DELAY_MS", value, kind)
        (heard,) = dialect.MAVLink(None).parse_buffer(bytearray(raw))
        assert (heard.param_id, heard.param_type) == ("GPS1_DELAY_MS", kind)
        assert whole in (heard.param_value, struct.unpack("<i", struct.pack("<f", heard.param_value))[0])
        (row,) = rows_of(raw)
        expect(row, [AutopilotParameter.GPS1_DELAY_MS, whole])


@pytest.mark.parametrize("name", ["GPS1_POS", "GPS1_POS_X2", "gps1_pos_x", "", "SYSID_THISMAV", "COMPASS_USE_LONG"])
def test_parameters_that_are_not_read_give_no_rows(name: str) -> None:
    assert [r[3] for r in rows_of(parameter(name, 1.0, 9) + frame("HEARTBEAT"))] == [Kind.HEARTBEAT]


def test_what_stands_behind_the_end_of_a_name_is_not_said() -> None:
    (row,) = rows_of(parameter("GPS1_POS_X\0junk!", 0.5, 9))
    expect(row, [AutopilotParameter.GPS1_POS_X, 0.5])


def test_a_parameter_that_is_not_finite() -> None:
    counts = DecodeCounts()
    raw = array(parameter("GPS1_POS_X", nan, 9))
    assert decode(raw, scan_records(raw, stamped=False)[0], counts) == {}
    assert counts.not_finite == 1


def test_heartbeat() -> None:
    (row,) = rows_of(frame("HEARTBEAT", type=2, autopilot=3, base_mode=81, system_status=4))
    assert head(row)[1:4] == (Clock.NONE, Kind.HEARTBEAT, Source.HEARTBEAT)
    assert np.isnan(row[0])
    expect(row, [2, 3, 81, 4])


def test_rows_keep_the_order_of_arrival_and_their_senders() -> None:
    raw = b"".join(
        (
            frame("SCALED_PRESSURE", time_boot_ms=1, press_abs=900),
            frame("HIGHRES_IMU", time_usec=2000, system=2, **FLOAT),
            frame("ATTITUDE", time_boot_ms=3, roll=1.0),
            frame("RAW_IMU", time_usec=4000, **INTEGER),
            frame("HEARTBEAT"),
            frame("HEARTBEAT", component=5),
            frame("SCALED_PRESSURE", time_boot_ms=6, press_abs=900),
        )
    )
    data = array(raw)
    frames, _ = scan_records(data, stamped=False)
    frames["stamp"] = 1_000_000 + np.arange(7)
    rows = decode(data, frames)
    assert set(rows) == {(1, 1), (1, 5), (2, 1)}
    kinds = [Kind.BAROMETER, Kind.MAGNETOMETER, Kind.IMU, Kind.HEARTBEAT, Kind.BAROMETER]
    assert list(rows[1, 1][:, 3]) == kinds
    assert list(rows[1, 1][:, 2]) == [1_000_000, 1_000_003, 1_000_003, 1_000_004, 1_000_006]
    assert list(rows[2, 1][:, 3]) == list(ALL)
    assert np.isnan(rows[1, 1][:, 6:8]).all()
    assert decode(data, frames[:0]) == {}
    assert decode(data, frames[2:3]) == {}


def test_dtypes_are_as_long_as_the_messages_of_the_dialect() -> None:
    assert len(message_ids()) > 300
    for name, kind in CLASSES.items():
        assert message_dtype(name).itemsize == kind.unpacker.size


def test_any_message_as_an_array_with_its_zeros_back() -> None:
    raw = array(frame("ATTITUDE_QUATERNION", time_boot_ms=5, q1=0.5) + frame("STATUSTEXT", text=b"hello"))
    frames, _ = scan_records(raw, stamped=False)
    attitude = gather(raw, frames[:1], "ATTITUDE_QUATERNION")
    assert attitude.dtype.names is not None
    assert (attitude["time_boot_ms"][0], attitude["q1"][0], attitude["rollspeed"][0]) == (5, 0.5, 0.0)
    assert gather(raw, frames[1:], "STATUSTEXT")["text"][0] == b"hello"


def test_a_short_payload_after_a_long_one_ends_in_zeros() -> None:
    long = frame("RAW_IMU", time_usec=BOOT, temperature=2550, **INTEGER)
    short = frame("RAW_IMU", time_usec=BOOT, xacc=1000)
    assert len(short) < len(long)
    expect(rows_of(long + short)[-1], [0, 0, 0, G, 0, 0, nan, 1e-3, 1e-3 * G])
