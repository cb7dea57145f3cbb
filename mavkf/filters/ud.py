"""The UD form: P = U D U', U unit upper triangular, D diagonal; no square roots anywhere.

Update: Bierman, "Measurement Updating Using the U-D Factorization", Automatica 12 (1976), and "Factorization Methods for Discrete
Sequential Estimation" (1977), chapter V. Prediction: Thornton's modified weighted Gram-Schmidt (Thornton, "Triangular Covariance
Factorizations for Kalman Filtering", JPL TM 33-798, 1976; Bierman 1977, chapter VI). P cannot lose positive semi-definiteness: it would
show as a negative D, which only sums and products of positive numbers make. The form's own array has D on the diagonal and U above it,
shape (n, n); below it is zero.
"""

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.dense import EPSILON


@compiled
def from_covariance(P):
    """U and D, packed (n, n), of a positive semi-definite P; where a pivot is nothing but rounding, D is zero."""
    n = P.shape[0]
    A = np.zeros((n, n))
    for j in range(n - 1, -1, -1):
        for i in range(j, -1, -1):
            total = P[i, j]
            for k in range(j + 1, n):
                total -= A[i, k] * A[k, k] * (A[j, k] if j < k else 1.0)
            if i == j:
                A[j, j] = 0.0 if total <= n * EPSILON * P[j, j] else total
            elif A[j, j] != 0.0:
                A[i, j] = total / A[j, j]
    return A


@compiled
def to_covariance(A):
    """P = U D U', symmetric to the bit."""
    n = A.shape[0]
    P = np.empty((n, n))
    for i in range(n):
        for j in range(i, n):
            total = A[j, j] if i == j else A[i, j] * A[j, j]
            for k in range(j + 1, n):
                total += A[i, k] * A[k, k] * A[j, k]
            P[i, j] = total
            P[j, i] = total
    return P


@compiled
def predict(A, Phi, G, q):
    """U D U' <- Phi U D U' Phi' + G diag(q) G', in place; q: (k,) variances, none negative.

    The rows of [Phi U, G] are made orthogonal under the weights (D, q), from the last to the first.
    """
    n = A.shape[0]
    k = q.shape[0]
    W = np.empty((n, n + k))
    weight = np.empty(n + k)
    for i in range(n):
        weight[i] = A[i, i]
        for j in range(n):
            total = Phi[i, j]
            for c in range(j):
                total += Phi[i, c] * A[c, j]
            W[i, j] = total
        for c in range(k):
            W[i, n + c] = G[i, c]
    for c in range(k):
        weight[n + c] = q[c]
    for j in range(n - 1, -1, -1):
        d = 0.0
        for c in range(n + k):
            d += W[j, c] * W[j, c] * weight[c]
        A[j, j] = d
        for i in range(j):
            total = 0.0
            for c in range(n + k):
                total += W[i, c] * W[j, c] * weight[c]
            u = total / d if d > 0.0 else 0.0
            A[i, j] = u
            for c in range(n + k):
                W[i, c] -= u * W[j, c]


@compiled
def update(A, H, r, dx):
    """Correct U and D in place by whitened measurements and fill dx (n,). H: (m, n), r: (m,), noise of unit covariance."""
    m, n = H.shape
    f = np.empty(n)
    b = np.empty(n)
    for i in range(n):
        dx[i] = 0.0
    for row in range(m):
        residual = r[row]
        for j in range(n):
            residual -= H[row, j] * dx[j]
            f[j] = H[row, j]
            for i in range(j):
                f[j] += A[i, j] * H[row, i]
        alpha = 1.0
        for j in range(n):
            v = A[j, j] * f[j]
            before = alpha
            alpha += v * f[j]
            A[j, j] *= before / alpha
            ratio = -f[j] / before
            for i in range(j):
                u = A[i, j]
                A[i, j] = u + b[i] * ratio
                b[i] += u * v
            b[j] = v
        for i in range(n):
            dx[i] += b[i] * residual / alpha
