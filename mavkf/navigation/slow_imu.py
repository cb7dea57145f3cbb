"""The telemetry model in the fold: rate and force as states, hand-over from and to the model that integrates the IMU."""

from mavkf.compiled import FLOAT, NOTHING, VECTOR, compiled_apart, kernel
from mavkf.models import telemetry
from mavkf.models.order import STATES_MOST
from mavkf.models.strapdown import BA, BG, DBG
from mavkf.models.telemetry import DOMEGA, FORCE, OMEGA
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Reason, Sensor
from mavkf.navigation.covariance import add_noise, bring_up, colour_decay, decay_colour, decay_estimate, record_added
from mavkf.navigation.fusing import forget, fuse, widen
from mavkf.navigation.layout import OUT
from mavkf.navigation.learning import learn
from mavkf.navigation.monitors import stop_monitors
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.propagation import set_acceleration
from mavkf.navigation.tape import attend, is_detailed, is_recording, record_link, record_noise, record_transition
from mavkf.samples import GYRO_RESOLUTION
from mavkf.stack import copy, flat, matrix, vector, zero_matrix, zero_vector

RATE_TIME, FORCE_TIME = 10.0, 10.0  # s: how long a rate and an acceleration last of themselves
BANDWIDTH = 40.0  # Hz: twice the low-pass of an autopilot's IMU, by which a noise density becomes a sample's variance
LEAST_DRIVE = 0.05  # of the learnt density that drives rate and force, against what the samples show


@kernel
def white_part(square, product):
    """Variance of the white part of a sampled signal: minus the mean product of successive differences, at most half their square."""
    return min(max(-product, 0.0), 0.5 * square)


@kernel
def sample_variance(s, e, c, k):
    """Variance of an axis of a sample, as a measurement of what lasts: white part, density, counts; k: 0 gyro, 1 accelerometer."""
    resolution = e[GYRO_RESOLUTION + k]
    white = white_part(s[L.DIFFERENCE_GYRO + k], s[L.TURN_GYRO + k])
    return white + c[Parameter.GYRO + k] ** 2 * BANDWIDTH + resolution * resolution / 12.0


@kernel
def enter(s, e, c):
    """Begin rate and force from the last sample: omega = z - bg, so that its error is minus the bias's and the sample's noise."""
    stop_monitors(s)  # the effects of faults on the states that come are not known
    if s[L.STATES] < STATES_MOST:
        widen(s, STATES_MOST)
    P = L.covariance(s)
    n = P.shape[0]
    for k in range(2):
        state, error = OMEGA + 3 * k, DOMEGA + 3 * k
        bias, bias_error = BG + 3 * k, DBG + 3 * k
        forget(s, error, 3, 0.0)
        for i in range(3):
            s[state + i] = s[L.IMU + 3 * k + i] - s[bias + i]
            for j in range(n):
                P[error + i, j] = -P[bias_error + i, j]
        for i in range(3):
            for j in range(n):
                P[j, error + i] = P[error + i, j]
        for i in range(3):
            for j in range(3):
                P[error + i, error + j] = P[bias_error + i, bias_error + j]
            P[error + i, error + i] += sample_variance(s, e, c, k)


@kernel
def begin_telemetry(s, e, c, out):
    """Enter in the half that is recorded."""
    bring_up(s, c, out)
    if is_recording(out):
        attend(s, out)
    enter(s, e, c)
    if is_recording(out):
        for i in range(6):
            record_link(s, out, DOMEGA + i, DBG + i, -1.0)


@kernel
def leave(s):
    """Let rate and force go: what is left is the marginal of the others."""
    n, left = int(s[L.STATES]), int(s[L.LASTING_STATES])
    old = matrix(n, n)
    copy(old, L.covariance(s))
    s[L.STATES] = left
    P = L.covariance(s)
    for i in range(left):
        for j in range(left):
            P[i, j] = old[i, j]


