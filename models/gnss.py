"""What a GNSS receiver shows: position and velocity of a little while ago, and a position error that lingers.

    position: p - v delta + a delta^2 / 2 + e        velocity: v - a delta

delta is what the delay is beyond the nominal one, a the acceleration at the nominal time of measurement, e the coloured error: a
Gauss-Markov process (Brown and Hwang, "Introduction to Random Signals and Applied Kalman Filtering", section 5.3). The delay is seen
through the velocity while the vehicle accelerates; the position alone cannot tell it from e.
"""

from mavkf.compiled import compiled
from mavkf.models import telemetry
from mavkf.models.strapdown import DDELAY, DELAY, DGNSS, GNSS, POS, VEL, V

# Behind the states of the kinematic models: where the antenna is from the IMU, in b, m
ANTENNA, DANTENNA = telemetry.X_SIZE, telemetry.N
X_SIZE, STATES_MOST = telemetry.X_SIZE + 3, telemetry.N + 3


@compiled
def predict_position(x, a, z_hat):
    """Metres (3,) north, east, down of the fix from the state's position. x: nominal state, a: (3,) acceleration in n, m/s^2."""
    delta = x[DELAY]
    for i in range(3):
        z_hat[i] = -x[V + i] * delta + 0.5 * a[i] * delta * delta + x[GNSS + i]


@compiled
def position_jacobian(x, a, H):
    """H (3, n) of `predict_position` with the position itself."""
    delta = x[DELAY]
    for i in range(3):
        for j in range(H.shape[1]):
            H[i, j] = 0.0
        H[i, POS + i] = 1.0
        H[i, VEL + i] = -delta
        H[i, DGNSS + i] = 1.0
        H[i, DDELAY] = -x[V + i] + a[i] * delta


@compiled
def predict_velocity(x, a, z_hat):
    """Velocity (3,) in n, m/s, that the receiver shows; arguments as of `predict_position`."""
    for i in range(3):
        z_hat[i] = x[V + i] - a[i] * x[DELAY]


@compiled
def velocity_jacobian(x, a, H):
    """H (3, n) of `predict_velocity`."""
    for i in range(3):
        for j in range(H.shape[1]):
            H[i, j] = 0.0
        H[i, VEL + i] = 1.0
        H[i, DDELAY] = -a[i]
