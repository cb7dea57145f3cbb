"""The estimator: a fold over events in the order in which they were measured.

    fold(state, event) -> state, records

Measurements wait in the state until the IMU sample that follows them, so that attitude, velocity and position at their time come
from interpolated samples, never from a sample held too long. After an IMU event the state stands at that sample's time with everything
before it fused: that is the pose for "now".
"""

import math

import numpy as np

from mavkf.compiled import compiled
from mavkf.models import constant_velocity, strapdown
from mavkf.models.earth import gravity
from mavkf.models.rotation import rotation_matrix
from mavkf.models.strapdown import (
    BA,
    BG,
    DBA,
    DBARO,
    DBG,
    DDELAY,
    DFIELD,
    DGNSS,
    DIRON,
    GNSS,
    HEIGHT,
    LATITUDE,
    POS,
    THETA,
    TOP,
    VEL,
    N,
    Q,
    V,
)
from mavkf.navigation import layout as L
from mavkf.navigation.alignment import collect
from mavkf.navigation.fusing import note
from mavkf.navigation.layout import NoteCode, Parameter
from mavkf.navigation.use_barometer import use_barometer
from mavkf.navigation.use_gnss import use_gnss
from mavkf.navigation.use_gravity import level, rest
from mavkf.navigation.use_magnetometer import use_magnetometer
from mavkf.navigation.yaw_bank import predict_bank
from mavkf.samples import (
    ACCEL_RESOLUTION,
    BASE_MODE,
    FIELD,
    FIX,
    GYRO,
    GYRO_RESOLUTION,
    HEIGHT_AMSL,
    KIND,
    PRESSURE,
    SIGMA_HORIZONTAL,
    TIME,
    VELOCITY_N,
    Kind,
)
from mavkf.samples import LATITUDE as FIX_LATITUDE
from mavkf.samples import LONGITUDE as FIX_LONGITUDE

DIFFERENCE_TIME = 20.0  # s: memory of how restless the samples are
OUTAGE_AFTER = 2.0  # s without a fused position
GIVE_UP_POSITION, GIVE_UP_VELOCITY = 300.0, 30.0  # m, m/s: one sigma at which position is not known any more
REST_DRIFT = 1e-6  # rad/s/sqrt(Hz): how a vehicle that stands turns
FIXES_AFTER_GAP = 3.0
COAST_RATE = 0.3  # rad/s/sqrt(Hz): how a vehicle turns while nobody looks
POLE = math.radians(86.0)  # beyond it north is no direction to navigate by
ARMED_BIT = 128  # MAV_MODE_FLAG_SAFETY_ARMED
# What no sensor of a drone shows: rad/s, m/s^2, m, m/s, m (or m/s), T, Pa.
MOST_RATE, MOST_FORCE, MOST_HEIGHT, MOST_SPEED, MOST_SIGMA, MOST_FIELD = 100.0, 1000.0, 1e5, 1000.0, 1e5, 1e-2
LEAST_PRESSURE, MOST_PRESSURE = 1e3, 2e5
IMU_KIND, GNSS_KIND, MAGNETOMETER_KIND, BAROMETER_KIND, HEARTBEAT_KIND = (
    int(Kind.IMU),
    int(Kind.GNSS),
    int(Kind.MAGNETOMETER),
    int(Kind.BAROMETER),
    int(Kind.HEARTBEAT),
)


@compiled
def begin(s, c):
    """Fill the state with the start of a session."""
    s[:] = 0.0
    s[L.X] = 1.0
    for i in (
        L.T,
        L.T_IMU,
        L.T_FIX,
        L.T_POSITION,
        L.T_VELOCITY,
        L.T_BAROMETER,
        L.T_GRAVITY,
        L.T_PREVIOUS_FIX,
        L.REFUSED_SINCE,
        L.ORIGIN_LATITUDE,
        L.ORIGIN_LONGITUDE,
        L.ORIGIN_HEIGHT,
        L.UNDULATION,
        L.DECLINATION,
        L.STRENGTH,
        L.T_FIELD,
        L.REST_SINCE,
        L.FIELD_REFUSED_SINCE,
    ):
        s[i] = np.nan
    s[L.T_MAGNETOMETER] = -1.0
    s[L.T_REST] = -1.0
    s[L.ARMED] = -1.0
    s[L.SCALE_VELOCITY] = 1.0
    s[L.SCALE_IMU] = 1.0
    for i in range(2):
        s[L.SCALE_POSITION + i] = 1.0
    s[L.PERIOD] = c[Parameter.IMU_PERIOD]
    s[L.RATE : L.RATE + 3] = np.nan
    P = s[L.P : L.P + N * N].reshape((N, N))
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


