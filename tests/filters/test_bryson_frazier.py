"""Modified Bryson-Frazier against the smoother of Rauch, Tung and Striebel, in dense numpy."""

import numpy as np
import pytest

from mavkf.filters.bryson_frazier import back_over_correction, back_over_transition, exchange, smoothed

Array = np.ndarray
N, MOVING, DRIVING, STEPS = 7, 3, 5, 25  # states; those that move, and those on which they depend


class Step:
    """What a filter did in a step: to predicted x, P by Phi, then to corrected x, P by K."""

    def __init__(self, random: np.random.Generator, x: Array, P: Array, considered: bool) -> None:
        self.m = int(random.integers(0, 4))
        self.Phi = np.eye(N)
        self.index = random.permutation(N)[:DRIVING].astype(np.int64)
        self.block = 0.4 * random.normal(size=(MOVING, DRIVING))
        self.Phi[self.index[:MOVING, None], self.index] = self.block
        G = random.normal(size=(N, 2))
        self.x_before, self.P_before = x, P
        self.x_predicted, self.P_predicted = self.Phi @ x, self.Phi @ P @ self.Phi.T + G @ G.T
        self.H, self.R = random.normal(size=(self.m, N)), np.diag(random.uniform(0.1, 2.0, self.m))
        self.S = self.H @ self.P_predicted @ self.H.T + self.R
        self.inverse = np.linalg.inv(self.S)
        self.r = random.normal(size=self.m)
        self.best = self.P_predicted @ self.H.T @ self.inverse
        self.K = self.best.copy()
        if considered:
            self.K[2:4] = 0.0
        A = np.eye(N) - self.K @ self.H
        self.x, self.P = self.x_predicted + self.K @ self.r, A @ self.P_predicted @ A.T + self.K @ self.R @ self.K.T

    def again(self, x: Array, P: Array, use: bool) -> tuple[Array, Array, Array, Array]:
        """The same step from another estimate, with the gain that is best then; use: whether what was measured is used."""
        Q = self.P_predicted - self.Phi @ self.P_before @ self.Phi.T
        z = self.r + self.H @ self.x_predicted
        x_predicted, P_predicted = self.Phi @ x, self.Phi @ P @ self.Phi.T + Q
        if not use:
            return x_predicted, P_predicted, x_predicted, P_predicted
        K = P_predicted @ self.H.T @ np.linalg.inv(self.H @ P_predicted @ self.H.T + self.R)
        return (
            x_predicted,
            P_predicted,
            x_predicted + K @ (z - self.H @ x_predicted),
            P_predicted - K @ self.H @ P_predicted,
        )


def flight(seed: int, considered: bool) -> list[Step]:
    random = np.random.default_rng(seed)
    A = random.normal(size=(N, N))
    x, P = random.normal(size=N), A @ A.T + 0.1 * np.eye(N)
    steps = []
    for _ in range(STEPS):
        steps.append(Step(random, x, P, considered))
        x, P = steps[-1].x, steps[-1].P
    return steps


def rauch_tung_striebel(steps: list[Step], first: int, use: bool = True) -> tuple[Array, Array]:
    """The best estimate at the beginning of step `first`, of the filter's there and of all that is measured later."""
    x, P = steps[first].x_before, steps[first].P_before
    done = []
    for step in steps[first:]:
        done.append((step, x, P, *step.again(x, P, use)))
        x, P = done[-1][5:]
    for step, x_before, P_before, x_predicted, P_predicted, _, _ in reversed(done):
        C = P_before @ step.Phi.T @ np.linalg.inv(P_predicted)
        x, P = x_before + C @ (x - x_predicted), P_before + C @ (P - P_predicted) @ C.T
    return x, P


def bryson_frazier(steps: list[Step], first: int, how: str) -> tuple[Array, Array]:
    adjoint, Adjoint = np.zeros(N), np.zeros((N, N))
    for step in reversed(steps[first:]):
        if step.m:
            if how != "best":
                assert exchange(adjoint, Adjoint, step.r, step.inverse, step.best - step.K, 1.0)
            if how == "out":
                assert exchange(adjoint, Adjoint, step.r, step.inverse, step.best, -1.0)
            else:
                back_over_correction(adjoint, Adjoint, step.r, step.inverse, step.H, step.best)
        back_over_transition(adjoint, Adjoint, step.block, step.index)
    dx, P = np.empty(N), np.empty((N, N))
    smoothed(np.ascontiguousarray(steps[first].P_before), adjoint, Adjoint, dx, P)
    return steps[first].x_before + dx, P


@pytest.mark.parametrize("how", ["best", "considered", "out"])
def test_equals_rauch_tung_striebel(how: str) -> None:
    for seed in range(20):
        steps = flight(seed, considered=how != "best")
        for first in (0, STEPS // 2, STEPS - 1):
            x, P = bryson_frazier(steps, first, how)
            x_reference, P_reference = rauch_tung_striebel(steps, first, use=how != "out")
            np.testing.assert_allclose(x, x_reference, rtol=1e-7, atol=1e-7 * np.abs(x_reference).max())
            np.testing.assert_allclose(P, P_reference, rtol=1e-7, atol=1e-7 * np.abs(P_reference).max())


def test_the_recursion_of_the_gain_that_was_used_is_not_enough_with_considered_states() -> None:
    steps = flight(1, considered=True)
    adjoint, Adjoint = np.zeros(N), np.zeros((N, N))
    for step in reversed(steps):
        if step.m:
            back_over_correction(adjoint, Adjoint, step.r, step.inverse, step.H, step.K)
        back_over_transition(adjoint, Adjoint, step.block, step.index)
    naive = steps[0].x_before + steps[0].P_before @ adjoint
    assert np.abs(naive - rauch_tung_striebel(steps, 0)[0]).max() > 1e-2
