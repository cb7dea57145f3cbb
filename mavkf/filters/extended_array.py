"""The extended array form: state and covariance in one array, carried by one orthogonal transformation.

    P = S S',  x = S s.     T [ 1        0          -z ]   [ S_r'   K_r'   -e ]
                              [ S' H'    S' Phi'     s ] = [ 0      S'      s ]
                              [ 0        sqrt(q) G'  0 ]   [ 0      0       . ]

Park and Kailath, "New Square-Root Algorithms for Kalman Filtering", IEEE Trans. Automatic Control 40 (1995). An orthogonal transformation
keeps the inner products of columns, and those are the Kalman filter's equations: S_r S_r' the innovation's covariance, e the whitened
innovation, S s the next predicted state. Neither a gain nor a triangular solution is needed. The form's own array is [S' | s], S' upper
triangular, shape (n, n + 1). Under the forms' contract the array carries the error state, zero between updates (s = 0).
"""

import math

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.dense import cholesky, identity, leading, outer_square, transposed, triangularise


@compiled
def from_covariance(P):
    """[S' | 0], shape (n, n + 1), of a positive semi-definite P."""
    n = P.shape[0]
    S = cholesky(P)
    A = np.zeros((n, n + 1))
    for i in range(n):
        for j in range(i + 1):
            A[j, i] = S[i, j]
    return A


@compiled
def to_covariance(A):
    """P = S S'."""
    return outer_square(transposed(leading(A, A.shape[0])))


@compiled
def to_state(A, x):
    """Fill x = S s (n,): the state that the array carries."""
    n = A.shape[0]
    for i in range(n):
        x[i] = 0.0
        for k in range(n):
            x[i] += A[k, i] * A[k, n]


@compiled
def set_state(A, x):
    """Make the array carry the state x (n,): s = S^-1 x. NaN where P is singular."""
    n = A.shape[0]
    for i in range(n):
        total = x[i]
        for k in range(i):
            total -= A[k, i] * A[k, n]
        A[i, n] = total / A[i, i] if A[i, i] != 0.0 else np.nan


@compiled
def step(A, Phi, G, q, H, z):
    """Correct by z and predict over Phi, in one transformation, in place; with H of no rows a prediction, with Phi = 1 an update.

    Phi: (n, n), G: (n, k), q: (k,) variances, none negative; H: (m, n) and z: (m,) whitened.
    """
    m, n = H.shape
    k = q.shape[0]
    M = np.zeros((m + n + k, m + n + 1))
    for a in range(m):
        M[a, a] = 1.0
        M[a, m + n] = -z[a]
        for j in range(n):
            for i in range(j, n):
                M[m + j, a] += A[j, i] * H[a, i]
    for j in range(n):
        for i in range(n):
            for c in range(j, n):
                M[m + j, m + i] += A[j, c] * Phi[i, c]
        M[m + j, m + n] = A[j, n]
    for c in range(k):
        for i in range(n):
            M[m + n + c, m + i] = G[i, c] * math.sqrt(q[c])
    triangularise(M, m + n)
    for i in range(n):
        for j in range(n + 1):
            A[i, j] = M[m + i, m + j]


@compiled
def predict(A, Phi, G, q):
    """State and covariance over one transition, in place: x <- Phi x, P <- Phi P Phi' + G diag(q) G'."""
    step(A, Phi, G, q, np.empty((0, A.shape[0])), np.empty(0))


@compiled
def update(A, H, r, dx):
    """Correct in place by whitened measurements of the error state and fill dx (n,), which the array no longer carries then."""
    n = H.shape[1]
    for i in range(n):
        A[i, n] = 0.0
    step(A, identity(n), np.empty((n, 0)), np.empty(0), H, r)
    to_state(A, dx)
    for i in range(n):
        A[i, n] = 0.0
