"""What the class of a vehicle says without a sensor: wheels roll where they point, rotors drag, wings fly nose first.

States follow those of `strapdown`. A ground rover:

    FORWARD        forward axis of the wheels in b, as turns about down and about right (2, rad): (1, a, -b)
    AXLE           distance (m) along that axis from the IMU to the point that does not slip sideways

    v_y - a v_x + omega_z l = 0        v_z + b v_x - omega_y l = 0

(non-holonomic constraints: Dissanayake, Sukkarieh, Nebot and Durrant-Whyte, "The aiding of a low-cost strapdown inertial measurement unit
using vehicle model constraints for land vehicle applications", IEEE Transactions on Robotics and Automation 17(5), 2001; v_b and omega_b
at the IMU). What flies:

    WIND           north and east (2, m/s)
    FACTOR         logarithm of the drag k of rotors (1/s), or of what a pitot tube shows against the true airspeed
    CURVE          c of rotors: drag of the airframe (1/m)
    SLIP           angle b of sideslip that lasts, of wings (rad): trim, and a wing low

    f_xy + (k + c |u|) u_xy = 0        exp(s) |u| = airspeed        u_y - b u_x = 0        with u = C_nb' (v_n - w_n)

(rotor drag is linear in the airspeed: Martin and Salaun, "The true role of accelerometer feedback in quadrotor control", ICRA 2010; that
of a body is quadratic).

With the attitude error on the left, C_true' v = C' (v + [v x] dtheta), as for the magnetic field.
"""

import math

from mavkf.compiled import kernel
from mavkf.models.order import CLASS, DCLASS
from mavkf.models.strapdown import BA, DBA, THETA, VEL, V
from mavkf.models.telemetry import DFORCE, FORCE

FORWARD, AXLE, DFORWARD, DAXLE = CLASS, CLASS + 2, DCLASS, DCLASS + 2
WIND, FACTOR, DWIND, DFACTOR = CLASS, CLASS + 2, DCLASS, DCLASS + 2
SLIP, DSLIP = CLASS + 3, DCLASS + 3
CURVE, DCURVE = CLASS + 3, DCLASS + 3

GAS_CONSTANT = 287.05287  # J/(kg K), dry air
SEA_LEVEL_TEMPERATURE, SEA_LEVEL_PRESSURE, LAPSE_EXPONENT = 288.15, 101325.0, 0.190263  # K, Pa: ISO 2533


@kernel
def body_velocity(x, C, wn, we, u):
    """Fill u (3,), m/s, with C' (v - w): velocity in b against air that moves by (wn, we, 0) in n. x: nominal state, C: C_nb (3, 3)."""
    for i in range(3):
        u[i] = C[0, i] * (x[V] - wn) + C[1, i] * (x[V + 1] - we) + C[2, i] * x[V + 2]


@kernel
def velocity_jacobian(x, C, wn, we, i, scale, H, row):
    """Add scale times the derivative of u_i of `body_velocity` by attitude and velocity to a row of H (m, n)."""
    v0, v1, v2 = x[V] - wn, x[V + 1] - we, x[V + 2]
    # C' [v x]: column j of [v x] has v_m at k and -v_k at m, for j, k, m in turn
    H[row, THETA] += scale * (C[1, i] * v2 - C[2, i] * v1)
    H[row, THETA + 1] += scale * (C[2, i] * v0 - C[0, i] * v2)
    H[row, THETA + 2] += scale * (C[0, i] * v1 - C[1, i] * v0)
    for j in range(3):
        H[row, VEL + j] += scale * C[j, i]


@kernel
def air_jacobian(x, C, i, scale, H, row):
    """The same with the wind of the state, and by it."""
    velocity_jacobian(x, C, x[WIND], x[WIND + 1], i, scale, H, row)
    for j in range(2):
        H[row, DWIND + j] -= scale * C[j, i]


@kernel
def predict_slip(x, C, omega, h):
    """Fill h (2,), m/s: sideways and vertical velocity of the wheels. omega: (3,) body rate, rad/s."""
    u0 = C[0, 0] * x[V] + C[1, 0] * x[V + 1] + C[2, 0] * x[V + 2]
    u1 = C[0, 1] * x[V] + C[1, 1] * x[V + 1] + C[2, 1] * x[V + 2]
    u2 = C[0, 2] * x[V] + C[1, 2] * x[V + 1] + C[2, 2] * x[V + 2]
    h[0] = u1 - x[FORWARD] * u0 + omega[2] * x[AXLE]
    h[1] = u2 + x[FORWARD + 1] * u0 - omega[1] * x[AXLE]


