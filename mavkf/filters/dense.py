"""Small dense matrices in compiled loops: what the forms share. Orders of magnitude of n here are 2 to 40.

Loops, because numba's own products and decompositions call SciPy, which is no dependency. Arrays are float64 and C-ordered.
Golub and Van Loan, "Matrix Computations", 4th ed.: Cholesky section 4.2, Householder section 5.1, Gaussian elimination section 3.4.
"""

import math

import numpy as np

from mavkf.compiled import compiled

EPSILON = 2.220446049250313e-16


@compiled
def identity(n):
    """The unit matrix (n, n)."""
    E = np.zeros((n, n))
    for i in range(n):
        E[i, i] = 1.0
    return E


@compiled
def leading(A, n):
    """A copy of the first n columns of A."""
    B = np.empty((A.shape[0], n))
    for i in range(A.shape[0]):
        for j in range(n):
            B[i, j] = A[i, j]
    return B


@compiled
def transposed(A):
    """A copy of A', C-ordered."""
    B = np.empty((A.shape[1], A.shape[0]))
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            B[j, i] = A[i, j]
    return B


@compiled
def product(A, B):
    """A B, shapes (a, b) and (b, c)."""
    rows, inner = A.shape
    columns = B.shape[1]
    C = np.zeros((rows, columns))
    for i in range(rows):
        for k in range(inner):
            a = A[i, k]
            if a != 0.0:
                for j in range(columns):
                    C[i, j] += a * B[k, j]
    return C


@compiled
def outer_square(A):
    """A A', symmetric to the bit, shape (n, n) of A (n, k)."""
    n, inner = A.shape
    P = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(inner):
                total += A[i, k] * A[j, k]
            P[i, j] = total
            P[j, i] = total
    return P


@compiled
def add_noise(P, G, q):
    """P += G diag(q) G', in place. G: (n, k); q: (k,) variances of independent noises."""
    n, k = G.shape
    for c in range(k):
        if q[c] != 0.0:
            for i in range(n):
                a = G[i, c] * q[c]
                if a != 0.0:
                    for j in range(n):
                        P[i, j] += a * G[j, c]


@compiled
def cholesky(P):
    """Lower triangular L with L L' = P, of a positive semi-definite P (n, n); where a pivot is nothing but rounding its column is zero."""
    n = P.shape[0]
    L = np.zeros((n, n))
    for j in range(n):
        pivot = P[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        if math.isnan(pivot):
            for i in range(j, n):
                L[i, j] = np.nan
        elif pivot > n * EPSILON * P[j, j]:
            L[j, j] = math.sqrt(pivot)
            for i in range(j + 1, n):
                total = P[i, j]
                for k in range(j):
                    total -= L[i, k] * L[j, k]
                L[i, j] = total / L[j, j]
    return L


@compiled
def triangularise(A, columns):
    """Householder reflections from the left on A (rows, any), in place, until its first `columns` columns are upper triangular.

    This is the orthogonal transformation of all array forms: inner products of columns do not change. The part below is set to zero.
    """
    rows, width = A.shape
    for j in range(min(columns, rows)):
        size = 0.0
        for i in range(j, rows):
            size = max(size, abs(A[i, j]))
        if size == 0.0:
            continue
        norm = 0.0  # scaled, so that squares of small roots do not underflow
        for i in range(j, rows):
            norm += (A[i, j] / size) ** 2
        norm = size * math.sqrt(norm)
        # the sign that does not cancel; afterwards the row's sign is turned so that the diagonal is positive
        positive = A[j, j] > 0.0
        alpha = -norm if positive else norm
        first = A[j, j] - alpha
        # reflection 1 - v v' / (-alpha first) with v = (first, A[j+1:, j])
        scale = -alpha * first
        for c in range(j + 1, width):
            total = first * A[j, c]
            for i in range(j + 1, rows):
                total += A[i, j] * A[i, c]
            total /= scale
            A[j, c] -= total * first
            for i in range(j + 1, rows):
                A[i, c] -= total * A[i, j]
        A[j, j] = alpha
        for i in range(j + 1, rows):
            A[i, j] = 0.0
        if positive:
            for c in range(j, width):
                A[j, c] = -A[j, c]


@compiled
def solve(A, B):
    """X with A X = B by Gaussian elimination with partial pivoting; A (n, n) and B (n, k) are left alone. NaN where A is singular."""
    n, k = B.shape
    U = A.copy()
    X = B.copy()
    for j in range(n):
        best = j
        for i in range(j + 1, n):
            if abs(U[i, j]) > abs(U[best, j]):
                best = i
        if not abs(U[best, j]) > 0.0:
            for i in range(n):
                for c in range(k):
                    X[i, c] = np.nan
            return X
        for c in range(n):
            U[j, c], U[best, c] = U[best, c], U[j, c]
        for c in range(k):
            X[j, c], X[best, c] = X[best, c], X[j, c]
        for i in range(j + 1, n):
            factor = U[i, j] / U[j, j]
            if factor != 0.0:
                for c in range(j, n):
                    U[i, c] -= factor * U[j, c]
                for c in range(k):
                    X[i, c] -= factor * X[j, c]
    for c in range(k):
        for i in range(n - 1, -1, -1):
            total = X[i, c]
            for j in range(i + 1, n):
                total -= U[i, j] * X[j, c]
            X[i, c] = total / U[i, i]
    return X
