"""The status says whether the first order is enough: on an honest flight it is, for a filter that knows little it is not."""

import numpy as np
import pytest

from mavkf.estimate import Status
from mavkf.models.strapdown import THETA, Q
from mavkf.navigation import layout as L
from mavkf.navigation.pose import pose_row
from mavkf.replay.linearity import shares_at
from mavkf.replay.options import Options, Watch
from mavkf.replay.results import SessionResult
from mavkf.replay.run import run
from mavkf.replay.simulation import simulate
from mavkf.service.judgement import CONDITION_EVERY, Judgement
from mavkf.service.linearisation import EVERY, RecentLinearisation


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[SessionResult, list[Status]]:
    log = tmp_path_factory.mktemp("linearisation") / "flight.tlog"
    simulate(log, seed=5, duration_s=80.0, imu_hz=50.0)
    statuses: list[Status] = []
    watch = Watch(step=lambda stream, step: statuses.append(step.status) if step.status is not None else None)
    (session,) = run(log, Options(as_live=True), watch).sessions
    return session, statuses


def test_an_honest_flight_is_linear_enough(flown: tuple[SessionResult, list[Status]]) -> None:
    last = flown[1][-1].linearisation
    assert set(last) == {"gnss_position", "gnss_velocity", "magnetometer", "prediction"}
    for found in last.values():
        assert found.verdict == "fine" and "first order is enough" in found.sentence
        assert 0.05 <= found.outside < 0.06


def test_nothing_is_said_before_there_is_a_state(flown: tuple[SessionResult, list[Status]]) -> None:
    said = [bool(status.linearisation) for status in flown[1]]
    known = [status.valid.position and status.valid.yaw for status in flown[1]]
    assert said == known and not said[0] and said[-1]


def test_a_filter_that_knows_little_is_told_so(flown: tuple[SessionResult, list[Status]]) -> None:
    session, _ = flown
    state, row = session.state.copy(), np.zeros(L.POSE_WIDTH)
    pose_row(state, session.parameters, row)
    recent = RecentLinearisation()
    recent.take(session.output.innovations)
    now = float(row[L.R_TIME])
    assert recent.report(now, row, state)["prediction"].verdict == "fine"
    P = L.covariance(state)
    for i in range(THETA, THETA + 3):
        P[i, :], P[:, i], P[i, i] = 0.0, 0.0, 0.5  # rad^2
    assert recent.report(now + 0.5 * EVERY, row, state)["prediction"].verdict == "fine"  # it is not yet time
    for k in range(1, 9):
        found = recent.report(now + k * EVERY, row, state)
    assert found["prediction"].verdict == "broken" and "not enough" in found["prediction"].sentence


def test_of_a_covariance_that_is_not_finite_nothing_is_said() -> None:
    x = np.zeros(L.X_SIZE)
    x[Q] = 1.0
    assert list(shares_at(x, np.full((30, 30), np.nan), np.zeros(3), np.zeros(3), {}, 0.2)) == []


def test_the_condition_of_the_covariance_is_looked_at_every_fifth_time(
    flown: tuple[SessionResult, list[Status]],
) -> None:
    session, statuses = flown
    assert all(status.condition is None or 1.0 <= status.condition < 1e8 for status in statuses)
    state, row = session.state.copy(), np.zeros(L.POSE_WIDTH)
    pose_row(state, session.parameters, row)
    judgement, found = Judgement(), []
    for k in range(CONDITION_EVERY + 1):
        found.append(judgement.report(float(k), row, state, 50.0)["condition"])
        P = L.covariance(state)
        P[:, :] = np.diag(np.diag(P))
        P[THETA, THETA + 1] = P[THETA + 1, THETA] = 0.5 * np.sqrt(P[THETA, THETA] * P[THETA + 1, THETA + 1])
    assert len(set(found[:-1])) == 1 and found[0] > 10.0
    assert found[-1] == pytest.approx(3.0)  # the eigenvalues of two correlated by a half: 1.5 and 0.5
