"""Each diagnostic alone: against SciPy or brute force, right about white Gaussian noise as often as it says, and about what is not."""

import numpy as np
import pytest
from scipy import stats

from mavkf.diagnostics import bias, consistency, covariance, divergence, linearisation, normality, whiteness
from mavkf.diagnostics.distributions import binomial_bound
from mavkf.errors import UsageError
from mavkf.models.textbook import coordinated_turn

Array = np.ndarray
N = 400


def white(seed: int, n: int = N) -> Array:
    return np.random.default_rng(seed).normal(size=n)


def coloured(seed: int, rho: float, n: int = N) -> Array:
    w, u = white(seed, n), np.zeros(n)
    for i in range(1, n):
        u[i] = rho * u[i - 1] + np.sqrt(1.0 - rho**2) * w[i]
    return u


JUDGES = {
    "autocorrelation": whiteness.judge_autocorrelation,
    "ljung_box": whiteness.judge_ljung_box,
    "periodogram": whiteness.judge_periodogram,
    "normality": normality.judge,
    "mean": bias.judge_mean,
    "trend": lambda u, p: bias.judge_trend(np.arange(len(u)) * 0.1, u, p),
    "nis": lambda u, p: consistency.judge(u**2, np.ones(len(u), dtype=int), p),
    "coverage": lambda u, p: consistency.judge_share(u**2, np.ones(len(u), dtype=int), p),
    "divergence": lambda u, p: divergence.judge(u[:, None], np.ones((len(u), 1, 1)), p),
}


@pytest.mark.parametrize("name", JUDGES)
@pytest.mark.parametrize("n", [60, N])
def test_false_alarms_are_as_rare_as_promised(name: str, n: int) -> None:
    """Of 300 sequences of a right filter one in twenty may be off: no more than chance allows, and not never either. So are p-values."""
    findings = [JUDGES[name](white(seed, n), 0.05) for seed in range(300)]
    off = sum(finding.verdict == "off" for finding in findings)
    assert off <= binomial_bound(1e-3, 300, 0.05)
    assert off >= 2  # all but 1e-5 of the time, at a true rate of 5 %; coverage and divergence have less
    for finding in findings:
        assert 0.0 <= finding.p_value <= 1.0
        assert finding.low <= finding.high
        if finding.verdict == "off":
            assert finding.p_value < 0.0501
        elif name != "divergence":
            assert finding.p_value > 0.0499


@pytest.mark.parametrize(
    ("name", "u", "word"),
    [
        ("autocorrelation", coloured(0, 0.4), "Innovations 1 apart are correlated by 0.39"),
        ("autocorrelation", coloured(0, -0.4), "Q is too large"),
        ("autocorrelation", np.tile(white(2, 7), 60)[:N], "Innovations 7 apart"),
        ("ljung_box", coloured(0, 0.3), "the past could have told more"),
        ("periodogram", coloured(0, 0.3), "low frequencies"),
        ("periodogram", coloured(0, -0.3), "high frequencies"),
        ("periodogram", white(3) + np.sin(np.arange(N) / 30.0), "low frequencies"),
        ("normality", np.random.default_rng(4).standard_t(3, size=N), "heavy tails"),
        ("normality", np.random.default_rng(4).uniform(-1.7, 1.7, size=N), "no tails"),
        ("normality", np.random.default_rng(4).exponential(size=N) - 1.0, "lean to one side"),
        ("mean", white(5) + 0.3, "biased"),
        ("trend", white(5) + np.linspace(-0.5, 0.5, N), "Innovations drift"),
        ("nis", white(6) * 1.3, "trusts itself or this sensor too much"),
        ("nis", white(6) * 0.7, "trusts itself or this sensor too little"),
        ("coverage", np.where(np.arange(N) % 10 == 0, 5.0, white(6)), "outliers"),
        ("coverage", white(6) * 0.5, "covariances are too large"),
        ("divergence", white(7) * np.linspace(0.5, 2.0, N), "The filter diverges"),
    ],
)
def test_what_is_wrong_is_seen_and_said(name: str, u: Array, word: str) -> None:
    finding = JUDGES[name](u, 0.001)
    assert finding.verdict == "off"
    assert word in finding.sentence
    assert not finding.low <= finding.value <= finding.high
    assert finding.p_value < 0.001
    assert finding.source


