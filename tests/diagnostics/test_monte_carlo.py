"""Seeded Monte-Carlo of the textbook models: the filter is as good as it says, and where it is set up wrongly, that is seen.

Truth starts where the filter's prior allows, is driven by the model's own noise and seen through the model's own sensor.
"""

from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from mavkf.diagnostics import consistency, judge_sensor
from mavkf.diagnostics.distributions import binomial_bound
from mavkf.diagnostics.records import SensorJudgement
from mavkf.filters import Filter, runge_kutta
from mavkf.filters.forms import noise_factor
from mavkf.models.textbook import constant_velocity, coordinated_turn, falling_body, van_der_pol

Array = np.ndarray
RUNS, STEPS = 40, 40
# model, order, dt (s), and the prior: with the paper's the falling body is not linear enough for any filter of these to be honest
CASES = {
    "constant_velocity": (constant_velocity, "first", 1.0, constant_velocity.P0),
    "coordinated_turn": (coordinated_turn, "first", 1.0, coordinated_turn.P0),
    "falling_body": (falling_body, "second-order", 0.5, np.diag([30.0, 3.0, 1.5e-5 / falling_body.FOOT]) ** 2),
    "van_der_pol": (van_der_pol, "second-order", 0.2, van_der_pol.P0),
}


def root(P: Array) -> Array:
    G, q = noise_factor(P)
    return np.asarray(G * np.sqrt(q))


def drawn(random: np.random.Generator, P: Array) -> Array:
    return np.asarray(root(P) @ random.normal(size=len(P)))


def advance(model: ModuleType, x: Array, dt: float, random: np.random.Generator) -> Array:
    """The truth after dt: a continuous one in small steps, each with its share of the noise."""
    if not hasattr(model, "Qc"):
        return np.asarray(model.f(x, None, dt) + drawn(random, model.Q(x, dt)))
    steps = 10
    for _ in range(steps):
        x = runge_kutta.fixed(lambda _, y: model.f(y, None), 0.0, x, dt / steps, 1) + drawn(
            random, model.Qc(x) * dt / steps
        )
    return x


def start(model: ModuleType) -> Array:
    return falling_body.TRUTH if model is falling_body else model.X0


def simulate(case: str, seed: int, steps: int = STEPS) -> tuple[Array, Array]:
    """Truths and measurements of a run."""
    model, _, dt, P0 = CASES[case]
    random = np.random.default_rng([seed, 77])
    x = start(model) + drawn(random, P0)
    truths, measured = [], []
    for _ in range(steps):
        x = advance(model, x, dt, random)
        truths.append(x)
        measured.append(model.h(x) + drawn(random, model.R))
    return np.array(truths), np.array(measured)


