"""Constant velocity: position and velocity driven by white acceleration, linear; attitude apart, by gyro and gravity.

It has the layout of `strapdown`, so that the estimator passes from one model to the other with its covariance. The specific force
does not enter: what is left of Phi is the plain Kalman filter's [[1, dt], [0, 1]] (Bar-Shalom, Li and Kirubarajan, "Estimation
with Applications to Tracking and Navigation", section 6.2.2) beside the attitude error driven by the gyro bias.
"""

from mavkf.compiled import kernel
from mavkf.models.rotation import rotation_matrix
from mavkf.models.strapdown import DBG, POS, THETA, VEL, Q, V, move, propagate_attitude, rates_of_frame
from mavkf.stack import matrix


@kernel
def propagate(x, imu0, imu1, dt, average):
    """Advance the nominal state by dt (s), in place; arguments as of `strapdown.propagate`, the specific force unused."""
    frame = average[12:21]
    rates_of_frame(x, frame)
    C0 = matrix(3, 3)
    C1 = matrix(3, 3)
    rotation_matrix(x[Q : Q + 4], C0)
    propagate_attitude(x, imu0, imu1, dt, frame)
    rotation_matrix(x[Q : Q + 4], C1)
    for i in range(3):
        average[i] = 0.0
        for j in range(3):
            average[3 + 3 * i + j] = 0.5 * (C0[i, j] + C1[i, j])
    move(x, dt * x[V], dt * x[V + 1], dt * x[V + 2])


@kernel
def transition(x, sums, dt, Phi):
    """Rows of attitude, velocity and position of the transition matrix over dt: Phi, shape (9, 15), as of `strapdown.transition`."""
    Phi[:, :] = 0.0
    frame = sums[42:51]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        Phi[THETA + i, THETA + i] = 1.0
        Phi[VEL + i, VEL + i] = 1.0
        Phi[POS + i, POS + i] = 1.0
        Phi[POS + i, VEL + i] = dt
        Phi[THETA + i, THETA + j] = frame[k] * dt
        Phi[THETA + i, THETA + k] = -frame[j] * dt
        for m in range(3):
            Phi[THETA + i, DBG + m] = -sums[6 + 3 * i + m]
