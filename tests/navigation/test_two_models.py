"""Two models beside each other: hand-over with covariance, the choice by innovations, and the same bits live and in batch."""

from functools import cache

import numpy as np
import pytest

from mavkf.config import Config, with_settings
from mavkf.models.order import STATES_MOST
from mavkf.models.strapdown import BG, DBA, DBG, N
from mavkf.models.telemetry import DFORCE, DOMEGA, FORCE, OMEGA
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.imu_noise import unseen_share
from mavkf.navigation.offline import run_offline
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.propagation import begin
from mavkf.navigation.setup import choose, parameters
from mavkf.navigation.slow_imu import enter, leave
from mavkf.navigation.two_models import weigh_models
from mavkf.navigation.use_class import ROTORS, ROVER
from mavkf.samples import ARRIVAL, KIND, TIME, Kind

from ._session import CONFIG, differences, position_error, run, session

Array = np.ndarray
SLOW = (115.0, 135.0)  # s: when the link carries less
EAGER = with_settings(CONFIG, ["model.even_hz=8.0"])  # the rate speaks for telemetry below it


def thinned(rows: Array, hz: float, begin_s: float = -np.inf, end_s: float = np.inf) -> Array:
    """Rows with one IMU sample and one field in 1 / hz, between two times."""
    keep = np.ones(rows.shape[0], dtype=bool)
    for kind in (Kind.IMU, Kind.MAGNETOMETER):
        last = -np.inf
        for i in np.flatnonzero((rows[:, KIND] == kind) & (rows[:, TIME] > begin_s) & (rows[:, TIME] < end_s)):
            keep[i] = rows[i, TIME] >= last + 1.0 / hz - 1e-6
            if keep[i]:
                last = rows[i, TIME]
    return rows[keep]


@cache
def changing() -> Array:
    return thinned(session(duration=50.0), 3.0, *SLOW)


@pytest.mark.parametrize("seed", range(3))
def test_a_flight_on_which_the_model_changes_over_is_the_same_in_every_order(seed: int) -> None:
    rows = changing()
    batch = run_offline(rows, EAGER)
    changes = batch.output.notes[batch.output.notes[:, L.NOTE_CODE] == NoteCode.MODEL_CHANGED]
    assert changes[:, L.NOTE_A].tolist() == [L.STRAPDOWN, L.TELEMETRY, L.STRAPDOWN]
    assert SLOW[0] < changes[1, L.NOTE_END] < SLOW[0] + 5.0
    assert SLOW[1] < changes[2, L.NOTE_END] < SLOW[1] + 5.0
    random = np.random.default_rng(seed)
    late = rows.copy()
    late[:, ARRIVAL] = rows[:, ARRIVAL].min() + 1e6 * (
        rows[:, TIME] - rows[0, TIME] + random.uniform(0.0, 1.5, rows.shape[0]) * (rows[:, TIME] > 107.0)
    )
    late = late[np.argsort(late[:, ARRIVAL], kind="stable")]
    for arrived in (rows, late):
        estimator, output = run(arrived, config=EAGER)
        assert estimator.late == 0
        assert differences(estimator.state, batch.state) == []
        live = output.notes[output.notes[:, L.NOTE_CODE] == NoteCode.MODEL_CHANGED]
        # what is told live was told when it was first found, before the late fixes
        assert live[:, L.NOTE_A].tolist() == changes[:, L.NOTE_A].tolist()


def test_poses_stay_good_through_both_changes() -> None:
    poses = run_offline(changing(), EAGER, rate_hz=10.0).output.poses
    poses = poses[(poses[:, L.R_TIME] > 112.0) & np.isfinite(poses[:, L.R_LATITUDE])]
    assert {L.STRAPDOWN, L.TELEMETRY} == set(poses[:, L.R_MODEL])
    # the fixes are off by 0.8 m on each axis
    assert np.sqrt(np.mean(position_error(poses) ** 2)) < 0.8
    assert np.sqrt(np.mean(position_error(poses[poses[:, L.R_MODEL] == L.TELEMETRY]) ** 2)) < 0.8


def test_the_second_model_is_given_up_when_the_imu_is_fast_again() -> None:
    result = run_offline(changing(), EAGER)
    assert result.state[L.SECOND] == 0.0
    assert not np.any(result.state[L.HALF :])
    halfway = run_offline(changing()[changing()[:, TIME] < 130.0], EAGER)
    assert halfway.state[L.SECOND] == 1.0
    assert {halfway.state[L.MODEL], halfway.state[L.HALF + L.MODEL]} == {L.STRAPDOWN, L.TELEMETRY}


