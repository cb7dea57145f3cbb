"""The square-root information form: the data equation z = R dx + noise of unit covariance, R' R = P^-1.

    update       T [ R   z ] = [ R   z ]       prediction   T [ 1                0          0 ]   [ .   .   . ]
                   [ H   r ]   [ 0   e ]                      [ -R Phi^-1 G sqrt(q)   R Phi^-1   z ] = [ 0   R   z ]

Dyer and McReynolds, "Extension of Square-Root Filtering to Include Process Noise", J. Optimization Theory and Applications 3 (1969);
Bierman, "Factorization Methods for Discrete Sequential Estimation" (1977), chapters V and VI. As `information`, knowing nothing is R = 0,
and what cannot be told yet stays in z; with twice the digits. Phi must be invertible. The form's own array is [R | z], R upper
triangular, shape (n, n + 1).
"""

import math

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.dense import (
    EPSILON,
    cholesky,
    identity,
    leading,
    outer_square,
    product,
    solve,
    transposed,
    triangularise,
)


@compiled
def from_covariance(P):
    """[R | 0], shape (n, n + 1), of a positive definite P; NaN where P is singular."""
    n = P.shape[0]
    L_inverse = solve(cholesky(P), identity(n))
    A = np.zeros((n, n + 1))
    for i in range(n):
        for j in range(n):
            A[i, j] = L_inverse[i, j]
    triangularise(A, n)
    return A


@compiled
def is_determined(A):
    """Whether the triangular R of [R | z] is regular by more than rounding, each column on its own scale."""
    n = A.shape[0]
    for j in range(n):
        size = 0.0
        for i in range(j + 1):
            size = max(size, abs(A[i, j]))
        if not abs(A[j, j]) > 4.0 * n * EPSILON * size:
            return False
    return True


@compiled
def to_covariance(A):
    """P = R^-1 R^-T (n, n); NaN where R is singular: not known yet."""
    n = A.shape[0]
    P = np.full((n, n), np.nan)
    if is_determined(A):
        P = outer_square(solve(leading(A, n), identity(n)))
    return P


@compiled
def predict(A, Phi, G, q):
    """[R | z] over one transition, in place. Phi: (n, n) invertible, G: (n, k), q: (k,) variances, none negative (zero is allowed)."""
    n = A.shape[0]
    k = q.shape[0]
    N = transposed(solve(transposed(Phi), transposed(leading(A, n))))  # R Phi^-1
    NG = product(N, G)
    M = np.zeros((n + k, k + n + 1))
    for c in range(k):
        M[c, c] = 1.0
        for i in range(n):
            M[k + i, c] = -NG[i, c] * math.sqrt(q[c])
    for i in range(n):
        for j in range(n):
            M[k + i, k + j] = N[i, j]
        M[k + i, k + n] = A[i, n]
    triangularise(M, n + k)
    for i in range(n):
        for j in range(n + 1):
            A[i, j] = M[k + i, k + j]


@compiled
def update(A, H, r, dx):
    """Fold whitened measurements into [R | z] in place and fill dx (n,): zero while R is singular. H: (m, n), r: (m,)."""
    m, n = H.shape
    M = np.empty((n + m, n + 1))
    for j in range(n):
        for i in range(n):
            M[i, j] = A[i, j]
        for a in range(m):
            M[n + a, j] = H[a, j]
    for i in range(n):
        M[i, n] = A[i, n]
    for a in range(m):
        M[n + a, n] = r[a]
    triangularise(M, n)
    for i in range(n):
        for j in range(n + 1):
            A[i, j] = M[i, j]
    for i in range(n):
        dx[i] = 0.0
    if is_determined(A):
        for i in range(n - 1, -1, -1):
            total = A[i, n]
            for j in range(i + 1, n):
                total -= A[i, j] * dx[j]
            dx[i] = total / A[i, i]
        for i in range(n):
            A[i, n] = 0.0
