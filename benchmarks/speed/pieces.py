"""Pieces of the fold in compiled loops, and the same by dense numpy."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.speed.measure import seconds
from mavkf.compiled import compiled
from mavkf.filters.joseph import correct, innovation_covariance, invert
from mavkf.models import strapdown
from mavkf.models.strapdown import SUMS, TOP, N
from mavkf.navigation.covariance import propagate_covariance
from mavkf.stack import matrix, vector, zero_matrix, zero_vector

Array = NDArray[np.float64]
DT = 0.005
LOOPS, DENSE_LOOPS = 100_000, 5_000


@compiled
def _states(x: Any, imu0: Any, imu1: Any, n: int) -> None:
    average = vector(21)
    sums = zero_vector(SUMS)
    for _ in range(n):
        strapdown.propagate(x, imu0, imu1, DT, average)
        strapdown.gather(average, DT, sums)


@compiled
def _covariances(x: Any, imu: Any, P: Any, n: int) -> None:
    average = vector(21)
    sums = zero_vector(SUMS)
    Phi = matrix(9, TOP)
    for _ in range(n):
        sums[:] = 0.0
        strapdown.propagate(x, imu, imu, 4.0 * DT, average)
        strapdown.gather(average, 4.0 * DT, sums)
        strapdown.transition(x, sums, 4.0 * DT, Phi)
        propagate_covariance(P, Phi)


@compiled
def _updates(P: Any, H: Any, R: Any, r: Any, n: int) -> None:
    m = H.shape[0]
    PHt, S, inverse = matrix(N, m), matrix(m, m), matrix(m, m)
    dx, K, work = vector(N), zero_matrix(N, m), matrix(6, N)
    for _ in range(n):
        innovation_covariance(P, H, R, PHt, S)
        invert(S, inverse)
        correct(P, PHt, S, inverse, r, dx, K, work, -1, 0, N)


def _start() -> tuple[Array, Array, Array]:
    """State in level flight, a sample of its IMU, and a covariance."""
    x = np.zeros(strapdown.X_SIZE)
    x[0], x[strapdown.LATITUDE], x[strapdown.HEIGHT] = 1.0, 0.8, 500.0
    root = np.random.default_rng(1).normal(size=(N, N))
    return x, np.array([0.0, 0.0, 0.0, 0.0, 0.0, -9.81]), root @ root.T / N + np.eye(N)


def state_us() -> float:
    """Advance the state by a sample and gather what its transition needs, microseconds."""
    x, imu, _ = _start()
    _states(x, imu, imu, 1)
    return 1e6 * seconds(lambda: _states(x, imu, imu, LOOPS)) / LOOPS


def covariance_us() -> float:
    """The transition over 20 ms and Phi P Phi', microseconds, the state's own advance by one step included."""
    x, imu, P = _start()
    _covariances(x, imu, P, 1)
    n = LOOPS // 10
    return 1e6 * seconds(lambda: _covariances(x, imu, P, n)) / n


def dense_covariance_us() -> float:
    """Phi P Phi' + Q by numpy, microseconds."""
    *_, P = _start()
    Phi = np.eye(N)
    Phi[:9, :9] += 1e-6
    Q = 1e-9 * np.eye(N)

    def work() -> None:
        A = P
        for _ in range(DENSE_LOOPS):
            A = Phi @ A @ Phi.T + Q

    return 1e6 * seconds(work) / DENSE_LOOPS


def _measurement(m: int) -> tuple[Array, Array, Array]:
    H = np.zeros((m, N))
    H[:, strapdown.POS : strapdown.POS + m] = np.eye(m)
    H[:, strapdown.DGNSS : strapdown.DGNSS + m] = np.eye(m)
    return H, np.eye(m), np.full(m, 0.1)


def update_us(m: int) -> float:
    """Innovation covariance, gain and Joseph update with m rows, microseconds."""
    *_, P = _start()
    H, R, r = _measurement(m)
    _updates(P, H, R, r, 1)
    n = LOOPS // 10
    return 1e6 * seconds(lambda: _updates(P, H, R, r, n)) / n


def dense_update_us(m: int) -> float:
    """The same as its equations are written, by numpy."""
    *_, P = _start()
    H, R, r = _measurement(m)
    one = np.eye(N)

    def work() -> None:
        A = P
        for _ in range(DENSE_LOOPS):
            S = H @ A @ H.T + R
            K = A @ H.T @ np.linalg.inv(S)
            K @ r
            A = (one - K @ H) @ A @ (one - K @ H).T + K @ R @ K.T

    return 1e6 * seconds(work) / DENSE_LOOPS
