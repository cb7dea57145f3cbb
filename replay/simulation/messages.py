"""Messages of a simulated vehicle: what it measured, in the units and steps in which ArduPilot sends it, into a tlog.

Units as ArduPilot 4.7 was seen to send them: RAW_IMU in mG, mrad/s and mgauss, cut toward zero; the field of
HIGHRES_IMU in thousandths of a mgauss; GPS_RAW_INT stamped when the fix came, zero before the first.
"""

from collections.abc import Callable, Iterator
from itertools import count
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from mavkf.models.earth import STANDARD_GRAVITY

Floats = NDArray[np.float64]
Column = NDArray[Any] | int | float

UNKNOWN_16 = 65535
CHUNK = 4096  # messages of a stream that are turned into Python numbers together
LATENCY, LATENCY_SPREAD = 2e-3, 1.5e-3  # s: from sending to the log's stamp, at least and on average above that


class Stream(NamedTuple):
    """All messages of one name: when they are sent (n), s since boot, rising, and their fields in order of the dialect."""

    name: str
    times: Floats
    columns: tuple[Column, ...]


def raw_imu(times: Floats, imu: Floats, field: Floats, temperature: Floats) -> Stream:
    """RAW_IMU of omega_b, f_b (n, 6), the field (n, 3), tesla, and degrees Celsius (n)."""
    return Stream(
        "raw_imu",
        times,
        (
            _micro(times),
            *_cut(imu[:, 3:] / STANDARD_GRAVITY * 1e3).T,
            *_cut(imu[:, :3] * 1e3).T,
            *_cut(field * 1e7).T,
            0,
            _cut(temperature * 100.0),
        ),
    )


def highres_imu(times: Floats, imu: Floats, field: Floats, air: tuple[Floats, Floats], temperature: Floats) -> Stream:
    """HIGHRES_IMU of the same, of the air: Pa (n) and metres above the start (n)."""
    pressure, climbed = air
    all_fields = 0x1FFF
    return Stream(
        "highres_imu",
        times,
        (
            _micro(times),
            *imu[:, 3:].T,
            *imu[:, :3].T,
            *(field * 1e10).T,
            pressure / 100,
            0.0,
            climbed,
            temperature,
            all_fields,
        ),
    )


def scaled_pressure(times: Floats, pressure: Floats, differential: Floats, temperature: Floats) -> Stream:
    """SCALED_PRESSURE of Pa (n), Pa (n) and degrees Celsius (n)."""
    return Stream(
        "scaled_pressure", times, (_milli(times), pressure / 100, differential / 100, _cut(temperature * 100.0))
    )


def gps_raw_int(
    times: Floats, stamps: Floats, place: tuple[Floats, Floats, Floats], v_n: Floats, accuracies: tuple[float, ...]
) -> Stream:
    """GPS_RAW_INT of fixes that came at `stamps` (n), s; NaN where there is none.

    place: rad, rad, m above sea level (n); v_n: m/s (n, 3); accuracies: horizontal m, vertical m, speed m/s.
    """
    fixed = np.isfinite(stamps)

    def fill(values: Any, missing: int = 0) -> NDArray[np.int64]:
        return np.where(fixed, np.rint(np.where(fixed, values, 0.0)), missing).astype(np.int64)

    course = np.degrees(np.arctan2(v_n[:, 1], v_n[:, 0])) % 360.0 * 100.0
    return Stream(
        "gps_raw_int",
        times,
        (
            1000 * fill(np.floor(stamps * 1e3)),
            fill(3, 1),
            *(fill(np.degrees(angle) * 1e7) for angle in place[:2]),
            fill(place[2] * 1e3),
            fill(90, UNKNOWN_16),
            fill(140, UNKNOWN_16),
            fill(np.hypot(v_n[:, 0], v_n[:, 1]) * 100.0),
            fill(course) % 36000,
            fill(14, 2),
            0,
            *(fill(accuracy * 1e3) for accuracy in accuracies),
            0,
            0,
        ),
    )


def attitude(times: Floats, euler: Floats, omega_b: Floats) -> Stream:
    """ATTITUDE of rad (n, 3) and rad/s (n, 3)."""
    return Stream("attitude", times, (_milli(times), *euler.T, *omega_b.T))


