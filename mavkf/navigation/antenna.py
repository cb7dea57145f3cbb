"""The lever arm of the GNSS antenna in the fold: where it can be laid into n, and what is left uncertain where it cannot."""

import math

from mavkf.compiled import kernel
from mavkf.models import gnss
from mavkf.models.order import ANTENNA
from mavkf.models.rotation import rotation_matrix
from mavkf.models.strapdown import POS, Q
from mavkf.navigation import layout as L
from mavkf.navigation.parameter import Parameter
from mavkf.stack import matrix


@kernel
def mounting(s, C, w):
    """Fill C (3, 3) with C_nb and w (3,) with omega_b; zeros where no lever arm can be laid into n: heading or rate are not known."""
    for i in range(3):
        w[i] = 0.0
        for j in range(3):
            C[i, j] = 0.0
    if s[L.ALIGNED] != 0.0 and s[L.YAW_KNOWN] != 0.0:
        rotation_matrix(s[Q : Q + 4], C)
        for i in range(3):
            w[i] = s[L.RATE + i] if math.isfinite(s[L.RATE + i]) else 0.0


@kernel
def unknown_lever(s, c):
    """One sigma (m) of an axis for a lever arm that cannot be laid into n: it stays as it is for as long as the heading does."""
    if s[L.ALIGNED] != 0.0 and s[L.YAW_KNOWN] != 0.0:
        return 0.0
    square = s[ANTENNA] ** 2 + s[ANTENNA + 1] ** 2 + s[ANTENNA + 2] ** 2
    return math.sqrt(0.5 * square + c[Parameter.ANTENNA_SIGMA] ** 2)


@kernel
def carry_lever(s, C, w):
    """Position errors (3) that were just cut loose get the part that comes from attitude and lever arm: dp = -H_l dx."""
    P = L.covariance(s)
    H = matrix(3, P.shape[0])
    gnss.lever_jacobian(s[L.X : L.P], C, w, 1.0, 0.0, H)
    for i in range(3):
        for j in range(P.shape[0]):
            if j < POS or j >= POS + 3:
                total = 0.0
                for k in range(P.shape[0]):
                    total -= H[i, k] * P[k, j]
                P[POS + i, j] += total
                P[j, POS + i] = P[POS + i, j]
    for i in range(3):
        for m in range(i, 3):
            for k in range(P.shape[0]):
                if k < POS or k >= POS + 3:
                    P[POS + i, POS + m] -= H[m, k] * P[POS + i, k]
            P[POS + m, POS + i] = P[POS + i, POS + m]
