"""From continuous to discrete time: (F, Qc, dt) to (Phi, Qd) by Van Loan's matrix exponential.

    exp( [ -F  Qc ]      )   [ .   Phi^-1 Qd ]
       ( [  0  F' ] dt   ) = [ 0   Phi'      ]

Van Loan, "Computing Integrals Involving the Matrix Exponential", IEEE Trans. Automatic Control AC-23 (1978). exp(-F dt) overflows for fast
stable modes, so the formula is used for a step short enough, which is then doubled: Phi <- Phi Phi, Qd <- Phi Qd Phi' + Qd.
"""

import math

import numpy as np

from mavkf.errors import UsageError

Array = np.ndarray
# Pade coefficients of degree 13 and the norm up to which they give full precision: Higham, "The Scaling and Squaring Method for the Matrix
# Exponential Revisited", SIAM J. Matrix Anal. Appl. 26 (2005).
PADE = (
    64764752532480000.0,
    32382376266240000.0,
    7771770303897600.0,
    1187353796428800.0,
    129060195264000.0,
    10559470521600.0,
    670442572800.0,
    33522128640.0,
    1323241920.0,
    40840800.0,
    960960.0,
    16380.0,
    182.0,
    1.0,
)
PADE_NORM = 5.371920351148152


def exponential(A: Array) -> Array:
    """exp(A) of a square matrix (n, n). Raises UsageError where A is not finite."""
    if not np.all(np.isfinite(A)):
        raise UsageError("The matrix of an exponential must be finite.")
    norm = float(np.abs(A).sum(axis=0).max(initial=0.0))
    if norm == 0.0:
        return np.eye(len(A))  # to the bit
    halvings = max(0, math.ceil(math.log2(norm / PADE_NORM))) if norm > PADE_NORM else 0
    A = A / 2.0**halvings
    square = A @ A
    even = odd = np.zeros_like(A)
    for k in range(12, -1, -2):
        even = even @ square + PADE[k] * np.eye(len(A))
        odd = odd @ square + PADE[k + 1] * np.eye(len(A))
    odd = A @ odd
    E = np.linalg.solve(even - odd, even + odd)
    for _ in range(halvings):
        E = E @ E
    return np.asarray(E)


def van_loan(F: Array, Qc: Array, dt: float) -> tuple[Array, Array]:
    """Phi and Qd (n, n) over dt (s) of dx/dt = F x + w, w white of spectral density Qc (n, n). Raises UsageError for a negative dt."""
    if not dt >= 0.0:
        raise UsageError(f"dt is {dt:g} s; it must not be negative.")
    n = len(F)
    norm = float(np.abs(F).sum(axis=0).max(initial=0.0)) * dt
    doublings = max(0, math.ceil(math.log2(norm))) if norm > 1.0 else 0
    E = exponential(np.block([[-F, Qc], [np.zeros((n, n)), F.T]]) * (dt / 2.0**doublings))
    Phi = E[n:, n:].T
    Qd = Phi @ E[:n, n:]
    for _ in range(doublings):
        Qd = Phi @ Qd @ Phi.T + Qd
        Phi = Phi @ Phi
    return Phi.copy(), 0.5 * (Qd + Qd.T)
