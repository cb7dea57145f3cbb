"""What a barometer shows: the height in the standard atmosphere, with a bias that follows the weather."""

from mavkf.compiled import compiled
from mavkf.models.strapdown import BARO, DBARO, HEIGHT, POS

SEA_LEVEL, SCALE, EXPONENT = (
    101325.0,
    44330.769,
    0.190263,
)  # Pa, m, of the International Standard Atmosphere below 11 km (ISO 2533)


@compiled
def pressure_height(pressure):
    """Height (m) in the standard atmosphere of a static pressure (Pa)."""
    return SCALE * (1.0 - (pressure / SEA_LEVEL) ** EXPONENT)


@compiled
def pressure_at(height):
    """Static pressure (Pa) at a height (m) in the standard atmosphere: the inverse of `pressure_height`."""
    return SEA_LEVEL * (1.0 - height / SCALE) ** (1.0 / EXPONENT)


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
