"""What each message gives in SI units: field by field, where it goes in a sample row, its unit, and what means unknown.

The tables are read by the compiled loop in `mavkf.link.decode`, which does the rest: what a table cannot say.
"""

from functools import cache
from math import nan, pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavkf import samples as s
from mavkf.link.layouts import HIGHEST_ID, message_dtype, message_ids
from mavkf.samples import ROW_WIDTH, AutopilotParameter, Kind, Source

MILLI_G = 9.80665e-3
MILLI_RAD_S = 1e-3
GAUSS = 1e-4
HECTO_PASCAL = 100.0
DEGREE_E7 = pi / 180 * 1e-7
CENTI_DEGREE = pi / 180 * 1e-2
UINT8_MAX, UINT16_MAX = 0xFF, 0xFFFF

# The values of one message: the columns of up to three rows, and what is read but is no column.
MAGNETOMETER, BAROMETER, MAIN, EXTRA = (block * ROW_WIDTH for block in range(4))
TIME_USEC, TIME_BOOT_MS, INSTANCE, UPDATED, IGNORED, SPEED, COURSE, YAW, PARAMETER_TYPE, BITS = range(EXTRA, EXTRA + 10)
VALUES = EXTRA + 10

# Families of messages, each with its own rules.
INTEGER_IMU, FLOAT_IMU, PRESSURE, GPS_RAW, HIL_GPS, GPS_INPUT, SYSTEM_TIME, HEARTBEAT, PARAM_VALUE = range(9)
KIND_HEARTBEAT, KIND_SYSTEM_TIME, KIND_GNSS = int(Kind.HEARTBEAT), int(Kind.SYSTEM_TIME), int(Kind.GNSS)
KIND_MAGNETOMETER, KIND_BAROMETER, KIND_IMU = int(Kind.MAGNETOMETER), int(Kind.BAROMETER), int(Kind.IMU)
KIND_PARAMETER = int(Kind.PARAMETER)

ROWS_OF_FAMILY = np.array([2, 3, 1, 1, 1, 1, 1, 1, 1])
"""The most rows that one message of a family gives."""


class Reading(NamedTuple):
    """One field of a message: the value that it gives is the raw value times `scale`, or NaN where it is `unknown`.

    A text gives the number of the `AutopilotParameter` that it names, NaN where it names none. as_integer: whether the bytes of a float
    are read as a whole number.
    """

    field: str
    slot: int
    scale: float = 1.0
    unknown: float = nan
    as_integer: bool = False


def _xyz(name: str, slot: int, scale: float = 1.0) -> tuple[Reading, ...]:
    return tuple(Reading(axis + name, slot + i, scale) for i, axis in enumerate("xyz"))


USEC = Reading("time_usec", TIME_USEC)
BOOT_MS = Reading("time_boot_ms", TIME_BOOT_MS)

