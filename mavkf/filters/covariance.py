"""The standard covariance form: the equations as Kalman wrote them.

    prediction   P <- Phi P Phi' + G diag(q) G'
    update       S = H P H' + 1,   K = P H' S^-1,   dx = K r,   P <- (1 - K H) P

Kalman, "A New Approach to Linear Filtering and Prediction Problems", J. Basic Eng. 82 (1960). The cheapest form and the weakest: the
difference in (1 - K H) P loses symmetry and positive definiteness to rounding where measurements are much better than what was known.
Nothing is repaired here; that is what the other forms are for. The form's own array is P itself, shape (n, n).
"""

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.dense import add_noise, product, solve


@compiled
def from_covariance(P):
    """The form's array of a covariance P (n, n): a copy."""
    return P.copy()


@compiled
def to_covariance(A):
    """The covariance (n, n) of the form's array: a copy."""
    return A.copy()


@compiled
def predict(A, Phi, G, q):
    """P <- Phi P Phi' + G diag(q) G', in place. Phi: (n, n), G: (n, k), q: (k,) variances of independent noises."""
    n = A.shape[0]
    M = product(Phi, A)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += M[i, k] * Phi[j, k]
            A[i, j] = total
    add_noise(A, G, q)


@compiled
def update(A, H, r, dx):
    """Correct P in place by whitened measurements and fill dx = K r (n,). H: (m, n), r: (m,), noise of unit covariance."""
    m, n = H.shape
    HP = product(H, A)
    S = np.empty((m, m))
    for a in range(m):
        for b in range(m):
            total = 1.0 if a == b else 0.0
            for i in range(n):
                total += HP[a, i] * H[b, i]
            S[a, b] = total
    Kt = solve(S, HP)  # K' = S^-1 H P
    for i in range(n):
        dx[i] = 0.0
        for a in range(m):
            dx[i] += Kt[a, i] * r[a]
    for i in range(n):
        for a in range(m):
            for j in range(n):
                A[i, j] -= Kt[a, i] * HP[a, j]
