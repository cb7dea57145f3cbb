"""Smoothed estimates of a stored sequence: each state as all measurements of the interval tell it, later ones too.

- `rauch_tung_striebel`: Rauch, Tung and Striebel, "Maximum Likelihood Estimates of Linear Dynamic Systems", AIAA Journal 3 (1965).
  Needs the inverse of each predicted covariance, and the covariances only.
- `modified_bryson_frazier`: Bierman, "Fixed Interval Smoothing with Discrete Measurements", Int. J. Control 18 (1973). Goes back with the
  adjoint of the filter, driven by the innovations; inverts nothing but S, so a singular P (a state known exactly) is no trouble.
- `FixedLag`: the fixed-interval smoother of the last few steps, anew at each: a result a constant number of steps late.

For an extended filter the sequence is the one linearised where the filter was, and these are its extended smoothers.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavkf.errors import UsageError

Array = np.ndarray


@dataclass(frozen=True)
class Step:
    """One time of a filter's run: how it was reached from the time before, and what was measured there.

    t (s); Phi (n, n) from the step before (unused in the first one); predicted x (n,) and P (n, n), before the measurement; the
    measurement's innovation r (m,), H (m, n) and R (m, m) as the gain used them, missing components left out (m may be 0); x_filtered and
    P_filtered, after it.
    """

    t: float
    Phi: Array
    x_predicted: Array
    P_predicted: Array
    H: Array
    R: Array
    r: Array
    x_filtered: Array
    P_filtered: Array


def _checked(steps: Sequence[Step]) -> None:
    if not steps:
        raise UsageError("There are no steps to smooth.")
    for step in steps:
        if np.isnan(step.P_filtered).any():
            raise UsageError(f"At {step.t:g} s the covariance is not known yet: smooth from where it is.")


def rauch_tung_striebel(steps: Sequence[Step]) -> tuple[Array, Array]:
    """Smoothed states (k, n) and covariances (k, n, n) of k steps.

    Raises UsageError where there are none, a covariance is unknown (NaN), or a predicted one singular, but for the first.
    """
    _checked(steps)
    x, P = [steps[-1].x_filtered], [steps[-1].P_filtered]
    for step, after in zip(reversed(steps[:-1]), reversed(steps[1:]), strict=True):
        try:
            C = np.linalg.solve(after.P_predicted, after.Phi @ step.P_filtered).T
        except np.linalg.LinAlgError:
            raise UsageError(
                f"At {after.t:g} s P is singular: modified_bryson_frazier needs no inverse of it."
            ) from None
        x.append(step.x_filtered + C @ (x[-1] - after.x_predicted))
        smoothed = step.P_filtered + C @ (P[-1] - after.P_predicted) @ C.T
        P.append(0.5 * (smoothed + smoothed.T))
    return np.array(x[::-1]), np.array(P[::-1])


def modified_bryson_frazier(steps: Sequence[Step]) -> tuple[Array, Array]:
    """Smoothed states (k, n) and covariances (k, n, n) of k steps. Raises UsageError where there are none, or a covariance is unknown.

    Backwards, with C = 1 - K H, from zero:
        before the update   lambda <- C' lambda - H' S^-1 r     Lambda <- C' Lambda C + H' S^-1 H
        before the step     lambda <- Phi' lambda               Lambda <- Phi' Lambda Phi
    and at each step x - P lambda and P - P Lambda P, of the filtered x and P.
    """
    _checked(steps)
    n = len(steps[0].x_filtered)
    adjoint, information = np.zeros(n), np.zeros((n, n))
    x, P = [], []
    for i in range(len(steps) - 1, -1, -1):
        step = steps[i]
        x.append(step.x_filtered - step.P_filtered @ adjoint)
        smoothed = step.P_filtered - step.P_filtered @ information @ step.P_filtered
        P.append(0.5 * (smoothed + smoothed.T))
        if len(step.r):
            HP = step.H @ step.P_predicted
            S = HP @ step.H.T + step.R
            C = np.eye(n) - np.linalg.solve(S, HP).T @ step.H
            adjoint = C.T @ adjoint - step.H.T @ np.linalg.solve(S, step.r)
            information = C.T @ information @ C + step.H.T @ np.linalg.solve(S, step.H)
        adjoint = step.Phi.T @ adjoint
        information = step.Phi.T @ information @ step.Phi
    return np.array(x[::-1]), np.array(P[::-1])


class FixedLag:
    """Estimates a constant number of steps late, each with all measurements until then; keeps no more than that many steps.

    Each step costs as many backward steps as the lag has.
    """

    def __init__(self, lag: int) -> None:
        """lag: steps, 0 or more; raises UsageError otherwise."""
        if lag < 0:
            raise UsageError(f"The lag is {lag} steps; it must be 0 or more.")
        self.lag = lag
        self._window: deque[Step] = deque(maxlen=lag + 1)

    def push(self, step: Step) -> tuple[float, Array, Array] | None:
        """The time (s), smoothed state (n,) and covariance (n, n) of the step that lies `lag` steps back; None until there is one."""
        self._window.append(step)
        if len(self._window) <= self.lag:
            return None
        x, P = modified_bryson_frazier(tuple(self._window))
        return self._window[0].t, x[0], P[0]
