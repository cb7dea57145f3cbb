"""The heading of a receiver with two antennas: the first yaw, a measurement, and what becomes of a wrong one."""

import numpy as np
import pytest

from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode, Sensor
from mavkf.navigation.offline import run_offline
from mavkf.samples import GNSS_YAW, KIND, TIME, Kind

from ._session import CONFIG, motion, session

Array = np.ndarray
DELAY = 0.2  # s, of the fixes of `session`


def with_headings(rows: Array, yaw0: float = 0.4, noise: float = np.radians(1.0), since: float = 0.0) -> Array:
    """The rows, each fix from boot time `since` on with the true heading at its measurement and noise (rad)."""
    told = rows.copy()
    mine = (rows[:, KIND] == Kind.GNSS) & (rows[:, TIME] > since)
    C = motion(rows[mine, TIME] - DELAY - 100.0, yaw0).C_nb
    yaw = np.arctan2(C[:, 1, 0], C[:, 0, 0]) + noise * np.random.default_rng(5).normal(size=C.shape[0])
    told[mine, GNSS_YAW] = yaw % (2.0 * np.pi)
    return told


def no_compass(rows: Array) -> Array:
    return rows[rows[:, KIND] != Kind.MAGNETOMETER]


def yaw_error(poses: Array, yaw0: float = 0.4) -> Array:
    C = motion(poses[:, L.R_TIME] - 100.0, yaw0).C_nb
    return np.angle(np.exp(1j * (poses[:, L.R_EULER + 2] - np.arctan2(C[:, 1, 0], C[:, 0, 0]))))


def events(output, code: NoteCode) -> Array:
    return output.notes[output.notes[:, L.NOTE_CODE] == code]


@pytest.mark.parametrize("yaw0", [0.4, 3.1, -2.0])
def test_the_first_heading_comes_at_once_and_stays_right(yaw0: float) -> None:
    rows = with_headings(no_compass(session(yaw0=yaw0)), yaw0)
    output = run_offline(rows, CONFIG).output
    found = events(output, NoteCode.YAW_FROM_GNSS)
    assert found.shape[0] == 1
    # with the first fix after the attitude
    assert found[0, L.NOTE_END] < events(output, NoteCode.ALIGNED)[0, L.NOTE_END] + 0.21
    poses = output.poses[output.poses[:, L.R_TIME] > found[0, L.NOTE_END] + 0.05]
    assert np.all(poses[:, L.R_VALID].astype(int) & L.VALID_YAW)
    error = yaw_error(poses, yaw0)
    late = poses[:, L.R_TIME] > 106.0
    assert np.sqrt(np.mean(error[late] ** 2)) < np.radians(0.6)
    assert np.sqrt(np.mean((error[late] / poses[late, L.R_SIGMA_EULER + 2]) ** 2)) < 1.2
    records = output.innovations[output.innovations[:, L.I_SENSOR] == Sensor.GNSS_YAW]
    assert records.shape[0] > 180
    assert np.all(records[:, L.I_FUSED] == 1.0)
    # noise of 1 deg where 2 are assumed
    assert np.mean(records[:, L.I_NIS]) < 0.6


def test_it_helps_a_compass() -> None:
    seeds = range(3)
    alone = [yaw_error(run_offline(session(seed=k), CONFIG, rate_hz=5.0).output.poses[-100:]) for k in seeds]
    both = [
        yaw_error(run_offline(with_headings(session(seed=k)), CONFIG, rate_hz=5.0).output.poses[-100:]) for k in seeds
    ]
    assert np.sqrt(np.mean(np.square(both))) < 0.7 * np.sqrt(np.mean(np.square(alone)))


def test_one_wild_heading_is_refused(rows: Array) -> None:
    wild = with_headings(no_compass(rows))
    where = int(np.flatnonzero((wild[:, KIND] == Kind.GNSS) & (wild[:, TIME] > 120.0))[0])
    wild[where, GNSS_YAW] += 0.6
    output = run_offline(wild, CONFIG).output
    records = output.innovations[output.innovations[:, L.I_SENSOR] == Sensor.GNSS_YAW]
    refused = records[records[:, L.I_FUSED] == 0.0]
    np.testing.assert_allclose(refused[:, L.I_TIME], wild[where, TIME] - DELAY, atol=1e-6)
    assert refused[0, L.I_R] == pytest.approx(0.6, abs=0.1)
    assert events(output, NoteCode.YAW_FROM_GNSS).shape[0] == 1


def test_a_wrong_first_heading_is_given_up(rows: Array) -> None:
    wrong = with_headings(no_compass(rows))
    first = np.flatnonzero(np.isfinite(wrong[:, GNSS_YAW]))[:9]
    wrong[first, GNSS_YAW] += 1.5
    output = run_offline(wrong, CONFIG).output
    found = events(output, NoteCode.YAW_FROM_GNSS)
    assert found.shape[0] == 2
    assert found[1, L.NOTE_END] - found[0, L.NOTE_END] < CONFIG.gates.reset_s + 2.0
    assert np.abs(yaw_error(output.poses[-100:])).max() < np.radians(2.0)


def test_antennas_the_wrong_way_round_do_not_win_against_a_compass(rows: Array) -> None:
    turned = with_headings(rows, since=110.0)
    turned[:, GNSS_YAW] += np.pi / 2.0
    output = run_offline(turned, CONFIG).output
    records = output.innovations[output.innovations[:, L.I_SENSOR] == Sensor.GNSS_YAW]
    assert records.shape[0] > 100
    assert not np.any(records[:, L.I_FUSED])
    assert not events(output, NoteCode.YAW_FROM_GNSS).size
    assert np.abs(yaw_error(output.poses[-100:])).max() < np.radians(4.0)
