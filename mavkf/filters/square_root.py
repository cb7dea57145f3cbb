"""The array form of the square root: prediction and update are each one orthogonal transformation of an array, P = S S'.

    prediction   [ Phi S   G sqrt(q) ] T = [ S   0 ]

    update       [ 1   H S ]     [ S_r   0 ]
                 [ 0     S ] T = [ K_r   S ],   dx = K_r S_r^-1 r,   S_r S_r' the innovation's covariance

Kailath, Sayed and Hassibi, "Linear Estimation" (2000), chapter 12; Kaminski, Bryson and Schmidt, IEEE Trans. Automatic Control AC-16
(1971). T is never formed: the transposed arrays are made upper triangular by Householder reflections. No difference of squares is ever
taken. The form's own array is S, lower triangular, shape (n, n).
"""

import math

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.dense import cholesky, outer_square, triangularise


@compiled
def from_covariance(P):
    """The lower triangular root S (n, n) of a positive semi-definite P."""
    return cholesky(P)


@compiled
def to_covariance(A):
    """P = S S'."""
    return outer_square(A)


@compiled
def predict(A, Phi, G, q):
    """S S' <- Phi S S' Phi' + G diag(q) G', in place; S is lower triangular afterwards. q: (k,) variances, none negative."""
    n = A.shape[0]
    k = q.shape[0]
    M = np.empty((n + k, n))
    for i in range(n):
        for j in range(n):
            total = 0.0
            for c in range(n):
                total += Phi[i, c] * A[c, j]
            M[j, i] = total
        for c in range(k):
            M[n + c, i] = G[i, c] * math.sqrt(q[c])
    triangularise(M, n)
    for i in range(n):
        for j in range(n):
            A[i, j] = M[j, i]


@compiled
def update(A, H, r, dx):
    """Correct S in place by whitened measurements and fill dx (n,). H: (m, n), r: (m,), noise of unit covariance."""
    m, n = H.shape
    M = np.zeros((m + n, m + n))
    for a in range(m):
        M[a, a] = 1.0
        for j in range(n):
            total = 0.0
            for i in range(n):
                total += H[a, i] * A[i, j]
            M[m + j, a] = total
    for i in range(n):
        for j in range(n):
            M[m + j, m + i] = A[i, j]
    triangularise(M, m + n)
    # dx = K_r e with S_r e = r
    for i in range(n):
        dx[i] = 0.0
    e = np.empty(m)
    for a in range(m):
        total = r[a]
        for b in range(a):
            total -= M[b, a] * e[b]
        e[a] = total / M[a, a]
        for i in range(n):
            dx[i] += M[a, m + i] * e[a]
    for i in range(n):
        for j in range(n):
            A[i, j] = M[m + j, m + i]
