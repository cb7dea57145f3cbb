"""Where everything is: the state of the fold, the parameters, the events, and the rows that come out.

The fold's whole memory is one flat float64 array, so that a snapshot is a copy and equality is equality of bits: nominal state,
covariance (of as many error states as are in use), then bookkeeping by name. Flags and counts are whole numbers in float64, which is
exact up to 2^53.
"""

from enum import IntEnum

import numpy as np

from mavkf.compiled import INTEGERS, MATRIX, VECTOR, compiled, several
from mavkf.models.vehicle_class import STATES_MOST, X_SIZE
from mavkf.samples import ROW_WIDTH

SLOW = 0.125  # s between IMU samples: from here on what a vehicle does between them is mostly not seen

# An event is a sample row whose TIME is the time it was measured (stamp less delay, s), and:
FIELD_N = ROW_WIDTH  # the earth's magnetic field at a fix: north, east, down, tesla (GNSS only; NaN: not known)
EVENT_ID = ROW_WIDTH + 3  # running number in the order of arrival
EVENT_WIDTH = ROW_WIDTH + 4

X = 0
P = X_SIZE
_book = P + STATES_MOST * STATES_MOST
(
    T,  # s, boot clock: what x and P are valid for
    ALIGNED,  # 1: attitude known but for yaw
    YAW_KNOWN,
    POSITION_KNOWN,
    MODEL,  # what carries velocity and position: CONSTANT_VELOCITY, STRAPDOWN or TELEMETRY
    WANTED,  # the model to use where it can be
    SECOND,  # 1: another model runs beside it, in the second half of the array
    ODDS,  # logarithm of the odds of telemetry against strapdown by likelihood, without the prior
    T_ODDS,
    LIKELIHOOD,  # logarithm, of what was fused since the models were weighed
    STATES,  # number of error states in use: P is (STATES, STATES)
    BAROMETER_KNOWN,
    T_IMU,  # last IMU sample, NaN: none
    PERIOD,  # s between IMU samples, running mean
    DIFFERENCE_GYRO,  # (rad/s)^2, running mean over 20 s of the squared difference of successive samples, per axis
    DIFFERENCE_ACCEL,  # (m/s^2)^2
    SQUARE_GYRO,  # of the last two samples
    SQUARE_ACCEL,
    TURN_GYRO,  # (rad/s)^2, the like of the product of successive differences
    TURN_ACCEL,  # (m/s^2)^2
    NOISE_GYRO,  # rad^2/s: the density in use now
    NOISE_ACCEL,  # m^2/s^3
    SMOOTH,  # samples in a row on a line with those before: repeated or interpolated, not measured
    ALIGN_START,
    ALIGN_COUNT,
    T_FIX,  # last fix of any receiver, NaN: none
    T_POSITION,  # last fused, of any receiver
    T_BAROMETER,
    T_MAGNETOMETER,
    T_FIELD,  # last heard, fused or not
    T_GRAVITY,
    ORIGIN_LATITUDE,
    ORIGIN_LONGITUDE,
    ORIGIN_HEIGHT,
    UNDULATION,  # m, ellipsoidal height less height above mean sea level, NaN: no message says
    DECLINATION,  # rad
    STRENGTH,  # T
    ARMED,  # 0 or 1, -1: no heartbeat yet
    OUTAGE,  # 1: positions have been missing long enough to be told
    GAP_COUNT,
    GAP_LONGEST,  # s
    DUPLICATES,  # repeated values and stamps that were passed over
    IMPLAUSIBLE,  # events whose values no sensor can show
    NO_FIX,  # fixes without a position in them
    REST_SINCE,  # start of an unbroken time without a sign of motion, NaN: moving
    T_REST,
    RESTING,  # 1: the vehicle stands still, so its attitude stays
    FIELD_REFUSED_SINCE,
    SCALE_BARO,  # learnt variance of the barometer, against what is assumed
    SCALE_FIELD,  # learnt variance of the magnetometer, against what is assumed
    SCALE_WALK,  # learnt variance of the walk of the gyro bias, against what is assumed
    SCALE_DRIVE,  # learnt density that drives the rate of the telemetry model, against what the samples show
    SCALE_DRIVE_FORCE,  # and its specific force
    SCALE_IMU,  # learnt noise density of the IMU, against what the samples show
    RECOVERING,  # fixes to come before a state that has crossed a gap of the IMU is shown again
    BANK_UPDATES,  # of the yaw bank, 0: it is not running
    BANK_SINCE,
    PENDING_COUNT,
    UNKNOWN_LEVER,  # m: one sigma of the lever arm that the coloured error stands for, while the heading is not known
    YAW_REFUSED_SINCE,  # start of an unbroken run of refused headings of the receiver, NaN: none
    MAIN,  # source of the main GNSS receiver
    IMU_SOURCE,  # of the IMU in use
    FIELD_SOURCE,  # of the magnetometer in use
    FIELD_LAST,  # when it was heard last, NaN: never
    FIELD_STANDBY,  # values of another in a row since then
    FIELD_USED,  # source of the last field that was taken, -1: none
    PRESSURE_SOURCE,
    PRESSURE_LAST,
    PRESSURE_STANDBY,
    PRESSURE_USED,
) = range(_book, _book + 70)
IMU = _book + 70  # last sample: omega_b, f_b
LAST_DIFFERENCE = IMU + 6  # of the samples before
RATE = LAST_DIFFERENCE + 6  # omega_b less bias at T
ALIGN_SUM = RATE + 3  # sums of the six components, then of their squares
FIELD = ALIGN_SUM + 12  # last magnetometer value, T
ACCELERATION = FIELD + 3  # in n, m/s^2, at T
COLOUR = ACCELERATION + 3  # one sigma of the coloured GNSS error, horizontal and vertical, m
COLOUR_TIME = COLOUR + 2  # s: how long that error lasts, horizontal and vertical
COLOUR_FLOOR = COLOUR_TIME + 2
LAST_INNOVATION = COLOUR_FLOOR + 2  # of the GNSS position, m
LAST_VELOCITY = LAST_INNOVATION + 3  # of the horizontal GNSS velocity, m/s
GNSS_SPEED = LAST_VELOCITY + 2  # horizontal velocity of the fixes, m/s, mean of some seconds
GUESSES, GUESS = 12, 33  # of the yaw bank: hypotheses, and numbers for each
BANK = GNSS_SPEED + 2
IMUS = 6  # messages
STANDBY = BANK + GUESSES * GUESS  # plausible samples in a row of an IMU that is not in use
STANDBY_T = STANDBY + IMUS  # and its last one
RECEIVERS = 4  # the book of each, in the order of `GNSS_SOURCES`, and in it:
(
    F_T,  # last 3D fix, NaN: none
    F_T_BEFORE,  # the one before
    F_SINCE,  # start of a time without a pause
    F_COUNT,  # fixes in a row that agree, before the first position
    F_T_POSITION,  # last fused
    F_T_VELOCITY,
    F_REFUSED_SINCE,  # start of an unbroken run of refused positions, NaN: none
    F_REFUSED_COUNT,
    F_VELOCITY_REFUSED,  # velocities in a row
    F_SCALE_VELOCITY,  # learnt variance of the white part of the velocity, against what is claimed
    F_SCALE_COLOUR,  # of the coloured part of the position, where it has no state
) = range(11)
F_SCALE_POSITION = 11  # of the white part of the position, horizontal and vertical
F_FIX = 13  # last fix: latitude, longitude, height, vn, ve
F_REFUSED = 18  # last refused fix, the same
BOOK = 23
BOOKS = STANDBY_T + IMUS
_class = BOOKS + RECEIVERS * BOOK
(
    T_CLASS,  # last use of what is known of the vehicle's class, NaN: none
    T_AIRSPEED,
    ARMED_HEIGHT,  # m, NaN: not armed, or not known
) = range(_class, _class + 3)
SCALE_CLASS = _class + 3  # learnt variance of that knowledge, against what is assumed: of two kinds
MEAN_FORCE = SCALE_CLASS + 2  # f_b as measured, running mean
LAST_CLASS = MEAN_FORCE + 3  # last innovations of the drag or of sideslip and airspeed
SCALE_LASTING = LAST_CLASS + 2  # learnt variance of the walk of the wind, or of slip that lasts
CORRECT_FROM = SCALE_LASTING + 1  # error states before it are considered, not corrected, by what is fused now
AIR_KNOWN = CORRECT_FROM + 1  # 1: the wind has been learnt in this flight
PENDING = AIR_KNOWN + 1
PENDING_CAPACITY = 32
HALF = PENDING + PENDING_CAPACITY * EVENT_WIDTH
STATE_SIZE = 2 * HALF  # all of it twice: see SECOND


