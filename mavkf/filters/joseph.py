"""The covariance form with Joseph's stabilised update.

    S = H P H' + R,   K = P H' S^-1,   P <- (I - K H) P (I - K H)' + K R K'

Bucy and Joseph, "Filtering for Stochastic Processes with Applications to Guidance" (1968); Maybeck, "Stochastic Models, Estimation, and
Control", vol. 1 (1979), eq. 5-96. Order n^2 m. Preserves symmetry and, unlike (I - K H) P, positive semi-definiteness for any
gain. The first functions are the estimator's: its own gain, gate and considered states lie between them. The
last four are the contract of all forms; the form's own array is P itself, shape (n, n).
"""

import math

import numpy as np

from mavkf.compiled import compiled, kernel
from mavkf.filters.covariance import predict as predict_covariance
from mavkf.filters.dense import identity
from mavkf.stack import vector


@kernel
def innovation_covariance(P, H, R, PHt, S):
    """Fill PHt = P H' (n, m) and S = H P H' + R (m, m). P: (n, n), H: (m, n), R: (m, m)."""
    m, n = H.shape
    row = vector(n)  # of H P, so that the sums run along the rows of P
    for b in range(m):
        for i in range(n):
            row[i] = 0.0
        for j in range(n):
            h = H[b, j]
            if h != 0.0:
                for i in range(n):
                    row[i] += P[j, i] * h
        for i in range(n):
            PHt[i, b] = row[i]
        for a in range(b + 1):
            total = 0.5 * (R[a, b] + R[b, a])
            for j in range(n):
                h = H[a, j]
                if h != 0.0:
                    total += h * row[j]
            S[a, b] = total
            S[b, a] = total


@kernel
def invert_three(S, inverse):
    """What `invert` does, for m = 3."""
    if not S[0, 0] > 0.0:
        return 0.0
    a = math.sqrt(S[0, 0])
    b, d = S[1, 0] / a, S[2, 0] / a
    square = S[1, 1] - b * b
    if not square > 0.0:
        return 0.0
    c = math.sqrt(square)
    e = (S[2, 1] - d * b) / c
    last = S[2, 2] - d * d - e * e
    if not last > 0.0:
        return 0.0
    # L = (a; b, c; d, e, f), its inverse (p; q, t; u, v, w)
    p, t, w = 1.0 / a, 1.0 / c, 1.0 / math.sqrt(last)
    q = -b * p * t
    u, v = -(d * p + e * q) * w, -e * t * w
    inverse[0, 0] = p * p + q * q + u * u
    inverse[1, 0] = inverse[0, 1] = q * t + u * v
    inverse[2, 0] = inverse[0, 2] = u * w
    inverse[1, 1] = t * t + v * v
    inverse[2, 1] = inverse[1, 2] = v * w
    inverse[2, 2] = w * w
    return S[0, 0] * square * last


@kernel
def invert(S, inverse):
    """Inverse of a symmetric positive definite matrix (m, m) by Cholesky; returns the determinant, 0 where it is not positive definite."""
    m = S.shape[0]
    if m == 1:
        if not S[0, 0] > 0.0:
            return 0.0
        inverse[0, 0] = 1.0 / S[0, 0]
        return S[0, 0]
    if m == 3:
        return invert_three(S, inverse)
    determinant = 1.0
    # the factor L, S = L L', in the lower triangle
    for i in range(m):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= inverse[i, k] * inverse[j, k]
            if i == j:
                if not total > 0.0:
                    return 0.0
                determinant *= total
                inverse[i, i] = math.sqrt(total)
            else:
                inverse[i, j] = total / inverse[j, j]
    # L^-1 in its place, column by column: row i needs rows of L above that are overwritten only in columns done before
    for c in range(m):
        inverse[c, c] = 1.0 / inverse[c, c]
        for i in range(c + 1, m):
            total = 0.0
            for k in range(c, i):
                total -= inverse[i, k] * inverse[k, c]
            inverse[i, c] = total / inverse[i, i]
    # S^-1 = L^-T L^-1; entry (i, j) needs rows i and below, so it may take the place of what it was computed from
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, m):
                total += inverse[k, i] * inverse[k, j]
            inverse[i, j] = total
    for i in range(m):
        for j in range(i):
            inverse[j, i] = inverse[i, j]
    return determinant


