"""Telemetry: body rate and specific force are states that the IMU measures, for samples too slow or irregular to be integrated.

Beside the nominal state of `strapdown`: body rate omega_b (3, rad/s) and specific force f_b (3, m/s^2); beside its error state their
differences, in the same order. The acceleration is carried as the specific force of the body because that is what lasts while the body
turns: the thrust of a rotor turns with it.

    dq/dt = q omega / 2,   dv/dt = C f + g,   dp/dt = v,   d omega/dt = -omega / tau + w,   df/dt = -(f + C' g) / tau + w

A vehicle that nobody looks at stops turning and accelerating in the mean. Rate and force are Gauss-Markov processes about that (Singer,
"Estimating optimal tracking filter performance for manned maneuvering targets", IEEE Transactions on Aerospace and Electronic Systems
6(4), 1970). Mean and covariance follow their differential equations (Jazwinski, "Stochastic Processes and Filtering Theory", section
6.2) by the Runge-Kutta method of fourth order:

    dPhi/dt = F Phi,   dQd/dt = F Qd + Qd F' + Qc,   P(t) = Phi P Phi' + Qd
"""

import math

from mavkf.compiled import kernel
from mavkf.models.earth import SEMI_MAJOR_AXIS
from mavkf.models.order import DMOTION, MOTION
from mavkf.models.rotation import rotation_matrix
from mavkf.models.strapdown import BG, DBG, LATITUDE, Q, V, move, rates_of_frame
from mavkf.stack import copy, matrix, vector, zero_matrix, zero_vector

OMEGA, FORCE = MOTION, MOTION + 3
DOMEGA, DFORCE = DMOTION, DMOTION + 3
# The states that move, in their own order: theta, v, p, omega, f
M, M_OMEGA, M_FORCE = 15, 9, 12
STEP = 0.05  # s: longest step of the integration
# The mean as it is integrated: q (4), v (3), metres moved (3), omega (3), f (3)
Y, Y_V, Y_P, Y_OMEGA, Y_FORCE = 16, 4, 7, 10, 13


@kernel
def place(m):
    """Index in the error state of the m-th state that moves."""
    return m if m < 9 else m - 9 + DOMEGA


@kernel
def derivative(y, frame, g, tau, dy):
    """Fill dy (Y,) of the mean. frame: (6,) as of `strapdown.rates_of_frame`; g: m/s^2; tau: (2,) s, of rate and force."""
    C = matrix(3, 3)
    rotation_matrix(y[0:4], C)
    # omega of b against n, in b
    w = vector(3)
    for i in range(3):
        w[i] = y[Y_OMEGA + i]
        for j in range(3):
            w[i] -= C[j, i] * frame[j]
    q0, q1, q2, q3 = y[0], y[1], y[2], y[3]
    dy[0] = 0.5 * (-q1 * w[0] - q2 * w[1] - q3 * w[2])
    dy[1] = 0.5 * (q0 * w[0] + q2 * w[2] - q3 * w[1])
    dy[2] = 0.5 * (q0 * w[1] - q1 * w[2] + q3 * w[0])
    dy[3] = 0.5 * (q0 * w[2] + q1 * w[1] - q2 * w[0])
    rx, ry, rz = frame[0] + frame[3], frame[1] + frame[4], frame[2] + frame[5]
    v0, v1, v2 = y[Y_V], y[Y_V + 1], y[Y_V + 2]
    for i in range(3):
        dy[Y_V + i] = C[i, 0] * y[Y_FORCE] + C[i, 1] * y[Y_FORCE + 1] + C[i, 2] * y[Y_FORCE + 2]
        dy[Y_P + i] = y[Y_V + i]
        dy[Y_OMEGA + i] = -y[Y_OMEGA + i] / tau[0]
        dy[Y_FORCE + i] = -(y[Y_FORCE + i] + C[2, i] * g) / tau[1]
    dy[Y_V] -= ry * v2 - rz * v1
    dy[Y_V + 1] -= rz * v0 - rx * v2
    dy[Y_V + 2] += g - (rx * v1 - ry * v0)


