"""Chi-square limits against published tables (Abramowitz and Stegun, table 26.8) and a sample."""

import numpy as np
import pytest

from mavkf.filters.chi_square import limit, survival

TABLE = {
    0.5: (0.455, 1.386, 2.366),
    0.05: (3.841, 5.991, 7.815),
    0.01: (6.635, 9.210, 11.345),
    0.001: (10.828, 13.816, 16.266),
    0.0001: (15.137, 18.421, 21.108),
}


@pytest.mark.parametrize("probability", TABLE)
@pytest.mark.parametrize("degrees", [1, 2, 3])
def test_table(probability: float, degrees: int) -> None:
    assert limit(probability, degrees) == pytest.approx(TABLE[probability][degrees - 1], abs=6e-4)


@pytest.mark.parametrize("degrees", [1, 2, 3])
def test_limit_is_the_inverse_of_survival(degrees: int) -> None:
    for probability in (0.999, 0.5, 0.1, 1e-3, 1e-6, 1e-9):
        assert survival(limit(probability, degrees), degrees) == pytest.approx(probability, rel=1e-6)


@pytest.mark.parametrize("degrees", [1, 2, 3])
def test_share_of_a_sample_beyond_the_limit(degrees: int) -> None:
    x = np.sum(np.random.default_rng(0).normal(size=(200_000, degrees)) ** 2, axis=1)
    for probability in (0.3, 0.05, 0.01):
        # four standard deviations of a binomial share
        assert np.mean(x > limit(probability, degrees)) == pytest.approx(
            probability, abs=4.0 * np.sqrt(probability / x.size)
        )
