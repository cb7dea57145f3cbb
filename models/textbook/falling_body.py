"""A body falling through the atmosphere with unknown drag, followed by a radar that measures its range: the classical hard problem.

Athans, Wishner and Bertolini, "Suboptimal State Estimation for Continuous-Time Nonlinear Systems from Discrete Noisy Measurements",
IEEE Trans. Automatic Control AC-13 (1968), with the parameters as Julier, Uhlmann and Durrant-Whyte repeat them, "A New Method for the
Nonlinear Transformation of Means and Covariances in Filters and Estimators", IEEE Trans. Automatic Control 45 (2000); they give feet,
here are metres.

State: altitude (m), velocity (m/s, down) and ballistic parameter (1/m), constant. There is no process noise: what is hard is that drag sets
in suddenly, and enters with the square of the velocity.
"""

import numpy as np

FOOT = 0.3048  # m
GAMMA = 5e-5 / FOOT  # 1/m, density falls as exp(-GAMMA altitude)
DISTANCE = 100_000.0 * FOOT  # m, of the radar from the line of fall
ALTITUDE = 100_000.0 * FOOT  # m, of the radar
R = np.array([[1e4 * FOOT**2]])  # m^2
TRUTH = np.array([300_000.0 * FOOT, 20_000.0 * FOOT, 1e-3 / FOOT])
X0 = np.array([300_000.0 * FOOT, 20_000.0 * FOOT, 3e-5 / FOOT])
P0 = np.diag([1e6 * FOOT**2, 4e6 * FOOT**2, 1e-4 / FOOT**2])


def f(x, u):
    """dx/dt; no input."""
    return np.array([-x[1], -np.exp(-GAMMA * x[0]) * x[1] ** 2 * x[2], 0.0])


def F(x, u):
    """df/dx (3, 3)."""
    density = np.exp(-GAMMA * x[0])
    return np.array(
        [
            [0.0, -1.0, 0.0],
            [GAMMA * density * x[1] ** 2 * x[2], -2.0 * density * x[1] * x[2], -density * x[1] ** 2],
            [0.0, 0.0, 0.0],
        ]
    )


def F_xx(x, u):
    """Hessians (3, 3, 3) of the components of f."""
    density = np.exp(-GAMMA * x[0])
    v, beta = x[1], x[2]
    hessians = np.zeros((3, 3, 3))
    hessians[1] = density * np.array(
        [
            [-(GAMMA**2) * v * v * beta, 2.0 * GAMMA * v * beta, GAMMA * v * v],
            [2.0 * GAMMA * v * beta, -2.0 * beta, -2.0 * v],
            [GAMMA * v * v, -2.0 * v, 0.0],
        ]
    )
    return hessians


def Qc(x):
    """Spectral density: none."""
    return np.zeros((3, 3))


def h(x):
    """The range (1,)."""
    return np.array([np.hypot(DISTANCE, x[0] - ALTITUDE)])


def H(x):
    """dh/dx (1, 3)."""
    return np.array([[(x[0] - ALTITUDE) / h(x)[0], 0.0, 0.0]])


def H_xx(x):
    """Hessian (1, 3, 3) of the range."""
    hessians = np.zeros((1, 3, 3))
    hessians[0, 0, 0] = DISTANCE**2 / h(x)[0] ** 3
    return hessians