@kernel
def row_variance(P, H, row):
    """H P H' of one row of H: the variance of what is predicted of one component."""
    total = 0.0
    for i in range(P.shape[0]):
        if H[row, i] != 0.0:
            for j in range(P.shape[0]):
                total += H[row, i] * P[i, j] * H[row, j]
    return total


@kernel
def quadratic(inverse, r):
    """r' S^-1 r: the normalised innovation squared."""
    total = 0.0
    for a in range(r.shape[0]):
        for b in range(r.shape[0]):
            total += r[a] * inverse[a, b] * r[b]
    return total


@kernel
def correct(P, PHt, S, inverse, r, dx, K, work, considered, first, last):
    """Fill the gain K (n, m) and dx = K r (n,), and update P in place; PHt, S and its inverse as computed before.

    considered: a state whose gain is zero (-1: none), as are those of all states before `first` and from `last` on: its uncertainty counts,
    its value is left alone (Schmidt's consider filter: Jazwinski, "Stochastic Processes and Filtering Theory", section 8.3).
    work: (2 m, n).

    The Joseph product, which holds for any gain, multiplied out: P - K U' - U K' with U = P H' - K S / 2, which is symmetric to the bit.
    """
    n, m = PHt.shape
    for i in range(n):
        total = 0.0
        for b in range(m):
            gain = 0.0
            for a in range(m):
                gain += PHt[i, a] * inverse[a, b]
            if i == considered or i < first or i >= last:
                gain = 0.0
            K[i, b] = gain
            total += gain * r[b]
        dx[i] = total
    # K and U as rows, so that what follows runs along them
    for b in range(m):
        for i in range(n):
            u = PHt[i, b]
            for a in range(m):
                u -= 0.5 * K[i, a] * S[a, b]
            work[b, i] = K[i, b]
            work[m + b, i] = u
    if m == 3:
        # P is read and written once
        for i in range(n):
            k0, k1, k2 = work[0, i], work[1, i], work[2, i]
            u0, u1, u2 = work[3, i], work[4, i], work[5, i]
            if k0 == 0.0 and k1 == 0.0 and k2 == 0.0 and u0 == 0.0 and u1 == 0.0 and u2 == 0.0:
                continue  # a state that is known exactly, or has nothing to do with it
            for j in range(n):
                P[i, j] -= (
                    (k0 * work[3, j] + u0 * work[0, j])
                    + (k1 * work[4, j] + u1 * work[1, j])
                    + (k2 * work[5, j] + u2 * work[2, j])
                )
    else:
        for b in range(m):
            for i in range(n):
                k, u = work[b, i], work[m + b, i]
                if k == 0.0 and u == 0.0:
                    continue
                for j in range(n):
                    P[i, j] -= k * work[m + b, j] + u * work[b, j]


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
    """P <- Phi P Phi' + G diag(q) G', in place, symmetric to the bit. Phi: (n, n), G: (n, k), q: (k,) variances."""
    predict_covariance(A, Phi, G, q)
    n = A.shape[0]
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (A[i, j] + A[j, i])
            A[i, j] = mean
            A[j, i] = mean


@compiled
def update(A, H, r, dx):
    """Correct P in place by whitened measurements and fill dx = K r (n,). H: (m, n), r: (m,), noise of unit covariance."""
    m, n = H.shape
    R = identity(m)
    PHt = np.empty((n, m))
    S = np.empty((m, m))
    inverse = np.empty((m, m))
    innovation_covariance(A, H, R, PHt, S)
    if not invert(S, inverse) > 0.0:
        for a in range(m):
            for b in range(m):
                inverse[a, b] = np.nan  # P is not a covariance: said by what comes out, not hidden
    correct(A, PHt, S, inverse, r, dx, np.empty((n, m)), np.empty((2 * m, n)), -1, 0, n)
