"""From the fields of each MAVLink message to sample rows in SI units; one stateless function per family of messages.

A converter takes the messages (structured array, n) and the counts of what it refuses, and returns a list of `Rows`:
which of the n messages gave a row, and the rows (see `mavkf.samples`; NaN where a message does not say). The list's
order is the order of the rows of one message.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavkf.samples import (
    ACCEL,
    ACCEL_RESOLUTION,
    AUTOPILOT,
    BARO_TEMPERATURE,
    BASE_MODE,
    CLOCK,
    DIFFERENTIAL_PRESSURE,
    FIELD,
    FIX,
    GNSS_YAW,
    GYRO,
    GYRO_RESOLUTION,
    HDOP,
    HEIGHT_AMSL,
    HEIGHT_ELLIPSOID,
    IMU_TEMPERATURE,
    KIND,
    LATITUDE,
    LONGITUDE,
    PRESSURE,
    ROW_WIDTH,
    SATELLITES,
    SIGMA_HORIZONTAL,
    SIGMA_SPEED,
    SIGMA_VERTICAL,
    STAMP,
    SYSTEM_STATUS,
    UNIX_US,
    VDOP,
    VEHICLE_TYPE,
    VELOCITY_D,
    VELOCITY_E,
    VELOCITY_N,
    Clock,
    Kind,
)

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Messages = NDArray[np.void]

MILLI_G = 9.80665e-3
MILLI_RAD_S = 1e-3
GAUSS = 1e-4
HECTO_PASCAL = 100.0
DEGREE_E7 = np.pi / 180 * 1e-7
CENTI_DEGREE = np.pi / 180 * 1e-2
FIRST_UNIX_US = 1e15
"""Microseconds at and above this are UNIX time (September 2001), below it boot time (31 years)."""


@dataclass
class DecodeCounts:
    """Messages that gave no row.

    not_finite:       a sensor value that is NaN or infinite.
    other_instances:  another IMU or receiver of the same component (`id` above 0).
    """

    not_finite: int = 0
    other_instances: int = 0


class Rows(NamedTuple):
    """Rows of one kind: the indices of their messages, and the rows (m, ROW_WIDTH)."""

    indices: NDArray[np.intp]
    rows: Floats


Converter = Callable[[Messages, DecodeCounts], list[Rows]]


def _vector(messages: Messages, names: str) -> Floats:
    return np.column_stack([messages[name] for name in names.split()]).astype(np.float64)


def _known(values: Any, unknown: int, scale: float = 1.0) -> Floats:
    """Scaled values, NaN where the raw value is the one that says unknown."""
    return np.where(values == unknown, np.nan, values * scale)


def _start(messages: Messages, kind: Kind, selected: Bools) -> Rows:
    """Empty rows of the selected messages, with STAMP, CLOCK and KIND. A time of 0 is one that was not filled in."""
    indices = np.flatnonzero(selected)
    rows = np.full((len(indices), ROW_WIDTH), np.nan)
    rows[:, KIND] = kind
    names = messages.dtype.names or ()
    if "time_boot_ms" in names:
        stamp = messages["time_boot_ms"][indices] * 1e3
        clock: Any = Clock.BOOT_MS
    elif "time_usec" in names:
        stamp = messages["time_usec"][indices].astype(np.float64)
        clock = np.where(stamp >= FIRST_UNIX_US, Clock.UNIX_US, Clock.BOOT_US)
    else:
        stamp, clock = np.zeros(len(indices)), Clock.NONE
    rows[:, STAMP] = np.where(stamp == 0, np.nan, stamp)
    rows[:, CLOCK] = np.where(stamp == 0, Clock.NONE, clock)
    return Rows(indices, rows)


def _finite(selected: Bools, values: Floats, counts: DecodeCounts) -> Bools:
    """Keep the selected ones whose values (n, m) are all finite; count the others."""
    finite = np.isfinite(values).all(axis=1)
    counts.not_finite += int(np.count_nonzero(selected & ~finite))
    return selected & finite


def _first_instance(messages: Messages, field: str, counts: DecodeCounts) -> Bools:
    if field not in (messages.dtype.names or ()):
        return np.ones(len(messages), np.bool_)
    first: Bools = messages[field] == 0
    counts.other_instances += int(np.count_nonzero(~first))
    return first


def _magnetometer(messages: Messages, field: Floats, selected: Bools, counts: DecodeCounts) -> Rows:
    """Rows of a field in tesla (n, 3); exactly zero means that there is no magnetometer."""
    out = _start(messages, Kind.MAGNETOMETER, _finite(selected & field.any(axis=1), field, counts))
    out.rows[:, FIELD : FIELD + 3] = field[out.indices]
    return out


def _barometer(
    messages: Messages, pressure: Floats, differential: Floats, temperature: Floats, selected: Bools
) -> Rows:
    out = _start(messages, Kind.BAROMETER, selected)
    out.rows[:, PRESSURE] = pressure[out.indices]
    out.rows[:, BARO_TEMPERATURE] = temperature[out.indices]
    out.rows[:, DIFFERENTIAL_PRESSURE] = differential[out.indices]
    return out


def _imu(messages: Messages, gyro: Floats, accel: Floats, temperature: Floats, selected: Bools) -> Rows:
    out = _start(messages, Kind.IMU, selected)
    out.rows[:, GYRO : GYRO + 3] = gyro[out.indices]
    out.rows[:, ACCEL : ACCEL + 3] = accel[out.indices]
    out.rows[:, IMU_TEMPERATURE] = temperature[out.indices]
    return out


def integer_imu(messages: Messages, counts: DecodeCounts) -> list[Rows]:
    """RAW_IMU, SCALED_IMU, SCALED_IMU2, SCALED_IMU3: mG, mrad/s, milligauss in int16 (ArduPilot's RAW_IMU too)."""
    selected = _first_instance(messages, "id", counts)
    imu = _imu(
        messages,
        _vector(messages, "xgyro ygyro zgyro") * MILLI_RAD_S,
        _vector(messages, "xacc yacc zacc") * MILLI_G,
        _known(messages["temperature"], 0, 1e-2),
        selected,
    )
    imu.rows[:, GYRO_RESOLUTION] = MILLI_RAD_S
    imu.rows[:, ACCEL_RESOLUTION] = MILLI_G
    field = _vector(messages, "xmag ymag zmag") * (GAUSS * 1e-3)
    return [_magnetometer(messages, field, selected, counts), imu]


def float_imu(messages: Messages, counts: DecodeCounts) -> list[Rows]:
    """HIGHRES_IMU, HIL_SENSOR: SI, gauss, hPa; of what `fields_updated` names, or all when it names nothing at all.

    ArduPilot sends the field in microgauss (4.7-dev, measured), others in milligauss: the earth's field is 0.2 to 0.7
    gauss, which tells them apart.
    """
    updated = messages["fields_updated"].astype(np.int64)
    updated[updated == 0] = 0x1FFF
    selected = _first_instance(messages, "id", counts)
    gyro, accel = _vector(messages, "xgyro ygyro zgyro"), _vector(messages, "xacc yacc zacc")
    temperature = messages["temperature"].astype(np.float64)
    temperature[~np.isfinite(temperature)] = np.nan
    has_imu = _finite(selected & (updated & 0x3F == 0x3F), np.column_stack([gyro, accel]), counts)
    imu = _imu(messages, gyro, accel, temperature, has_imu)
    imu.rows[:, [GYRO_RESOLUTION, ACCEL_RESOLUTION]] = 0.0

    field = _vector(messages, "xmag ymag zmag")
    strength = np.linalg.norm(field, axis=1)
    unit = np.where(strength > 5e3, GAUSS * 1e-6, np.where(strength > 5, GAUSS * 1e-3, GAUSS))
    magnetometer = _magnetometer(messages, field * unit[:, None], selected & (updated & 0x1C0 == 0x1C0), counts)

    pressure = messages["abs_pressure"] * HECTO_PASCAL
    has_pressure = _finite(selected & (updated & 0x200 != 0), pressure[:, None], counts) & (pressure > 0)
    differential = messages["diff_pressure"] * HECTO_PASCAL
    differential = np.where((updated & 0x400 != 0) & np.isfinite(differential), differential, np.nan)
    return [magnetometer, _barometer(messages, pressure, differential, temperature, has_pressure), imu]


def scaled_pressure(messages: Messages, counts: DecodeCounts) -> list[Rows]:
    """SCALED_PRESSURE, SCALED_PRESSURE2, SCALED_PRESSURE3: hPa, centidegrees; a pressure of 0 or less is unknown."""
    pressure = messages["press_abs"] * HECTO_PASCAL
    differential = messages["press_diff"] * HECTO_PASCAL
    differential = np.where(np.isfinite(differential), differential, np.nan)
    selected = _finite(np.ones(len(messages), np.bool_), pressure[:, None], counts) & (pressure > 0)
    return [_barometer(messages, pressure, differential, messages["temperature"] * 1e-2, selected)]


def _gnss(messages: Messages, height: Floats, selected: Bools) -> Rows:
    """Fill what all GNSS messages share.

    A receiver without a fix has no time of measurement (ArduPilot repeats that of the last fix), so no STAMP either.
    """
    out = _start(messages, Kind.GNSS, selected)
    m, rows = messages[out.indices], out.rows
    rows[:, FIX] = m["fix_type"]
    rows[:, LATITUDE] = m["lat"] * DEGREE_E7
    rows[:, LONGITUDE] = m["lon"] * DEGREE_E7
    rows[:, HEIGHT_AMSL] = height[out.indices]
    rows[:, SATELLITES] = _known(m["satellites_visible"], 255)
    rows[:, GNSS_YAW] = np.where((m["yaw"] >= 1) & (m["yaw"] <= 36000), m["yaw"] % 36000 * CENTI_DEGREE, np.nan)
    no_fix = m["fix_type"] < 2
    rows[no_fix, STAMP] = np.nan
    rows[no_fix, CLOCK] = Clock.NONE
    return out


def gps_raw(messages: Messages, counts: DecodeCounts) -> list[Rows]:
    """GPS_RAW_INT, GPS2_RAW: speed and course over ground, accuracies in the extension fields (0: not sent)."""
    del counts
    out = _gnss(messages, messages["alt"] * 1e-3, np.ones(len(messages), np.bool_))
    rows = out.rows
    speed = _known(messages["vel"], 0xFFFF, 1e-2)
    course = np.where(messages["vel"] == 0, 0.0, _known(messages["cog"], 0xFFFF, CENTI_DEGREE))
    rows[:, VELOCITY_N] = speed * np.cos(course)
    rows[:, VELOCITY_E] = speed * np.sin(course)
    rows[:, HDOP] = _known(messages["eph"], 0xFFFF, 1e-2)
    rows[:, VDOP] = _known(messages["epv"], 0xFFFF, 1e-2)
    rows[:, HEIGHT_ELLIPSOID] = _known(messages["alt_ellipsoid"], 0, 1e-3)
    rows[:, SIGMA_HORIZONTAL] = _known(messages["h_acc"], 0, 1e-3)
    rows[:, SIGMA_VERTICAL] = _known(messages["v_acc"], 0, 1e-3)
    rows[:, SIGMA_SPEED] = _known(messages["vel_acc"], 0, 1e-3)
    return [out]


def hil_gps(messages: Messages, counts: DecodeCounts) -> list[Rows]:
    """HIL_GPS: velocity north, east, down in cm/s; `vel` of 65535 says that it is unknown."""
    out = _gnss(messages, messages["alt"] * 1e-3, _first_instance(messages, "id", counts))
    m, rows = messages[out.indices], out.rows
    velocity = _vector(m, "vn ve vd") * 1e-2
    velocity[m["vel"] == 0xFFFF] = np.nan
    rows[:, VELOCITY_N : VELOCITY_D + 1] = velocity
    rows[:, HDOP] = _known(m["eph"], 0xFFFF, 1e-2)
    rows[:, VDOP] = _known(m["epv"], 0xFFFF, 1e-2)
    return [out]


GPS_INPUT_FIELDS = (
    # bit of ignore_flags, field, column, whether 0 or less is unknown
    (2, "hdop", HDOP, True),
    (4, "vdop", VDOP, True),
    (8, "vn", VELOCITY_N, False),
    (8, "ve", VELOCITY_E, False),
    (16, "vd", VELOCITY_D, False),
    (32, "speed_accuracy", SIGMA_SPEED, True),
    (64, "horiz_accuracy", SIGMA_HORIZONTAL, True),
    (128, "vert_accuracy", SIGMA_VERTICAL, True),
)


def gps_input(messages: Messages, counts: DecodeCounts) -> list[Rows]:
    """GPS_INPUT: SI floats, of which `ignore_flags` names those not to be used."""
    flags = messages["ignore_flags"]
    height = np.where(flags & 1, np.nan, messages["alt"].astype(np.float64))
    measured = np.column_stack(
        [np.where(flags & bit, 0.0, messages[f]) for bit, f in ((1, "alt"), (8, "vn"), (8, "ve"), (16, "vd"))]
    )
    out = _gnss(messages, height, _finite(_first_instance(messages, "gps_id", counts), measured, counts))
    m = messages[out.indices]
    for bit, field, column, positive in GPS_INPUT_FIELDS:
        value = m[field].astype(np.float64)
        used = (m["ignore_flags"] & bit == 0) & np.isfinite(value) & ((value > 0) | (not positive))
        out.rows[:, column] = np.where(used, value, np.nan)
    return [out]


def system_time(messages: Messages, counts: DecodeCounts) -> list[Rows]:
    """SYSTEM_TIME: UNIX time at STAMP, unknown until the vehicle knows it."""
    del counts
    out = _start(messages, Kind.SYSTEM_TIME, np.ones(len(messages), np.bool_))
    unix = messages["time_unix_usec"].astype(np.float64)
    out.rows[:, UNIX_US] = np.where(unix >= FIRST_UNIX_US, unix, np.nan)
    return [out]


def heartbeat(messages: Messages, counts: DecodeCounts) -> list[Rows]:
    """HEARTBEAT: what the component is, and its state."""
    del counts
    out = _start(messages, Kind.HEARTBEAT, np.ones(len(messages), np.bool_))
    for column, field in (
        (VEHICLE_TYPE, "type"),
        (AUTOPILOT, "autopilot"),
        (BASE_MODE, "base_mode"),
        (SYSTEM_STATUS, "system_status"),
    ):
        out.rows[:, column] = messages[field]
    return [out]


CONVERTERS: Mapping[str, Converter] = {
    "RAW_IMU": integer_imu,
    "SCALED_IMU": integer_imu,
    "SCALED_IMU2": integer_imu,
    "SCALED_IMU3": integer_imu,
    "HIGHRES_IMU": float_imu,
    "HIL_SENSOR": float_imu,
    "GPS_RAW_INT": gps_raw,
    "GPS2_RAW": gps_raw,
    "GPS_INPUT": gps_input,
    "HIL_GPS": hil_gps,
    "SCALED_PRESSURE": scaled_pressure,
    "SCALED_PRESSURE2": scaled_pressure,
    "SCALED_PRESSURE3": scaled_pressure,
    "SYSTEM_TIME": system_time,
    "HEARTBEAT": heartbeat,
}
"""The converter of every message that gives rows; the names are those of `mavkf.samples.Source`."""
