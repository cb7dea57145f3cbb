"""Several GNSS receivers: what a second one is worth, and which is believed when one falls silent, wanders off or jumps."""

from math import exp

import numpy as np
import pytest

from mavkf.config import with_settings
from mavkf.models.strapdown import DDELAY, DGNSS, GNSS
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode, Sensor
from mavkf.navigation.offline import Offline, run_offline
from mavkf.navigation.receivers import become_main, book_of, lasting, set_colour
from mavkf.navigation.records import RecordWriter
from mavkf.samples import (
    FIX,
    KIND,
    LATITUDE,
    LONGITUDE,
    SIGMA_HORIZONTAL,
    SIGMA_VERTICAL,
    SOURCE,
    TIME,
    VELOCITY_N,
    Kind,
    Source,
)

from ._session import CONFIG, ORIGIN, RADII, copied, merged, position_error, second_receiver, session, without

Array = np.ndarray
ONE, TWO = Source.GPS_RAW_INT, Source.GPS2_RAW


def of(rows: Array, source: Source) -> Array:
    return (rows[:, KIND] == Kind.GNSS) & (rows[:, SOURCE] == source)


def wander(rows: Array, source: Source, sigma: float, seed: int, tau: float = 40.0) -> None:
    """Add a Gauss-Markov error (m) to the horizontal fixes of a receiver, in place."""
    random = np.random.default_rng(seed)
    mine = np.flatnonzero(of(rows, source))
    mine = mine[np.argsort(rows[mine, TIME])]
    phi = exp(-0.2 / tau)
    for column, scale in ((LATITUDE, RADII[0]), (LONGITUDE, RADII[1] * np.cos(ORIGIN[0]))):
        error = sigma * random.normal()
        for i in mine:
            error = phi * error + np.sqrt(1.0 - phi * phi) * sigma * random.normal()
            rows[i, column] += error / scale


def events(output, code: NoteCode) -> Array:
    return output.notes[output.notes[:, L.NOTE_CODE] == code]


def innovations(output, sensor: Sensor, source: Source) -> Array:
    rows = output.innovations
    return rows[(rows[:, L.I_SENSOR] == sensor) & (rows[:, L.I_SOURCE] == source)]


@pytest.mark.parametrize(("dt", "tau"), [(0.2, 40.0), (1.0, 40.0), (5.0, 4.0), (100.0, 1.0)])
def test_white_noise_that_tells_as_little_as_a_lasting_error(dt: float, tau: float) -> None:
    # the variance of the mean of many, summed term by term
    n, phi = 20_000, exp(-dt / tau)
    lags = np.arange(1, n)
    of_mean = (n + 2.0 * np.sum((n - lags) * phi**lags)) / n**2
    assert lasting(dt, tau) == pytest.approx(n * of_mean, rel=0.02)
    # and what 30 of them tell of a constant
    covariance = phi ** np.abs(np.subtract.outer(np.arange(30), np.arange(30)))
    assert 1.0 + 29.0 / lasting(dt, tau) == pytest.approx(np.linalg.solve(covariance, np.ones(30)).sum(), rel=1e-9)
    if dt < 0.1 * tau:
        assert lasting(dt, tau) == pytest.approx(2.0 * tau / dt, rel=1e-2)


def test_two_receivers_are_better_than_one_and_no_more_is_claimed() -> None:
    errors: dict[str, list[Array]] = {"one": [], "two": []}
    ratios: dict[str, list[Array]] = {"one": [], "two": []}
    for seed in range(16):
        rows = merged(session(60.0, seed), second_receiver(60.0, 500 + seed))
        wander(rows, ONE, 0.8, seed)
        wander(rows, TWO, 0.8, 1000 + seed)
        for name, these in (("one", rows[rows[:, SOURCE] != TWO]), ("two", rows)):
            output = run_offline(these, CONFIG, rate_hz=2.0).output
            poses = output.poses[output.poses[:, L.R_TIME] > 120.0]
            errors[name].append(position_error(poses))
            sigma = np.sqrt(poses[:, L.R_POSE_COVARIANCE] + poses[:, L.R_POSE_COVARIANCE + 7])
            ratios[name].append(errors[name][-1] / sigma)
    rms = {name: float(np.sqrt(np.mean(np.square(found)))) for name, found in errors.items()}
    # two errors of the same size and of their own: 0.71 of one
    assert rms["two"] < 0.85 * rms["one"]
    honest = {name: float(np.sqrt(np.mean(np.square(found)))) for name, found in ratios.items()}
    assert 0.6 < honest["two"] < 1.25
    assert honest["two"] < 1.15 * honest["one"]