@kernel
def dynamics(y, frame, g, tau, place_of, F):
    """Fill F (M, M) of the error state at the mean y. place_of: latitude (rad), and the radii plus height (2, m)."""
    C = matrix(3, 3)
    rotation_matrix(y[0:4], C)
    F[:, :] = 0.0
    f = vector(3)
    for i in range(3):
        f[i] = C[i, 0] * y[Y_FORCE] + C[i, 1] * y[Y_FORCE + 1] + C[i, 2] * y[Y_FORCE + 2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        F[i, j] = frame[k]
        F[i, k] = -frame[j]
        F[3 + i, 3 + j] = frame[k] + frame[3 + k]
        F[3 + i, 3 + k] = -frame[j] - frame[3 + j]
        F[3 + i, j] = f[k]
        F[3 + i, k] = -f[j]
        F[6 + i, 3 + i] = 1.0
        F[M_OMEGA + i, M_OMEGA + i] = -1.0 / tau[0]
        F[M_FORCE + i, M_FORCE + i] = -1.0 / tau[1]
        for m in range(3):
            F[i, M_OMEGA + m] = C[i, m]
            F[3 + i, M_FORCE + m] = C[i, m]
        # -C' [g x] / tau with g down: [g x] has -g at (0, 1) and g at (1, 0)
        F[M_FORCE + i, 1] = C[0, i] * g / tau[1]
        F[M_FORCE + i, 0] = -C[1, i] * g / tau[1]
    F[0, 4] = -1.0 / place_of[2]
    F[1, 3] = 1.0 / place_of[1]
    F[2, 4] = math.tan(place_of[0]) / place_of[2]
    F[5, 8] = 2.0 * g / SEMI_MAJOR_AXIS


@kernel
def moment_rates(F, Phi, Qd, Qc, dPhi, dQd):
    """Fill dPhi = F Phi and dQd = F Qd + Qd F' + Qc; Qc: (M,), the diagonal."""
    for i in range(M):
        for j in range(M):
            dPhi[i, j] = 0.0
            dQd[i, j] = 0.0
    for i in range(M):
        for k in range(M):
            f = F[i, k]
            if f != 0.0:
                for j in range(M):
                    dPhi[i, j] += f * Phi[k, j]
                    dQd[i, j] += f * Qd[k, j]
    for i in range(M):
        for j in range(i + 1):
            both = dQd[i, j] + dQd[j, i]
            dQd[i, j] = both
            dQd[j, i] = both
        dQd[i, i] += Qc[i]


@kernel
def propagate(x, dt, tau, Qc, Phi, Qd):
    """Advance the nominal state (X_SIZE of `order`,) by dt (s), in place, and fill Phi and Qd (M, M) of the states that move.

    tau: (2,) time constants of rate and force, s; Qc: (M,) spectral densities of white noise on each state's rate.
    """
    frame = vector(9)
    g = rates_of_frame(x, frame)
    place_of = vector(3)
    place_of[0], place_of[1], place_of[2] = x[LATITUDE], frame[7], frame[8]
    y = zero_vector(Y)
    for i in range(4):
        y[i] = x[Q + i]
    for i in range(3):
        y[Y_V + i] = x[V + i]
    for i in range(6):
        y[Y_OMEGA + i] = x[OMEGA + i]
    for i in range(M):
        for j in range(M):
            Phi[i, j] = 1.0 if i == j else 0.0
            Qd[i, j] = 0.0
    steps = math.ceil(dt / STEP)
    h = dt / steps
    F = matrix(M, M)
    dy, total_y, point_y = vector(Y), vector(Y), vector(Y)
    dPhi, total_Phi, point_Phi = matrix(M, M), matrix(M, M), matrix(M, M)
    dQd, total_Qd, point_Qd = matrix(M, M), matrix(M, M), matrix(M, M)
    for _ in range(steps):
        copy(point_y, y)
        copy(point_Phi, Phi)
        copy(point_Qd, Qd)
        for stage in range(4):
            derivative(point_y, frame, g, tau, dy)
            dynamics(point_y, frame, g, tau, place_of, F)
            moment_rates(F, point_Phi, point_Qd, Qc, dPhi, dQd)
            weight = h / 6.0 if stage % 3 == 0 else h / 3.0
            ahead = h if stage == 2 else 0.5 * h
            for i in range(Y):
                total_y[i] = (y[i] if stage == 0 else total_y[i]) + weight * dy[i]
                point_y[i] = y[i] + ahead * dy[i]
            for i in range(M):
                for j in range(M):
                    total_Phi[i, j] = (Phi[i, j] if stage == 0 else total_Phi[i, j]) + weight * dPhi[i, j]
                    point_Phi[i, j] = Phi[i, j] + ahead * dPhi[i, j]
                    total_Qd[i, j] = (Qd[i, j] if stage == 0 else total_Qd[i, j]) + weight * dQd[i, j]
                    point_Qd[i, j] = Qd[i, j] + ahead * dQd[i, j]
        copy(y, total_y)
        copy(Phi, total_Phi)
        copy(Qd, total_Qd)
    size = math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2] + y[3] * y[3])
    for i in range(4):
        x[Q + i] = y[i] / size
    for i in range(3):
        x[V + i] = y[Y_V + i]
    for i in range(6):
        x[OMEGA + i] = y[Y_OMEGA + i]
    move(x, y[Y_P], y[Y_P + 1], y[Y_P + 2])


@kernel
def propagate_covariance(P, Phi, Qd):
    """P <- Phi P Phi' + Qd (n, n), where Phi and Qd (M, M) are of the states that move and all else stays."""
    n = P.shape[0]
    A = zero_matrix(M, n)
    for a in range(M):
        for b in range(M):
            p = Phi[a, b]
            if p != 0.0:
                k = place(b)
                for j in range(n):
                    A[a, j] += p * P[k, j]
    for a in range(M):
        i = place(a)
        for j in range(n):
            P[i, j] = A[a, j]
            P[j, i] = A[a, j]
    for a in range(M):
        for b in range(a, M):
            total = Qd[a, b]
            for k in range(M):
                total += A[a, place(k)] * Phi[b, k]
            P[place(a), place(b)] = total
            P[place(b), place(a)] = total


@kernel
def predict_sample(x, k, z_hat):
    """What the IMU shows (3,): k = 0 the gyro, rad/s, k = 1 the accelerometer, m/s^2."""
    for i in range(3):
        z_hat[i] = x[OMEGA + 3 * k + i] + x[BG + 3 * k + i]


@kernel
def sample_jacobian(k, H):
    """H (3, n) of `predict_sample`."""
    for i in range(3):
        for j in range(H.shape[1]):
            H[i, j] = 0.0
        H[i, DOMEGA + 3 * k + i] = 1.0
        H[i, DBG + 3 * k + i] = 1.0
