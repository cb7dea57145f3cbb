"""From one time to the next: the begin of a session, state and covariance over an interval, and the noise that goes with it."""

import numpy as np

from mavkf.compiled import VECTOR, called_with, kernel
from mavkf.models import constant_velocity, strapdown
from mavkf.models.earth import gravity
from mavkf.models.order import ANTENNA, DANTENNA
from mavkf.models.rotation import rotation_matrix
from mavkf.models.strapdown import (
    BA,
    BG,
    DBA,
    DBARO,
    DBG,
    DDELAY,
    DFIELD,
    DIRON,
    HEIGHT,
    LATITUDE,
    POS,
    SUMS,
    THETA,
    VEL,
    N,
    Q,
)
from mavkf.navigation import layout as L
from mavkf.navigation.covariance import bring_up
from mavkf.navigation.disturbances import begin_faults
from mavkf.navigation.monitors import stop_monitors
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.receivers import begin_books
from mavkf.navigation.sources import begin_sources
from mavkf.navigation.tape import attend, is_recording
from mavkf.navigation.use_class import begin_class
from mavkf.navigation.yaw_bank import predict_bank
from mavkf.stack import copy, matrix, vector, zero_vector

REST_DRIFT = 1e-6  # rad/s/sqrt(Hz): how a vehicle that stands turns
COAST_RATE = 0.3  # rad/s/sqrt(Hz): how a vehicle turns while nobody looks


@called_with(VECTOR, VECTOR)
@kernel
def begin(s, c):
    """Fill the state with the start of a session."""
    s[:] = 0.0
    s[L.X] = 1.0
    antenna = c[Parameter.ANTENNA_SIGMA] > 0.0
    s[L.STATES] = DANTENNA + 3 if antenna else N
    s[L.WANTED] = c[Parameter.MODEL]
    s[L.BROUGHT_UP] = -1.0
    for i in (
        L.T,
        L.T_IMU,
        L.T_FIX,
        L.T_POSITION,
        L.T_BAROMETER,
        L.T_GRAVITY,
        L.ORIGIN_LATITUDE,
        L.ORIGIN_LONGITUDE,
        L.ORIGIN_HEIGHT,
        L.UNDULATION,
        L.DECLINATION,
        L.STRENGTH,
        L.T_FIELD,
        L.REST_SINCE,
        L.FIELD_REFUSED_SINCE,
        L.YAW_REFUSED_SINCE,
    ):
        s[i] = np.nan
    s[L.T_MAGNETOMETER] = -1.0
    s[L.T_REST] = -1.0
    s[L.ARMED] = -1.0
    s[L.SCALE_BARO] = 1.0
    s[L.SCALE_FIELD] = 1.0
    s[L.SCALE_WALK] = 1.0
    s[L.SCALE_IMU] = 1.0
    s[L.SCALE_DRIVE] = 1.0
    s[L.SCALE_DRIVE + 1] = 1.0
    for i in range(2):
        s[L.COLOUR_TIME + i] = c[Parameter.COLOUR_TIME]
    s[L.PERIOD] = c[Parameter.IMU_PERIOD]
    begin_sources(s, c)
    begin_faults(s)
    stop_monitors(s)
    begin_books(s, c)
    s[L.RATE : L.RATE + 3] = np.nan
    P = L.covariance(s)
    for i in range(3):
        P[THETA + i, THETA + i] = 9.0
        P[VEL + i, VEL + i] = 100.0
        P[POS + i, POS + i] = 1e6
        P[DBG + i, DBG + i] = c[Parameter.GYRO_BIAS] ** 2
        P[DBA + i, DBA + i] = c[Parameter.ACCEL_BIAS] ** 2
        P[DIRON + i, DIRON + i] = c[Parameter.IRON] ** 2
        P[DFIELD + i, DFIELD + i] = c[Parameter.EARTH_FIELD] ** 2
    P[DBARO, DBARO] = 1.0
    P[DDELAY, DDELAY] = c[Parameter.DELAY] ** 2
    for i in range(3):
        s[ANTENNA + i] = c[Parameter.ANTENNA_X + i]
        if antenna:
            P[DANTENNA + i, DANTENNA + i] = c[Parameter.ANTENNA_SIGMA] ** 2
    begin_class(s, c)
    s[L.LASTING_STATES] = s[L.STATES]