def test_every_fix_of_both_leaves_its_records() -> None:
    rows = merged(session(), second_receiver())
    output = run_offline(rows, CONFIG).output
    start = events(output, NoteCode.POSITION_FOUND)[0, L.NOTE_END]
    for source in (ONE, TWO):
        times = np.sort(rows[of(rows, source), TIME]) - 0.2
        times = times[(times > start + 0.01) & (times <= 139.99)]
        for sensor in (Sensor.GNSS_POSITION, Sensor.GNSS_VELOCITY):
            records = innovations(output, sensor, source)
            np.testing.assert_allclose(records[:, L.I_TIME], times, atol=1e-6)
            assert np.mean(records[:, L.I_FUSED]) > 0.99
            assert 0.3 < np.mean(records[:, L.I_NIS]) / 3.0 < 1.5
    writer = RecordWriter("1-1")
    assert {writer.innovation(row, 0).instance for row in output.innovations} == {0, 1}


@pytest.mark.parametrize("how", ["silent", "no fix"])
def test_a_receiver_that_is_gone_gives_way_and_comes_back_when_the_other_is(how: str) -> None:
    rows = merged(session(), second_receiver())
    for source, start, end in ((ONE, 118.0, 126.0), (TWO, 130.0, 200.0)):
        if how == "silent":
            rows = without(rows, source, start, end)
        else:
            lost = of(rows, source) & (rows[:, TIME] > start) & (rows[:, TIME] < end)
            rows[lost, FIX] = 1
    result = run_offline(rows, CONFIG)
    changes = events(result.output, NoteCode.RECEIVER_CHANGED)
    assert changes[:, L.NOTE_A : L.NOTE_B + 1].tolist() == [[ONE, TWO], [TWO, ONE]]
    np.testing.assert_allclose(changes[:, L.NOTE_END], [120.0, 132.0], atol=0.5)
    np.testing.assert_allclose(changes[:, L.NOTE_SIZE], 2.1, atol=0.2)
    assert not events(result.output, NoteCode.GNSS_OUTAGE).size
    assert not events(result.output, NoteCode.POSITION_RESET).size
    assert position_error(result.output.poses[result.output.poses[:, L.R_TIME] > 110.0]).max() < 1.5
    event = RecordWriter("1-1").event(changes[0], 0)
    assert event.kind == "receiver_changed"
    assert event.evidence == {"before": "GPS_RAW_INT", "now": "GPS2_RAW"}


def test_another_receiver_begins_a_new_error_that_lingers(batch: Offline) -> None:
    s, fix = batch.state.copy(), np.zeros(L.EVENT_WIDTH)
    fix[SIGMA_HORIZONTAL], fix[SIGMA_VERTICAL] = 0.5, 0.7
    delay = L.covariance(s)[DDELAY, DDELAY]
    become_main(s, batch.parameters, L.buffers(8, 8, 8), float(TWO), 138.0)
    set_colour(s, fix, batch.parameters)
    P = L.covariance(s)
    assert s[L.MAIN] == TWO
    assert not s[GNSS : GNSS + 3].any()
    share = CONFIG.noise.gnss_colour * 0.5, CONFIG.noise.gnss_colour_vertical * 0.7
    expected = np.diag(np.square([share[0], share[0], share[1]]))
    np.testing.assert_allclose(P[DGNSS : DGNSS + 3, DGNSS : DGNSS + 3], expected, rtol=1e-12)
    assert not P[:DGNSS, DGNSS : DGNSS + 3].any()
    # and what its delay is beyond the nominal one is known less
    assert P[DDELAY, DDELAY] == pytest.approx(delay + CONFIG.noise.gnss_delay_initial_s**2)
    # the position is as sure as it was
    np.testing.assert_array_equal(P[6:9, 6:9], L.covariance(batch.state)[6:9, 6:9])


def test_a_jump_that_another_receiver_does_not_see_is_not_followed() -> None:
    rows = merged(session(), second_receiver())
    rows[of(rows, ONE) & (rows[:, TIME] > 118.0), LATITUDE] += 60.0 / RADII[0]
    output = run_offline(rows, CONFIG).output
    assert not events(output, NoteCode.POSITION_RESET).size
    changes = events(output, NoteCode.RECEIVER_CHANGED)
    assert changes[:, L.NOTE_A : L.NOTE_B + 1].tolist() == [[ONE, TWO]]
    assert changes[0, L.NOTE_END] == pytest.approx(118.0 + CONFIG.gates.reset_s, abs=0.5)
    assert position_error(output.poses[output.poses[:, L.R_TIME] > 110.0]).max() < 2.0


