"""The estimator: a fold over events in the order in which they were measured.

    fold(state, event) -> state, records

Measurements wait in the state until the IMU sample that follows them, so that attitude, velocity and position at their time come
from interpolated samples, never from a sample held too long. After an IMU event the state stands at that sample's time with everything
before it fused: that is the pose for "now".
"""

import math

import numpy as np

from mavkf.compiled import NOTHING, VECTOR, compiled_apart, kernel
from mavkf.models.strapdown import BG, LATITUDE, POS, VEL, V
from mavkf.navigation import layout as L
from mavkf.navigation.alignment import collect
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.covariance import bring_up, bring_up_in_turn
from mavkf.navigation.disturbances import is_on, watch_imu
from mavkf.navigation.fusing import forget, note
from mavkf.navigation.imu_noise import untruncated, watch_samples
from mavkf.navigation.layout import OUT
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.plausible import (
    BAROMETER_KIND,
    GNSS_KIND,
    HEARTBEAT_KIND,
    IMU_KIND,
    MAGNETOMETER_KIND,
    POLE,
    plausible,
)
from mavkf.navigation.propagation import coast, set_acceleration, step
from mavkf.navigation.slow_imu import advance, begin_telemetry, leave, use_sample
from mavkf.navigation.sources import imu_in_use, in_use
from mavkf.navigation.two_models import weigh_models
from mavkf.navigation.use_barometer import use_barometer
from mavkf.navigation.use_class import use_airspeed, use_class
from mavkf.navigation.use_gnss import use_gnss
from mavkf.navigation.use_gravity import level, rest
from mavkf.navigation.use_magnetometer import is_passed_over, use_magnetometer
from mavkf.samples import BASE_MODE, KIND, SOURCE, TIME
from mavkf.stack import copy, vector

OUTAGE_AFTER = 2.0  # s without a fused position
GIVE_UP_POSITION, GIVE_UP_VELOCITY = 300.0, 30.0  # m, m/s: one sigma at which position is not known any more
FIXES_AFTER_GAP = 3.0
ARMED_BIT = 128  # MAV_MODE_FLAG_SAFETY_ARMED


@kernel
def choose_model(s, e, c, out):
    """The model that is wanted where it can be: attitude, yaw and position known. A vehicle at rest needs no states for its motion."""
    model = s[L.WANTED]
    unknown = s[L.ALIGNED] == 0.0 or s[L.YAW_KNOWN] == 0.0 or s[L.POSITION_KNOWN] == 0.0
    if unknown or is_on(s, NoteCode.ACCELEROMETER_SCALE):
        model = L.CONSTANT_VELOCITY
    elif model == L.TELEMETRY and s[L.RESTING] != 0.0:
        model = L.STRAPDOWN
    if model == s[L.MODEL]:
        return
    bring_up(s, c, out)
    if s[L.MODEL] == L.TELEMETRY:
        leave(s)
    told = model == L.CONSTANT_VELOCITY or s[L.MODEL] == L.CONSTANT_VELOCITY
    s[L.MODEL] = model
    if model == L.TELEMETRY:
        begin_telemetry(s, e, c, out)
    if told:
        note(out, NoteCode.MODEL_CHANGED, s[L.T], s[L.T], 0.0, model, 0.0)


@kernel
def watch_position(s, out):
    """Tell of an outage; give the position up when nobody could use it; refuse the neighbourhood of the poles."""
    if s[L.POSITION_KNOWN] == 0.0 or s[L.BEHIND] != 0.0:
        return
    P = L.covariance(s)
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
        for k in range(L.RECEIVERS):
            s[L.BOOKS + k * L.BOOK + L.F_COUNT] = 0.0
        s[L.OUTAGE] = 0.0
        if s[L.MODEL] == L.TELEMETRY:
            leave(s)
        s[L.MODEL] = L.CONSTANT_VELOCITY
        forget(s, VEL, 3, 100.0)
        forget(s, POS, 3, 1e6)
        s[V : V + 3] = 0.0


@compiled_apart(NOTHING, VECTOR, VECTOR, VECTOR, OUT)
def measure(s, e, c, out):
    """Fuse one measurement at the state's time."""
    kind = int(e[KIND])
    if kind == GNSS_KIND:
        use_gnss(s, e, c, out)
    elif kind == MAGNETOMETER_KIND:
        use_magnetometer(s, e, c, out)
    elif kind == BAROMETER_KIND:
        use_airspeed(s, e, c, out)
        use_barometer(s, e, c, out)


@kernel
def use_imu(s, e, c, out):
    """An IMU sample: go through the measurements that wait, each at its own time between the samples, then to the sample's time."""
    t = e[TIME]
    imu = vector(6)
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
        s[L.RECOVERING] = FIXES_AFTER_GAP if s[L.MODEL] != L.CONSTANT_VELOCITY else 0.0
    if not first and not gap:
        s[L.PERIOD] = dt if s[L.PERIOD] == 0.0 else s[L.PERIOD] + (dt - s[L.PERIOD]) * min(1.0, dt / 2.0 + 0.02)
        gyro, accel = watch_samples(s, e, c, imu, dt)
    if s[L.ALIGNED] == 0.0:
        fuse_waiting(s, c, out, False)
        coast_or_start(s, c, t, out)
        collect(s, imu, t, c, out)
    elif gap or first:
        fuse_waiting(s, c, out, False)
        coast_or_start(s, c, t, out)
    elif s[L.MODEL] == L.TELEMETRY:
        fuse_waiting(s, c, out, True)
        advance(s, c, t, out)
    else:
        interpolate(s, imu, t, c, out)
    s[L.T_IMU] = t
    for i in range(6):
        s[L.IMU + i] = imu[i]
    for i in range(3):
        s[L.RATE + i] = imu[i] - s[BG + i]
    watch_imu(s, out)
    bring_up_in_turn(s, c, out)
    if s[L.MODEL] == L.TELEMETRY:
        if gap:
            begin_telemetry(s, e, c, out)
        else:
            use_sample(s, e, c, out)
    if s[L.ALIGNED] != 0.0 and s[L.MODEL] == L.CONSTANT_VELOCITY:
        level(s, e, c, out)
    if s[L.ALIGNED] != 0.0 and c[Parameter.REST] != 0.0:
        rest(s, e, c, out, gyro, accel)
    use_class(s, e, c, out)
    watch_position(s, out)
    choose_model(s, e, c, out)


