"""Coordinated turn in a plane with unknown turn rate, seen by a radar at the origin.

State: position (2, m), velocity (2, m/s), turn rate omega (rad/s, from the first axis to the second). Measured: range (m) and
bearing (rad, from the first axis to the second). Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and
Navigation" (2001), section 11.7: the nearly constant turn, with noise accelerations that are constant over a step.
"""

import numpy as np

SIGMA_A = 0.3  # m/s^2
SIGMA_OMEGA = 0.005  # rad/s^2
R = np.diag([25.0, 0.003**2])  # m^2, rad^2
X0 = np.array([2000.0, 1000.0, -60.0, 80.0, 0.05])
P0 = np.diag([400.0, 400.0, 25.0, 25.0, 0.02**2])
SERIES = 0.2  # rad, turn in a step below which closed forms lose digits


def integrals(omega, dt):
    """Sine and cosine integrals over dt, with first and second derivatives by omega: rows s, c; columns value, ', ''.

    s = sin(omega dt) / omega, c = (1 - cos(omega dt)) / omega.
    """
    a = omega * dt
    if abs(a) < SERIES:
        # s = dt (1 - a^2/3! + a^4/5! - ...), c = dt (a/2! - a^3/4! + ...)
        table = np.zeros((2, 3))
        factorial = 1.0
        for k in range(14):
            factorial *= k + 1
            coefficient = (1.0, 1.0, -1.0, -1.0)[k % 4] / factorial
            row = k % 2
            table[row, 0] += coefficient * a**k
            table[row, 1] += coefficient * k * a ** max(k - 1, 0)
            table[row, 2] += coefficient * k * (k - 1) * a ** max(k - 2, 0)
        return table * [dt, dt**2, dt**3]
    sin, cos = np.sin(a), np.cos(a)
    s, c = sin / omega, (1.0 - cos) / omega
    s1, c1 = (dt * cos - s) / omega, (dt * sin - c) / omega
    s2, c2 = (-dt * dt * sin - 2.0 * s1) / omega, (dt * dt * cos - 2.0 * c1) / omega
    return np.array([[s, s1, s2], [c, c1, c2]])


def f(x, u, dt):
    """State after dt; no input."""
    (s, _, _), (c, _, _) = integrals(x[4], dt)
    sin, cos = np.sin(x[4] * dt), np.cos(x[4] * dt)
    return np.array(
        [
            x[0] + s * x[2] - c * x[3],
            x[1] + c * x[2] + s * x[3],
            cos * x[2] - sin * x[3],
            sin * x[2] + cos * x[3],
            x[4],
        ]
    )


def F(x, u, dt):
    """df/dx (5, 5)."""
    (s, s1, _), (c, c1, _) = integrals(x[4], dt)
    sin, cos = np.sin(x[4] * dt), np.cos(x[4] * dt)
    v, w = x[2], x[3]
    return np.array(
        [
            [1.0, 0.0, s, -c, s1 * v - c1 * w],
            [0.0, 1.0, c, s, c1 * v + s1 * w],
            [0.0, 0.0, cos, -sin, -dt * (sin * v + cos * w)],
            [0.0, 0.0, sin, cos, dt * (cos * v - sin * w)],
            [0.0, 0.0, 0.0, 0.0, 1.0],
        ]
    )


def F_xx(x, u, dt):
    """Hessians (5, 5, 5) of the components of f."""
    (_, s1, s2), (_, c1, c2) = integrals(x[4], dt)
    sin, cos = np.sin(x[4] * dt), np.cos(x[4] * dt)
    v, w = x[2], x[3]
    hessians = np.zeros((5, 5, 5))
    for i, (by_v, by_w, twice) in enumerate(
        [
            (s1, -c1, s2 * v - c2 * w),
            (c1, s1, c2 * v + s2 * w),
            (-dt * sin, -dt * cos, -dt * dt * (cos * v - sin * w)),
            (dt * cos, -dt * sin, -dt * dt * (sin * v + cos * w)),
        ]
    ):
        hessians[i, 2, 4] = hessians[i, 4, 2] = by_v
        hessians[i, 3, 4] = hessians[i, 4, 3] = by_w
        hessians[i, 4, 4] = twice
    return hessians


def Q(x, dt):
    """Covariance (5, 5) of what the noise does over dt."""
    G = np.zeros((5, 3))
    G[0, 0] = G[1, 1] = 0.5 * dt * dt
    G[2, 0] = G[3, 1] = G[4, 2] = dt
    return G @ np.diag([SIGMA_A**2, SIGMA_A**2, SIGMA_OMEGA**2]) @ G.T


def h(x):
    """Range and bearing."""
    return np.array([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])])


def H(x):
    """dh/dx (2, 5)."""
    rho = np.hypot(x[0], x[1])
    jacobian = np.zeros((2, 5))
    jacobian[0, :2] = x[0] / rho, x[1] / rho
    jacobian[1, :2] = -x[1] / rho**2, x[0] / rho**2
    return jacobian


def H_xx(x):
    """Hessians (2, 5, 5) of range and bearing."""
    a, b = x[0], x[1]
    rho = np.hypot(a, b)
    hessians = np.zeros((2, 5, 5))
    hessians[0, :2, :2] = np.array([[b * b, -a * b], [-a * b, a * a]]) / rho**3
    hessians[1, :2, :2] = np.array([[2.0 * a * b, b * b - a * a], [b * b - a * a, -2.0 * a * b]]) / rho**4
    return hessians


def residual(z, z_hat):
    """z - z_hat, the bearing between -pi and pi."""
    r = z - z_hat
    r[1] = np.remainder(r[1] + np.pi, 2.0 * np.pi) - np.pi
    return r