def test_a_jump_of_both_is() -> None:
    rows = merged(session(), second_receiver())
    rows[(rows[:, KIND] == Kind.GNSS) & (rows[:, TIME] > 118.0), LATITUDE] += 60.0 / RADII[0]
    output = run_offline(rows, with_settings(CONFIG, ["integrity.suspicion_s=10"])).output
    assert events(output, NoteCode.POSITION_RESET).shape[0] == 1
    after = output.poses[output.poses[:, L.R_TIME] > 131.0].copy()
    after[:, L.R_LATITUDE] -= 60.0 / RADII[0]
    assert position_error(after).max() < 3.0


def test_a_small_jump_of_the_other_is_refused_however_little_it_weighs() -> None:
    rows = merged(session(), second_receiver())
    rows[of(rows, TWO) & (rows[:, TIME] > 118.0), LATITUDE] += 12.0 / RADII[0]
    output = run_offline(rows, CONFIG).output
    records = innovations(output, Sensor.GNSS_POSITION, TWO)
    assert not np.any(records[records[:, L.I_TIME] > 118.0, L.I_FUSED])
    assert position_error(output.poses[output.poses[:, L.R_TIME] > 110.0]).max() < 1.5


def test_one_that_wanders_more_than_it_claims_loses_its_weight() -> None:
    rows = merged(session(60.0), second_receiver(60.0))
    wander(rows, TWO, 2.5, 3, tau=15.0)
    result = run_offline(rows, CONFIG)
    assert result.state[book_of(float(TWO)) + L.F_SCALE_COLOUR] > 2.0
    alone = run_offline(rows[rows[:, SOURCE] != ONE], CONFIG)
    late = [run.output.poses[run.output.poses[:, L.R_TIME] > 115.0] for run in (result, alone)]
    assert np.sqrt(np.mean(position_error(late[0]) ** 2)) < 0.4 * np.sqrt(np.mean(position_error(late[1]) ** 2))


def test_the_same_fix_in_another_message_counts_once(rows: Array) -> None:
    echo = rows[of(rows, ONE)].copy()
    echo[:, SOURCE] = Source.HIL_GPS
    twice, once = run_offline(merged(rows, echo), CONFIG), run_offline(rows, CONFIG)
    np.testing.assert_array_equal(twice.state[: L.T + 1], once.state[: L.T + 1])
    assert twice.state[L.DUPLICATES] > once.state[L.DUPLICATES] + 150


def test_the_same_fix_without_a_velocity_counts_once(rows: Array) -> None:
    untold = rows.copy()
    untold[of(rows, ONE), VELOCITY_N : VELOCITY_N + 3] = np.nan
    twice = merged(untold, copied(untold, Kind.GNSS, TWO))
    once = run_offline(untold, CONFIG).output
    both = run_offline(twice, CONFIG).output
    assert not innovations(both, Sensor.GNSS_POSITION, TWO).size
    assert innovations(both, Sensor.GNSS_POSITION, ONE).shape == innovations(once, Sensor.GNSS_POSITION, ONE).shape


def test_the_first_velocity_of_a_receiver_that_begins_later_is_a_measurement(rows: Array) -> None:
    other = second_receiver()
    both = run_offline(merged(rows, other[other[:, TIME] > 120.0]), CONFIG).output
    first = innovations(both, Sensor.GNSS_VELOCITY, TWO)[0]
    assert first[L.I_FUSED] == 1.0
    assert np.all(np.isfinite(first))


def test_a_short_jump_of_a_receiver_without_velocity_is_waited_out(rows: Array) -> None:
    jumped = rows.copy()
    mine = of(rows, ONE)
    jumped[mine, VELOCITY_N : VELOCITY_N + 3] = np.nan
    jumped[mine & (rows[:, TIME] > 120.0) & (rows[:, TIME] < 125.0), LATITUDE] += 60.0 / RADII[0]
    assert not events(run_offline(jumped, CONFIG).output, NoteCode.POSITION_RESET).size


def test_a_receiver_that_never_had_a_fix_gives_way_to_one_that_has(rows: Array) -> None:
    blind = merged(rows, second_receiver())
    blind[of(blind, ONE), FIX] = 1
    blind[of(blind, TWO) & (blind[:, TIME] < 108.0), FIX] = 1  # after the set-up
    output = run_offline(blind, CONFIG).output
    assert events(output, NoteCode.RECEIVER_CHANGED).shape[0] == 1
    assert events(output, NoteCode.POSITION_FOUND)[0, L.NOTE_END] == pytest.approx(110.4, abs=0.4)
    assert position_error(output.poses[output.poses[:, L.R_TIME] > 115.0]).max() < 2.0
