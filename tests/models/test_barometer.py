"""The standard atmosphere against its published table."""

import numpy as np
import pytest

from mavkf.models.barometer import pressure_at, pressure_height

# geopotential height (m) and static pressure (Pa): ISO 2533, table of the lower layers
TABLE = [(0.0, 101325.0), (1000.0, 89874.6), (2000.0, 79495.2), (5000.0, 54019.9)]


@pytest.mark.parametrize(("height", "pressure"), TABLE)
def test_heights_and_pressures_are_those_of_the_table(height: float, pressure: float) -> None:
    assert pressure_height(pressure) == pytest.approx(height, abs=0.1)
    assert pressure_at(height) == pytest.approx(pressure, abs=1.0)


def test_one_is_the_inverse_of_the_other() -> None:
    heights = np.linspace(-500.0, 9000.0, 20)
    np.testing.assert_allclose(pressure_height(pressure_at(heights)), heights, atol=1e-8)
