"""Potter's square root: P = S S', corrected by one scalar after another.

    a = S' h,   s = a' a + 1,   K = S a / s,   S <- S - K a' / (1 + sqrt(1 / s))

Potter's algorithm for the Apollo navigation, as in Kaminski, Bryson and Schmidt, "Discrete Square Root Filtering: A Survey of Current
Techniques", IEEE Trans. Automatic Control AC-16 (1971); Maybeck, "Stochastic Models, Estimation, and Control", vol. 1 (1979), section 7.3.
The root is full after an update and lower triangular after a prediction. P cannot lose positive semi-definiteness, whatever the rounding.
The form's own array is S, shape (n, n).
"""

import math

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.dense import cholesky, outer_square
from mavkf.filters.square_root import predict as predict_root


@compiled
def from_covariance(P):
    """A root S (n, n), lower triangular, of a positive semi-definite P."""
    return cholesky(P)


@compiled
def to_covariance(A):
    """P = S S'."""
    return outer_square(A)


@compiled
def predict(A, Phi, G, q):
    """S S' <- Phi S S' Phi' + G diag(q) G', in place. Potter's own had no process noise; this is the array's prediction."""
    predict_root(A, Phi, G, q)


@compiled
def update(A, H, r, dx):
    """Correct S in place by whitened measurements and fill dx (n,). H: (m, n), r: (m,), noise of unit covariance."""
    m, n = H.shape
    a = np.empty(n)
    K = np.empty(n)
    for i in range(n):
        dx[i] = 0.0
    for row in range(m):
        residual = r[row]
        s = 1.0
        for j in range(n):
            residual -= H[row, j] * dx[j]
            a[j] = 0.0
            for i in range(n):
                a[j] += A[i, j] * H[row, i]
            s += a[j] * a[j]
        gamma = 1.0 / (1.0 + math.sqrt(1.0 / s))
        for i in range(n):
            K[i] = 0.0
            for j in range(n):
                K[i] += A[i, j] * a[j]
            K[i] /= s
            dx[i] += K[i] * residual
        for i in range(n):
            for j in range(n):
                A[i, j] -= gamma * K[i] * a[j]