def test_innovations_overrule_the_rate() -> None:
    """A strong vibration that a slow IMU samples: integrated it is wrong, as a measurement it is averaged."""
    rows = thinned(session(duration=60.0), 4.0)
    random = np.random.default_rng(3)
    samples = rows[:, KIND] == Kind.IMU
    flying = samples & (rows[:, TIME] > 110.0)
    rows[np.ix_(flying, range(8, 11))] += 0.3 * random.normal(size=(int(flying.sum()), 3))
    rows[np.ix_(flying, range(11, 14))] += 3.0 * random.normal(size=(int(flying.sum()), 3))
    result = run_offline(rows, CONFIG)
    assert result.setup.model == "strapdown"
    leads = result.output.notes[result.output.notes[:, L.NOTE_CODE] == NoteCode.MODEL_CHANGED]
    assert leads[-1, L.NOTE_A] == L.TELEMETRY
    # and where the rate alone decides, it stays
    alone = run_offline(rows, with_settings(CONFIG, ["model.compare_hz=0.0"]))
    assert alone.state[L.MODEL] == L.STRAPDOWN


def test_telemetry_that_leads_alone_gives_way_when_the_imu_is_fast() -> None:
    s, e, c = state_with_covariance()
    s[L.MODEL] = s[L.WANTED] = L.TELEMETRY
    c[Parameter.COMPARE_HZ] = 8.0
    out = L.buffers(4, 4, 4)
    for period, wanted in ((0.11, L.TELEMETRY), (0.02, L.STRAPDOWN)):
        s[L.PERIOD] = period
        weigh_models(s, e, c, out)
        assert s[L.WANTED] == wanted


def state_with_covariance(vehicle_class: float = 0.0, antenna: float = 0.0) -> tuple[Array, Array, Array]:
    c = parameters(Config(), choose(np.empty((0, 24)), Config()))
    c[Parameter.CLASS], c[Parameter.ANTENNA_SIGMA] = vehicle_class, antenna
    s, e = np.empty(L.STATE_SIZE), np.zeros(L.EVENT_WIDTH)
    begin(s, c)
    random = np.random.default_rng(5)
    n = int(s[L.STATES])
    A = random.normal(size=(n, n))
    L.covariance(s)[:, :] = A @ A.T
    s[L.IMU : L.IMU + 6] = random.normal(size=6)
    s[BG : BG + 6] = random.normal(size=6)
    return s, e, c


@pytest.mark.parametrize(
    ("vehicle_class", "antenna", "states"),
    [(0.0, 0.0, N), (ROTORS, 0.0, N + 4), (0.0, 0.1, N + 7), (ROVER, 0.1, N + 7)],
)
def test_hand_over_keeps_the_covariance_and_adds_what_a_sample_tells(
    vehicle_class: float, antenna: float, states: int
) -> None:
    s, e, c = state_with_covariance(vehicle_class, antenna)
    before = L.covariance(s).copy()
    assert before.shape == (states, states)  # and none of the telemetry model's
    enter(s, e, c)
    P = L.covariance(s)
    assert P.shape == (STATES_MOST, STATES_MOST)
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > -1e-12
    # omega = z - bg: the errors are opposite, and differ by the sample's noise
    np.testing.assert_allclose(s[OMEGA : FORCE + 3], s[L.IMU : L.IMU + 6] - s[BG : BG + 6])
    np.testing.assert_array_equal(P[DOMEGA : DFORCE + 3, :states], -before[DBG : DBA + 3, :])
    noise = P[DOMEGA:, DOMEGA:] - before[DBG : DBA + 3, DBG : DBA + 3]
    assert np.all(np.diag(noise) > 0.0)
    np.testing.assert_allclose(noise - np.diag(np.diag(noise)), 0.0, atol=1e-12)
    leave(s)
    np.testing.assert_array_equal(L.covariance(s), before)


@pytest.mark.parametrize("signal", ["white", "walk", "smooth"])
def test_what_a_trapezoid_misses_is_what_the_differences_say(signal: str) -> None:
    """The error of the trapezoid over a fine signal of each kind, against dt^2 times the mean squared difference times the share."""
    random = np.random.default_rng(9)
    fine, n = 50, 4000
    t = np.arange(fine * n + 1) / fine  # dt = 1
    if signal == "walk":
        x = np.cumsum(random.normal(size=t.size)) / np.sqrt(fine)
        true = x
    elif signal == "smooth":
        x = np.sin(0.7 * t) + 0.5 * np.sin(0.31 * t)
        true = x
    else:
        true = np.zeros(t.size)
        x = random.normal(size=t.size)
    samples = x[::fine]
    whole = np.array([np.trapezoid(true[k * fine : (k + 1) * fine + 1], dx=1.0 / fine) for k in range(n)])
    error = 0.5 * (samples[1:] + samples[:-1]) - whole
    differences = np.diff(samples)
    square, product = np.mean(differences**2), np.mean(differences[1:] * differences[:-1])
    # what ten steps add up to, per step
    true_variance = np.mean(error.reshape(-1, 10).sum(1) ** 2) / 10.0
    said = square * unseen_share(square, product)
    if signal == "smooth":
        assert said > true_variance  # its errors cancel and add up again; they are never underestimated
        assert unseen_share(square, product) < 1.0 / 24.0
    else:
        assert said == pytest.approx(true_variance, rel=0.2)