@compiled
def add_noise(P, c, gyro, accel, dt):
    """Add the noise of dt to the diagonal: densities `gyro` (rad^2/s) and `accel` (m^2/s^3), and the walks of the biases."""
    for i in range(3):
        P[THETA + i, THETA + i] += gyro * dt
        P[VEL + i, VEL + i] += accel * dt
        P[DBG + i, DBG + i] += c[Parameter.GYRO_WALK] ** 2 * dt
        P[DBA + i, DBA + i] += c[Parameter.ACCEL_WALK] ** 2 * dt
    P[DBARO, DBARO] += c[Parameter.BARO_WALK] ** 2 * dt
    P[DDELAY, DDELAY] += c[Parameter.DELAY_WALK] ** 2 * dt


@compiled
def propagate_covariance(P, Phi):
    """P <- Phi P Phi' where Phi (9, TOP) holds the rows that are not the identity."""
    A = np.zeros((9, N))
    for i in range(9):
        for k in range(TOP):
            p = Phi[i, k]
            if p != 0.0:
                for j in range(N):
                    A[i, j] += p * P[k, j]
    for i in range(9):
        for j in range(9, N):
            P[i, j] = A[i, j]
            P[j, i] = A[i, j]
    for i in range(9):
        for j in range(i, 9):
            total = 0.0
            for k in range(TOP):
                total += A[i, k] * Phi[j, k]
            P[i, j] = total
            P[j, i] = total


