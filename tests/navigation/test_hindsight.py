"""What a whole flight tells of its sensors: the noise of a receiver's velocity."""

import math

import numpy as np
import pytest

from mavkf.navigation import layout as L
from mavkf.navigation.codes import SENSORS, Sensor
from mavkf.navigation.events import EventOrder
from mavkf.navigation.hindsight import BEST_SPEED, Scatter, Surprise, look_back
from mavkf.navigation.offline import run_offline
from mavkf.navigation.propagation import begin
from mavkf.navigation.smoothing import fold_block
from mavkf.samples import KIND, SIGMA_SPEED, Kind

from ._session import CONFIG, session

NO_NOTES, NO_FAULTS = np.zeros((0, L.NOTE_WIDTH)), np.zeros((0, 3))


def autoregressive(sigma: float, rho: float, count: int, seed: int) -> np.ndarray:
    """(count, 2) of an autoregressive process of first order."""
    draws = np.random.default_rng(seed).normal(size=(count, 2))
    values = draws * sigma
    for k in range(1, count):
        values[k] = rho * values[k - 1] + math.sqrt(1.0 - rho * rho) * sigma * draws[k]
    return values


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_what_lingers_counts_by_the_variance_of_its_mean(rho: float) -> None:
    n, count = 400, 2000
    means = [autoregressive(0.05, rho, n, seed).mean(axis=0) for seed in range(count // 10)]
    equivalent = math.sqrt(n * np.mean(np.square(means)))  # white noise whose mean of n scatters as much
    scatter = Scatter()
    values = autoregressive(0.05, rho, 4000, 1)
    for part in np.array_split(values, 37):
        scatter.take(part)
    # the noisiest of forty stretches is noisier than all of them together, more so where fewer of them are independent
    assert equivalent < scatter.sigma < 1.9 * equivalent


def test_the_noisiest_stretch_counts_and_parts_do_not() -> None:
    values = np.random.default_rng(3).normal(scale=0.03, size=(1000, 2))
    values[300:450] *= 5.0
    whole, parts = Scatter(), Scatter()
    whole.take(values)
    for k in range(0, 1000, 7):
        parts.take(values[k : k + 7])
    assert whole.sigma == pytest.approx(parts.sigma, rel=1e-12)
    assert 0.12 < whole.sigma < 0.2


def velocities(source: float, r: np.ndarray) -> np.ndarray:
    rows = np.ones((len(r), L.INNOVATION_WIDTH))
    rows[:, L.I_SENSOR], rows[:, L.I_SOURCE] = Sensor.GNSS_VELOCITY.value, source
    rows[:, L.I_R : L.I_R + 2] = r
    return rows


def test_the_worse_of_two_receivers_is_what_is_known() -> None:
    good, bad = (np.random.default_rng(k).normal(scale=scale, size=(300, 2)) for k, scale in ((1, 0.03), (2, 0.1)))
    surprise, mixed = Surprise(), np.empty((600, L.INNOVATION_WIDTH))
    mixed[0::2], mixed[1::2] = velocities(6.0, good), velocities(7.0, bad)
    surprise.take(mixed)
    alone = Scatter()
    alone.take(bad)
    assert surprise.speed_sigma == alone.sigma
    surprise.take(velocities(8.0, good[:50]))  # one that has not told enough
    assert surprise.speed_sigma == math.inf


@pytest.mark.parametrize(("scale", "known"), [(0.0, BEST_SPEED), (0.06, 0.06), (0.3, None)])
def test_a_velocity_is_known_where_it_is_better_than_was_believed(scale: float, known: float | None) -> None:
    done = run_offline(session(8.0), CONFIG)
    surprise = Surprise()
    surprise.take(velocities(6.0, np.random.default_rng(5).normal(scale=scale, size=(300, 2)) + 1e-9))
    hindsight = look_back(done.state, done.parameters, surprise, NO_NOTES)
    held = dict(hindsight.held)
    if known is None:
        assert L.KNOWN_SPEED not in held
    else:
        assert held[L.KNOWN_SPEED] == pytest.approx(known, rel=0.25)
        assert any(f"{held[L.KNOWN_SPEED]:.2f} m/s" in sentence for sentence in hindsight.words)


@pytest.mark.parametrize(
    ("known", "claim", "least", "most"),
    [(0.0, 0.02, 0.2, 0.3), (0.05, 0.02, 0.05, 0.1), (0.05, 0.6, 0.2, 0.7)],
    ids=["floor", "known", "a fix that claims to be bad is one"],
)
def test_a_known_velocity_is_weighed_by_what_is_known(known: float, claim: float, least: float, most: float) -> None:
    rows = session(30.0)
    rows[rows[:, KIND] == Kind.GNSS, SIGMA_SPEED] = claim
    done = run_offline(rows, CONFIG)
    events = np.concatenate(list(EventOrder(done.setup, 3.0).push(rows, last=True)))
    state, out, poses = np.empty(L.STATE_SIZE), L.buffers(4096, 512, SENSORS, 0), np.empty((9, L.POSE_WIDTH))
    begin(state, done.parameters)
    held = np.array([[float(L.KNOWN_SPEED), known]])
    variances = []
    for k in range(len(events)):
        fold_block(state, events[k : k + 1], -1, 0, done.parameters, 1.0, held, NO_FAULTS, poses, out)
        innovations = out[0][: out[2][0]]
        mine = innovations[innovations[:, L.I_SENSOR] == Sensor.GNSS_VELOCITY.value]
        variances += [row[L.I_S : L.I_S + 9].reshape(3, 3).diagonal() for row in mine]
    north, _, down = np.sqrt(np.min(variances, axis=0))
    assert least < north < most
    assert down > 1.5 * CONFIG.noise.gnss_speed_floor_m_s  # of the vertical nothing is known
