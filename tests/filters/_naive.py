"""The textbook's equations in dense numpy, as written: what every form is held to. And random problems to hold it with."""

import numpy as np

Array = np.ndarray


def predict(x: Array, P: Array, Phi: Array, G: Array, q: Array) -> tuple[Array, Array]:
    return Phi @ x, Phi @ P @ Phi.T + G @ np.diag(q) @ G.T


def update(x: Array, P: Array, H: Array, R: Array, z: Array) -> tuple[Array, Array]:
    """All components at once, those that are there; correlations in S."""
    there = ~np.isnan(z)
    H, R, z = H[there], R[np.ix_(there, there)], z[there]
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    A = np.eye(len(x)) - K @ H
    return x + K @ (z - H @ x), A @ P @ A.T + K @ R @ K.T


def positive(random: np.random.Generator, n: int, spread: float = 0.5) -> Array:
    """A random covariance whose standard deviations range over some decades."""
    A = random.normal(size=(n, n + 2)) * 10.0 ** random.uniform(-spread, spread, (n, 1))
    return np.asarray(A @ A.T)


def orthogonal(random: np.random.Generator, n: int) -> Array:
    return np.asarray(np.linalg.qr(random.normal(size=(n, n)))[0])


def problem(seed: list[int], n: int, m: int, k: int, steps: int, missing: float = 0.3) -> dict[str, Array]:
    """A random stable linear system with correlated measurements, some of them missing. Phi is well conditioned."""
    random = np.random.default_rng(seed)
    Phi = np.array([orthogonal(random, n) * random.uniform(0.7, 1.1, n) for _ in range(steps)])
    z = random.normal(size=(steps, m)) * 3.0
    z[random.random((steps, m)) < missing] = np.nan
    return {
        "x": random.normal(size=n),
        "P": positive(random, n),
        "Phi": Phi,
        "G": random.normal(size=(steps, n, k)),
        "q": random.uniform(0.1, 1.0, (steps, k)) * (random.random((steps, k)) < 0.8),
        "H": random.normal(size=(steps, m, n)) * (random.random((steps, m, n)) < 0.7),
        "R": np.array([positive(random, m) for _ in range(steps)]),
        "z": z,
    }


def difference(x: Array, P: Array, x0: Array, P0: Array) -> float:
    """The larger of the errors of x and P, against x0 and P0, in units of the standard deviations (and of x0 itself)."""
    sigma = np.sqrt(np.diag(P0))
    return float(max(np.max(np.abs(x - x0) / (sigma + np.abs(x0))), np.max(np.abs(P - P0) / np.outer(sigma, sigma))))
