"""Samples: what the sensors said, in SI units, one flat row of float64 each.

Everything that `link` decodes and `navigation` estimates from passes through this one layout, live and offline. A row is
plain numbers because compiled code reads it; the names of its columns are the constants below. What a message does not
say is NaN (never 0, never a guess).

Head, for every kind:

    STAMP      the time that the message itself carries, whole microseconds on the clock named by CLOCK (NaN: it has none)
    CLOCK      a `Clock`
    ARRIVAL    when the frame was received, whole microseconds UTC
    KIND       a `Kind`
    SOURCE     a `Source`: the message that it came from
    SEQUENCE   the frame's MAVLink sequence number (0-255)
    TIME       boot time, seconds, wraps unrolled: filled by `mavkf.link.clocks`, NaN before
    SESSION    the session (boot) that it belongs to, from 0: filled by `mavkf.link.clocks`, NaN before

Then the values of its kind, from column 8 on. Frames: `n` is north-east-down, `b` is body forward-right-down.
"""

from enum import IntEnum

ROW_WIDTH = 24
STAMP, CLOCK, ARRIVAL, KIND, SOURCE, SEQUENCE, TIME, SESSION = range(8)

# IMU: angular rate omega_b (rad/s), specific force f_b (m/s^2), temperature (degC), resolution of one count of each
GYRO, ACCEL, IMU_TEMPERATURE, GYRO_RESOLUTION, ACCEL_RESOLUTION = 8, 11, 14, 15, 16

# MAGNETOMETER: field m_b (tesla)
FIELD = 8

# BAROMETER: static pressure (Pa), temperature of the sensor (degC), differential pressure (Pa)
PRESSURE, BARO_TEMPERATURE, DIFFERENTIAL_PRESSURE = 8, 9, 10

# GNSS: MAVLink fix type, geodetic position (rad, rad, m), velocity v_n (m/s), claimed accuracies (one sigma: m, m, m/s),
# satellites, dilutions of precision, heading of a dual antenna (rad from north)
FIX, LATITUDE, LONGITUDE, HEIGHT_AMSL, HEIGHT_ELLIPSOID = 8, 9, 10, 11, 12
VELOCITY_N, VELOCITY_E, VELOCITY_D = 13, 14, 15
SIGMA_HORIZONTAL, SIGMA_VERTICAL, SIGMA_SPEED = 16, 17, 18
SATELLITES, HDOP, VDOP, GNSS_YAW = 19, 20, 21, 22

# SYSTEM_TIME: UNIX time (microseconds) at STAMP
UNIX_US = 8

# PARAMETER: an `AutopilotParameter`, and its value in the autopilot's own unit
PARAMETER, PARAMETER_VALUE = 8, 9

# HEARTBEAT: MAV_TYPE, MAV_AUTOPILOT, MAV_MODE_FLAG bits, MAV_STATE
VEHICLE_TYPE, AUTOPILOT, BASE_MODE, SYSTEM_STATUS = 8, 9, 10, 11


class Kind(IntEnum):
    """What a row holds; the order breaks ties between samples measured at the same time."""

    HEARTBEAT = 0
    SYSTEM_TIME = 1
    PARAMETER = 2
    GNSS = 3
    MAGNETOMETER = 4
    BAROMETER = 5
    IMU = 6


class Clock(IntEnum):
    """The clock of a row's STAMP."""

    NONE = 0
    BOOT_US = 1
    BOOT_MS = 2
    """Microseconds, but made of 32-bit milliseconds: wraps after 49.7 days."""
    UNIX_US = 3


class Source(IntEnum):
    """The MAVLink message that a row was decoded from."""

    RAW_IMU = 0
    SCALED_IMU = 1
    SCALED_IMU2 = 2
    SCALED_IMU3 = 3
    HIGHRES_IMU = 4
    HIL_SENSOR = 5
    GPS_RAW_INT = 6
    GPS2_RAW = 7
    GPS_INPUT = 8
    HIL_GPS = 9
    SCALED_PRESSURE = 10
    SCALED_PRESSURE2 = 11
    SCALED_PRESSURE3 = 12
    SYSTEM_TIME = 13
    HEARTBEAT = 14
    PARAM_VALUE = 15


class AutopilotParameter(IntEnum):
    """The parameters of autopilots that are read, by their names on the wire; what they mean is in `mavkf.navigation.stated`."""

    # ArduPilot from 4.6 on
    GPS1_POS_X = 0
    GPS1_POS_Y = 1
    GPS1_POS_Z = 2
    GPS1_DELAY_MS = 3
    # ArduPilot before that
    GPS_POS1_X = 4
    GPS_POS1_Y = 5
    GPS_POS1_Z = 6
    GPS_DELAY_MS = 7
    # ArduPilot, both
    INS_POS1_X = 8
    INS_POS1_Y = 9
    INS_POS1_Z = 10
    COMPASS_ENABLE = 11
    COMPASS_USE = 12
    COMPASS_USE2 = 13
    COMPASS_USE3 = 14
    # PX4 from 1.18 on
    SENS_GPS0_OFFX = 15
    SENS_GPS0_OFFY = 16
    SENS_GPS0_OFFZ = 17
    SENS_GPS0_DELAY = 18
    # PX4 before that
    EKF2_GPS_POS_X = 19
    EKF2_GPS_POS_Y = 20
    EKF2_GPS_POS_Z = 21
    EKF2_GPS_DELAY = 22
    # PX4, both
    EKF2_IMU_POS_X = 23
    EKF2_IMU_POS_Y = 24
    EKF2_IMU_POS_Z = 25
    EKF2_MAG_TYPE = 26
    SYS_HAS_MAG = 27


IMU_SOURCES = (
    Source.RAW_IMU,
    Source.SCALED_IMU,
    Source.SCALED_IMU2,
    Source.SCALED_IMU3,
    Source.HIGHRES_IMU,
    Source.HIL_SENSOR,
)
GNSS_SOURCES = (Source.GPS_RAW_INT, Source.GPS2_RAW, Source.GPS_INPUT, Source.HIL_GPS)