@pytest.mark.parametrize("name", JUDGES)
def test_short_and_constant_sequences(name: str) -> None:
    """Too few are unknown, and no number of equal ones divides by zero."""
    for n in (0, 1, 2):
        assert JUDGES[name](np.zeros(n), 0.05).verdict in ("unknown", "off" if name == "nis" else "unknown", "fine")
    JUDGES[name](np.zeros(50), 0.05)
    JUDGES[name](np.ones(50), 0.05)


def test_normality_is_scipys() -> None:
    for n in (20, 51, 400):
        for u in (
            white(n, n),
            np.random.default_rng(n).standard_t(3, size=n),
            np.random.default_rng(n).exponential(size=n),
        ):
            theirs = stats.normaltest(u)
            finding = normality.judge(u, 0.05)
            assert finding.value == pytest.approx(theirs.statistic, rel=1e-9)
            assert finding.p_value == pytest.approx(theirs.pvalue, rel=1e-6)


def test_mean_and_trend_are_scipys() -> None:
    u, t = white(1, 30) + 0.4, np.sort(np.random.default_rng(0).uniform(size=30))
    assert bias.judge_mean(u, 0.05).p_value == pytest.approx(stats.ttest_1samp(u, 0.0).pvalue, rel=1e-9)
    theirs = stats.linregress(t, u)
    finding = bias.judge_trend(t, u, 0.05)
    assert finding.value == pytest.approx(theirs.slope * (t[-1] - t[0]), rel=1e-9)
    assert finding.p_value == pytest.approx(theirs.pvalue, rel=1e-9)


def test_whiteness_by_its_definitions() -> None:
    """Each number from sums written out, and Kolmogorov's distance as SciPy has it."""
    u = coloured(3, 0.5, 41) + 2.0
    n, mean = len(u), sum(u) / len(u)
    power = sum((x - mean) ** 2 for x in u)
    rho = [sum((u[i] - mean) * (u[i + k] - mean) for i in range(n - k)) / power for k in range(1, 11)]
    np.testing.assert_allclose(whiteness.autocorrelation(u, 10), rho, rtol=1e-12)
    total = n * (n + 2) * sum(rho[k - 1] ** 2 / (n - k) for k in range(1, 11))
    finding = whiteness.judge_ljung_box(u, 0.05)
    assert finding.value == pytest.approx(total, rel=1e-12)
    assert finding.p_value == pytest.approx(stats.chi2(10).sf(total), rel=1e-9)
    times = np.arange(n)
    lines = [abs(np.sum((u - mean) * np.exp(-2j * np.pi * k * times / n))) ** 2 for k in range(1, 21)]
    share = np.cumsum(lines) / np.sum(lines)
    np.testing.assert_allclose(whiteness.cumulative_periodogram(u), share, rtol=1e-9)
    for v in (u, coloured(3, -0.5, 41)):
        distance = stats.kstest(whiteness.cumulative_periodogram(v)[:-1], "uniform").statistic
        assert whiteness.judge_periodogram(v, 0.05).value == pytest.approx(distance, rel=1e-9)


def test_nis_of_partial_measurements() -> None:
    random = np.random.default_rng(0)
    A = random.normal(size=(50, 3, 4))
    S = A @ A.transpose(0, 2, 1)
    r = random.normal(size=(50, 3))
    r[::3, 1], r[7] = np.nan, np.nan
    values, components = consistency.squared(r, S)
    assert components[7] == 0
    assert values[7] == 0.0
    assert components[3] == 2
    keep = [0, 2]
    assert values[3] == pytest.approx(r[3, keep] @ np.linalg.inv(S[3][np.ix_(keep, keep)]) @ r[3, keep])
    assert values[1] == pytest.approx(r[1] @ np.linalg.inv(S[1]) @ r[1])
    with pytest.raises(UsageError, match="must be"):
        consistency.squared(r, S[:, :2])


@pytest.mark.parametrize("k", [1, 3])
def test_a_gate_makes_what_passes_smaller(k: int) -> None:
    gate = 0.02
    limit = stats.chi2(k).isf(gate)
    values = np.random.default_rng(k).chisquare(k, size=40000)
    passed = values[values < limit]
    assert consistency.expected_in_gate(k, gate) == pytest.approx(passed.mean() / k, rel=0.02)
    components = np.full(len(passed), k)
    assert consistency.judge(passed, components, 0.001).verdict == "off"
    assert consistency.judge(passed, components, 0.001, gate=gate).verdict == "fine"
    assert consistency.judge_share(passed, components, 0.001).verdict == "off"
    assert consistency.judge_share(passed, components, 0.001, gate=gate).verdict == "fine"