_INTEGER_IMU = (  # ArduPilot's RAW_IMU has the units of SCALED_IMU
    *_xyz("gyro", MAIN + s.GYRO, MILLI_RAD_S),
    *_xyz("acc", MAIN + s.ACCEL, MILLI_G),
    *_xyz("mag", MAGNETOMETER + s.FIELD, GAUSS * 1e-3),
    Reading("temperature", MAIN + s.IMU_TEMPERATURE, 1e-2, 0),
)
_FLOAT_IMU = (
    USEC,
    *_xyz("gyro", MAIN + s.GYRO),
    *_xyz("acc", MAIN + s.ACCEL),
    *_xyz("mag", MAGNETOMETER + s.FIELD, GAUSS),
    Reading("temperature", MAIN + s.IMU_TEMPERATURE),
    Reading("temperature", BAROMETER + s.BARO_TEMPERATURE),
    Reading("abs_pressure", BAROMETER + s.PRESSURE, HECTO_PASCAL),
    Reading("diff_pressure", BAROMETER + s.DIFFERENTIAL_PRESSURE, HECTO_PASCAL),
    Reading("fields_updated", UPDATED),
    Reading("id", INSTANCE),
)
_PRESSURE = (
    BOOT_MS,
    Reading("press_abs", BAROMETER + s.PRESSURE, HECTO_PASCAL),
    Reading("temperature", BAROMETER + s.BARO_TEMPERATURE, 1e-2),
    Reading("press_diff", BAROMETER + s.DIFFERENTIAL_PRESSURE, HECTO_PASCAL),
)
_GNSS = (
    USEC,
    Reading("fix_type", MAIN + s.FIX),
    Reading("lat", MAIN + s.LATITUDE, DEGREE_E7),
    Reading("lon", MAIN + s.LONGITUDE, DEGREE_E7),
    Reading("satellites_visible", MAIN + s.SATELLITES, 1, UINT8_MAX),
    Reading("yaw", YAW),
)
_DILUTION = (
    Reading("alt", MAIN + s.HEIGHT_AMSL, 1e-3),
    Reading("eph", MAIN + s.HDOP, 1e-2, UINT16_MAX),
    Reading("epv", MAIN + s.VDOP, 1e-2, UINT16_MAX),
    Reading("vel", SPEED, 1e-2, UINT16_MAX),
)
_GPS_RAW = (
    *_GNSS,
    *_DILUTION,
    Reading("cog", COURSE, CENTI_DEGREE, UINT16_MAX),
    Reading("alt_ellipsoid", MAIN + s.HEIGHT_ELLIPSOID, 1e-3, 0),
    Reading("h_acc", MAIN + s.SIGMA_HORIZONTAL, 1e-3, 0),
    Reading("v_acc", MAIN + s.SIGMA_VERTICAL, 1e-3, 0),
    Reading("vel_acc", MAIN + s.SIGMA_SPEED, 1e-3, 0),
)
_HIL_GPS = (
    *_GNSS,
    *_DILUTION,
    Reading("vn", MAIN + s.VELOCITY_N, 1e-2),
    Reading("ve", MAIN + s.VELOCITY_E, 1e-2),
    Reading("vd", MAIN + s.VELOCITY_D, 1e-2),
    Reading("id", INSTANCE),
)
_GPS_INPUT = (
    *_GNSS,
    Reading("alt", MAIN + s.HEIGHT_AMSL),
    Reading("hdop", MAIN + s.HDOP),
    Reading("vdop", MAIN + s.VDOP),
    Reading("vn", MAIN + s.VELOCITY_N),
    Reading("ve", MAIN + s.VELOCITY_E),
    Reading("vd", MAIN + s.VELOCITY_D),
    Reading("speed_accuracy", MAIN + s.SIGMA_SPEED),
    Reading("horiz_accuracy", MAIN + s.SIGMA_HORIZONTAL),
    Reading("vert_accuracy", MAIN + s.SIGMA_VERTICAL),
    Reading("ignore_flags", IGNORED),
    Reading("gps_id", INSTANCE),
)
_SYSTEM_TIME = (BOOT_MS, Reading("time_unix_usec", MAIN + s.UNIX_US))
_HEARTBEAT = (
    Reading("type", MAIN + s.VEHICLE_TYPE),
    Reading("autopilot", MAIN + s.AUTOPILOT),
    Reading("base_mode", MAIN + s.BASE_MODE),
    Reading("system_status", MAIN + s.SYSTEM_STATUS),
)
_PARAM_VALUE = (
    Reading("param_id", MAIN + s.PARAMETER),
    Reading("param_value", MAIN + s.PARAMETER_VALUE),
    Reading("param_value", BITS, as_integer=True),
    Reading("param_type", PARAMETER_TYPE),
)

