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

Lambda may be a larger matrix, of which the first n rows and columns are meant; n is the length of lambda.
"""

from mavkf.compiled import fused_kernel, kernel
from mavkf.filters.joseph import invert
from mavkf.stack import matrix, vector, zero_matrix, zero_vector


@fused_kernel
def back_over_transition(adjoint, Adjoint, Phi, index):
    """Take lambda (n,) and Lambda (n, n) back over a transition, in place.

    Phi (a, b) has the rows of the transition matrix that are not the identity's: those of the states index[:a], in the columns of the
    states index[:b]; in all other columns they are zero. index: (b,) whole numbers.
    """
    a, b = Phi.shape
    n = adjoint.shape[0]
    old = vector(a)
    for i in range(a):
        old[i] = adjoint[index[i]]
    for j in range(b):
        total = 0.0 if j < a else adjoint[index[j]]
        for i in range(a):
            total += Phi[i, j] * old[i]
        adjoint[index[j]] = total
    B = zero_matrix(b, n)  # the rows of Phi' Lambda that are not those of Lambda
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
    row = vector(b)
    for j in range(b):
        for k in range(b):
            row[k] = 0.0 if k < a else B[j, index[k]]
        for i in range(a):
            p = B[j, index[i]]
            for k in range(b):
                row[k] += p * Phi[i, k]
        for k in range(j, b):
            Adjoint[index[j], index[k]] = row[k]
            Adjoint[index[k], index[j]] = row[k]


@fused_kernel
def product(A, B, C):
    """Fill C (m, n) with A' B; A: (l, m), B: (l, n)."""
    m, n = C.shape
    for a in range(m):
        for j in range(n):
            C[a, j] = 0.0
        for i in range(A.shape[0]):
            p = A[i, a]
            if p != 0.0:
                for j in range(n):
                    C[a, j] += p * B[i, j]


@kernel
def symmetrise(A, n):
    """Give the first n rows and columns of A the mean of the two triangles."""
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (A[i, j] + A[j, i])
            A[i, j] = mean
            A[j, i] = mean


@fused_kernel
def exchange(adjoint, Adjoint, r, inverse, D, sign):
    """Pass to an estimate x + sign D r of covariance P - sign D S D', in place; returns whether that could be done.

    r: (m,), inverse: S^-1 (m, m), D: (n, m), sign: 1 or -1.
    """
    n, m = D.shape
    B = matrix(m, n)  # D' Lambda
    product(D, Adjoint, B)
    left, W, v = matrix(m, m), matrix(m, m), vector(m)
    for a in range(m):
        v[a] = 0.0
        for i in range(n):
            v[a] += D[i, a] * adjoint[i]
        for b in range(m):
            v[a] -= inverse[a, b] * r[b]
            left[a, b] = inverse[a, b]
            for i in range(n):
                left[a, b] -= sign * D[i, a] * B[b, i]
    if not invert(left, W) > 0.0:
        return False
    for a in range(m):
        for b in range(m):
            W[a, b] *= sign
    weighed = matrix(m, n)
    product(W, B, weighed)
    for a in range(m):
        for i in range(n):
            adjoint[i] += weighed[a, i] * v[a]
    for i in range(n):
        for a in range(m):
            p = weighed[a, i]
            for j in range(n):
                Adjoint[i, j] += p * B[a, j]
    symmetrise(Adjoint, n)
    return True


@fused_kernel
def back_over_correction(adjoint, Adjoint, r, inverse, H, K):
    """Take lambda (n,) and Lambda (n, n) back over a correction by the optimal gain, in place.

    r: (m,), inverse: S^-1 (m, m), H: (m, n), K: (n, m).
    """
    m, n = H.shape
    B = matrix(m, n)  # K' Lambda
    product(K, Adjoint, B)
    M, v = matrix(m, m), vector(m)  # K' Lambda K + S^-1
    for a in range(m):
        v[a] = 0.0
        for i in range(n):
            v[a] -= K[i, a] * adjoint[i]
        for b in range(m):
            v[a] += inverse[a, b] * r[b]
            M[a, b] = inverse[a, b]
            for i in range(n):
                M[a, b] += K[i, a] * B[b, i]
    # Lambda + H' C + C' H with C = M H / 2 - K' Lambda
    C = matrix(m, n)
    for a in range(m):
        for j in range(n):
            C[a, j] = -B[a, j]
        for b in range(m):
            half = 0.25 * (M[a, b] + M[b, a])
            for j in range(n):
                C[a, j] += half * H[b, j]
    row = zero_vector(n)
    for i in range(n):
        seen = False
        for j in range(n):
            row[j] = 0.0
        for a in range(m):
            h = H[a, i]
            if h != 0.0:
                seen = True
                adjoint[i] += h * v[a]
                for j in range(n):
                    row[j] += h * C[a, j]
        if seen:  # the same sums in both triangles: it stays symmetric to the bit
            for j in range(n):
                Adjoint[i, j] += row[j]
                Adjoint[j, i] += row[j]


@fused_kernel
def smoothed(P, adjoint, Adjoint, dx, P_smoothed):
    """Fill dx (n,) = P lambda and the first k rows and columns of P - P Lambda P; P: (n, n), P_smoothed: (k, k)."""
    n, k = P.shape[0], P_smoothed.shape[0]
    for i in range(n):
        dx[i] = 0.0
    for j in range(n):
        p = adjoint[j]
        for i in range(n):
            dx[i] += P[j, i] * p
    row, left = vector(n), vector(k)
    for i in range(k):
        for m in range(n):
            row[m] = 0.0
        for j in range(n):
            p = P[i, j]
            if p != 0.0:
                for m in range(n):
                    row[m] += p * Adjoint[j, m]
        for j in range(k):
            left[j] = P[i, j]
        for m in range(n):
            p = row[m]
            for j in range(k):
                left[j] -= p * P[m, j]
        for j in range(i + 1):
            P_smoothed[i, j] = left[j]
            P_smoothed[j, i] = left[j]
