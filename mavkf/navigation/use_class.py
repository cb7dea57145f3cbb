"""What is known of the vehicle's class in the fold: wheels do not slip, rotors drag, wings fly nose first.

The error of such knowledge lasts: a car that slips does so for a bend, a gust for seconds. It is judged by its variance and fused with
what such errors tell together (`receivers.lasting`).
"""

import math

import numpy as np

from mavkf.compiled import NOTHING, VECTOR, compiled_apart, kernel
from mavkf.filters.joseph import row_variance
from mavkf.models import vehicle_class as model
from mavkf.models.earth import STANDARD_GRAVITY
from mavkf.models.order import DCLASS
from mavkf.models.rotation import rotation_matrix
from mavkf.models.strapdown import HEIGHT, Q, V
from mavkf.models.vehicle_class import CURVE, DCURVE, DSLIP, DWIND, FACTOR, SLIP, WIND
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.navigation.covariance import bring_up, prepare
from mavkf.navigation.fusing import fuse_lasting, widen
from mavkf.navigation.layout import OUT
from mavkf.navigation.learning import learn
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.receivers import lasting
from mavkf.navigation.tape import attend, is_recording, record_link
from mavkf.samples import DIFFERENTIAL_PRESSURE, PRESSURE
from mavkf.stack import matrix, vector, zero_matrix

ROVER_PERIOD, AIR_PERIOD = 0.5, 1.0  # s between updates
# Rover. How the wheels stand in b (a level mounting by eye), and where the axle is that does not steer.
FORWARD_SIGMA, AXLE_SIGMA = 0.05, 1.0  # rad, m
ROUGH, ROUGH_VERTICAL = 0.05, 0.1  # m/s: ground and suspension
FLEX = 3e-3  # rad: of mounting and body, times the speed
TYRE = 0.07  # rad of slip, or of the body's roll and pitch on its springs, for each g
BEND = 1.0  # s: how long a bend or braking lasts
ROLLING = 1.0  # m/s: one that stands says nothing of how its wheels hold
# Air. A wind of a usual day, and how fast its mean changes for what moves through it: 1 m/s in 45 s.
WIND_SIGMA, WIND_WALK = 5.0, 0.15  # m/s, m/s/sqrt(s)
WIND_KNOWN = 2.0  # m/s: one sigma of an axis, by which the air has become a sensor
DRAG, DRAG_SIGMA = 0.25, 0.7  # 1/s, and one sigma of its logarithm
BODY_DRAG, BODY_DRAG_SIGMA = 0.02, 0.02  # 1/m: half of air density, drag coefficient and area by the mass
PITOT_SIGMA = 0.1  # of the logarithm of a pitot tube's factor, air density included
GUST, GUST_ALONG = 0.3, 0.7  # m/s: across, or as rotors feel it; along, as a pitot tube shows it
MISFIT, MISFIT_TIME = 0.05, 10.0  # share of the airspeed that the drag law is off, for as long as a leg lasts, s
SLIP_SIGMA, SLIP_TIME = 0.05, 20.0  # rad, s: sideslip of a wing that lasts as long as a turn does
SMOOTH = 0.1  # s: time constant of the mean of the force
LEAST_AIRSPEED = 6.0  # m/s: a pitot tube shows nothing useful below
ABOVE_GROUND, MOVING = 3.0, 3.0  # m, m/s
LEAST_ROVER_SCALE, LEAST_AIR_SCALE = 0.3, 0.2  # what lingers is not seen in the innovations
LASTING_LEARNING, LEAST_WIND, MOST_LASTING = (
    0.1,
    0.25,
    25.0,
)  # of the variance of the wind's walk against what is assumed, or of slip
UNCORRELATED = 0.05  # correlation that a white noise assumed too large makes by itself
ROVER, WING, ROTORS = 1.0, 2.0, 3.0  # values of Parameter.CLASS


