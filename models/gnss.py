"""What a GNSS receiver shows: position and velocity of its antenna a little while ago, and a position error that lingers.

    position: p + l - (v + u) delta + a delta^2 / 2 + e        velocity: v + u - a delta
    l = C_nb l_b        u = C_nb (omega_b x l_b)

delta is what the delay is beyond the nominal one, a the acceleration at the nominal time of measurement, l_b the antenna's place from
the IMU (the lever arm: Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems", 2nd ed., section 14.3.1),
e the coloured error: a Gauss-Markov process (Brown and Hwang, "Introduction to Random Signals and Applied Kalman Filtering", section
5.3). The delay is seen through the velocity while the vehicle accelerates; the position alone cannot tell it from e. The lever arm is
seen while the vehicle turns.

With the attitude error on the left, C_true l_b = l - [l x] dtheta. The body rate is taken as it is: a gyro bias of 2 mrad/s at 0.3 m
makes 0.6 mm/s.
"""

import math

from mavkf.compiled import kernel
from mavkf.models.order import ANTENNA, DANTENNA
from mavkf.models.strapdown import DDELAY, DELAY, DGNSS, GNSS, POS, THETA, VEL, V


@kernel
def lever(x, C, w, i):
    """Component i in n of the lever arm l (m) and of its velocity u (m/s).

    x: nominal state; C: C_nb (3, 3), zeros where the heading is not known: the antenna is then taken to be where the IMU is; w: (3,)
    omega_b, rad/s.
    """
    b0, b1, b2 = x[ANTENNA], x[ANTENNA + 1], x[ANTENNA + 2]
    place = C[i, 0] * b0 + C[i, 1] * b1 + C[i, 2] * b2
    velocity = C[i, 0] * (w[1] * b2 - w[2] * b1) + C[i, 1] * (w[2] * b0 - w[0] * b2) + C[i, 2] * (w[0] * b1 - w[1] * b0)
    return place, velocity


@kernel
def predict_position(x, a, C, w, z_hat):
    """Metres (3,) north, east, down of the fix from the state's position. a: (3,) acceleration in n, m/s^2; x, C, w: as of `lever`."""
    delta = x[DELAY]
    for i in range(3):
        place, velocity = lever(x, C, w, i)
        z_hat[i] = place - (x[V + i] + velocity) * delta + 0.5 * a[i] * delta * delta + x[GNSS + i]


@kernel
def position_jacobian(x, a, C, w, H):
    """H (3, n) of `predict_position` with the position itself."""
    delta = x[DELAY]
    lever_jacobian(x, C, w, 1.0, -delta, H)
    for i in range(3):
        _, velocity = lever(x, C, w, i)
        H[i, POS + i] = 1.0
        H[i, VEL + i] = -delta
        H[i, DGNSS + i] = 1.0
        H[i, DDELAY] = -x[V + i] - velocity + a[i] * delta


@kernel
def predict_velocity(x, a, C, w, z_hat):
    """Velocity (3,) in n, m/s, that the receiver shows; arguments as of `predict_position`."""
    for i in range(3):
        _, velocity = lever(x, C, w, i)
        z_hat[i] = x[V + i] + velocity - a[i] * x[DELAY]


@kernel
def velocity_jacobian(x, a, C, w, H):
    """H (3, n) of `predict_velocity`."""
    lever_jacobian(x, C, w, 0.0, 1.0, H)
    for i in range(3):
        H[i, VEL + i] = 1.0
        H[i, DDELAY] = -a[i]


@kernel
def lever_jacobian(x, C, w, of_place, of_velocity, H):
    """Fill H (3, n) with the Jacobian of of_place * l + of_velocity * u alone, zeros elsewhere."""
    for i in range(3):
        for j in range(H.shape[1]):
            H[i, j] = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        place, velocity = lever(x, C, w, i)
        size = of_place * place + of_velocity * velocity
        # -[m x]: entry (j, k) is +m_i, entry (k, j) is -m_i
        H[j, THETA + k] += size
        H[k, THETA + j] -= size
        if H.shape[1] >= DANTENNA + 3:
            # C + C [w x]: column i of [w x] has w_k at j and -w_j at k
            for m in range(3):
                H[m, DANTENNA + i] = of_place * C[m, i] + of_velocity * (C[m, j] * w[k] - C[m, k] * w[j])


@kernel
def predict_yaw(C):
    """Heading (rad from north) of the body's forward axis, as a receiver with two antennas shows it. C: C_nb (3, 3)."""
    return math.atan2(C[1, 0], C[0, 0])


@kernel
def yaw_jacobian(C, H):
    """H (1, n) of `predict_yaw`, which grows without bound near a pitch of 90 deg.

    With dC = [dtheta x] C, d(yaw) = (C_00 dC_10 - C_10 dC_00) / (C_00^2 + C_10^2).
    """
    for j in range(H.shape[1]):
        H[0, j] = 0.0
    share = -C[2, 0] / (C[0, 0] * C[0, 0] + C[1, 0] * C[1, 0])
    H[0, THETA] = share * C[0, 0]
    H[0, THETA + 1] = share * C[1, 0]
    H[0, THETA + 2] = 1.0
