"""Smoothing of the fold: against Rauch-Tung-Striebel on what it did, against the truth, and over breaks."""

import numpy as np
import pytest

from mavkf.config import with_settings
from mavkf.models.order import STATES_MOST
from mavkf.models.strapdown import DBG, DGNSS, TOP
from mavkf.navigation import layout as L
from mavkf.navigation import tape as T
from mavkf.navigation.codes import SENSORS, NoteCode
from mavkf.navigation.events import EventOrder
from mavkf.navigation.fusing import forget
from mavkf.navigation.offline import run_offline
from mavkf.navigation.propagation import begin
from mavkf.navigation.smoothing import fold_block, sweep
from mavkf.navigation.timeline import order
from mavkf.replay.faults import apply_faults, parse_fault
from mavkf.samples import KIND, SEQUENCE, SOURCE, TIME, Kind

from ._session import CONFIG, ORIGIN, RADII, Array, motion, position_error, session
from .test_consistency import TOLD

NOTHING = np.zeros((0, 2)), np.zeros((0, 3))
QUIET = ["use_rest=false", "use_class=false", "monitors=false"]
BEGIN = 112.0


def buffers(tape: int) -> tuple[Array, ...]:
    return L.buffers(512, 512, SENSORS, tape)


def prepared(rows: Array, config=CONFIG, model: str | None = None) -> tuple[Array, Array, Array]:
    """State before the first event, sorted events, parameters."""
    done = run_offline(rows, config, model=model)
    state = np.empty(L.STATE_SIZE)
    begin(state, done.parameters)
    events = np.concatenate(list(EventOrder(done.setup, 3.0).push(rows, last=True)))
    return state, events, done.parameters


def entries(tape: Array) -> list[tuple[int, int, Array]]:
    """(kind, number of states, content) of all entries, in their order."""
    found, end = [], int(tape[T.LENGTH])
    while end > T.BEGIN:
        n, size, kind = (int(number) for number in tape[end - T.TAIL : end])
        end -= T.TAIL + size
        found.append((kind, n, tape[end : end + size]))
    return found[::-1]


def test_recording_changes_no_bit(rows: Array) -> None:
    start, events, c = prepared(rows)
    states = []
    for size in (0, 16_000_000):
        state = start.copy()
        fold_block(state, events, -1, 0, c, 50.0, *NOTHING, np.empty((5000, L.POSE_WIDTH)), buffers(size))
        states.append(state)
    np.testing.assert_array_equal(states[0].view(np.uint64), states[1].view(np.uint64))