@kernel
def interpolate(s, imu, t, c, out):
    """From the last sample to this one (6,) at time t, stopping at each measurement that waits."""
    t0 = s[L.T_IMU]
    previous, start, end = vector(6), vector(6), vector(6)
    copy(previous, s[L.IMU : L.IMU + 6])
    copy(start, previous)
    n = int(s[L.PENDING_COUNT])
    for k in range(n):
        e = vector(L.EVENT_WIDTH)
        copy(e, s[L.PENDING + k * L.EVENT_WIDTH : L.PENDING + (k + 1) * L.EVENT_WIDTH])
        dt = e[TIME] - s[L.T]
        if dt > 1e-9:
            share = (e[TIME] - t0) / (t - t0)
            for i in range(6):
                end[i] = previous[i] + share * (imu[i] - previous[i])
            step(s, c, start, end, dt, s[L.NOISE_GYRO], s[L.NOISE_ACCEL], out)
            s[L.T] = e[TIME]
            copy(start, end)
            for i in range(3):
                s[L.RATE + i] = end[i] - s[BG + i]
            set_acceleration(s, end)
        measure(s, e, c, out)
    s[L.PENDING_COUNT] = 0.0
    step(s, c, start, imu, t - s[L.T], s[L.NOISE_GYRO], s[L.NOISE_ACCEL], out)
    s[L.T] = t


@kernel
def coast_or_start(s, c, t, out):
    """Bring the state to time t without an IMU; the first event of a session starts its clock."""
    if math.isfinite(s[L.T]):
        coast(s, c, t, out)
    else:
        s[L.T] = t


@kernel
def fuse_waiting(s, c, out, by_model):
    """Fuse the measurements that wait, each at its time: by the telemetry model, or without the IMU's help."""
    n = int(s[L.PENDING_COUNT])
    for k in range(n):
        e = vector(L.EVENT_WIDTH)
        copy(e, s[L.PENDING + k * L.EVENT_WIDTH : L.PENDING + (k + 1) * L.EVENT_WIDTH])
        if by_model:
            advance(s, c, e[TIME], out)
        else:
            coast_or_start(s, c, e[TIME], out)
        measure(s, e, c, out)
    s[L.PENDING_COUNT] = 0.0


@kernel
def fold(s, e, c, out):
    """Take one event (EVENT_WIDTH,) into the state (STATE_SIZE,), in place: into both of its halves where two models are run.

    Arguments as of `fold_one`.
    """
    fold_one(s[: L.HALF], e, c, out)
    if s[L.SECOND] != 0.0:
        out[2][2] = 1  # what the second finds is not told
        fold_one(s[L.HALF :], e, c, out)
        out[2][2] = 0
    if int(e[KIND]) == IMU_KIND and e[SOURCE] == s[L.IMU_SOURCE]:
        weigh_models(s, e, c, out)


@compiled_apart(NOTHING, VECTOR, VECTOR, VECTOR, OUT)
def fold_one(s, e, c, out):
    """Take one event (EVENT_WIDTH,) into one half of the state (HALF,), in place.

    c: parameters; out: innovation rows, note rows, their two counts and whether to keep
    silent (int64), the times of the last notes, the events on record.
    Events must come in the order of `timeline.precedes`. Nothing is raised: what cannot be used is refused and recorded.
    """
    kind = int(e[KIND])
    if not plausible(e):
        s[L.IMPLAUSIBLE] += 1.0
    elif kind == IMU_KIND:
        if imu_in_use(s, e, c, out):
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
    elif (kind == MAGNETOMETER_KIND and not in_use(s, e, L.FIELD_SOURCE, L.FIELD_LAST, L.FIELD_STANDBY)) or (
        kind == BAROMETER_KIND and not in_use(s, e, L.PRESSURE_SOURCE, L.PRESSURE_LAST, L.PRESSURE_STANDBY)
    ):
        return
    else:
        flowing = math.isfinite(s[L.T_IMU]) and e[TIME] - s[L.T_IMU] <= max(c[Parameter.GAP], 3.0 * s[L.PERIOD])
        if flowing and kind == MAGNETOMETER_KIND and s[L.ALIGNED] != 0.0 and is_passed_over(s, e):
            return
        if flowing and int(s[L.PENDING_COUNT]) < L.PENDING_CAPACITY:
            k = L.PENDING + int(s[L.PENDING_COUNT]) * L.EVENT_WIDTH
            for i in range(L.EVENT_WIDTH):
                s[k + i] = e[i]
            s[L.PENDING_COUNT] += 1.0
            return
        fuse_waiting(s, c, out, False)
        coast_or_start(s, c, e[TIME], out)
        measure(s, e, c, out)
        watch_position(s, out)