@kernel
def begin_class(s, c):
    """Give the states of the class their place and prior; none where nothing is known of it."""
    if c[Parameter.CLASS] == 0.0:
        return
    widen(s, max(int(s[L.STATES]), DCLASS + (3 if c[Parameter.CLASS] == ROVER else 4)))
    P = L.covariance(s)
    s[L.T_CLASS] = np.nan
    s[L.SCALE_LASTING] = 1.0
    s[L.T_AIRSPEED] = np.nan
    s[L.ARMED_HEIGHT] = np.nan
    for i in range(2):
        s[L.SCALE_CLASS + i] = 1.0
        P[DCLASS + i, DCLASS + i] = (FORWARD_SIGMA if c[Parameter.CLASS] == ROVER else WIND_SIGMA) ** 2
    last = AXLE_SIGMA if c[Parameter.CLASS] == ROVER else PITOT_SIGMA
    if c[Parameter.CLASS] == ROTORS:
        last = DRAG_SIGMA
        s[FACTOR] = math.log(DRAG)
        s[CURVE] = BODY_DRAG
        P[DCURVE, DCURVE] = BODY_DRAG_SIGMA**2
    P[DCLASS + 2, DCLASS + 2] = last * last
    if c[Parameter.CLASS] == WING:
        P[DSLIP, DSLIP] = SLIP_SIGMA**2


@kernel
def is_off(s, c):
    """Whether the vehicle does what its class does: armed, moving or above the ground, with attitude, heading and velocity known."""
    if s[L.ARMED] != 1.0:
        s[L.ARMED_HEIGHT] = np.nan
        s[L.AIR_KNOWN] = 0.0
        return False
    if s[L.MODEL] == L.CONSTANT_VELOCITY or s[L.RESTING] != 0.0 or s[L.RECOVERING] != 0.0:
        return False
    if not math.isfinite(s[L.ARMED_HEIGHT]):
        s[L.ARMED_HEIGHT] = s[HEIGHT]
    if c[Parameter.CLASS] == ROVER:
        return True
    speed = math.hypot(s[V], s[V + 1])
    high = abs(s[HEIGHT] - s[L.ARMED_HEIGHT]) > ABOVE_GROUND
    return high and speed > LEAST_AIRSPEED if c[Parameter.CLASS] == WING else high or speed > MOVING


@compiled_apart(NOTHING, VECTOR, VECTOR, VECTOR, OUT)
def use_class(s, e, c, out):
    """After an IMU event: fuse what the class says, when it is due."""
    if c[Parameter.CLASS] == 0.0:
        return
    share = min(1.0, s[L.PERIOD] / SMOOTH)
    for i in range(3):
        s[L.MEAN_FORCE + i] += share * (s[L.IMU + 3 + i] - s[L.MEAN_FORCE + i])
    period = ROVER_PERIOD if c[Parameter.CLASS] == ROVER else AIR_PERIOD
    if s[L.T] < s[L.T_CLASS] + period - 1e-6 or not is_off(s, c):
        return
    dt = s[L.T] - s[L.T_CLASS] if math.isfinite(s[L.T_CLASS]) else period
    s[L.T_CLASS] = s[L.T]
    bring_up(s, c, out)
    C = matrix(3, 3)
    rotation_matrix(s[Q : Q + 4], C)
    if c[Parameter.CLASS] == ROVER:
        use_wheels(s, e, c, out, C, dt)
        return
    P = L.covariance(s)
    for i in range(2):
        P[DWIND + i, DWIND + i] += WIND_WALK**2 * s[L.SCALE_LASTING] * dt
    if c[Parameter.CLASS] == ROTORS:
        use_drag(s, e, c, out, C, dt)
    else:
        use_sideslip(s, e, c, out, C, dt)


@kernel
def teach(s, k, r, H, row, variance, least):
    """Learn how much more or less than assumed the knowledge errs, from an innovation; variance: of its error as it is, not as told."""
    total = variance + row_variance(L.covariance(s), H, row)
    s[L.SCALE_CLASS + k] = learn(s[L.SCALE_CLASS + k], r * r / total, 1, variance / total, least)
    return total


