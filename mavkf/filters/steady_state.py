"""The steady state of constant systems: the algebraic Riccati equations, solved by doubling.

    discrete     P = F P F' - F P H' (H P H' + R)^-1 H P F' + Q       P predicted, K = P H' (H P H' + R)^-1
    continuous   0 = F P + P F' - P H' Rc^-1 H P + Qc                 K = P H' Rc^-1

One doubling step takes the filter over twice the time, so k of them reach the covariance after 2^k measurements: Anderson, "Second-Order
Convergent Algorithms for the Steady-State Riccati Equation", Int. J. Control 28 (1978); in the structure-preserving form of Chu, Fan, Lin
and Wang, Int. J. Control 77 (2004). The continuous equation is brought to the discrete one by a Cayley transform: Chu, Fan and Lin, "A
Structure-Preserving Doubling Algorithm for Continuous-Time Algebraic Riccati Equations", Linear Algebra and its Applications 396 (2005).
"""

import numpy as np

from mavkf.errors import UsageError

Array = np.ndarray
DOUBLINGS = 60  # 2^60 measurements: what has not settled by then never will
CONVERGED = 1e-14
NONE = "There is no steady state: a state that is not stable is not seen in the measurements, or not driven by noise."


@np.errstate(all="ignore")  # what has no steady state overflows, and is refused at the end
def _double(A: Array, G: Array, P: Array) -> Array:
    """The limit of P: A (n, n) the transposed transition, G (n, n) the information of a measurement, P (n, n) the noise."""
    for _ in range(DOUBLINGS):
        try:
            W = np.linalg.inv(np.eye(len(A)) + G @ P)
        except np.linalg.LinAlgError:
            break
        AW = A @ W
        change = A.T @ P @ W @ A
        P_next = P + 0.5 * (change + change.T)
        G = G + AW @ G @ A.T
        G = 0.5 * (G + G.T)
        A = AW @ A
        if not (np.all(np.isfinite(P_next)) and np.all(np.isfinite(A))):
            break
        settled = np.abs(P_next - P).max() <= CONVERGED * np.abs(P_next).max()
        P = P_next
        if settled:
            return P
    raise UsageError(NONE)


def discrete(F: Array, H: Array, Q: Array, R: Array) -> tuple[Array, Array]:
    """P (n, n), predicted, and the gain K (n, m) of the filter that has run for ever.

    F: (n, n), H: (m, n), Q: (n, n), R: (m, m) positive definite. Raises UsageError where (F, H) is not detectable, or noise that would keep
    the covariance from zero is missing on the unit circle.
    """
    P = _double(F.T, H.T @ np.linalg.solve(R, H), Q)
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    # without noise P = 0 solves the equation too, but no filter that starts with a doubt gets there
    if not np.abs(np.linalg.eigvals(F - F @ K @ H)).max() < 1.0:
        raise UsageError(NONE)
    return P, np.asarray(K)


def continuous(F: Array, H: Array, Qc: Array, Rc: Array) -> tuple[Array, Array]:
    """P (n, n) and the gain K (n, m) of the Kalman-Bucy filter that has run for ever.

    F: (n, n), H: (m, n), Qc: (n, n), Rc: (m, m) positive definite spectral densities. Raises UsageError as `discrete`.
    """
    G = H.T @ np.linalg.solve(Rc, H)
    n = len(F)
    # any gamma beyond the eigenvalues of F serves; the scale of the closed loop is that of the Hamiltonian's
    gamma = 1.1 * max(np.linalg.norm(F, 2), np.sqrt(np.linalg.norm(G, 2) * np.linalg.norm(Qc, 2)), 1e-300)
    shifted = np.linalg.inv(F.T - gamma * np.eye(n))
    inverse = np.linalg.inv(F - gamma * np.eye(n) + Qc @ shifted @ G)
    A = np.eye(n) + 2.0 * gamma * inverse.T
    P = _double(A, 2.0 * gamma * shifted @ G @ inverse, 2.0 * gamma * inverse @ Qc @ shifted)
    K = np.linalg.solve(Rc, H @ P).T
    if not np.linalg.eigvals(F - K @ H).real.max() < 0.0:
        raise UsageError(NONE)
    return P, np.asarray(K)
