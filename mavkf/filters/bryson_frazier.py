"""Fixed-interval smoothing by the modified Bryson-Frazier recursions: backward over what a forward filter did, with no inverse of P.

Bierman, "Fixed interval smoothing with discrete measurements", International Journal of Control 18(1), 1973. What the measurements after
some moment say of the state at that moment is an adjoint lambda with its covariance Lambda, both zero behind the last of them. With
the filter's estimate x and covariance P at any moment

    x_smoothed = x + P lambda        P_smoothed = P - P Lambda P

(Bierman's lambda has the other sign.) Backward over a correction by the innovation r of covariance S, and over a transition Phi:

    lambda <- (I - K H)' lambda + H' S^-1 r        Lambda <- (I - K H)' Lambda (I - K H) + H' S^-1 H
    lambda <- Phi' lambda                          Lambda <- Phi' Lambda Phi

Process noise does not enter: it is in P. So noise that is added at any other time passes unchanged, and a state that is replaced by a new,
independent one is a transition with a row of zeros.

The correction is that of the optimal gain P H' S^-1. Where the filter used less, K = P H' S^-1 - D with a considered state (Schmidt),
its covariance is larger than the optimal one by D S D'. Now lambda = Lambda (x_later - x) and Lambda = (P + Omega^-1)^-1, where Omega is
the information in what comes later: it does not depend on the gain. So for an exchange of x and P for x + D r and P - D S D' (Woodbury)

    lambda <- lambda + Lambda D W (D' lambda - S^-1 r)    Lambda <- Lambda + Lambda D W D' Lambda    W = (S^-1 - D' Lambda D)^-1

and then the correction. The smoothed estimate is then the best one of the filter's at its time and of everything measured later, as if
the filter had used the optimal gain from that time on. The other way round, with x - G r and P + G S G' where G = P H' S^-1, it takes a
measurement out: that goes back over a correction as if it had not been made.
"""

import numpy as np

from mavkf.compiled import compiled
from mavkf.filters.joseph import invert


@compiled
def back_over_transition(adjoint, Adjoint, Phi, index):
    """Take lambda (n,) and Lambda (n, n) back over a transition, in place.

    Phi (a, b) has the rows of the transition matrix that are not the identity's: those of the states index[:a], in the columns of the
    states index[:b]; in all other columns they are zero. index: (b,) whole numbers.
    """
    a, b = Phi.shape
    n = adjoint.shape[0]
    old = np.empty(a)
    for i in range(a):
        old[i] = adjoint[index[i]]
    for j in range(b):
        total = 0.0 if j < a else adjoint[index[j]]
        for i in range(a):
            total += Phi[i, j] * old[i]
        adjoint[index[j]] = total
    B = np.zeros((b, n))  # the rows of Phi' Lambda that are not those of Lambda
    for j in range(b):
        if j >= a:
            for k in range(n):
                B[j, k] = Adjoint[index[j], k]
        for i in range(a):
            p = Phi[i, j]
            if p != 0.0:
                for k in range(n):
                    B[j, k] += p * Adjoint[index[i], k]
    for j in range(b):
        for k in range(n):
            Adjoint[index[j], k] = B[j, k]
            Adjoint[k, index[j]] = B[j, k]
    for j in range(b):
        for k in range(j, b):
            total = 0.0 if k < a else B[j, index[k]]
            for i in range(a):
                total += B[j, index[i]] * Phi[i, k]
            Adjoint[index[j], index[k]] = total
            Adjoint[index[k], index[j]] = total


@compiled
def symmetrise(A):
    """Give A (n, n) the mean of its two triangles."""
    for i in range(A.shape[0]):
        for j in range(i):
            mean = 0.5 * (A[i, j] + A[j, i])
            A[i, j] = mean
            A[j, i] = mean


@compiled
def exchange(adjoint, Adjoint, r, inverse, D, sign):
    """Pass to an estimate x + sign D r of covariance P - sign D S D', in place; returns whether that could be done.

    r: (m,), inverse: S^-1 (m, m), D: (n, m), sign: 1 or -1.
    """
    n, m = D.shape
    B = np.zeros((n, m))
    for i in range(n):
        for j in range(n):
            for a in range(m):
                B[i, a] += Adjoint[i, j] * D[j, a]
    left = np.empty((m, m))
    W = np.empty((m, m))
    v = np.empty(m)
    for a in range(m):
        v[a] = 0.0
        for i in range(n):
            v[a] += D[i, a] * adjoint[i]
        for b in range(m):
            v[a] -= inverse[a, b] * r[b]
            left[a, b] = inverse[a, b]
            for i in range(n):
                left[a, b] -= sign * D[i, a] * B[i, b]
    if not invert(left, W) > 0.0:
        return False
    for i in range(n):
        for a in range(m):
            weighed = 0.0
            for b in range(m):
                weighed += sign * B[i, b] * W[b, a]
            adjoint[i] += weighed * v[a]
            for j in range(n):
                Adjoint[i, j] += weighed * B[j, a]
    symmetrise(Adjoint)
    return True


@compiled
def back_over_correction(adjoint, Adjoint, r, inverse, H, K):
    """Take lambda (n,) and Lambda (n, n) back over a correction by the optimal gain, in place.

    r: (m,), inverse: S^-1 (m, m), H: (m, n), K: (n, m).
    """
    m, n = H.shape
    B = np.zeros((n, m))  # Lambda K
    for i in range(n):
        for j in range(n):
            for a in range(m):
                B[i, a] += Adjoint[i, j] * K[j, a]
    M = np.empty((m, m))  # K' Lambda K + S^-1
    v = np.empty(m)
    for a in range(m):
        v[a] = 0.0
        for i in range(n):
            v[a] -= K[i, a] * adjoint[i]
        for b in range(m):
            v[a] += inverse[a, b] * r[b]
            M[a, b] = inverse[a, b]
            for i in range(n):
                M[a, b] += K[i, a] * B[i, b]
    for a in range(m):
        for i in range(n):
            h = H[a, i]
            if h != 0.0:
                adjoint[i] += h * v[a]
                for j in range(n):
                    Adjoint[i, j] -= h * B[j, a]
                    Adjoint[j, i] -= h * B[j, a]
                for b in range(m):
                    for j in range(n):
                        Adjoint[i, j] += h * M[a, b] * H[b, j]
    symmetrise(Adjoint)


@compiled
def smoothed(P, adjoint, Adjoint, dx, P_smoothed):
    """Fill dx (n,) = P lambda and the first k rows and columns of P - P Lambda P; P: (n, n), P_smoothed: (k, k)."""
    n, k = P.shape[0], P_smoothed.shape[0]
    for i in range(n):
        dx[i] = 0.0
        for j in range(n):
            dx[i] += P[i, j] * adjoint[j]
    A = np.zeros((k, n))
    for i in range(k):
        for j in range(n):
            p = P[i, j]
            if p != 0.0:
                for m in range(n):
                    A[i, m] += p * Adjoint[j, m]
    for i in range(k):
        for j in range(i + 1):
            total = P[i, j]
            for m in range(n):
                total -= A[i, m] * P[j, m]
            P_smoothed[i, j] = total
            P_smoothed[j, i] = total