CONSTANT_VELOCITY, STRAPDOWN, TELEMETRY = 0.0, 1.0, 2.0  # values of MODEL

# An innovation row: time, sensor, source, dimension, r (3), S (9), nis, limit, fused, reason
(I_TIME, I_SENSOR, I_SOURCE, I_SIZE) = range(4)
I_R, I_S, I_NIS, I_LIMIT, I_FUSED, I_REASON = 4, 7, 16, 17, 18, 19
INNOVATION_WIDTH = 20

# A note: code, start, end (s), size, two numbers of evidence
NOTE_CODE, NOTE_START, NOTE_END, NOTE_SIZE, NOTE_A, NOTE_B = range(6)
NOTE_WIDTH = 6

# A pose row
(
    R_TIME,
    R_MODE,
    R_FLAGS,
    R_VALID,  # bits: position 1, velocity 2, tilt 4, yaw 8
    R_MODEL,
    R_LATITUDE,
    R_LONGITUDE,
    R_HEIGHT,
    R_UNDULATION,
    R_ORIGIN_LATITUDE,
    R_ORIGIN_LONGITUDE,
    R_ORIGIN_HEIGHT,
) = range(12)
R_NED, R_V, R_Q, R_EULER, R_RATE, R_BG, R_BA = 12, 15, 18, 22, 25, 28, 31
R_POSE_COVARIANCE = 34  # position then rotation, row-major 6 x 6
R_VELOCITY_COVARIANCE = 70
R_SIGMA_EULER = 79  # one sigma of roll, pitch, yaw, rad
POSE_WIDTH = 82

VALID_POSITION, VALID_VELOCITY, VALID_TILT, VALID_YAW = 1, 2, 4, 8


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


NOTE_CODES = len(NoteCode)


OUT = several(MATRIX, MATRIX, INTEGERS, VECTOR, VECTOR)
"""Type of the output buffers of the fold: innovation rows, note rows, counts, times of the last notes, events on record."""


@compiled
def covariance(s: np.ndarray) -> np.ndarray:
    """P (STATES, STATES) of a state, as a view."""
    n = int(s[STATES])
    return s[P : P + n * n].reshape((n, n))