def global_position_int(
    times: Floats, place: tuple[Floats, Floats, Floats], climbed: Floats, v_n_yaw: Floats, known: NDArray[Any]
) -> Stream:
    """GLOBAL_POSITION_INT of rad, rad, m (n), m above the start (n), m/s, rad (n, 4); zeros where not `known`."""
    latitude, longitude, height = place
    fields = np.column_stack(
        [np.degrees(latitude) * 1e7, np.degrees(longitude) * 1e7, height * 1e3, climbed * 1e3, v_n_yaw[:, :3] * 100.0]
    )
    whole = (np.rint(fields) * known[:, None]).astype(np.int64)
    heading = np.rint(np.degrees(v_n_yaw[:, 3]) * 100.0).astype(np.int64) % 36000
    return Stream("global_position_int", times, (_milli(times), *whole.T, heading))


def system_time(times: Floats, boot_utc_us: int, known: NDArray[np.bool_]) -> Stream:
    """SYSTEM_TIME: 0 as long as UTC is not `known` (n)."""
    return Stream("system_time", times, (np.where(known, boot_utc_us + _micro(times), 0), _milli(times)))


def heartbeat(times: Floats, vehicle_type: int, armed_mode: int, armed: NDArray[np.bool_]) -> Stream:
    """HEARTBEAT of an ArduPilot: in stabilised mode 0 and standby, in `armed_mode` and active while `armed` (n)."""
    ardupilot, version = 3, 3
    return Stream(
        "heartbeat",
        times,
        (
            vehicle_type,
            ardupilot,
            np.where(armed, 217, 81),
            np.where(armed, armed_mode, 0),
            np.where(armed, 4, 3),
            version,
        ),
    )


def _cut(values: Floats) -> NDArray[np.int64]:
    """Whole numbers of 16 bits, as a C++ cast makes them: toward zero."""
    return np.clip(np.trunc(values), -32768, 32767).astype(np.int64)


def _micro(times: Floats) -> NDArray[np.int64]:
    return np.floor(times * 1e6).astype(np.int64)


def _milli(times: Floats) -> NDArray[np.int64]:
    return np.floor(times * 1e3).astype(np.int64)


def _fields(stream: Stream) -> Iterator[tuple[Any, ...]]:
    size = len(stream.times)
    columns = [np.broadcast_to(column, size) for column in stream.columns]
    for i in range(0, size, CHUNK):
        yield from zip(*(column[i : i + CHUNK].tolist() for column in columns), strict=True)


def write_tlog(
    file: BinaryIO,
    streams: list[Stream],
    rng: Generator,
    *,
    boot_utc_us: int,
    address: tuple[int, int],
    progress: Callable[[float], object],
) -> int:
    """Write all messages in the order of their sending, each behind its time of arrival; give their number.

    address:  system and component that send them.
    progress: called with the fraction written, now and then.
    """
    from pymavlink.dialects.v20 import all as dialect

    times = np.concatenate([stream.times for stream in streams])
    sender = np.concatenate([np.full(len(stream.times), i) for i, stream in enumerate(streams)])
    order = np.argsort(times, kind="stable")
    sent = times[order]
    arrival = np.maximum.accumulate(sent + LATENCY + LATENCY_SPREAD * rng.standard_exponential(len(sent)))
    # the two lowest bits say which link a frame came by (MAVProxy): the first one
    stamps = (boot_utc_us + np.rint(arrival * 1e6).astype(np.int64)) & ~3
    heads = stamps.astype(">u8").tobytes()
    classes = [getattr(dialect, f"MAVLink_{stream.name}_message") for stream in streams]
    fields = [_fields(stream) for stream in streams]
    link = dialect.MAVLink(None, srcSystem=address[0], srcComponent=address[1])
    for number, i in zip(count(), sender[order].tolist()):
        link.seq = number & 0xFF
        frame = classes[i](*next(fields[i])).pack(link)
        file.write(heads[8 * number : 8 * number + 8] + frame)
        if number % CHUNK == 0:
            progress(number / len(sent))
    return len(sent)
