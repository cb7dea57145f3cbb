"""What is kept of a session that has gone by: the same in whatever pieces it came, evenly spread, and enough."""

from typing import Any

import numpy as np
import pytest

from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.replay.states import FEWEST, States
from mavkf.replay.stretches import EACH, STRETCHES, Stretches
from mavkf.samples import Source


def innovations(sensor: Sensor, source: Source, size: int, count: int) -> Any:
    found = np.zeros((count, L.INNOVATION_WIDTH))
    found[:, L.I_TIME] = np.arange(count)
    found[:, L.I_SENSOR], found[:, L.I_SOURCE], found[:, L.I_SIZE] = sensor, source, size
    found[:, L.I_R : L.I_R + size] = np.random.default_rng(1).normal(size=(count, size))
    found[:, L.I_S : L.I_S + size * size] = np.eye(size).ravel()
    found[:, L.I_NIS] = np.sum(found[:, L.I_R : L.I_R + size] ** 2, axis=1)
    found[:, L.I_LIMIT], found[:, L.I_FUSED] = 25.0, 1.0
    return found


@pytest.mark.parametrize("cut", [90_000, 4096, 77])
def test_long_sessions_are_judged_by_stretches(cut: int) -> None:
    """Evenly spread, whole, and the same in whatever pieces they come; what is summed up is all."""
    all_ = innovations(Sensor.BAROMETER, Source.SCALED_PRESSURE, 1, 90_000)
    all_[::10, L.I_FUSED] = 0.0
    kept = Stretches()
    for first in range(0, 90_000, cut):
        some = all_[first : first + cut]
        kept.take(some, pose_rows(some[-1:, L.I_TIME]))
    kept.finish()
    (found,) = kept.by_sensor(0.0)
    steps = np.diff(found.t)
    assert found.t[0] == 0.0 and len(found.t) % EACH == 0 and STRETCHES // 2 <= len(found.t) // EACH <= STRETCHES
    assert set(steps[steps != 1.0]) == {15 * EACH + 1.0}
    np.testing.assert_array_equal(found.rows, all_[found.t.astype(int)])
    (sums,) = kept.kept.values()
    assert (sums.count, sums.refused) == (90_000, 9_000)
    assert sums.nis == pytest.approx(np.sum(all_[all_[:, L.I_FUSED] > 0.0, L.I_NIS]))


def test_short_sessions_are_judged_whole() -> None:
    all_ = innovations(Sensor.BAROMETER, Source.SCALED_PRESSURE, 1, 9_900)
    kept = Stretches()
    kept.take(all_, pose_rows(np.array([5000.0])))
    kept.finish()
    np.testing.assert_array_equal(kept.by_sensor(0.0)[0].rows, all_)


def test_an_innovation_has_the_speed_of_the_next_pose() -> None:
    poses = pose_rows(np.array([10.0, 20.0, 30.0]))
    poses[:, L.R_V : L.R_V + 2] = [[3.0, 4.0], [6.0, 8.0], [0.3, 0.4]]
    held = innovations(Sensor.GNSS_VELOCITY, Source.GPS_RAW_INT, 2, 40)
    for cut in (3, 2, 1):
        kept = Stretches()
        for some in np.split(poses, [cut]):
            before = poses[cut - 1, L.R_TIME]
            late = held[:, L.I_TIME] > before
            kept.take(held[late] if len(some) == 3 - cut else held[~late], some)
        kept.finish()
        (only,) = kept.kept.values()
        speed = only.rows[:, -1]
        expected = np.where(held[:, L.I_TIME] <= 10.0, 5.0, np.where(held[:, L.I_TIME] <= 20.0, 10.0, 0.5))
        np.testing.assert_allclose(speed, expected)


def pose_rows(t: np.ndarray) -> np.ndarray:
    found = np.zeros((len(t), L.POSE_WIDTH))
    found[:, L.R_TIME] = t
    return found


@pytest.mark.parametrize("cut", [100_000, 1000, 7])
def test_states_are_spread_evenly_with_the_acceleration_of_their_time(cut: int) -> None:
    t = np.arange(0.0, 1000.0, 0.05)
    poses = pose_rows(t)
    poses[:, L.R_V], poses[:, L.R_V + 2] = 0.5 * t**2, -2.0 * t
    states = States()
    none = np.empty((0, L.INNOVATION_WIDTH))
    for first in range(0, len(t), cut):
        states.take(poses[first : first + cut], none)
    states.finish()
    taken = np.array([state.row[L.R_TIME] for state in states.found.values()])
    assert FEWEST <= len(taken) <= 2 * FEWEST
    np.testing.assert_allclose(np.diff(taken), 64.0, atol=0.051)
    assert taken[0] == pytest.approx(1.0, abs=0.051)
    for state in states.found.values():
        np.testing.assert_allclose(state.acceleration, [state.row[L.R_TIME], 0.0, -2.0], atol=0.06)


def test_states_are_taken_on_both_sides_of_a_gap() -> None:
    t = np.concatenate([np.arange(0.0, 3.0, 0.1), np.arange(500.05, 503.0, 0.1)])
    states = States()
    for first in range(0, len(t), 10):
        states.take(pose_rows(t[first : first + 10]), np.empty((0, L.INNOVATION_WIDTH)))
    states.finish()
    taken = [state.row[L.R_TIME] for state in states.found.values()]
    assert len(taken) == 4 and min(taken) < 2.0 and max(taken) > 500.0
