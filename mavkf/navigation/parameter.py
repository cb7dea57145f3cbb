"""The parameter array: what the fold is told of the configuration and of what was chosen for the session."""

from enum import IntEnum


class Parameter(IntEnum):
    """Columns of the parameter array: configuration and what was chosen for the session."""

    MODEL = 0
    GYRO = 1
    ACCEL = 2
    GYRO_WALK = 3
    ACCEL_WALK = 4
    GYRO_BIAS = 5
    ACCEL_BIAS = 6
    SAMPLING = 7
    GNSS_HORIZONTAL = 8
    GNSS_VERTICAL = 9
    GNSS_FLOOR = 10
    SPEED = 11
    SPEED_FLOOR = 12
    COURSE = 13
    BARO = 14
    BARO_WALK = 15
    ACCELERATION = 16
    ACCELERATION_TIME = 17
    LIMIT_1 = 18
    LIMIT_2 = 19
    LIMIT_3 = 20
    RESET = 21
    GAP = 22
    DECLINATION = 23
    USE_MAGNETOMETER = 24
    USE_BAROMETER = 25
    IMU_PERIOD = 26
    COLOUR = 27
    COLOUR_TIME = 28
    MAGNETOMETER = 29
    IRON = 30
    EARTH_FIELD = 31
    DELAY = 32
    DELAY_WALK = 33
    TRUNCATION = 34
    REST = 35
    USE_MOTION_YAW = 36
    COLOUR_VERTICAL = 37
    COMPARE_HZ = 38
    EVEN_HZ = 39
    ANTENNA_X = 40
    ANTENNA_Y = 41
    ANTENNA_Z = 42
    ANTENNA_SIGMA = 43  # m, 0: its place is not estimated
    USE_GNSS_YAW = 44
    GNSS_YAW = 45
    IMU_SOURCE = 46  # sources of what is used first
    GNSS_SOURCE = 47
    FIELD_SOURCE = 48
    PRESSURE_SOURCE = 49
    MONITORS = 51  # 1: they run
    SUSPICION = 52  # s
    RISK = 53
    CLASS = 50  # of the vehicle, as far as it is used: 0 none, 1 rover, 2 wing, 3 rotors


PARAMETERS = len(Parameter)
