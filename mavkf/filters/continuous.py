"""Continuous-discrete prediction: the moments between two measurements, along the deterministic solution.

    dx/dt = f(x, t) + w,  w white of spectral density Qc

    first order    dx/dt = f                        dP/dt = F P + P F' + Qc
    second order   dx/dt = f_i + 1/2 tr(f_i'' P)     dP/dt = F P + P F' + Qc

Jazwinski, "Stochastic Processes and Filtering Theory" (1970), chapter 9; Gelb, "Applied Optimal Estimation" (1974), section 6.1.
Integrated by `runge_kutta`: in equal steps, or in steps that keep the error of each below a tolerance, in parts of the standard
deviations. `transition` gives the same as Phi and Qd, which any form can be predicted with.
"""

from collections.abc import Callable

import numpy as np

from mavkf.errors import UsageError
from mavkf.filters import runge_kutta
from mavkf.filters.orders import second_order_mean

Array = np.ndarray
Function = Callable[[Array, float], Array]


def _checked(dt: float, steps: int, tolerance: float | None) -> None:
    if not dt >= 0.0:
        raise UsageError(f"dt is {dt:g} s; it must not be negative.")
    if steps < 1:
        raise UsageError(f"The number of steps is {steps}; it must be 1 or more.")
    if tolerance is not None and not tolerance > 0.0:
        raise UsageError(f"The tolerance is {tolerance:g}; it must be positive.")


def _allowed(tolerance: float, scale: Array, y: Array) -> Array:
    """The error of a step: beside the tolerance the rounding of y itself, below which no step can get."""
    return np.asarray(tolerance * scale + 1e-14 * np.abs(y) + 1e-300)


def moments(
    f: Function,
    F: Function,
    Qc: Array,
    x: Array,
    P: Array,
    dt: float,
    *,
    F_xx: Function | None = None,
    t: float = 0.0,
    steps: int = 1,
    tolerance: float | None = None,
) -> tuple[Array, Array]:
    """Mean x (n,) and covariance P (n, n) after dt (s).

    f(x, t): (n,); F(x, t): df/dx (n, n); Qc: (n, n); F_xx(x, t): Hessians (n, n, n) of the components of f, for the second order.
    steps: of order four, equal, or with a tolerance (of sigma) as many as it needs. Raises UsageError for a dt that is negative, and where
    no step is short enough.
    """
    n = len(x)
    _checked(dt, steps, tolerance)

    def rate(time: float, y: Array) -> Array:
        mean, covariance = y[:n], y[n:].reshape(n, n)
        velocity = f(mean, time)
        if F_xx is not None:
            velocity = velocity + second_order_mean(F_xx(mean, time), covariance)
        FP = F(mean, time) @ covariance
        return np.concatenate([velocity, (FP + FP.T + Qc).ravel()])

    y = np.concatenate([x, P.ravel()])
    if tolerance is None:
        y = runge_kutta.fixed(rate, t, y, dt, steps)
    else:
        sigma = np.sqrt(np.diag(P))
        scale = np.concatenate([sigma, np.outer(sigma, sigma).ravel()])
        y, _ = runge_kutta.adaptive(rate, t, y, dt, _allowed(tolerance, scale, y))
    P = y[n:].reshape(n, n)
    return y[:n], 0.5 * (P + P.T)


def transition(
    f: Function,
    F: Function,
    Qc: Array,
    x: Array,
    dt: float,
    *,
    P: Array | None = None,
    F_xx: Function | None = None,
    t: float = 0.0,
    steps: int = 1,
    tolerance: float | None = None,
) -> tuple[Array, Array, Array]:
    """Mean x (n,), Phi and Qd (n, n) over dt (s): P after it is Phi P Phi' + Qd.

    Arguments as of `moments`; P, before dt, is needed for the second order and for a tolerance. Raises UsageError where it is missing.

    x and Phi (dPhi/dt = F Phi) go by two steps of Runge-Kutta from end to end of each panel; the panels are equal, or with a tolerance
    those that Dormand and Prince's method needs. Qd, the integral of Phi Qc Phi', goes by Simpson's rule over the panel's three points,
    which is of order four too, and positive semi-definite however coarse; the integral of dQd/dt = F Qd + Qd F' + Qc is not.
    """
    n = len(x)
    _checked(dt, steps, tolerance)
    if P is None and (F_xx is not None or tolerance is not None):
        raise UsageError("The second order and a tolerance need the covariance P to start from.")
    unit, zero = np.eye(n), np.zeros((n, n))
    panels = [dt / steps] * steps
    if tolerance is not None and P is not None:
        sigma = np.sqrt(np.diag(P)) + 1e-300
        scale = np.concatenate([sigma, np.outer(sigma, 1.0 / sigma).ravel(), np.outer(sigma, sigma).ravel()])
        y = np.concatenate([x, unit.ravel(), zero.ravel()])
        _, panels = runge_kutta.adaptive(_rate(f, F, Qc, P, F_xx), t, y, dt, _allowed(tolerance, scale, y))
    Phi, Qd = unit, zero
    for h in panels:
        halves = []
        for _ in range(2):
            y = np.concatenate([x, unit.ravel(), zero.ravel()])
            y = runge_kutta.fixed(_rate(f, F, Qc, P, F_xx), t, y, 0.5 * h, 1)
            x, (half, noise) = y[:n], y[n:].reshape(2, n, n)
            P = None if P is None else half @ P @ half.T + noise
            t += 0.5 * h
            halves.append(half)
        whole = halves[1] @ halves[0]
        Qd = whole @ Qd @ whole.T + h / 6.0 * (whole @ Qc @ whole.T + 4.0 * halves[1] @ Qc @ halves[1].T + Qc)
        Phi = whole @ Phi
    return x, Phi, 0.5 * (Qd + Qd.T)


def _rate(f: Function, F: Function, Qc: Array, P: Array | None, F_xx: Function | None) -> runge_kutta.Rate:
    """The rate of x, Phi and Qd in one vector, of P before."""

    def rate(time: float, y: Array) -> Array:
        n = len(Qc)
        mean, (Phi, Qd) = y[:n], y[n:].reshape(2, n, n)
        velocity, jacobian = f(mean, time), F(mean, time)
        if F_xx is not None:
            velocity = velocity + second_order_mean(F_xx(mean, time), Phi @ P @ Phi.T + Qd)
        FQ = jacobian @ Qd
        return np.concatenate([velocity, (jacobian @ Phi).ravel(), (FQ + FQ.T + Qc).ravel()])

    return rate
