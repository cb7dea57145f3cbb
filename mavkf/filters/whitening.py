"""Measurements as independent ones of unit variance: what every form's update takes.

    R = L L',   H_w = L^-1 H,   r_w = L^-1 r

Bierman, "Factorization Methods for Discrete Sequential Estimation" (1977), chapter III. A component that is missing (NaN in r) is left
out before R is factored, so that what is left keeps the correlations among itself.
"""

import math

import numpy as np

from mavkf.compiled import compiled


@compiled
def whiten(H, R, r, H_w, r_w):
    """Fill the first rows of H_w (m, n) and r_w (m,) with the whitened rows of H and r; return how many there are.

    H: (m, n), R: (m, m) positive definite, r: (m,) with NaN for what is missing, all left alone. Returns -1 where the R of the
    components at hand is not positive definite.
    """
    m, n = H.shape
    used = 0
    L = R.copy()
    index = np.empty(m, np.int64)
    for a in range(m):
        if math.isnan(r[a]):
            continue
        index[used] = a
        for b in range(used + 1):
            total = 0.5 * (R[a, index[b]] + R[index[b], a])
            for k in range(b):
                total -= L[used, k] * L[b, k]
            if b < used:
                L[used, b] = total / L[b, b]
            elif total > 0.0:
                L[used, used] = math.sqrt(total)
            else:
                return -1
        for i in range(n):
            value = H[a, i]
            for k in range(used):
                value -= L[used, k] * H_w[k, i]
            H_w[used, i] = value / L[used, used]
        value = r[a]
        for k in range(used):
            value -= L[used, k] * r_w[k]
        r_w[used] = value / L[used, used]
        used += 1
    return used
