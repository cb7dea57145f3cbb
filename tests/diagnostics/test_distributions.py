"""The distributions against SciPy's, which the test extra brings along, over many orders of size."""

import pytest
from scipy import stats

from mavkf.diagnostics import distributions as mine
from mavkf.filters import chi_square

PROBABILITIES = [1e-6, 1e-3, 0.05, 0.5, 0.9, 0.999]


@pytest.mark.parametrize("degrees", [0.7, 1, 2, 3, 17, 200, 5000, 300000])
def test_chi_square(degrees: float) -> None:
    theirs = stats.chi2(degrees)
    for p in PROBABILITIES:
        x = mine.chi_square_quantile(p, degrees)
        assert x == pytest.approx(theirs.ppf(p), rel=1e-9)
        assert mine.chi_square(x, degrees) == pytest.approx(p, rel=1e-8)
        assert mine.chi_square_survival(x, degrees) == pytest.approx(theirs.sf(x), rel=1e-8)
    far = theirs.isf(1e-30)
    assert mine.chi_square_survival(far, degrees) == pytest.approx(1e-30, rel=1e-6)
    assert mine.chi_square(0.0, degrees) == 0.0
    assert mine.chi_square_survival(0.0, degrees) == 1.0


def test_is_the_filters_own_chi_square() -> None:
    for degrees in (1, 2, 3):
        for p in PROBABILITIES:
            assert mine.chi_square_quantile(1.0 - p, degrees) == pytest.approx(chi_square.limit(p, degrees), rel=1e-8)


@pytest.mark.parametrize("degrees", [1, 2, 10, 1000, 1e6])
def test_student(degrees: float) -> None:
    for p in PROBABILITIES:
        t = mine.student_bound(p, degrees)
        assert t == pytest.approx(stats.t(degrees).isf(p / 2.0), rel=1e-8)
        assert mine.student_two_sided(t, degrees) == pytest.approx(p, rel=1e-8)
        assert mine.student_two_sided(-t, degrees) == pytest.approx(p, rel=1e-8)


@pytest.mark.parametrize("degrees", [(1, 1), (3, 50), (400, 20), (3000, 3000)])
def test_f(degrees: tuple[int, int]) -> None:
    for p in PROBABILITIES:
        x = mine.f_bound(p, *degrees)
        assert x == pytest.approx(stats.f(*degrees).isf(p), rel=1e-7)
        assert mine.f_survival(x, *degrees) == pytest.approx(p, rel=1e-7)


@pytest.mark.parametrize(("trials", "success"), [(1, 0.5), (20, 0.05), (300, 0.95)])
def test_binomial(trials: int, success: float) -> None:
    for count in (0, 1, trials // 2, trials):
        expected = stats.binom(trials, success).sf(count - 1)
        assert mine.binomial_survival(count, trials, success) == pytest.approx(expected, rel=1e-9, abs=1e-300)
    for p in (0.2, 1e-3):
        assert mine.binomial_bound(p, trials, success) == stats.binom(trials, success).isf(p)


@pytest.mark.parametrize("count", [20, 100, 3000])
def test_kolmogorov(count: int) -> None:
    for p in (0.001, 0.05, 0.5):
        bound = mine.kolmogorov_bound(p, count)
        assert bound == pytest.approx(stats.kstwo(count).isf(p), rel=0.02)  # Stephens' correction is an approximation
        assert mine.kolmogorov_survival(bound, count) == pytest.approx(p, rel=1e-8)
    assert mine.kolmogorov_survival(0.0, count) == 1.0