def whole_transition(n: int, content: Array) -> Array:
    F = np.eye(n)
    F[:9, :TOP] = content[T.T_PHI :].reshape(9, TOP)
    for i in range(3):
        F[DGNSS + i, DGNSS + i] = content[T.T_DECAY + i // 2]
    return F


def test_equals_rauch_tung_striebel_on_what_the_fold_did(rows: Array) -> None:
    start, events, c = prepared(rows, with_settings(CONFIG, QUIET))
    # measured at the time of a sample: what is done in an event is a transition, then corrections
    samples = events[events[:, KIND] == Kind.IMU, TIME]
    others = events[:, KIND] != Kind.IMU
    at = np.minimum(np.searchsorted(samples, events[others, TIME]), samples.size - 1)
    events[others, TIME] = samples[at]
    events = np.ascontiguousarray(events[order(*events[:, (TIME, KIND, SOURCE, SEQUENCE)].T)])
    first = int(np.searchsorted(events[:, TIME], 125.0))
    stretch = events[first : first + 900]
    poses, out = np.empty((1, L.POSE_WIDTH)), buffers(T.BEGIN + 200_000)
    fold_block(start, events[:first], -1, 0, c, 0.0, *NOTHING, poses, buffers(0))
    did, state = [], start
    for event in stretch:
        before = L.covariance(state).copy()
        fold_block(state, event[None], 0, 0, c, 1e-9, *NOTHING, poses, out)
        did.append((before, L.covariance(state).copy(), out[5][: int(out[5][T.LENGTH])].copy()))
    n = int(state[L.STATES])
    d, P = np.zeros(n), did[-1][1]
    adjoint, Adjoint = np.zeros(STATES_MOST), np.zeros((STATES_MOST, STATES_MOST))
    corrections = 0
    for before, after, tape in reversed(did):
        np.testing.assert_allclose(after @ adjoint[:n], d, rtol=1e-6, atol=1e-6 * np.abs(d).max())
        both = after - after @ Adjoint[:n, :n] @ after
        scale = np.sqrt(np.outer(np.diag(after), np.diag(after)))
        np.testing.assert_allclose(both, P, rtol=1e-6, atol=1e-9 * scale.max())
        F, shift, lost = np.eye(n), np.zeros(n), np.zeros((n, n))
        for kind, size, content in entries(tape):
            assert kind in (T.TRANSITION, T.CORRECTION) and size == n
            if kind == T.TRANSITION:
                F = whole_transition(n, content) @ F
                continue
            corrections += 1
            m, k = int(content[T.C_SIZE]), T.C_R
            assert content[T.C_GAIN] == T.OPTIMAL
            r, inverse = content[k : k + m], content[k + m : k + m + m * m].reshape(m, m)
            K = content[-n * m :].reshape(n, m)
            shift += K @ r
            lost += K @ np.linalg.inv(inverse) @ K.T
        if tape[T.LENGTH] > T.BEGIN:
            used = np.flatnonzero(np.diag(before) > 0.0)
            predicted = (after + lost)[np.ix_(used, used)]
            unit = 1.0 / np.sqrt(np.diag(predicted))
            inverse = np.linalg.inv(predicted * np.outer(unit, unit)) * np.outer(unit, unit)
            C = (before @ F.T)[:, used] @ inverse
            d = C @ (d + shift)[used]
            P = before + C @ (P - after - lost)[np.ix_(used, used)] @ C.T
        sweep(tape, adjoint, Adjoint, poses, 0.0)
    assert corrections > 50 and np.abs(adjoint).max() > 0.0


@pytest.mark.parametrize("model", ["strapdown", "telemetry", "constant-velocity"])
def test_variance_is_never_above_the_filters(rows: Array, model: str) -> None:
    state, events, c = prepared(rows, model=model)
    poses, out = np.full((5000, L.POSE_WIDTH), np.nan), buffers(24_000_000)
    _, count = fold_block(state, events, -1, 0, c, 20.0, *NOTHING, poses, out)
    filtered = poses[:count].copy()
    sweep(out[5], np.zeros(STATES_MOST), np.zeros((STATES_MOST, STATES_MOST)), poses, 0.0)
    for block, size in ((L.R_POSE_COVARIANCE, 6), (L.R_VELOCITY_COVARIANCE, 3)):
        for i in range(size):
            k = block + (size + 1) * i
            known = np.isfinite(filtered[:, k])
            assert known.sum() > 300
            assert np.all(poses[:count][known, k] <= filtered[known, k] * (1.0 + 1e-9))
            assert np.all(poses[:count][known, k] > 0.0)
            assert np.mean(poses[:count][known, k]) < 0.9 * np.mean(filtered[known, k])


def north_error(poses: Array) -> Array:
    return (poses[:, L.R_LATITUDE] - ORIGIN[0]) * RADII[0] - motion(poses[:, L.R_TIME] - 100.0).p[:, 0]


def test_smoothed_is_closer_to_the_truth_and_says_how_close() -> None:
    config = with_settings(CONFIG, TOLD)
    squares: dict[bool, list[float]] = {False: [], True: []}
    ratios = []
    for seed in range(6):
        rows = session(duration=30.0, seed=200 + seed)
        for smoothing in (False, True):
            poses = run_offline(rows, config, rate_hz=2.0, smoothing=smoothing).output.poses
            poses = poses[poses[:, L.R_TIME] > BEGIN]
            squares[smoothing].append(float(np.mean(position_error(poses) ** 2)))
        ratios.append(north_error(poses) ** 2 / poses[:, L.R_POSE_COVARIANCE])
    assert np.mean(squares[True]) < 0.7 * np.mean(squares[False])
    assert 0.5 < np.sqrt(np.mean(ratios)) < 1.5


def test_a_tape_tells_noise_from_a_cut_and_from_a_break(rows: Array) -> None:
    state, events, c = prepared(rows)
    out = buffers(T.BEGIN + 100_000)
    fold_block(state, events, -1, 0, c, 50.0, *NOTHING, np.empty((5000, L.POSE_WIDTH)), buffers(0))
    for change, expected in (("noise", []), ("cut", [T.LINK] * 3), ("moved", [T.BREAK])):
        changed = state.copy()
        T.rewind(changed, out[5])
        if change == "noise":
            L.covariance(changed)[0, 0] += 1.0
        elif change == "cut":
            forget(changed, DBG, 3, 1e-4)
        else:
            changed[L.X + 4] += 1.0
        kinds = [kind for kind, _, _ in entries(attended(changed, out))]
        assert kinds == expected


def attended(state: Array, out: tuple[Array, ...]) -> Array:
    """The tape with what was done to the state since its last entry."""
    T.record_pose(state, out, 0)
    tape = out[5]
    tape[T.LENGTH] -= T.TAIL + tape[int(tape[T.LENGTH]) - 2]  # the pose itself
    return tape


def test_a_reset_is_not_smoothed_across(rows: Array) -> None:
    # from 125 s on the fixes lie 60 m further north, and their velocity knows nothing of it: in the end the filter follows them
    jumped = apply_faults(rows, [parse_fault("gnss-step:at=125,size=60,towards=0")])
    config = with_settings(CONFIG, ["integrity.suspicion_s=5"])
    notes = run_offline(jumped, config).output.notes
    (reset,) = notes[notes[:, L.NOTE_CODE] == NoteCode.POSITION_RESET.value, L.NOTE_TIME]
    state, events, c = prepared(jumped, config)
    poses, out = np.full((5000, L.POSE_WIDTH), np.nan), buffers(24_000_000)
    _, count = fold_block(state, events, -1, 0, c, 20.0, *NOTHING, poses, out)
    poses, tape = poses[:count], out[5]
    # the same flight as if it ended there
    ended = poses.copy()
    end = int(tape[T.LENGTH])
    while tape[end - 1] != T.BREAK:
        end -= T.TAIL + int(tape[end - 2])
    for smoothed, length in ((poses, tape[T.LENGTH]), (ended, end)):
        tape[T.LENGTH] = length
        sweep(tape, np.zeros(STATES_MOST), np.zeros((STATES_MOST, STATES_MOST)), smoothed, 0.0)
    before, after = (poses[:, L.R_TIME] < reset), poses[:, L.R_TIME] > reset
    np.testing.assert_array_equal(poses[before], ended[before])
    assert np.any(poses[after] != ended[after])
    assert position_error(poses[before & (poses[:, L.R_TIME] > BEGIN)]).max() < 2.5


def test_a_drift_that_was_found_is_left_out_from_its_start() -> None:
    drifting = apply_faults(session(90.0), [parse_fault("gnss-drift:at=140,for=25,size=1.2,towards=90")])
    filtered = run_offline(drifting, CONFIG, rate_hz=5.0).output.poses
    done = run_offline(drifting, CONFIG, rate_hz=5.0, smoothing=True)
    assert any("left out" in sentence for sentence in done.hindsight)
    during = (filtered[:, L.R_TIME] > 140.0) & (filtered[:, L.R_TIME] < 165.0)
    worst = [position_error(poses[during]).max() for poses in (filtered, done.output.poses)]
    assert worst[1] < min(0.5 * worst[0], 2.0)