@pytest.mark.parametrize("case", CASES)
def test_as_good_as_it_says(case: str) -> None:
    """The mean over the runs lies inside its bounds of 95 % for as much of the time: NIS, and NEES, whose times are not independent."""
    model, order, dt, P0 = CASES[case]
    nis, nees = np.empty((RUNS, STEPS)), np.empty((RUNS, STEPS))
    for run in range(RUNS):
        kf = Filter(model, start(model), P0, order=order, steps=4)
        for i, (truth, z) in enumerate(zip(*simulate(case, run), strict=True)):
            kf.predict(dt)
            nis[run, i] = kf.update(z).nis
            nees[run, i] = consistency.squared((kf.x - truth)[None], kf.P[None])[0][0]
    for values, degrees, independent in ((nis, len(model.R), STEPS), (nees, len(P0), STEPS // 5)):
        low, high = consistency.bounds(degrees * RUNS, 0.05)
        means = values.mean(axis=0) / degrees
        inside = float(np.mean((means >= low) & (means <= high)))
        # how much of the time may be missing by chance, at one in a thousand
        assert 1.0 - inside <= binomial_bound(1e-3, independent, 0.05) / independent, (inside, low, high)
    assert consistency.judge(nis.ravel(), np.full(nis.size, len(model.R)), 1e-3).verdict == "fine"


def judged(
    seed: int, *, r_scale: float = 1.0, q_scale: float = 1.0, delay: float = 0.0, bias: float = 0.0
) -> SensorJudgement:
    """A vehicle that circles with an acceleration of 3 m/s^2, which the filter is told, and 400 fixes of it at 2 Hz.

    Wrong, if asked: R or Q of the filter by a factor; the fixes, older by `delay` (s) than the filter thinks; the acceleration that it is
    told, by `bias` (m/s^2) in the first axis.
    """
    dt, parts, count = 0.5, 5, 400
    random = np.random.default_rng([seed, 5])
    model = SimpleNamespace(**{name: getattr(constant_velocity, name) for name in ("f", "F", "h", "H")})
    model.Q = lambda x, dt: q_scale * constant_velocity.Q(x, dt)
    model.R = r_scale * constant_velocity.R
    x, path = constant_velocity.X0 + drawn(random, constant_velocity.P0), []
    kf = Filter(model, constant_velocity.X0, constant_velocity.P0, form="ud")
    shake, noise = root(constant_velocity.Q(x, dt / parts)), root(constant_velocity.R)
    records = []
    for i in range(count):
        u = 3.0 * np.array([np.sin(0.3 * i), np.cos(0.3 * i)])
        for _ in range(parts):
            x = constant_velocity.f(x, u, dt / parts) + shake @ random.normal(size=4)
            path.append(x[:2])
        late = round(delay / dt * parts)
        z = path[max(len(path) - 1 - late, 0)] + noise @ random.normal(size=2)
        kf.predict(dt, u + np.array([bias, 0.0]))
        records.append(kf.update(z))
    return judge_sensor(
        "gnss",
        np.array([record.t for record in records]),
        np.array([record.r for record in records]),
        np.array([record.S for record in records]),
        axes=("north", "east"),
    )


def off(judgement: SensorJudgement) -> set[str]:
    return {finding.name for finding in judgement.findings if finding.verdict == "off"}


@pytest.mark.parametrize("seed", range(4))
def test_a_right_filter_is_fine(seed: int) -> None:
    judgement = judged(seed)
    assert judgement.verdict == "fine"
    assert judgement.used == 400
    assert "nothing in its innovations" in judgement.sentence


@pytest.mark.parametrize(
    ("wrong", "seen_by"),
    [
        ({"r_scale": 0.3}, {"NIS", "coverage of NIS"}),
        ({"r_scale": 3.0}, {"NIS", "coverage of NIS"}),
        ({"q_scale": 0.02}, {"NIS", "autocorrelation", "Ljung-Box", "cumulative periodogram"}),
        ({"q_scale": 50.0}, {"NIS", "autocorrelation", "Ljung-Box", "cumulative periodogram"}),
    ],
)
@pytest.mark.parametrize("seed", range(2))
def test_a_wrong_q_or_r_is_detected(seed: int, wrong: dict[str, float], seen_by: set[str]) -> None:
    judgement = judged(seed, **wrong)
    assert judgement.verdict == "off"
    assert seen_by <= off(judgement)


@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_delay_is_detected(seed: int) -> None:
    judgement = judged(seed, delay=0.8)
    assert judgement.verdict == "off"
    assert {"autocorrelation", "cumulative periodogram"} <= off(judgement)
    assert "gnss" in judgement.sentence


@pytest.mark.parametrize("seed", range(3))
def test_an_unmodelled_bias_is_detected(seed: int) -> None:
    """Where it is, and in which direction: of the first axis alone; the filter expects too much acceleration, so the mean is negative."""
    judgement = judged(seed, bias=0.3)
    means = {finding.axis: finding for finding in judgement.findings if finding.name == "mean"}
    assert means["north"].verdict == "off"
    assert means["north"].value < 0.0
    assert means["east"].verdict == "fine"
