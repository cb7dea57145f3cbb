"""Other forms and orders on the fold's flight: the same estimates, over resets, outages and a slow IMU; the orders where they matter."""

import numpy as np
import pytest

from benchmarks.forms import differences
from mavkf.config import with_settings
from mavkf.errors import UsageError
from mavkf.filters.forms import FORMS
from mavkf.models.strapdown import DDELAY
from mavkf.navigation import layout as L
from mavkf.navigation import tape as T
from mavkf.navigation.codes import SENSORS, NoteCode
from mavkf.navigation.events import EventOrder
from mavkf.navigation.form_flight import ENTRIES
from mavkf.navigation.form_steps import FormSteps
from mavkf.navigation.offline import Offline, run_offline
from mavkf.navigation.propagation import begin
from mavkf.navigation.relinearise import composed, left_jacobian
from mavkf.navigation.smoothing import fold_block
from mavkf.replay.faults import apply_faults, parse_fault
from mavkf.samples import KIND, Kind, Source

from ._session import CONFIG, Array, position_error, session, without

RATE = 4.0  # Hz of poses
SAME = 1e-4  # sigma
IMPATIENT = with_settings(CONFIG, ["integrity.suspicion_s=5"])


def codes(run: Offline) -> set[int]:
    return {int(code) for code in run.output.notes[:, L.NOTE_CODE]}


def agree(run: Offline, own: Offline) -> None:
    """Assert that the poses are the same to a ten thousandth of sigma, and not the very same numbers."""
    assert np.array_equal(np.isnan(run.output.poses), np.isnan(own.output.poses))
    states, covariances = differences(run.output.poses, own.output.poses)
    assert 0.0 < states < SAME
    assert 0.0 < covariances < SAME


@pytest.fixture(scope="module")
def eventful() -> Array:
    """35 s with fixes away from 14 to 18 s, and 60 m off for good from 22 s on: that becomes a reset."""
    rows = without(session(35.0, rate=50.0), Source.GPS_RAW_INT, 114.0, 118.0)
    return apply_faults(rows, [parse_fault("gnss-step:at=122,size=60,towards=0")])


@pytest.fixture(scope="module")
def own(eventful: Array) -> Offline:
    return run_offline(eventful, IMPATIENT, RATE)


@pytest.fixture(scope="module")
def slow() -> Array:
    return session(25.0, rate=4.0)


@pytest.fixture(scope="module")
def slow_own(slow: Array) -> Offline:
    return run_offline(slow, CONFIG, RATE, model="telemetry")


@pytest.mark.parametrize("form", FORMS)
def test_every_form_over_an_outage_and_a_reset(eventful: Array, own: Offline, form: str) -> None:
    assert {NoteCode.GNSS_OUTAGE, NoteCode.POSITION_RESET} <= codes(own)
    run = run_offline(eventful, IMPATIENT, RATE, form=(form, "first"))
    agree(run, own)
    assert run.form is not None
    assert run.form.updates > 10 * run.form.restarts


@pytest.mark.parametrize("form", FORMS)
def test_every_form_with_a_slow_imu(slow: Array, slow_own: Offline, form: str) -> None:
    assert np.any(slow_own.output.poses[:, L.R_MODEL] == L.TELEMETRY)
    agree(run_offline(slow, CONFIG, RATE, model="telemetry", form=(form, "first")), slow_own)


def test_iterating_changes_nothing_where_the_model_is_linear() -> None:
    """Constant velocity with fixes and pressure, and a delay that is known, which would be multiplied by the velocity."""
    config = with_settings(CONFIG, ["noise.gnss_delay_initial_s=0", "noise.gnss_delay_walk=0"])
    rows = session(15.0)
    rows = rows[np.isin(rows[:, KIND], (Kind.GNSS, Kind.BAROMETER))]
    first, iterated = (
        run_offline(rows, config, RATE, form=("ud", update)).output.poses for update in ("first", "iterated")
    )
    states, covariances = differences(iterated, first)
    assert states < 1e-6
    assert covariances < 1e-6