def test_neglected_terms() -> None:
    """The share outside against brute force: a parabola, and a plane turned about a curved one."""
    random = np.random.default_rng(1)
    for curvature, n in ((0.0, 1), (0.3, 1), (1.0, 1), (0.6, 2)):
        P, R, H = np.eye(n), 0.5 * np.eye(n), np.eye(n)
        hessians = np.zeros((n, n, n))
        hessians[0, 0, 0] = curvature
        S = H @ P @ H.T + R
        share = linearisation.outside(hessians, P, S)
        e, v = random.normal(size=(200000, n)), random.normal(size=(200000, n)) * np.sqrt(0.5)
        innovation = e + 0.5 * np.einsum("aij,bi,bj->ba", hessians, e, e) + v
        nis = np.einsum("bi,ij,bj->b", innovation, np.linalg.inv(S), innovation)
        assert share == pytest.approx(
            np.mean(nis > stats.chi2(n).isf(0.05)), rel=0.2
        )  # the curved innovation is not Gaussian: its tail is near, not the same
        assert share >= 0.05 - 1e-12
    with pytest.raises(UsageError, match="positive definite"):
        linearisation.outside(np.zeros((1, 1, 1)), np.eye(1), np.zeros((1, 1)))


@pytest.mark.parametrize(("curvature", "verdict"), [(0.01, "fine"), (0.55, "marginal"), (2.0, "broken")])
def test_degrees_of_linearisation(curvature: float, verdict: str) -> None:
    share = linearisation.outside(np.full((1, 1, 1), curvature), np.eye(1), np.full((1, 1), 1.5))
    finding = linearisation.judge(np.full(5, share), "prediction")
    assert finding.verdict == verdict
    assert finding.name == "linearisation of the prediction"
    assert linearisation.judge(np.empty(0)).verdict == "unknown"


def test_a_radar_is_linear_from_afar() -> None:
    """A place known to 1 m along the line of sight and 50 m across: the range is curved at 200 m, straight at 20 km."""
    P = np.diag([1.0, 50.0**2, 1.0, 1.0, 1e-4])
    verdicts = []
    for distance in (200.0, 20000.0):
        x = np.array([distance, 0.0, 0.0, 0.0, 0.0])
        H = coordinated_turn.H(x)
        share = linearisation.outside(coordinated_turn.H_xx(x), P, H @ P @ H.T + coordinated_turn.R)
        verdicts.append(linearisation.judge(np.array([share])).verdict)
    assert verdicts == ["broken", "fine"]


def test_condition_and_symmetry() -> None:
    units = np.diag([1e6, 1e-6, 1.0])
    assert covariance.judge_condition(units @ units).value == pytest.approx(1.0)  # metres and radians do not matter
    for rest, verdict in ((0.1, "fine"), (1e-10, "marginal"), (0.0, "broken"), (-0.1, "broken")):
        P = units @ np.array([[1.0, 1.0 - rest, 0.0], [1.0 - rest, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ units
        assert covariance.judge_condition(P).verdict == verdict
    assert covariance.judge_condition(np.diag([1.0, 0.0])).verdict == "fine"  # a state known exactly
    assert covariance.judge_condition(np.full((2, 2), np.nan)).verdict == "broken"
    assert covariance.judge_symmetry(np.array([[1.0, 0.5], [0.5 + 1e-12, 1.0]])).verdict == "fine"
    assert covariance.judge_symmetry(np.array([[1.0, 0.5], [0.6, 1.0]])).verdict == "broken"
    assert covariance.judge_symmetry(np.zeros((2, 2))).verdict == "fine"
    with pytest.raises(UsageError, match="must be square"):
        covariance.judge_symmetry(np.zeros((2, 3)))


def test_growing_with_its_sigma_is_no_divergence() -> None:
    growth = np.linspace(0.5, 4.0, N)
    u, S = white(1)[:, None] * growth[:, None], np.square(growth)[:, None, None]
    assert divergence.judge(u, S, 0.001).verdict == "fine"
    finding = divergence.judge(u * growth[:, None], S, 0.001)
    assert finding.verdict == "fine"
    assert "it knows that it knows less" in finding.sentence
    assert divergence.judge(u * growth[:, None], S, 0.001, size=np.linspace(2.0, 1.0, N)).verdict == "off"
