"""From the values of one message to its rows: the rules that a table cannot say. Compiled, called by `decode`.

`values` is what `mavkf.link.conversions` lays out; what is not finite has been read as NaN. Each function appends rows to
`out`, which has n of them, and returns how many it has then; the head of the rows (but KIND) is left to the caller.
"""

from math import cos, isnan, nan, sin, sqrt
from typing import Any

from mavkf import samples as s
from mavkf.compiled import compiled
from mavkf.link import conversions as c
from mavkf.samples import ROW_WIDTH, Kind

FIRST_UNIX_US = 1e15
"""Microseconds at and above this are UNIX time (September 2001), below it boot time (31 years)."""

IMU, GNSS, SYSTEM_TIME, HEARTBEAT = int(Kind.IMU), int(Kind.GNSS), int(Kind.SYSTEM_TIME), int(Kind.HEARTBEAT)
MAGNETOMETER, BAROMETER = int(Kind.MAGNETOMETER), int(Kind.BAROMETER)
NOT_FINITE, OTHER_INSTANCES = range(2)


@compiled
def emit(values: Any, block: int, kind: int, out: Any, n: int) -> int:
    """Append the row in a block of the values to `out`, which has n rows; the head follows later."""
    for j in range(s.TIME, ROW_WIDTH):
        out[n, j] = values[block + j]
    out[n, s.KIND] = kind
    return n + 1


@compiled
def all_finite(values: Any, slot: int, size: int) -> bool:
    """Whether values[slot : slot + size] are finite."""
    total = 0.0
    for j in range(slot, slot + size):
        total += values[j]
    return not isnan(total)  # what is infinite was read as NaN


@compiled
def emit_sensor(values: Any, block: int, kind: int, size: int, counts: Any, out: Any, n: int) -> int:  # noqa: PLR0917
    """Append a row whose first `size` values are what the sensor measured, unless they are not finite."""
    if all_finite(values, block + s.SESSION + 1, size):
        return emit(values, block, kind, out, n)
    counts[NOT_FINITE] += 1
    return n


@compiled
def field_of(values: Any) -> float:
    """Strength of the magnetic field, tesla; exactly 0 where there is no magnetometer."""
    x, y, z = (
        values[c.MAGNETOMETER + s.FIELD],
        values[c.MAGNETOMETER + s.FIELD + 1],
        values[c.MAGNETOMETER + s.FIELD + 2],
    )
    return sqrt(x * x + y * y + z * z)


@compiled
def float_imu(values: Any, counts: Any, out: Any, n: int) -> int:
    """HIGHRES_IMU, HIL_SENSOR: rows of what `fields_updated` names, or of all when it names nothing at all.

    ArduPilot sends the field in microgauss (4.7-dev, measured), others in milligauss: the earth's field is 0.2 to 0.7
    gauss, which tells them apart.
    """
    updated = int(values[c.UPDATED])
    if updated == 0:
        updated = 0x1FFF
    if updated & 0x1C0 == 0x1C0:
        strength = field_of(values)
        if strength > 5 * c.GAUSS:
            unit = 1e-6 if strength > 5e3 * c.GAUSS else 1e-3
            for j in range(c.MAGNETOMETER + s.FIELD, c.MAGNETOMETER + s.FIELD + 3):
                values[j] *= unit
        if strength != 0:
            n = emit_sensor(values, c.MAGNETOMETER, MAGNETOMETER, 3, counts, out, n)
    if updated & 0x200 and not values[c.BAROMETER + s.PRESSURE] <= 0:
        if not updated & 0x400:
            values[c.BAROMETER + s.DIFFERENTIAL_PRESSURE] = nan
        n = emit_sensor(values, c.BAROMETER, BAROMETER, 1, counts, out, n)
    if updated & 0x3F == 0x3F:
        values[c.MAIN + s.GYRO_RESOLUTION] = values[c.MAIN + s.ACCEL_RESOLUTION] = 0.0
        n = emit_sensor(values, c.MAIN, IMU, 6, counts, out, n)
    return n


