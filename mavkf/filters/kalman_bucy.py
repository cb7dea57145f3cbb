"""Continuous observations: the Kalman-Bucy filter and its Riccati equation.

    dx/dt = F x + w,   z = H x + v,   w and v white of spectral densities Qc and Rc

    dx/dt = F x + B u + K (z - H x),   K = P H' Rc^-1
    dP/dt = F P + P F' + Qc - P H' Rc^-1 H P

Kalman and Bucy, "New Results in Linear Filtering and Prediction Theory", J. Basic Eng. 83 (1961); Jazwinski, "Stochastic Processes and
Filtering Theory" (1970), chapter 7. It is the limit of the discrete filter with Q = Qc dt and R = Rc / dt for dt to zero.
"""

import numpy as np

from mavkf.errors import UsageError
from mavkf.filters import runge_kutta
from mavkf.filters.discretise import exponential

Array = np.ndarray


def gain(P: Array, H: Array, Rc: Array) -> Array:
    """K = P H' Rc^-1 (n, m). H: (m, n), Rc: (m, m) spectral density of the measurement's noise."""
    return np.asarray(np.linalg.solve(Rc.T, H @ P.T).T)


def riccati(P: Array, F: Array, H: Array, Qc: Array, Rc: Array) -> Array:
    """dP/dt (n, n)."""
    FP = F @ P
    K = gain(P, H, Rc)
    return np.asarray(FP + FP.T + Qc - K @ Rc @ K.T)


def covariance(P: Array, F: Array, H: Array, Qc: Array, Rc: Array, dt: float) -> Array:
    """The solution P (n, n) of the Riccati equation after dt (s), exactly, for constant matrices.

    P = Y X^-1 with d/dt [X; Y] = [-F', H' Rc^-1 H; Qc, F] [X; Y] (Kalman and Bucy 1961). Long dt need to be cut by the caller: Y and X grow
    alike, and their quotient loses digits.
    """
    n = len(F)
    E = exponential(np.block([[-F.T, H.T @ np.linalg.solve(Rc, H)], [Qc, F]]) * dt)
    X = E[:n, :n] + E[:n, n:] @ P
    Y = E[n:, :n] + E[n:, n:] @ P
    after = np.linalg.solve(X.T, Y.T)
    return np.asarray(0.5 * (after + after.T))


def step(
    x: Array,
    P: Array,
    F: Array,
    H: Array,
    Qc: Array,
    Rc: Array,
    z: Array,
    dt: float,
    *,
    B: Array | None = None,
    u: Array | None = None,
    steps: int = 1,
) -> tuple[Array, Array]:
    """x (n,) and P (n, n) after dt (s) in which z (m,) and u (k,) stay constant: state and Riccati equation by Runge-Kutta, order four.

    A component of z that is NaN is not observed during dt. Raises UsageError where Rc is not positive definite, or u comes without B.
    """
    n = len(x)
    there = ~np.isnan(z)
    H, Rc, z = H[there], Rc[np.ix_(there, there)], z[there]
    if len(z) and np.linalg.eigvalsh(Rc).min() <= 0.0:
        raise UsageError("Rc must be positive definite: a measurement without noise determines the state at once.")
    if u is not None and B is None:
        raise UsageError("A control input u needs its matrix B.")
    push = np.zeros(n) if B is None or u is None else B @ u

    def rate(_: float, y: Array) -> Array:
        mean, cov = y[:n], y[n:].reshape(n, n)
        K = gain(cov, H, Rc)
        FP = F @ cov
        return np.concatenate([F @ mean + push + K @ (z - H @ mean), (FP + FP.T + Qc - K @ Rc @ K.T).ravel()])

    y = runge_kutta.fixed(rate, 0.0, np.concatenate([x, P.ravel()]), dt, steps)
    P = y[n:].reshape(n, n)
    return y[:n], 0.5 * (P + P.T)
