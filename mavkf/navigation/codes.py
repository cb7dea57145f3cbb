"""What the numbers mean that the fold writes: sensors, reasons, modes, flags, and events."""

from enum import IntEnum


class Sensor(IntEnum):
    """What an innovation belongs to."""

    GNSS_POSITION = 0
    GNSS_VELOCITY = 1
    MAGNETOMETER = 2
    BAROMETER = 3
    GRAVITY = 4
    REST_VELOCITY = 5
    REST_RATE = 6
    GYRO = 7
    ACCELEROMETER = 8
    GNSS_YAW = 9
    WHEELS = 10
    DRAG = 11
    SIDESLIP = 12
    AIRSPEED = 13


SENSORS = len(Sensor)


class Reason(IntEnum):
    """Why a measurement was not fused."""

    FUSED = 0
    GATE = 1
    DISTURBED = 2
    SINGULAR = 3
    SUSPECTED = 4


class ModeCode(IntEnum):
    """Modes in the order of `mavkf.estimate.Mode`."""

    WAITING = 0
    ALIGNING = 1
    ATTITUDE = 2
    NAVIGATING = 3
    DEAD_RECKONING = 4


class Flag(IntEnum):
    """Bits of a pose row's flags, in the order of `mavkf.estimate.FLAGS`."""

    NO_IMU = 0
    NO_GNSS = 1
    NO_MAGNETOMETER = 2
    YAW_UNKNOWN = 3
    IMU_SLOW = 4
    CONSTANT_VELOCITY = 5
    GNSS_REFUSED = 6
    GNSS_SUSPECTED = 7
    MAGNETOMETER_DISTURBED = 8


class NoteCode(IntEnum):
    """What an event of the estimator says."""

    ALIGNED = 0
    YAW_ALIGNED = 1
    POSITION_FOUND = 2
    POSITION_RESET = 3
    GNSS_OUTAGE = 4
    GNSS_BACK = 5
    POSITION_GIVEN_UP = 6
    IMU_GAP = 7
    MODEL_CHANGED = 8
    ARMED = 9
    DISARMED = 10
    MAGNETOMETER_RELEARNT = 11
    YAW_FROM_MOTION = 12
    VELOCITY_RESET = 13
    YAW_FROM_GNSS = 14
    RECEIVER_CHANGED = 15
    IMU_CHANGED = 16
    MAGNETOMETER_CHANGED = 17
    BAROMETER_CHANGED = 18
    GNSS_JUMP = 19
    GNSS_DRIFT = 20
    GNSS_HEIGHT_DRIFT = 21
    GNSS_VELOCITY_WRONG = 22
    GNSS_FROZEN = 23
    GNSS_JAMMED = 24
    MAGNETIC_DISTURBANCE = 25
    BAROMETER_DISTURBANCE = 26
    GYRO_STEP = 27
    ACCELEROMETER_STEP = 28
    ACCELEROMETER_SCALE = 29
    IMU_CLIPPING = 30
    IMU_VIBRATION = 31
    IMU_FROZEN = 32


NOTE_CODES = len(NoteCode)
FAULT_CODES = tuple(code for code in NoteCode if code >= NoteCode.GNSS_JUMP)
"""Events that say that a sensor is wrong: each is told when it begins and once more when it is over."""
FAULTS = len(FAULT_CODES)
