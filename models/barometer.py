"""What a barometer shows: the height in the standard atmosphere, with a bias that follows the weather."""

from mavkf.compiled import compiled
from mavkf.models.strapdown import BARO, DBARO, HEIGHT, POS


@compiled
def pressure_height(pressure):
    """Height (m) in the International Standard Atmosphere of a static pressure (Pa), below 11 km (ISO 2533)."""
    return 44330.769 * (1.0 - (pressure / 101325.0) ** 0.190263)


@compiled
def predict(x):
    """Pressure height (m) of a nominal state."""
    return x[HEIGHT] + x[BARO]


@compiled
def jacobian(H):
    """H (1, n) of `predict`; the position error is down, the height is up."""
    for j in range(H.shape[1]):
        H[0, j] = 0.0
    H[0, POS + 2] = -1.0
    H[0, DBARO] = 1.0