@kernel
def at_rest(x, imu, still):
    """Fill `still` with a sample (6,) whose gyro is as if the body stood still on the earth: the earth's rate and the bias."""
    C = matrix(3, 3)
    frame = vector(9)
    copy(still, imu)
    rotation_matrix(x[Q : Q + 4], C)
    strapdown.rates_of_frame(x, frame)
    for i in range(3):
        still[i] = x[BG + i]
        for j in range(3):
            still[i] += C[j, i] * frame[j]


@kernel
def roaming(c):
    """Density (m^2/s^3) of what a vehicle does unseen: white acceleration with the power of one that lasts its time, 2 sigma^2 tau."""
    return 2.0 * c[Parameter.ACCELERATION] ** 2 * c[Parameter.ACCELERATION_TIME]


@kernel
def step(s, c, imu0, imu1, dt, gyro, accel, out):
    """Advance the state by dt with the samples at both ends, noise densities `gyro` (rad^2/s) and `accel` (m^2/s^3).

    The covariance follows when somebody asks for it (`bring_up`).
    """
    x = s[L.X : L.P]
    average = vector(21)
    if s[L.BEHIND] == 0.0 and is_recording(out):
        attend(s, out)
    still0, still1 = vector(6), vector(6)
    if s[L.RESTING] != 0.0:
        at_rest(x, imu0, still0)
        at_rest(x, imu1, still1)
        imu0, imu1 = still0, still1
        gyro = REST_DRIFT**2
    if s[L.MODEL] == L.STRAPDOWN:
        strapdown.propagate(x, imu0, imu1, dt, average)
    else:
        constant_velocity.propagate(x, imu0, imu1, dt, average)
        if s[L.BANK_UPDATES] > 0.0:
            predict_bank(s, imu0, imu1, dt)
        accel = roaming(c) if s[L.POSITION_KNOWN] != 0.0 else 0.0
    strapdown.gather(average, dt, s[L.BEHIND_SUMS : L.BEHIND_SUMS + SUMS])
    s[L.BEHIND] += dt
    s[L.BEHIND_GYRO] += gyro * dt
    s[L.BEHIND_ACCEL] += accel * dt
    s[L.T] += dt
    if s[L.MODEL] != L.STRAPDOWN:
        bring_up(s, c, out)


@kernel
def coast(s, c, t, out):
    """Advance to time t without an IMU: the velocity is kept, what the vehicle may do meanwhile is noise."""
    dt = t - s[L.T]
    if not dt > 0.0:
        return
    bring_up(s, c, out)
    model = s[L.MODEL]
    s[L.MODEL] = L.CONSTANT_VELOCITY
    s[L.BANK_UPDATES] = 0.0  # the guesses have missed a motion
    s[L.RESTING] = 0.0  # nor has anybody seen that it still stands
    s[L.REST_SINCE] = np.nan
    still = zero_vector(6)
    copy(still[0:3], s[BG : BG + 3])
    steps = min(100, int(dt) + 1)
    for _ in range(steps):
        step(s, c, still, still, dt / steps, COAST_RATE**2, 0.0, out)
    s[L.MODEL] = model
    s[L.T] = t
    s[L.RATE : L.RATE + 3] = np.nan


@kernel
def set_acceleration(s, imu):
    """Keep the acceleration in n (m/s^2) that a sample (6,) at the state's time shows; it is what makes a delay visible."""
    if s[L.MODEL] == L.CONSTANT_VELOCITY:
        for i in range(3):
            s[L.ACCELERATION + i] = 0.0
        return
    C = matrix(3, 3)
    rotation_matrix(s[Q : Q + 4], C)
    for i in range(3):
        s[L.ACCELERATION + i] = gravity(s[LATITUDE], s[HEIGHT]) if i == 2 else 0.0
        for j in range(3):
            s[L.ACCELERATION + i] += C[i, j] * (imu[3 + j] - s[BA + j])