@compiled
def decay_colour(s, c, dt):
    """The coloured GNSS error falls off, and is renewed: e <- phi e, variance phi^2 P + (1 - phi^2) sigma^2 with phi = exp(-dt / tau)."""
    P = s[L.P : L.P + N * N].reshape((N, N))
    phi = math.exp(-dt / c[Parameter.COLOUR_TIME])
    for i in range(3):
        s[GNSS + i] *= phi
        for j in range(N):
            P[DGNSS + i, j] *= phi
        for j in range(N):
            P[j, DGNSS + i] *= phi
        P[DGNSS + i, DGNSS + i] += (1.0 - phi * phi) * s[L.COLOUR + i // 2] ** 2


@compiled
def at_rest(x, imu):
    """A sample (6,) with the gyro as it would be if the body stood still on the earth: the earth's rate and the bias."""
    C = np.empty((3, 3))
    frame = np.empty(6)
    still = imu.copy()
    rotation_matrix(x[Q : Q + 4], C)
    strapdown.rates_of_frame(x, frame)
    for i in range(3):
        still[i] = x[BG + i]
        for j in range(3):
            still[i] += C[j, i] * frame[j]
    return still


@compiled
def step(s, c, imu0, imu1, dt, gyro, accel):
    """Advance state and covariance by dt with the samples at both ends; half of the noise before, half after (second order in dt)."""
    x = s[L.X : L.P]
    P = s[L.P : L.P + N * N].reshape((N, N))
    Phi = np.empty((9, TOP))
    average = np.empty(21)
    if s[L.RESTING] != 0.0:
        imu0 = at_rest(x, imu0)
        imu1 = at_rest(x, imu1)
        gyro = REST_DRIFT**2
    if s[L.STRAPDOWN] != 0.0:
        strapdown.propagate(x, imu0, imu1, dt, average)
        strapdown.transition(x, average, dt, Phi)
    else:
        constant_velocity.propagate(x, imu0, imu1, dt, average)
        constant_velocity.transition(x, average, dt, Phi)
        if s[L.BANK_UPDATES] > 0.0:
            predict_bank(s, imu0, imu1, dt)
        # white acceleration with the power of one that lasts its time constant: 2 sigma^2 tau
        accel = (
            2.0 * c[Parameter.ACCELERATION] ** 2 * c[Parameter.ACCELERATION_TIME] if s[L.POSITION_KNOWN] != 0.0 else 0.0
        )
    if s[L.RESTING] != 0.0:
        # the gyro was not asked, so its bias did no harm
        for i in range(9):
            for j in range(3):
                Phi[i, DBG + j] = 0.0
    add_noise(P, c, gyro, accel, 0.5 * dt)
    propagate_covariance(P, Phi)
    add_noise(P, c, gyro, accel, 0.5 * dt)
    decay_colour(s, c, dt)
    s[L.T] += dt


@compiled
def coast(s, c, t):
    """Advance to time t without an IMU: the velocity is kept, what the vehicle may do meanwhile is noise."""
    dt = t - s[L.T]
    if not dt > 0.0:
        return
    model = s[L.STRAPDOWN]
    s[L.STRAPDOWN] = 0.0
    s[L.BANK_UPDATES] = 0.0  # the guesses have missed a motion
    still = np.zeros(6)
    still[0:3] = s[BG : BG + 3]
    steps = min(100, int(dt) + 1)
    for _ in range(steps):
        step(s, c, still, still, dt / steps, COAST_RATE**2, 0.0)
    s[L.STRAPDOWN] = model
    s[L.T] = t
    s[L.RATE : L.RATE + 3] = np.nan


@compiled
def watch_samples(s, e, c, imu, dt):
    """Noise densities in use from how much successive samples differ: what happens between them is not seen.

    A quarter of dt times the larger of now and the 20 s average of the squared differences, plus the rounding to whole counts. Returns
    the squared differences of now, gyro and accelerometer, per axis.
    """
    gyro = 0.0
    accel = 0.0
    for i in range(3):
        gyro += (imu[i] - s[L.IMU + i]) ** 2 / 3.0
        accel += (imu[3 + i] - s[L.IMU + 3 + i]) ** 2 / 3.0
    weight = 1.0 - math.exp(-dt / DIFFERENCE_TIME)
    s[L.DIFFERENCE_GYRO] += weight * (gyro - s[L.DIFFERENCE_GYRO])
    s[L.DIFFERENCE_ACCEL] += weight * (accel - s[L.DIFFERENCE_ACCEL])
    share = c[Parameter.SAMPLING] * dt * s[L.SCALE_IMU]
    s[L.NOISE_GYRO] = (
        c[Parameter.GYRO] ** 2 + share * max(gyro, s[L.DIFFERENCE_GYRO]) + dt * e[GYRO_RESOLUTION] ** 2 / 12.0
    )
    s[L.NOISE_ACCEL] = (
        c[Parameter.ACCEL] ** 2 + share * max(accel, s[L.DIFFERENCE_ACCEL]) + dt * e[ACCEL_RESOLUTION] ** 2 / 12.0
    )
    return gyro, accel


@compiled
def untruncated(e, c, imu):
    """Fill imu (6,) with the sample; values that were cut off toward zero to whole counts are half a count larger in the mean."""
    for i in range(6):
        value = e[GYRO + i]
        count = c[Parameter.TRUNCATION] * (e[GYRO_RESOLUTION] if i < 3 else e[ACCEL_RESOLUTION])
        if value > 0.0:
            value += 0.5 * count
        elif value < 0.0:
            value -= 0.5 * count
        imu[i] = value


@compiled
def choose_model(s, c, out):
    """Strapdown where it is wanted and can be: attitude and yaw known, position known, samples without a gap."""
    wanted = (
        c[Parameter.WANT_STRAPDOWN] != 0.0
        and s[L.ALIGNED] != 0.0
        and s[L.YAW_KNOWN] != 0.0
        and s[L.POSITION_KNOWN] != 0.0
    )
    if wanted and s[L.STRAPDOWN] == 0.0:
        s[L.STRAPDOWN] = 1.0
        note(out, NoteCode.MODEL_CHANGED, s[L.T], s[L.T], 0.0, 1.0, 0.0)
    elif not wanted and s[L.STRAPDOWN] != 0.0:
        s[L.STRAPDOWN] = 0.0
        note(out, NoteCode.MODEL_CHANGED, s[L.T], s[L.T], 0.0, 0.0, 0.0)


@compiled
def watch_position(s, out):
    """Tell of an outage; give the position up when nobody could use it; refuse the neighbourhood of the poles."""
    if s[L.POSITION_KNOWN] == 0.0:
        return
    P = s[L.P : L.P + N * N].reshape((N, N))
    since = s[L.T] - s[L.T_POSITION]
    if since > OUTAGE_AFTER and s[L.OUTAGE] == 0.0:
        s[L.OUTAGE] = 1.0
        note(out, NoteCode.GNSS_OUTAGE, s[L.T_POSITION], s[L.T], since, 0.0, 0.0)
    lost = P[POS, POS] + P[POS + 1, POS + 1] > 2.0 * GIVE_UP_POSITION**2
    lost = lost or P[VEL, VEL] + P[VEL + 1, VEL + 1] > 2.0 * GIVE_UP_VELOCITY**2
    if lost or abs(s[LATITUDE]) > POLE or not math.isfinite(P[POS, POS] + s[LATITUDE]):
        note(
            out,
            NoteCode.POSITION_GIVEN_UP,
            s[L.T_POSITION],
            s[L.T],
            math.sqrt(P[POS, POS] + P[POS + 1, POS + 1]),
            0.0,
            0.0,
        )
        s[L.POSITION_KNOWN] = 0.0
        s[L.FIX_COUNT] = 0.0
        s[L.OUTAGE] = 0.0
        s[L.STRAPDOWN] = 0.0
        for first in (VEL, POS):
            for i in range(first, first + 3):
                for j in range(N):
                    P[i, j] = 0.0
                    P[j, i] = 0.0
                P[i, i] = 100.0 if first == VEL else 1e6
        s[V : V + 3] = 0.0


@compiled
def measure(s, e, c, out):
    """Fuse one measurement at the state's time."""
    kind = int(e[KIND])
    if kind == GNSS_KIND:
        use_gnss(s, e, c, out)
    elif kind == MAGNETOMETER_KIND:
        use_magnetometer(s, e, c, out)
    elif kind == BAROMETER_KIND:
        use_barometer(s, e, c, out)


@compiled
def use_imu(s, e, c, out):
    """An IMU sample: go through the measurements that wait, each at its own time between the samples, then to the sample's time."""
    t = e[TIME]
    imu = np.empty(6)
    untruncated(e, c, imu)
    first = not math.isfinite(s[L.T_IMU])
    gyro, accel = np.inf, np.inf
    dt = t - s[L.T_IMU]
    if not first and not dt > 1e-6:
        s[L.DUPLICATES] += 1.0
        return
    gap = not first and dt > max(c[Parameter.GAP], 3.0 * s[L.PERIOD])
    if gap:
        s[L.GAP_COUNT] += 1.0
        s[L.GAP_LONGEST] = max(s[L.GAP_LONGEST], dt)
        note(out, NoteCode.IMU_GAP, s[L.T_IMU], t, dt, 0.0, 0.0)
        s[L.RECOVERING] = FIXES_AFTER_GAP if s[L.STRAPDOWN] != 0.0 else 0.0
    if not first and not gap:
        s[L.PERIOD] = dt if s[L.PERIOD] == 0.0 else s[L.PERIOD] + (dt - s[L.PERIOD]) * min(1.0, dt / 2.0 + 0.02)
        gyro, accel = watch_samples(s, e, c, imu, dt)
    if s[L.ALIGNED] == 0.0:
        flush(s, c, out)
        coast_or_start(s, c, t)
        collect(s, imu, t, c, out)
    elif gap or first:
        flush(s, c, out)
        coast_or_start(s, c, t)
    else:
        interpolate(s, imu, t, c, out)
    s[L.T_IMU] = t
    for i in range(6):
        s[L.IMU + i] = imu[i]
    for i in range(3):
        s[L.RATE + i] = imu[i] - s[BG + i]
    if s[L.ALIGNED] != 0.0 and s[L.STRAPDOWN] == 0.0:
        level(s, e, c, out)
    if s[L.ALIGNED] != 0.0 and c[Parameter.REST] != 0.0:
        rest(s, e, c, out, gyro, accel)
    watch_position(s, out)
    choose_model(s, c, out)


@compiled
def set_acceleration(s, imu):
    """Keep the acceleration in n (m/s^2) that a sample (6,) at the state's time shows; it is what makes a delay visible."""
    if s[L.STRAPDOWN] == 0.0:
        for i in range(3):
            s[L.ACCELERATION + i] = 0.0
        return
    C = np.empty((3, 3))
    rotation_matrix(s[Q : Q + 4], C)
    for i in range(3):
        s[L.ACCELERATION + i] = gravity(s[LATITUDE], s[HEIGHT]) if i == 2 else 0.0
        for j in range(3):
            s[L.ACCELERATION + i] += C[i, j] * (imu[3 + j] - s[BA + j])


@compiled
def interpolate(s, imu, t, c, out):
    """From the last sample to this one (6,) at time t, stopping at each measurement that waits."""
    t0 = s[L.T_IMU]
    previous = s[L.IMU : L.IMU + 6].copy()
    start = previous.copy()
    end = np.empty(6)
    n = int(s[L.PENDING_COUNT])
    for k in range(n):
        e = s[L.PENDING + k * L.EVENT_WIDTH : L.PENDING + (k + 1) * L.EVENT_WIDTH].copy()
        dt = e[TIME] - s[L.T]
        if dt > 1e-9:
            share = (e[TIME] - t0) / (t - t0)
            for i in range(6):
                end[i] = previous[i] + share * (imu[i] - previous[i])
            step(s, c, start, end, dt, s[L.NOISE_GYRO], s[L.NOISE_ACCEL])
            s[L.T] = e[TIME]
            start[:] = end
            set_acceleration(s, end)
        measure(s, e, c, out)
    s[L.PENDING_COUNT] = 0.0
    step(s, c, start, imu, t - s[L.T], s[L.NOISE_GYRO], s[L.NOISE_ACCEL])
    s[L.T] = t


@compiled
def coast_or_start(s, c, t):
    """Bring the state to time t without an IMU; the first event of a session starts its clock."""
    if math.isfinite(s[L.T]):
        coast(s, c, t)
    else:
        s[L.T] = t


@compiled
def flush(s, c, out):
    """Fuse the measurements that wait without the IMU's help."""
    n = int(s[L.PENDING_COUNT])
    for k in range(n):
        e = s[L.PENDING + k * L.EVENT_WIDTH : L.PENDING + (k + 1) * L.EVENT_WIDTH].copy()
        coast_or_start(s, c, e[TIME])
        measure(s, e, c, out)
    s[L.PENDING_COUNT] = 0.0


@compiled
def plausible(e):
    """Whether the values of an event can be measurements at all: finite, and within what sensors can show. NaN stands for not known."""
    kind = int(e[KIND])
    if kind == IMU_KIND:
        for i in range(6):
            # a NaN fails every comparison
            if not abs(e[GYRO + i]) < (MOST_RATE if i < 3 else MOST_FORCE):
                return False
        return 0.0 <= e[GYRO_RESOLUTION] < 1.0 and 0.0 <= e[ACCEL_RESOLUTION] < 10.0
    if kind == GNSS_KIND:
        if e[FIX] >= 3.0:
            if not (abs(e[FIX_LATITUDE]) <= POLE and abs(e[FIX_LONGITUDE]) <= 2.0 * math.pi):
                return False
            if not abs(e[HEIGHT_AMSL]) < MOST_HEIGHT:
                return False
        for i in range(3):
            if abs(e[VELOCITY_N + i]) > MOST_SPEED or e[SIGMA_HORIZONTAL + i] > MOST_SIGMA:
                return False
    elif kind == MAGNETOMETER_KIND:
        for i in range(3):
            if not abs(e[FIELD + i]) < MOST_FIELD:
                return False
    elif kind == BAROMETER_KIND:
        return LEAST_PRESSURE < e[PRESSURE] < MOST_PRESSURE
    return True


@compiled
def fold(s, e, c, out):
    """Take one event (EVENT_WIDTH,) into the state (STATE_SIZE,), in place.

    c: parameters; out: innovation rows, note rows, their two counts (int64), the times of the last notes, the events on record.
    Events must come in the order of `timeline.precedes`. Nothing is raised: what cannot be used is refused and recorded.
    """
    kind = int(e[KIND])
    if not plausible(e):
        s[L.IMPLAUSIBLE] += 1.0
    elif kind == IMU_KIND:
        use_imu(s, e, c, out)
    elif kind == HEARTBEAT_KIND:
        armed = 1.0 if int(e[BASE_MODE]) & ARMED_BIT else 0.0
        if armed != s[L.ARMED]:
            first = s[L.ARMED] < 0.0
            s[L.ARMED] = armed
            if first and armed == 0.0:
                return
            code = NoteCode.ARMED if armed != 0.0 else NoteCode.DISARMED
            note(out, code, e[TIME], e[TIME], 0.0, 0.0, 0.0)
    else:
        flowing = math.isfinite(s[L.T_IMU]) and e[TIME] - s[L.T_IMU] <= max(c[Parameter.GAP], 3.0 * s[L.PERIOD])
        if flowing and int(s[L.PENDING_COUNT]) < L.PENDING_CAPACITY:
            k = L.PENDING + int(s[L.PENDING_COUNT]) * L.EVENT_WIDTH
            for i in range(L.EVENT_WIDTH):
                s[k + i] = e[i]
            s[L.PENDING_COUNT] += 1.0
            return
        flush(s, c, out)
        coast_or_start(s, c, e[TIME])
        measure(s, e, c, out)
        watch_position(s, out)