@compiled
def integer_imu(values: Any, counts: Any, out: Any, n: int) -> int:
    """RAW_IMU, SCALED_IMU, SCALED_IMU2, SCALED_IMU3."""
    if field_of(values) != 0:
        n = emit_sensor(values, c.MAGNETOMETER, MAGNETOMETER, 3, counts, out, n)
    values[c.MAIN + s.GYRO_RESOLUTION] = c.MILLI_RAD_S
    values[c.MAIN + s.ACCEL_RESOLUTION] = c.MILLI_G
    return emit_sensor(values, c.MAIN, IMU, 6, counts, out, n)


@compiled
def ignore(values: Any, bit: int, column: int, positive: bool) -> None:
    """Forget a value of GPS_INPUT that its flags tell to ignore, or that is not positive and should be."""
    if int(values[c.IGNORED]) & bit or (positive and not values[c.MAIN + column] > 0):
        values[c.MAIN + column] = nan


@compiled
def gnss(values: Any, family: int, counts: Any, out: Any, n: int) -> int:
    """GPS_RAW_INT, GPS2_RAW, HIL_GPS, GPS_INPUT."""
    if 1 <= values[c.YAW] <= 36000:
        values[c.MAIN + s.GNSS_YAW] = values[c.YAW] % 36000 * c.CENTI_DEGREE
    if family == c.GPS_RAW:
        # A vehicle at rest has no course.
        course = 0.0 if values[c.SPEED] == 0 else values[c.COURSE]
        values[c.MAIN + s.VELOCITY_N] = values[c.SPEED] * cos(course)
        values[c.MAIN + s.VELOCITY_E] = values[c.SPEED] * sin(course)
    elif family == c.HIL_GPS and isnan(values[c.SPEED]):
        values[c.MAIN + s.VELOCITY_N] = values[c.MAIN + s.VELOCITY_E] = values[c.MAIN + s.VELOCITY_D] = nan
    elif family == c.GPS_INPUT:
        flags = int(values[c.IGNORED])
        if (
            not (flags & 1 or all_finite(values, c.MAIN + s.HEIGHT_AMSL, 1))
            or not (flags & 8 or all_finite(values, c.MAIN + s.VELOCITY_N, 2))
            or not (flags & 16 or all_finite(values, c.MAIN + s.VELOCITY_D, 1))
        ):
            counts[NOT_FINITE] += 1
            return n
        ignore(values, 1, s.HEIGHT_AMSL, False)
        ignore(values, 2, s.HDOP, True)
        ignore(values, 4, s.VDOP, True)
        ignore(values, 8, s.VELOCITY_N, False)
        ignore(values, 8, s.VELOCITY_E, False)
        ignore(values, 16, s.VELOCITY_D, False)
        ignore(values, 32, s.SIGMA_SPEED, True)
        ignore(values, 64, s.SIGMA_HORIZONTAL, True)
        ignore(values, 128, s.SIGMA_VERTICAL, True)
    return emit(values, c.MAIN, GNSS, out, n)


@compiled
def message_rows(values: Any, family: int, counts: Any, out: Any, n: int) -> int:
    """Append the rows of one message, in the order MAGNETOMETER, BAROMETER, IMU."""
    if values[c.INSTANCE] > 0:
        counts[OTHER_INSTANCES] += 1
        return n
    if family == c.INTEGER_IMU:
        return integer_imu(values, counts, out, n)
    if family == c.FLOAT_IMU:
        return float_imu(values, counts, out, n)
    if family == c.PRESSURE:
        if values[c.BAROMETER + s.PRESSURE] <= 0:
            return n
        return emit_sensor(values, c.BAROMETER, BAROMETER, 1, counts, out, n)
    if family == c.SYSTEM_TIME:
        if values[c.MAIN + s.UNIX_US] < FIRST_UNIX_US:
            values[c.MAIN + s.UNIX_US] = nan
        return emit(values, c.MAIN, SYSTEM_TIME, out, n)
    if family == c.HEARTBEAT:
        return emit(values, c.MAIN, HEARTBEAT, out, n)
    return gnss(values, family, counts, out, n)