@kernel
def slip_jacobian(x, C, omega, H):
    """H (2, n) of `predict_slip`. The rate is taken as it is: a gyro bias of 2 mrad/s at 1 m makes 2 mm/s."""
    H[:, :] = 0.0
    u0 = C[0, 0] * x[V] + C[1, 0] * x[V + 1] + C[2, 0] * x[V + 2]
    velocity_jacobian(x, C, 0.0, 0.0, 1, 1.0, H, 0)
    velocity_jacobian(x, C, 0.0, 0.0, 0, -x[FORWARD], H, 0)
    velocity_jacobian(x, C, 0.0, 0.0, 2, 1.0, H, 1)
    velocity_jacobian(x, C, 0.0, 0.0, 0, x[FORWARD + 1], H, 1)
    H[0, DFORWARD] = -u0
    H[0, DAXLE] = omega[2]
    H[1, DFORWARD + 1] = u0
    H[1, DAXLE] = -omega[1]


@kernel
def predict_drag(x, u, f, h):
    """Fill h (2,), m/s^2: specific force along x and y of b that drag does not explain. u: (3,) as of `body_velocity`, f: (3,) in b."""
    size = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    k = math.exp(x[FACTOR]) + x[CURVE] * size
    h[0] = f[0] + k * u[0]
    h[1] = f[1] + k * u[1]


@kernel
def drag_jacobian(x, C, u, is_state, H):
    """H (2, n) of `predict_drag`; is_state: whether f is the telemetry model's state, else a sample less the bias."""
    H[:, :] = 0.0
    size = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    rotor = math.exp(x[FACTOR])
    for i in range(2):
        air_jacobian(x, C, i, rotor + x[CURVE] * size, H, i)
        if size > 0.0:
            for j in range(3):
                air_jacobian(x, C, j, x[CURVE] * u[i] * u[j] / size, H, i)
        H[i, DFACTOR] = rotor * u[i]
        H[i, DCURVE] = size * u[i]
        if is_state:
            H[i, DFORCE + i] = 1.0
        else:
            H[i, DBA + i] = -1.0


@kernel
def specific_force(x, sample, is_state, f):
    """Fill f (3,), m/s^2, in b: of the telemetry model's state, or of a sample (3,) less the bias."""
    for i in range(3):
        f[i] = x[FORCE + i] if is_state else sample[i] - x[BA + i]


@kernel
def predict_airspeed(x, u):
    """What a pitot tube shows, m/s. u: (3,) as of `body_velocity`."""
    return math.exp(x[FACTOR]) * math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])


@kernel
def airspeed_jacobian(x, C, u, H):
    """H (1, n) of `predict_airspeed`; u must not be zero."""
    H[:, :] = 0.0
    size = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    factor = math.exp(x[FACTOR])
    for i in range(3):
        air_jacobian(x, C, i, factor * u[i] / size, H, 0)
    H[0, DFACTOR] = factor * size


@kernel
def predict_sideslip(x, u):
    """Velocity of the air from the side that the lasting sideslip does not explain, m/s. u: (3,) as of `body_velocity`."""
    return u[1] - x[SLIP] * u[0]


@kernel
def sideslip_jacobian(x, C, u, H):
    """H (1, n) of `predict_sideslip`."""
    H[:, :] = 0.0
    air_jacobian(x, C, 1, 1.0, H, 0)
    air_jacobian(x, C, 0, -x[SLIP], H, 0)
    H[0, DSLIP] = -u[0]


@kernel
def airspeed(difference, pressure):
    """True airspeed (m/s) of a differential and a static pressure (Pa) by Bernoulli, in the air of the standard atmosphere."""
    temperature = SEA_LEVEL_TEMPERATURE * (pressure / SEA_LEVEL_PRESSURE) ** LAPSE_EXPONENT
    return math.sqrt(2.0 * difference * GAS_CONSTANT * temperature / pressure)
