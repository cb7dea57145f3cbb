"""The information form: the inverse of the covariance, Y = P^-1, and the information vector y = Y dx.

    update       Y <- Y + H' H,   y <- y + H' r
    prediction   M = Phi^-T Y Phi^-1,   Y <- M - M G (diag(q)^-1 + G' M G)^-1 G' M,   and y likewise

Fraser, "A New Technique for the Optimal Smoothing of Data" (1967); Maybeck, "Stochastic Models, Estimation, and Control", vol. 1 (1979),
section 5.7. An update is a sum, and knowing nothing (Y = 0) is a number. Where Y is singular the state cannot be told yet: y keeps what was
learnt, relative to the state as it stands, and moves it once it can be. Phi must be invertible. The form's own array is [Y | y], shape
(n, n + 1).
"""

import math

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.dense import EPSILON, cholesky, identity, leading, product, solve, transposed


@compiled
def from_covariance(P):
    """[P^-1 | 0], shape (n, n + 1), of a positive definite P; NaN where P is singular."""
    n = P.shape[0]
    A = np.zeros((n, n + 1))
    Y = solve(P, identity(n))
    for i in range(n):
        for j in range(n):
            A[i, j] = 0.5 * (Y[i, j] + Y[j, i])
    return A


@compiled
def is_determined(Y):
    """Whether Y (n, n) is positive definite by more than rounding, each state on its own scale."""
    n = Y.shape[0]
    scaled = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            if not (Y[i, i] > 0.0 and Y[j, j] > 0.0):
                return False
            scaled[i, j] = Y[i, j] / math.sqrt(Y[i, i] * Y[j, j])
    L = cholesky(scaled)
    regular = True
    for i in range(n):
        regular = regular and L[i, i] * L[i, i] > 4.0 * n * EPSILON
    return regular


@compiled
def to_covariance(A):
    """P = Y^-1 (n, n); NaN where Y is singular: not known yet."""
    n = A.shape[0]
    Y = leading(A, n)
    P = np.full((n, n), np.nan)
    if is_determined(Y):
        P = solve(Y, identity(n))
        for i in range(n):
            for j in range(i):
                P[i, j] = 0.5 * (P[i, j] + P[j, i])
                P[j, i] = P[i, j]
    return P


@compiled
def predict(A, Phi, G, q):
    """Y and y over one transition, in place. Phi: (n, n) invertible, G: (n, k), q: (k,) variances, none negative (zero is allowed).

    With W = G sqrt(q) the inverse in the middle is that of 1 + W' M W, which exists for any q.
    """
    n = A.shape[0]
    k = q.shape[0]
    Phit = transposed(Phi)
    B = solve(Phit, A)  # Phi^-T [Y | y]
    M = solve(Phit, transposed(leading(B, n)))  # Phi^-T Y Phi^-1
    W = np.empty((n, k))
    for i in range(n):
        for c in range(k):
            W[i, c] = G[i, c] * math.sqrt(q[c])
    MW = product(M, W)
    inner = np.empty((k, k))
    right = np.empty((k, n + 1))
    for a in range(k):
        for b in range(k):
            total = 1.0 if a == b else 0.0
            for i in range(n):
                total += W[i, a] * MW[i, b]
            inner[a, b] = total
        right[a, n] = 0.0
        for i in range(n):
            right[a, i] = MW[i, a]
            right[a, n] += W[i, a] * B[i, n]
    taken = product(MW, solve(inner, right))
    for i in range(n):
        for j in range(n):
            A[i, j] = 0.5 * (M[i, j] + M[j, i] - taken[i, j] - taken[j, i])
        A[i, n] = B[i, n] - taken[i, n]


@compiled
def update(A, H, r, dx):
    """Add the information of whitened measurements in place and fill dx (n,): zero while Y is singular. H: (m, n), r: (m,)."""
    m, n = H.shape
    for a in range(m):
        for i in range(n):
            h = H[a, i]
            if h != 0.0:
                for j in range(n):
                    A[i, j] += h * H[a, j]
                A[i, n] += h * r[a]
    for i in range(n):
        dx[i] = 0.0
    Y = leading(A, n)
    if is_determined(Y):
        y = np.empty((n, 1))
        for i in range(n):
            y[i, 0] = A[i, n]
        moved = solve(Y, y)
        for i in range(n):
            dx[i] = moved[i, 0]
            A[i, n] = 0.0
