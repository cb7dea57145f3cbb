"""The Van der Pol oscillator, its displacement measured: a limit cycle, nonlinear damping, white force.

    x1' = x2,   x2' = mu (1 - x1^2) x2 - x1 + w

Van der Pol, "On Relaxation-Oscillations", Philosophical Magazine 2 (1926). Without units.
"""

import numpy as np

MU = 1.0
R = np.array([[0.04]])
X0 = np.array([1.0, 0.0])
P0 = np.diag([0.1, 0.1])


def f(x, u):
    """dx/dt; u: force that is known, or None."""
    force = 0.0 if u is None else u
    return np.array([x[1], MU * (1.0 - x[0] ** 2) * x[1] - x[0] + force])


def F(x, u):
    """df/dx (2, 2)."""
    return np.array([[0.0, 1.0], [-2.0 * MU * x[0] * x[1] - 1.0, MU * (1.0 - x[0] ** 2)]])


def F_xx(x, u):
    """Hessians (2, 2, 2) of the components of f."""
    hessians = np.zeros((2, 2, 2))
    hessians[1] = [[-2.0 * MU * x[1], -2.0 * MU * x[0]], [-2.0 * MU * x[0], 0.0]]
    return hessians


def Qc(x):
    """Spectral density (2, 2) of the force."""
    return np.diag([0.0, 0.02])


def h(x):
    """The displacement (1,)."""
    return x[:1]


def H(x):
    """dh/dx (1, 2)."""
    return np.eye(1, 2)


def H_xx(x):
    """Hessian of h: none."""
    return np.zeros((1, 2, 2))