@compiled_apart(NOTHING, VECTOR, VECTOR, FLOAT, OUT)
def advance(s, c, t, out):
    """Bring the state to time t by the telemetry model."""
    dt = t - s[L.T]
    if not dt > 0.0:
        return
    recording = is_recording(out)
    if recording:
        attend(s, out)
    x = s[L.X : L.P]
    P = L.covariance(s)
    tau = vector(2)
    tau[0], tau[1] = RATE_TIME, FORCE_TIME
    Qc = zero_vector(telemetry.M)
    Phi = matrix(telemetry.M, telemetry.M)
    Qd = matrix(telemetry.M, telemetry.M)
    period = max(s[L.PERIOD], 1e-3)
    for k in range(2):
        square = max(s[L.DIFFERENCE_GYRO + k], s[L.SQUARE_GYRO + k])
        white = white_part(s[L.DIFFERENCE_GYRO + k], s[L.TURN_GYRO + k])
        # differences that look white may be a vibration or motion that is over between samples: half of it is believed to be motion
        unseen = c[Parameter.GYRO + k] ** 2 + s[L.SCALE_IMU] * 0.5 * white * period
        drive = s[L.SCALE_DRIVE + k] * max(square - 2.0 * white, 1e-2 * square + 1e-9) / period
        for i in range(3):
            Qc[3 * k + i] = unseen
            Qc[telemetry.M_OMEGA + 3 * k + i] = drive
    telemetry.propagate(x, dt, tau, Qc, Phi, Qd)
    telemetry.propagate_covariance(P, Phi, Qd)
    add_noise(s, c, 0.0, 0.0, dt, P)
    phi = vector(2)
    colour_decay(s, dt, phi)
    decay_estimate(s, phi)
    decay_colour(s, phi, P)
    s[L.T] = t
    if recording:
        record_transition(s, out, Phi, phi)
        if is_detailed(out):
            record_noise(out, int(s[L.STATES]), flat(Qd))
            record_added(s, c, 0.0, 0.0, dt, dt, out)
    imu = vector(6)
    for i in range(3):
        s[L.RATE + i] = s[OMEGA + i]
        imu[i] = s[OMEGA + i] + s[BG + i]
        imu[3 + i] = s[FORCE + i] + s[BA + i]
    set_acceleration(s, imu)


@kernel
def use_sample(s, e, c, out):
    """Fuse the IMU sample at the state's time as two vectors; one that surprises is believed less, not refused."""
    n = int(s[L.STATES])
    P = L.covariance(s)
    z_hat = vector(3)
    r = vector(3)
    H = matrix(3, n)
    R = zero_matrix(3, 3)
    for k in range(2):
        error, bias = DOMEGA + 3 * k, DBG + 3 * k
        telemetry.predict_sample(s[L.X : L.P], k, z_hat)
        telemetry.sample_jacobian(k, H)
        variance = sample_variance(s, e, c, k)
        share = 0.0
        nis = 0.0
        for i in range(3):
            r[i] = s[L.IMU + 3 * k + i] - z_hat[i]
            S = P[error + i, error + i] + 2.0 * P[error + i, bias + i] + P[bias + i, bias + i] + variance
            nis += r[i] * r[i] / S
            share += P[error + i, error + i] / S / 3.0
        limit = c[Parameter.LIMIT_3]
        for i in range(3):
            R[i, i] = variance
        if nis > limit:
            # a motion that begins: the state gives way to it, not the sample
            for i in range(3):
                P[error + i, error + i] += r[i] * r[i]
        fuse(s, e, c, out, Sensor.GYRO if k == 0 else Sensor.ACCELEROMETER, r, H, R, Reason.FUSED)
        s[L.SCALE_DRIVE + k] = learn(s[L.SCALE_DRIVE + k], nis, 3, share, LEAST_DRIVE)
    for i in range(3):
        s[L.RATE + i] = s[OMEGA + i]