@pytest.mark.parametrize("update", ["iterated", "second-order"])
def test_other_orders_differ_by_little_and_stay_near_the_truth(rows: Array, batch: Offline, update: str) -> None:
    run = run_offline(rows, CONFIG, RATE, form=("ud", update))
    late = run.output.poses[:, L.R_TIME] > 115.0
    own = run_offline(rows, CONFIG, RATE).output.poses
    states, _ = differences(run.output.poses[late], own[late])
    assert SAME < states < 1.0
    error = position_error(run.output.poses[late])
    assert np.median(error) < 1.1 * np.median(position_error(own[late]))
    claimed = run.output.poses[late][:, [L.R_POSE_COVARIANCE, L.R_POSE_COVARIANCE + 7]].sum(axis=1)
    assert np.mean(error**2 / claimed) < 2.0


def test_a_tape_in_detail_changes_no_bit(eventful: Array) -> None:
    done = run_offline(eventful, IMPATIENT)
    events = np.concatenate(list(EventOrder(done.setup, 3.0).push(eventful, last=True)))
    states, poses = [], np.empty((5000, L.POSE_WIDTH))
    for size in (0, T.BEGIN + ENTRIES * len(events) // 4):
        state, out = np.empty(L.STATE_SIZE), L.buffers(512, 512, SENSORS, size)
        begin(state, done.parameters)
        if size:
            out[5][T.MODE] = T.DETAILED
        for first in range(0, len(events), 256):
            block = events[first : first + 256]
            fold_block(state, block, 0, 0, done.parameters, 1e-9, np.empty((0, 2)), np.empty((0, 3)), poses, out)
        states.append(state)
    np.testing.assert_array_equal(states[0].view(np.uint64), states[1].view(np.uint64))


@pytest.mark.parametrize("form", FORMS)
def test_considered_states_are_left_alone_and_count(form: str) -> None:
    """The steps of a form against Joseph's product for the gain without the considered rows."""
    random = np.random.default_rng(3)
    n, m = 26, 3
    root = random.normal(size=(n, n))
    P, H, r = root @ root.T + np.eye(n), random.normal(size=(m, n)), random.normal(size=m)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.eye(m))
    K[DDELAY] = 0.0
    left = np.eye(n) - K @ H
    steps, dx = FormSteps(form), np.empty(n)
    steps.considered = np.arange(n) == DDELAY
    A = steps.from_covariance(P)
    steps.update(A, H, r, dx)
    np.testing.assert_allclose(dx, K @ r, atol=1e-9)
    np.testing.assert_allclose(steps.to_covariance(A), left @ P @ left.T + K @ K.T, atol=1e-8)


def test_the_standard_form_is_kept_symmetric() -> None:
    steps, n = FormSteps("covariance"), 26
    A, dx = np.eye(n) + 1e-3 * np.triu(np.ones((n, n)), 1), np.empty(n)
    steps.predict(A, np.eye(n), np.eye(n), np.ones(n))
    np.testing.assert_array_equal(A, A.T)
    A[0, 1] += 1e-9
    steps.considered = np.zeros(n, dtype=bool)
    steps.update(A, np.eye(n)[:2].copy(), np.ones(2), dx)
    np.testing.assert_array_equal(A, A.T)


def test_the_left_jacobian_is_that_of_composed_turns() -> None:
    theta, e = np.array([0.3, -0.8, 0.5]), 1e-6 * np.array([1.0, 2.0, -1.0])
    np.testing.assert_allclose(composed(theta, left_jacobian(theta) @ e), theta + e, atol=1e-11)


def test_names_that_there_are_not() -> None:
    rows = session(12.0)
    with pytest.raises(UsageError, match="the forms are"):
        run_offline(rows, CONFIG, form=("cholesky", "first"))
    with pytest.raises(UsageError, match="the orders are"):
        run_offline(rows, CONFIG, form=("ud", "third"))
