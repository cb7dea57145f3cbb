"""Constant velocity in a plane: the first Kalman filter of every course. Linear.

State: position (2, m) and velocity (2, m/s), driven by white acceleration; the position is measured. Bar-Shalom, Li and Kirubarajan,
"Estimation with Applications to Tracking and Navigation" (2001), section 6.2.2.
"""

import numpy as np

INTENSITY = 0.5  # m^2/s^3, spectral density of the acceleration
R = np.diag([4.0, 4.0])  # m^2
X0 = np.array([0.0, 0.0, 10.0, -5.0])
P0 = np.diag([100.0, 100.0, 25.0, 25.0])


def f(x, u, dt):
    """State after dt; u: acceleration (2, m/s^2) that is known, or None."""
    after = F(x, u, dt) @ x
    if u is not None:
        after = after + np.concatenate([0.5 * dt * dt * np.asarray(u), dt * np.asarray(u)])
    return after


def F(x, u, dt):
    """df/dx (4, 4)."""
    return np.kron([[1.0, dt], [0.0, 1.0]], np.eye(2))


def F_xx(x, u, dt):
    """Hessians of f: none."""
    return np.zeros((4, 4, 4))


def Q(x, dt):
    """Covariance (4, 4) of what the acceleration does over dt."""
    return INTENSITY * np.kron([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]], np.eye(2))


def h(x):
    """The position."""
    return x[:2]


def H(x):
    """dh/dx (2, 4)."""
    return np.eye(2, 4)


def H_xx(x):
    """Hessians of h: none."""
    return np.zeros((2, 4, 4))
