"""The linear Kalman filter with control input: its five equations, one after the other.

    x <- F x + B u                     P <- F P F' + Q
    K = P H' (H P H' + R)^-1
    x <- x + K (z - H x)               P <- (1 - K H) P (1 - K H)' + K R K'

Kalman (1960); Maybeck, "Stochastic Models, Estimation, and Control", vol. 1 (1979), section 5.3. For a linear system with Gaussian noise no
other estimator has a smaller mean square error. Arguments are float64 and C-ordered; x and P are changed in place.
"""

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.dense import product
from mavkf.filters.joseph import update as update_joseph
from mavkf.filters.whitening import whiten


@compiled
def predict(x, P, F, B, u, Q):
    """State and covariance one step later. x: (n,), P, F, Q: (n, n), B: (n, k), u: (k,)."""
    n = x.shape[0]
    before = x.copy()
    FP = product(F, P)
    for i in range(n):
        x[i] = 0.0
        for j in range(n):
            x[i] += F[i, j] * before[j]
        for j in range(u.shape[0]):
            x[i] += B[i, j] * u[j]
        for j in range(i + 1):
            total = 0.5 * (Q[i, j] + Q[j, i])
            for k in range(n):
                total += FP[i, k] * F[j, k]
            P[i, j] = total
            P[j, i] = total


@compiled
def correct(x, P, H, R, z, r):
    """Correct by z (m,), NaN where a component is missing, and fill the innovation r (m,); returns how many components were used.

    H: (m, n), R: (m, m), correlated or not. Returns -1, and changes nothing, where R is not positive definite.
    """
    m, n = H.shape
    for a in range(m):
        r[a] = z[a]
        for i in range(n):
            r[a] -= H[a, i] * x[i]
    H_w = np.empty((m, n))
    r_w = np.empty(m)
    used = whiten(H, R, r, H_w, r_w)
    if used > 0:
        dx = np.empty(n)
        update_joseph(P, H_w[:used], r_w[:used], dx)
        for i in range(n):
            x[i] += dx[i]
    return used