@kernel
def teach_lasting(s, k, r, variance, least):
    """Let the wind change faster, or a rover's slip last longer, while successive innovations of this variance agree; else the contrary."""
    rho = min(max(r * s[L.LAST_CLASS + k] / variance, -3.0), 3.0)
    s[L.LAST_CLASS + k] = r
    scale = s[L.SCALE_LASTING] * math.exp(LASTING_LEARNING * (rho - UNCORRELATED))
    s[L.SCALE_LASTING] = min(max(scale, least), MOST_LASTING)


@kernel
def fuse_air(s, e, c, out, sensor, r, H, R, R_lasting):
    """Fuse what the air says: into wind and drag alone until the wind is known, and while GNSS and a fast IMU know the motion better.

    Else into everything. What is not corrected counts with its uncertainty, so that all stays ready for an outage.
    """
    P = L.covariance(s)
    if P[DWIND, DWIND] < WIND_KNOWN**2 and P[DWIND + 1, DWIND + 1] < WIND_KNOWN**2:
        s[L.AIR_KNOWN] = 1.0
    if s[L.OUTAGE] == 0.0 and (s[L.AIR_KNOWN] == 0.0 or s[L.PERIOD] < L.SLOW):
        s[L.CORRECT_CLASS] = 1.0
    fuse_lasting(s, e, c, out, sensor, r, H, R, R_lasting)
    s[L.CORRECT_CLASS] = 0.0


@kernel
def use_wheels(s, e, c, out, C, dt):
    """Wheels move neither sideways nor off the ground."""
    x = s[L.X : L.P]
    h = vector(2)
    H = matrix(2, int(s[L.STATES]))
    R = zero_matrix(2, 2)
    R_lasting = zero_matrix(2, 2)
    omega = s[L.RATE : L.RATE + 3]
    model.predict_slip(x, C, omega, h)
    model.slip_jacobian(x, C, omega, H)
    speed = math.sqrt(x[V] ** 2 + x[V + 1] ** 2 + x[V + 2] ** 2)
    r = vector(2)
    for i in range(2):
        r[i] = -h[i]
        # across, and along for what the springs do
        a = speed * omega[2] if i == 0 else s[L.MEAN_FORCE]
        slip = TYRE * a / STANDARD_GRAVITY * speed
        rough = ROUGH if i == 0 else ROUGH_VERTICAL
        white = rough * rough + (FLEX * speed) ** 2
        R[i, i] = s[L.SCALE_CLASS + i] * (white + slip * slip)
        told = s[L.SCALE_CLASS + i] * (white + slip * slip * lasting(dt, BEND))
        if speed > ROLLING:
            teach_lasting(s, i, r[i], teach(s, i, r[i], H, i, R[i, i], LEAST_ROVER_SCALE), 1.0)
        R_lasting[i, i] = told * s[L.SCALE_LASTING]
    fuse_lasting(s, e, c, out, Sensor.WHEELS, r, H, R, R_lasting)


@kernel
def use_drag(s, e, c, out, C, dt):
    """Across the rotors' axis there is no force but drag."""
    x = s[L.X : L.P]
    u = vector(3)
    f = vector(3)
    h = vector(2)
    H = matrix(2, int(s[L.STATES]))
    R = zero_matrix(2, 2)
    R_lasting = zero_matrix(2, 2)
    is_state = s[L.MODEL] == L.TELEMETRY
    model.body_velocity(x, C, x[WIND], x[WIND + 1], u)
    model.specific_force(x, s[L.MEAN_FORCE : L.MEAN_FORCE + 3], is_state, f)
    model.drag_jacobian(x, C, u, is_state, H)
    speed = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    lag = 0.0 if is_state else max(0.0, SMOOTH - s[L.PERIOD])
    # the mean of the force is of a while ago: du/dt = f + C' g - omega x u
    w = s[L.RATE : L.RATE + 3]
    d0 = f[0] + C[2, 0] * STANDARD_GRAVITY - (w[1] * u[2] - w[2] * u[1])
    d1 = f[1] + C[2, 1] * STANDARD_GRAVITY - (w[2] * u[0] - w[0] * u[2])
    u[0] -= lag * d0
    u[1] -= lag * d1
    model.predict_drag(x, u, f, h)
    k = math.exp(x[FACTOR]) + 2.0 * abs(x[CURVE]) * speed
    gust = s[L.SCALE_CLASS] * GUST * GUST
    misfit = s[L.SCALE_CLASS] * (MISFIT * speed) ** 2
    white = 0.0 if is_state else 0.5 * s[L.DIFFERENCE_ACCEL] * min(1.0, s[L.PERIOD] / SMOOTH)
    r = vector(2)
    for i in range(2):
        r[i] = -h[i]
        R[i, i] = k * k * (gust + misfit) + white
        R_lasting[i, i] = k * k * (gust + misfit * lasting(dt, MISFIT_TIME)) + white
    for i in range(2):
        teach_lasting(s, i, r[i], teach(s, 0, r[i], H, i, R[i, i], LEAST_AIR_SCALE), LEAST_WIND)
    fuse_air(s, e, c, out, Sensor.DRAG, r, H, R, R_lasting)


