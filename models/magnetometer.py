"""What a magnetometer shows: the earth's field turned into the body, and the field of the vehicle itself.

    m_b = C_nb' m_n + b

With the attitude error on the left, C_true' m = C' (m + [m x] dtheta), so the Jacobian of the attitude is C' [m x].
"""

from mavkf.compiled import kernel
from mavkf.models.strapdown import DFIELD, DIRON, EARTH_FIELD, IRON, THETA


@kernel
def predict(x, C, z_hat):
    """Field (3,) in b, tesla. x: nominal state, C: C_nb (3, 3)."""
    for i in range(3):
        z_hat[i] = x[IRON + i]
        for j in range(3):
            z_hat[i] += C[j, i] * x[EARTH_FIELD + j]


@kernel
def jacobian(x, C, H):
    """H (3, n) of `predict`."""
    for i in range(3):
        for j in range(H.shape[1]):
            H[i, j] = 0.0
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            # column j of [m x]: entry (k, j) is m_m, entry (m, j) is -m_k
            H[i, THETA + j] = C[k, i] * x[EARTH_FIELD + m] - C[m, i] * x[EARTH_FIELD + k]
            H[i, DFIELD + j] = C[j, i]
        H[i, DIRON + i] = 1.0
