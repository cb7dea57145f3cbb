"""Carlson's square root: P = C C' with C upper triangular, which stays triangular through the update.

Carlson, "Fast Triangular Formulation of the Square Root Filter", AIAA Journal 11 (1973). Half of Potter's work, n square roots for each
scalar. The form's own array is C, shape (n, n).
"""

import math

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.dense import cholesky, outer_square, triangularise


@compiled
def from_covariance(P):
    """The upper triangular root C (n, n) of a positive semi-definite P: the lower one of P with the states in reverse order."""
    n = P.shape[0]
    reverse = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            reverse[i, j] = P[n - 1 - i, n - 1 - j]
    L = cholesky(reverse)
    C = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            C[i, j] = L[n - 1 - i, n - 1 - j]
    return C


@compiled
def to_covariance(A):
    """P = C C'."""
    return outer_square(A)


@compiled
def predict(A, Phi, G, q):
    """C C' <- Phi C C' Phi' + G diag(q) G', in place; q: (k,) variances, none negative. Householder reflections, states reversed."""
    n = A.shape[0]
    k = q.shape[0]
    M = np.empty((n + k, n))
    for i in range(n):
        for j in range(n):
            total = 0.0
            for c in range(n):
                total += Phi[i, c] * A[c, j]
            M[j, n - 1 - i] = total
        for c in range(k):
            M[n + c, n - 1 - i] = G[i, c] * math.sqrt(q[c])
    triangularise(M, n)
    for i in range(n):
        for j in range(n):
            A[i, j] = M[n - 1 - j, n - 1 - i]


@compiled
def update(A, H, r, dx):
    """Correct C in place by whitened measurements and fill dx (n,). H: (m, n), r: (m,), noise of unit covariance.

    Column by column alpha grows from the noise's variance to the innovation's, and w from zero to the gain times it.
    """
    m, n = H.shape
    w = np.empty(n)
    for i in range(n):
        dx[i] = 0.0
    for row in range(m):
        residual = r[row]
        for i in range(n):
            residual -= H[row, i] * dx[i]
            w[i] = 0.0
        alpha = 1.0
        for j in range(n):
            sigma = 0.0
            for i in range(j + 1):
                sigma += A[i, j] * H[row, i]
            before = alpha
            alpha += sigma * sigma
            gamma = math.sqrt(before * alpha)
            eta = before / gamma
            zeta = sigma / gamma
            for i in range(j + 1):
                c = A[i, j]
                A[i, j] = eta * c - zeta * w[i]
                w[i] += c * sigma
        for i in range(n):
            dx[i] += w[i] * residual / alpha