@kernel
def use_sideslip(s, e, c, out, C, dt):
    """A wing flies nose first through the air."""
    x = s[L.X : L.P]
    u = vector(3)
    r = vector(1)
    H = matrix(1, int(s[L.STATES]))
    R = matrix(1, 1)
    model.body_velocity(x, C, x[WIND], x[WIND + 1], u)
    if is_recording(out):
        attend(s, out)
    phi = math.exp(-dt / SLIP_TIME)
    x[SLIP] *= phi
    P = L.covariance(s)
    for j in range(P.shape[0]):
        P[DSLIP, j] *= phi
    for j in range(P.shape[0]):
        P[j, DSLIP] *= phi
    P[DSLIP, DSLIP] += (1.0 - phi * phi) * SLIP_SIGMA**2
    if is_recording(out):
        record_link(s, out, DSLIP, DSLIP, phi)
    model.sideslip_jacobian(x, C, u, H)
    r[0] = -model.predict_sideslip(x, u)
    gust = s[L.SCALE_CLASS] * GUST**2
    R[0, 0] = gust
    teach_lasting(s, 0, r[0], teach(s, 0, r[0], H, 0, gust, LEAST_AIR_SCALE), LEAST_WIND)
    fuse_air(s, e, c, out, Sensor.SIDESLIP, r, H, R, R)


@kernel
def use_airspeed(s, e, c, out):
    """A barometer event that carries a pitot tube's pressure: fuse the airspeed, when it is due."""
    if c[Parameter.CLASS] != WING or not e[DIFFERENTIAL_PRESSURE] > 0.0 or not e[PRESSURE] > 0.0:
        return
    if s[L.T] < s[L.T_AIRSPEED] + AIR_PERIOD - 1e-6 or not is_off(s, c):
        return
    shown = model.airspeed(e[DIFFERENTIAL_PRESSURE], e[PRESSURE])
    if not shown > LEAST_AIRSPEED:
        return
    s[L.T_AIRSPEED] = s[L.T]
    prepare(s, e, c, out)
    x = s[L.X : L.P]
    C = matrix(3, 3)
    rotation_matrix(x[Q : Q + 4], C)
    u = vector(3)
    r = vector(1)
    H = matrix(1, int(s[L.STATES]))
    R = matrix(1, 1)
    model.body_velocity(x, C, x[WIND], x[WIND + 1], u)
    if not u[0] * u[0] + u[1] * u[1] + u[2] * u[2] > 1.0:
        return
    model.airspeed_jacobian(x, C, u, H)
    r[0] = shown - model.predict_airspeed(x, u)
    gust = s[L.SCALE_CLASS + 1] * GUST_ALONG**2
    R[0, 0] = gust
    teach_lasting(s, 1, r[0], teach(s, 1, r[0], H, 0, gust, LEAST_AIR_SCALE), LEAST_WIND)
    fuse_air(s, e, c, out, Sensor.AIRSPEED, r, H, R, R)
