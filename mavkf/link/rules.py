"""From the values of one message to its rows: the rules that a table cannot say. Compiled, called by `decode`.

`values` is what `mavkf.link.conversions` lays out; what is not finite has been read as NaN. Each function appends rows to
`out` and counts them in `counts`; the head of the rows (but KIND) is left to the caller.
"""

from math import cos, isnan, nan, sin, sqrt
from typing import Any

import numpy as np

from mavkf import samples as s
from mavkf.compiled import kernel
from mavkf.link import conversions as c
from mavkf.samples import ROW_WIDTH

FIRST_UNIX_US = 1e15
"""Microseconds at and above this are UNIX time (September 2001), below it boot time (31 years)."""

NOT_FINITE, OTHER_INSTANCES, WRITTEN = range(3)

SENSOR_VALUES = np.array([0, 0, 2, 0, 3, 1, 6])
"""How many values of a row, by its kind, are what the sensor measured or the autopilot said."""

REAL32 = 9
"""MAV_PARAM_TYPE of a float; the numbers below it are whole."""

IGNORE_FLAGS = np.array(
    [
        # bit of ignore_flags, column, whether what is not above 0 is unknown
        [1, s.HEIGHT_AMSL, 0],
        [2, s.HDOP, 1],
        [4, s.VDOP, 1],
        [8, s.VELOCITY_N, 0],
        [8, s.VELOCITY_E, 0],
        [16, s.VELOCITY_D, 0],
        [32, s.SIGMA_SPEED, 1],
        [64, s.SIGMA_HORIZONTAL, 1],
        [128, s.SIGMA_VERTICAL, 1],
    ]
)
"""What the flags of GPS_INPUT tell to ignore."""


@kernel
def emit(values: Any, block: int, kind: int, counts: Any, out: Any) -> None:
    """Append the row in a block of the values."""
    n = counts[WRITTEN]
    for j in range(s.TIME, ROW_WIDTH):
        out[n, j] = values[block + j]
    out[n, s.KIND] = kind
    counts[WRITTEN] = n + 1


@kernel
def emit_sensor(values: Any, block: int, kind: int, counts: Any, out: Any) -> None:
    """Append the row in a block of the values, unless what its sensor measured is not finite."""
    for j in range(SENSOR_VALUES[kind]):
        if isnan(values[block + s.SESSION + 1 + j]):
            counts[NOT_FINITE] += 1
            return
    emit(values, block, kind, counts, out)


@kernel
def field_of(values: Any) -> float:
    """Strength of the magnetic field, tesla; exactly 0 where there is no magnetometer."""
    x, y, z = (
        values[c.MAGNETOMETER + s.FIELD],
        values[c.MAGNETOMETER + s.FIELD + 1],
        values[c.MAGNETOMETER + s.FIELD + 2],
    )
    return sqrt(x * x + y * y + z * z)


@kernel
def float_imu(values: Any, counts: Any, out: Any) -> None:
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
            emit_sensor(values, c.MAGNETOMETER, c.KIND_MAGNETOMETER, counts, out)
    if updated & 0x200 and not values[c.BAROMETER + s.PRESSURE] <= 0:
        if not updated & 0x400:
            values[c.BAROMETER + s.DIFFERENTIAL_PRESSURE] = nan
        emit_sensor(values, c.BAROMETER, c.KIND_BAROMETER, counts, out)
    if updated & 0x3F == 0x3F:
        values[c.MAIN + s.GYRO_RESOLUTION] = values[c.MAIN + s.ACCEL_RESOLUTION] = 0.0
        emit_sensor(values, c.MAIN, c.KIND_IMU, counts, out)