MESSAGES: dict[Source, tuple[int, tuple[Reading, ...]]] = {
    Source.RAW_IMU: (INTEGER_IMU, (USEC, *_INTEGER_IMU, Reading("id", INSTANCE))),
    Source.SCALED_IMU: (INTEGER_IMU, (BOOT_MS, *_INTEGER_IMU)),
    Source.SCALED_IMU2: (INTEGER_IMU, (BOOT_MS, *_INTEGER_IMU)),
    Source.SCALED_IMU3: (INTEGER_IMU, (BOOT_MS, *_INTEGER_IMU)),
    Source.HIGHRES_IMU: (FLOAT_IMU, _FLOAT_IMU),
    Source.HIL_SENSOR: (FLOAT_IMU, _FLOAT_IMU),
    Source.GPS_RAW_INT: (GPS_RAW, _GPS_RAW),
    Source.GPS2_RAW: (GPS_RAW, _GPS_RAW),
    Source.GPS_INPUT: (GPS_INPUT, _GPS_INPUT),
    Source.HIL_GPS: (HIL_GPS, _HIL_GPS),
    Source.SCALED_PRESSURE: (PRESSURE, _PRESSURE),
    Source.SCALED_PRESSURE2: (PRESSURE, _PRESSURE),
    Source.SCALED_PRESSURE3: (PRESSURE, _PRESSURE),
    Source.SYSTEM_TIME: (SYSTEM_TIME, _SYSTEM_TIME),
    Source.HEARTBEAT: (HEARTBEAT, _HEARTBEAT),
    Source.PARAM_VALUE: (PARAM_VALUE, _PARAM_VALUE),
}
"""Every message that gives rows: its family, and how its fields are read."""

# Columns of the tables of readings: of their places and units, and of the runs of one type. A type is the number of bytes, negative if
# signed; 0 is a float of four bytes, TEXT a text.
OFFSET, SLOT = range(2)
SCALE, UNKNOWN = range(2)
TYPE, BEGIN, END = range(3)
SPLIT = 100
"""Added to the size of a type that does not lie at a multiple of it, as extensions of a message may."""
TEXT = 16
"""The bytes of a text, zeros at its end where it is shorter: those of `param_id`."""


class Tables(NamedTuple):
    """The tables for compiled code.

    sources:   `Source` of each message id (int8), -1 for messages that give no rows.
    families:  family of each source.
    first:     where the runs of each source begin; one more at the end.
    runs:      (r, 3) int64.
    places:    (k, 2) int64, of each reading.
    units:     (k, 2) float64, of each reading.
    names:     of the parameters that are read, (n, TEXT).
    """

    sources: NDArray[np.int8]
    families: NDArray[np.int64]
    first: NDArray[np.int64]
    runs: NDArray[np.int64]
    places: NDArray[np.int64]
    units: NDArray[np.float64]
    names: NDArray[np.uint8]


ALL = frozenset(MESSAGES)


@cache
def tables(messages: frozenset[Source] = ALL) -> Tables:
    """Build the tables from the layouts of the dialect; of messages that are not wanted it is as if they gave no rows."""
    sources = np.full(HIGHEST_ID + 1, -1, np.int8)
    families = np.zeros(len(MESSAGES), np.int64)
    first = np.zeros(len(MESSAGES) + 1, np.int64)
    runs: list[tuple[int, int, int]] = []
    places: list[tuple[int, int]] = []
    units: list[tuple[float, float]] = []
    for source in sorted(MESSAGES):
        family, fields = MESSAGES[source]
        if source in messages:
            sources[message_ids()[source.name]] = source
        families[source] = family
        layout = message_dtype(source.name).fields
        assert layout is not None
        by_type: dict[int, list[Reading]] = {}
        for reading in fields:
            by_type.setdefault(_type_of(reading, *layout[reading.field][:2]), []).append(reading)
        for kind, alike in by_type.items():
            runs.append((kind, len(places), len(places) + len(alike)))
            places += [(layout[reading.field][1], reading.slot) for reading in alike]
            units += [(reading.scale, reading.unknown) for reading in alike]
        first[source + 1] = len(runs)
    names = b"".join(parameter.name.encode().ljust(TEXT, b"\0") for parameter in AutopilotParameter)
    table = np.frombuffer(names, np.uint8).reshape(-1, TEXT).copy()  # what is written to the compiled loop has one type
    return Tables(sources, families, first, np.array(runs), np.array(places), np.array(units, np.float64), table)


def _type_of(reading: Reading, dtype: "np.dtype[Any]", offset: int) -> int:
    """The type of a field, as of the table of runs."""
    size = dtype.itemsize
    kind = {"u": size, "i": -size, "f": 0, "S": TEXT}[dtype.kind]
    assert kind or (size == 4 and offset % 4 == 0)
    assert kind != TEXT or size == TEXT
    if reading.as_integer:
        kind = -size
    return kind if kind in (0, TEXT) or offset % size == 0 else kind + (SPLIT if kind > 0 else -SPLIT)
