"""Where everything is: the state of the fold, the parameters, the events, and the rows that come out.

The fold's whole memory is one flat float64 array, so that a snapshot is a copy and equality is equality of bits: nominal state,
covariance (of as many error states as are in use), then bookkeeping by name. Flags and counts are whole numbers in float64, which is
exact up to 2^53.
"""

import numpy as np

from mavkf.compiled import INTEGERS, MATRIX, VECTOR, compiled, several
from mavkf.models.order import STATES_MOST, X_SIZE
from mavkf.models.strapdown import SUMS, TOP
from mavkf.navigation.codes import FAULTS, NOTE_CODES
from mavkf.samples import ROW_WIDTH
from mavkf.stack import block

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
    LASTING_STATES,  # of them, what is there without the telemetry model
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
    KNOWN_SPEED,  # m/s: noise of the main receiver's velocity as the whole flight has shown it, 0: not known
) = range(_book, _book + 72)
IMU = _book + 72  # last sample: omega_b, f_b
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
    F_REPEATS,  # fixes in a row with the very same values
) = range(12)
F_SCALE_POSITION = 12  # of the white part of the position, horizontal and vertical
F_FIX = 14  # last fix: latitude, longitude, height, vn, ve
F_REFUSED = 19  # last refused fix, the same
F_INNOVATION = 24  # of the last position, m
F_ASTRAY = 27  # sums over refused velocities: how far the positions went where they point, and how far they would have gone, (m/s)^2 s
BOOK = 29
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
CORRECT_CLASS = SCALE_LASTING + 1  # 1: what is fused now corrects the class's states only, others are considered
AIR_KNOWN = CORRECT_CLASS + 1  # 1: the wind has been learnt in this flight
# Faults that are going on, in the order of FAULT_CODES: three numbers each
FAULT_SINCE, FAULT_SIZE, FAULT_LAST = range(3)  # start (NaN: none), the largest size so far, when it was seen last
FAULT_BOOK = AIR_KNOWN + 1
_suspicion = FAULT_BOOK + 3 * FAULTS
(
    SUSPECT_POSITION,  # since when the main receiver's positions are not believed, s; NaN: they are
    SUSPECT_VELOCITY,  # its velocities
    SUSPECT_HEIGHT,  # its heights
    HEIGHT_AGREES_SINCE,
    AGREES_SINCE,  # start of an unbroken time in which what is suspected agrees with the state, NaN: it does not
    DOUBT,  # m: by how much two accounts of the position differed when nothing could tell which was right
    SCATTER,  # of late, positions that were refused and did not agree with each other either
    PRESSURE_REFUSED_SINCE,  # start of an unbroken run of refused pressures, NaN: none
    PRESSURE_HEIGHT,  # m, the last; NaN: none
    HEIGHTS_APART,  # m: pressure height less the height of fixes, now, and its running mean
    HEIGHTS_MEAN,
    CLIPPED,  # samples in a row that show the same extreme force
    MONITORED,  # 1: the effects of faults are being carried along
) = range(_suspicion, _suspicion + 13)
SINCE_UPDATE = (
    _suspicion + 13
)  # since the effects were carried along last: transition (9, TOP), and decay of the coloured error (2)
# Hypothetical faults, see `monitors`. Each: start, J (3, 3), c (3). Then the effects of all on the estimate (STATES_MOST, COLUMNS).
H_SINCE, H_J, H_C = 0, 1, 10
HYPOTHESIS = 13
HYPOTHESES = 15
MONITORS = SINCE_UPDATE + 9 * TOP + 2
EFFECTS = MONITORS + HYPOTHESES * HYPOTHESIS
COLUMNS = 3 * HYPOTHESES
BEHIND = EFFECTS + STATES_MOST * COLUMNS  # s by which the covariance is behind T: see `propagation.bring_up`
BEHIND_GYRO = BEHIND + 1  # rad^2, the noise of that time
BEHIND_ACCEL = BEHIND + 2  # (m/s)^2
BROUGHT_UP = BEHIND + 3  # number of the interval in which that was done last
BEHIND_SUMS = BEHIND + 4  # and the integrals of which its transition is made
PENDING = BEHIND_SUMS + SUMS
PENDING_CAPACITY = 32
HALF = PENDING + PENDING_CAPACITY * EVENT_WIDTH
STATE_SIZE = 2 * HALF  # all of it twice: see SECOND


CONSTANT_VELOCITY, STRAPDOWN, TELEMETRY = 0.0, 1.0, 2.0  # values of MODEL

# An innovation row: time, sensor, source, dimension, r (3), S (9), nis, limit, fused, reason
(I_TIME, I_SENSOR, I_SOURCE, I_SIZE) = range(4)
I_R, I_S, I_NIS, I_LIMIT, I_FUSED, I_REASON = 4, 7, 16, 17, 18, 19
INNOVATION_WIDTH = 20

# A note: code, when it was told, start, end (s; NaN: it lasts), size, two numbers of evidence
NOTE_CODE, NOTE_TIME, NOTE_START, NOTE_END, NOTE_SIZE, NOTE_A, NOTE_B = range(7)
NOTE_WIDTH = 7

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
R_PL_H, R_PL_V = 82, 83  # m: protection levels
POSE_WIDTH = 84

VALID_POSITION, VALID_VELOCITY, VALID_TILT, VALID_YAW = 1, 2, 4, 8


OUT = several(MATRIX, MATRIX, INTEGERS, VECTOR, VECTOR, VECTOR)
"""Type of the output buffers of the fold."""


def buffers(innovations: int, notes: int, recorded: int, tape: int = 0) -> tuple[np.ndarray, ...]:
    """Output buffers of the fold, with room for so many innovation rows, notes, and events of which it is known who has left an innovation.

    Innovation rows, note rows, their two counts and whether to keep silent (int64), the time of the last note of each code as it began and
    as it ended, the numbers of the events on record with a bit for each sensor, and a tape of so many numbers (see `tape`; 0: nothing is
    recorded).
    """
    return (
        np.empty((innovations, INNOVATION_WIDTH)),
        np.empty((notes, NOTE_WIDTH)),
        np.zeros(3, dtype=np.int64),
        np.full(2 * NOTE_CODES, -np.inf),
        np.full(recorded, -1.0),
        np.zeros(tape),
    )


@compiled
def covariance(s: np.ndarray) -> np.ndarray:
    """P (STATES, STATES) of a state, as a view."""
    n = int(s[STATES])
    return block(s, P, n, n)  # type: ignore[no-any-return]