@kernel
def integer_imu(values: Any, counts: Any, out: Any) -> None:
    """RAW_IMU, SCALED_IMU, SCALED_IMU2, SCALED_IMU3."""
    if field_of(values) != 0:
        emit_sensor(values, c.MAGNETOMETER, c.KIND_MAGNETOMETER, counts, out)
    values[c.MAIN + s.GYRO_RESOLUTION] = c.MILLI_RAD_S
    values[c.MAIN + s.ACCEL_RESOLUTION] = c.MILLI_G
    emit_sensor(values, c.MAIN, c.KIND_IMU, counts, out)


@kernel
def gnss(values: Any, family: int, counts: Any, out: Any) -> None:
    """GPS_RAW_INT, GPS2_RAW, HIL_GPS, GPS_INPUT."""
    has_yaw = 1 <= values[c.YAW] <= 36000
    values[c.MAIN + s.GNSS_YAW] = values[c.YAW] % 36000 * c.CENTI_DEGREE if has_yaw else nan
    if family == c.GPS_RAW:
        # A vehicle at rest has no course.
        course = 0.0 if values[c.SPEED] == 0 else values[c.COURSE]
        values[c.MAIN + s.VELOCITY_N] = values[c.SPEED] * cos(course)
        values[c.MAIN + s.VELOCITY_E] = values[c.SPEED] * sin(course)
    elif family == c.HIL_GPS and isnan(values[c.SPEED]):
        values[c.MAIN + s.VELOCITY_N] = values[c.MAIN + s.VELOCITY_E] = values[c.MAIN + s.VELOCITY_D] = nan
    elif family == c.GPS_INPUT:
        flags = int(values[c.IGNORED])
        for k in range(IGNORE_FLAGS.shape[0]):
            bit, slot, positive = IGNORE_FLAGS[k, 0], c.MAIN + IGNORE_FLAGS[k, 1], IGNORE_FLAGS[k, 2]
            if flags & bit:
                values[slot] = nan
            elif positive:
                values[slot] = values[slot] if values[slot] > 0 else nan
            elif isnan(values[slot]):
                counts[NOT_FINITE] += 1
                return
    emit(values, c.MAIN, c.KIND_GNSS, counts, out)


@kernel
def parameter(values: Any, counts: Any, out: Any) -> None:
    """PARAM_VALUE of a parameter that is read.

    A whole number stands in the float as its value (ArduPilot) or as its bytes (PX4), and no message need say which. The bytes of a whole
    number up to 8,388,607 are a float below 1.2e-38, those of a small negative one none at all, so a float that is whole was the value.
    """
    if isnan(values[c.MAIN + s.PARAMETER]):
        return
    value = values[c.MAIN + s.PARAMETER_VALUE]
    if values[c.PARAMETER_TYPE] < REAL32 and value % 1.0 != 0.0:
        values[c.MAIN + s.PARAMETER_VALUE] = values[c.BITS]
    emit_sensor(values, c.MAIN, c.KIND_PARAMETER, counts, out)


@kernel
def message_rows(values: Any, family: int, counts: Any, out: Any) -> None:
    """Append the rows of one message, in the order MAGNETOMETER, BAROMETER, IMU."""
    if values[c.INSTANCE] > 0:
        counts[OTHER_INSTANCES] += 1
    elif family == c.INTEGER_IMU:
        integer_imu(values, counts, out)
    elif family == c.FLOAT_IMU:
        float_imu(values, counts, out)
    elif family == c.PRESSURE:
        if not values[c.BAROMETER + s.PRESSURE] <= 0:
            emit_sensor(values, c.BAROMETER, c.KIND_BAROMETER, counts, out)
    elif family == c.SYSTEM_TIME:
        if values[c.MAIN + s.UNIX_US] < FIRST_UNIX_US:
            values[c.MAIN + s.UNIX_US] = nan
        emit(values, c.MAIN, c.KIND_SYSTEM_TIME, counts, out)
    elif family == c.HEARTBEAT:
        emit(values, c.MAIN, c.KIND_HEARTBEAT, counts, out)
    elif family == c.PARAM_VALUE:
        parameter(values, counts, out)
    else:
        gnss(values, family, counts, out)
