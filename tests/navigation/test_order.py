"""The same events give the same estimate to the last bit, however they come: live, late, shuffled, in pieces, in one batch."""

import numpy as np
import pytest

from mavkf.config import Config
from mavkf.navigation import history as live
from mavkf.navigation import layout as L
from mavkf.navigation import timeline
from mavkf.navigation.codes import SENSORS, NoteCode, Sensor
from mavkf.navigation.estimator import BUFFER
from mavkf.navigation.events import Arrivals
from mavkf.navigation.offline import Offline, run_offline
from mavkf.navigation.propagation import begin
from mavkf.navigation.timeline import order, precedes
from mavkf.samples import ARRIVAL, KIND, SEQUENCE, SOURCE, TIME, Kind, Source

from ._session import CONFIG, DELAYS, copied, differences, merged, run, second_receiver, session, without

Array = np.ndarray
SETUP = CONFIG.timeline.setup_s


def in_order(events: Array) -> Array:
    return np.ascontiguousarray(events[order(*events[:, (TIME, KIND, SOURCE, SEQUENCE)].T)])


def shuffled(rows: Array, seed: int, lateness: float, start: float = -np.inf) -> Array:
    """Rows that arrive up to `lateness` seconds after their stamps, those before boot time `start` as they came."""
    random = np.random.default_rng(seed)
    late = rows.copy()
    late[:, ARRIVAL] = rows[:, ARRIVAL].min() + 1e6 * (
        rows[:, TIME] - rows[0, TIME] + random.uniform(0.0, lateness, rows.shape[0])
    )
    head = rows[:, TIME] < start
    return np.concatenate([rows[head], late[~head][np.argsort(late[~head, ARRIVAL], kind="stable")]])


def measured_order(rows: Array, batch: Offline) -> Array:
    return rows[np.argsort(Arrivals(batch.setup).events(rows)[:, TIME], kind="stable")]


def test_order_of_arrival_is_not_that_of_measurement(rows: Array, batch: Offline) -> None:
    # otherwise what follows would show nothing
    t = Arrivals(batch.setup).events(rows)[:, TIME]
    assert np.sum(np.diff(t) < 0.0) > 100
    assert np.max(np.maximum.accumulate(t) - t) > 0.4


def test_live_in_order_of_arrival_equals_batch(rows: Array, batch: Offline) -> None:
    estimator, _ = run(rows)
    assert estimator.late == 0
    assert differences(estimator.state, batch.state) == []
    assert batch.state[L.MODEL] == L.STRAPDOWN  # it did navigate


def test_live_in_order_of_measurement_equals_batch(rows: Array, batch: Offline) -> None:
    ordered = measured_order(rows, batch)
    estimator, _ = run(ordered)
    assert estimator.parameters.tobytes() == run_offline(ordered, CONFIG).parameters.tobytes()
    assert differences(estimator.state, run_offline(ordered, CONFIG).state) == []
    np.testing.assert_allclose(estimator.state[: L.T], batch.state[: L.T], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_shuffled_after_the_set_up_equals_batch(rows: Array, batch: Offline, seed: int) -> None:
    # a fix is 0.2 s older than its stamp: 2.7 s late at most keeps it in the window of 3 s
    late = shuffled(rows, seed, 2.7, start=rows[0, TIME] + SETUP + 1.0)
    estimator, _ = run(late)
    assert estimator.late == 0
    assert estimator.parameters.tobytes() == batch.parameters.tobytes()
    assert differences(estimator.state, batch.state) == []


@pytest.mark.parametrize("seed", range(5))
def test_shuffled_within_the_set_up_equals_its_own_batch(rows: Array, batch: Offline, seed: int) -> None:
    late = shuffled(rows, seed, 2.5)
    estimator, _ = run(late)
    own = run_offline(late, CONFIG)
    assert estimator.late == 0
    assert differences(estimator.state, own.state) == []
    assert own.setup.imu is batch.setup.imu
    assert own.setup.model == batch.setup.model
    assert own.parameters.tobytes() == batch.parameters.tobytes()
    assert differences(own.state, batch.state) == []


@pytest.mark.parametrize("seed", range(3))
def test_pieces_of_any_size_give_the_same_rows(rows: Array, seed: int) -> None:
    random = np.random.default_rng(seed)
    cuts = np.sort(random.integers(0, rows.shape[0], 300)).tolist()
    late = shuffled(rows, seed, 2.5)
    whole, expected = run(late)
    pieces, output = run(late, cuts)
    assert expected.poses.shape[0] > 250  # only the newest IMU sample makes a pose
    for name in ("poses", "innovations", "notes"):
        assert getattr(output, name).tobytes() == getattr(expected, name).tobytes(), name
    assert pieces.state.tobytes() == whole.state.tobytes()


def test_row_by_row_gives_the_same_rows(rows: Array) -> None:
    first = rows[:1500]
    whole, expected = run(first)
    single, output = run(first, list(range(1, 1500)))
    assert output.poses.tobytes() == expected.poses.tobytes()
    assert single.state.tobytes() == whole.state.tobytes()


def changing() -> Array:
    """A flight in which each kind of sensor falls silent while another of its kind speaks, some of them more than once."""
    rows = merged(
        session(),
        second_receiver(),
        copied(session(), Kind.IMU, Source.SCALED_IMU2, every=2),
        copied(session(), Kind.IMU, Source.SCALED_IMU3, every=20, later=0.0),
        copied(session(), Kind.MAGNETOMETER, Source.SCALED_IMU2),
        copied(session(), Kind.BAROMETER, Source.SCALED_PRESSURE2, later=0.0),
    )
    for source, start, end, kind in (
        (Source.GPS_RAW_INT, 114.0, 120.0, Kind.GNSS),
        (Source.GPS2_RAW, 126.0, 131.0, Kind.GNSS),
        (Source.HIGHRES_IMU, 117.0, 121.0, Kind.IMU),
        (Source.SCALED_IMU2, 124.0, 127.0, Kind.IMU),
        (Source.HIGHRES_IMU, 113.0, 116.0, Kind.MAGNETOMETER),
        (Source.SCALED_PRESSURE, 112.0, 150.0, Kind.BAROMETER),
    ):
        rows = without(rows, source, start, end, kind)
    return rows


@pytest.mark.parametrize("seed", range(4))
def test_sensors_that_change_do_so_alike_however_their_samples_come(seed: int) -> None:
    rows = changing()
    whole = run_offline(rows, CONFIG)
    codes = whole.output.notes[:, L.NOTE_CODE]
    changes = (
        NoteCode.RECEIVER_CHANGED,
        NoteCode.IMU_CHANGED,
        NoteCode.MAGNETOMETER_CHANGED,
        NoteCode.BAROMETER_CHANGED,
    )
    assert [int(np.sum(codes == code)) for code in changes] == [2, 2, 1, 1]
    live, expected = run(rows)
    assert live.late == 0
    assert differences(live.state, whole.state) == []
    late = shuffled(rows, seed, 2.6, start=rows[0, TIME] + SETUP + 1.0)
    estimator, _ = run(late)
    assert estimator.late == 0
    assert differences(estimator.state, whole.state) == []
    # as live, in pieces
    cuts = np.sort(np.random.default_rng(seed).integers(0, rows.shape[0], 200)).tolist()
    pieces, output = run(rows, cuts)
    assert output.poses.tobytes() == expected.poses.tobytes()
    assert output.notes.tobytes() == expected.notes.tobytes()
    assert pieces.state.tobytes() == live.state.tobytes()


def test_every_measurement_leaves_one_record_however_often_it_is_folded(rows: Array, batch: Offline) -> None:
    late = shuffled(rows, 7, 2.5, start=rows[0, TIME] + SETUP + 1.0)
    _, output = run(late)
    columns = [L.I_TIME, L.I_SENSOR]
    live = output.innovations[:, columns]
    measured = live[:, 1] != Sensor.GRAVITY
    keys, counts = np.unique(live[measured], axis=0, return_counts=True)
    assert counts.max() == 1
    expected = batch.output.innovations[:, columns]
    expected = np.unique(expected[expected[:, 1] != Sensor.GRAVITY], axis=0)
    # every fix after the start-up, every barometer and magnetometer value
    events = Arrivals(batch.setup).events(rows)
    start = batch.output.notes[batch.output.notes[:, L.NOTE_CODE] == NoteCode.POSITION_FOUND, L.NOTE_END][0]
    last = events[events[:, KIND] == Kind.IMU, TIME].max()
    fixes = np.sort(events[(events[:, KIND] == Kind.GNSS) & (events[:, TIME] > start), TIME])
    for sensor in (Sensor.GNSS_POSITION, Sensor.GNSS_VELOCITY):
        np.testing.assert_allclose(expected[expected[:, 1] == sensor, 0], fixes[fixes <= last], atol=1e-9)
        np.testing.assert_allclose(keys[keys[:, 1] == sensor, 0], fixes[fixes <= last], atol=1e-9)
    barometer = events[(events[:, KIND] == Kind.BAROMETER) & (events[:, TIME] > start), TIME]
    assert np.sum(expected[:, 1] == Sensor.BAROMETER) == np.sum(barometer <= last) - 1  # the first sets the bias
    assert np.sum(keys[:, 1] == Sensor.BAROMETER) == np.sum(barometer <= last) - 1


def test_older_than_the_window_is_counted_and_dropped(rows: Array) -> None:
    window = CONFIG.timeline.window_s
    t = rows[:, TIME] - rows[0, TIME]
    where = int(np.flatnonzero(t > 20.0)[0])
    candidates = np.flatnonzero((rows[:, KIND] == Kind.GNSS) & (t > 15.0) & (t < 20.0 - window - 0.5))
    held = candidates[:3]
    without = np.delete(rows, held, axis=0)
    late = np.concatenate([np.delete(rows[:where], held, axis=0), rows[held], rows[where:]])
    estimator, _ = run(late)
    assert estimator.late == 3
    assert differences(estimator.state, run(without)[0].state) == []
    # just inside the window it counts
    inside = int(np.flatnonzero((rows[:, KIND] == Kind.GNSS) & (t > 20.0 - window + 0.25))[0])
    late = np.concatenate([rows[:inside], rows[inside + 1 : where], rows[inside : inside + 1], rows[where:]])
    estimator, _ = run(late)
    assert estimator.late == 0
    assert differences(estimator.state, run(rows)[0].state) == []


def run_with_history(events: Array, c: Array, capacity: int) -> tuple[Array, Array]:
    """State and cursor of a live run whose history holds `capacity` events."""
    state, poses = np.empty(L.STATE_SIZE), np.empty((BUFFER, L.POSE_WIDTH))
    begin(state, c)
    held, snapshots, cursor, marks = live.history(capacity)
    out = L.buffers(BUFFER, BUFFER, 4 * capacity)
    i = 0
    while i < events.shape[0]:
        out[2][:] = 0
        i, _ = live.run_live(state, events, i, c, 50.0, 3.0, held, snapshots, cursor, marks, poses, out)
    assert cursor[live.EVENTS] <= capacity < events.shape[0]
    return state, cursor


def test_a_history_takes_the_memory_that_its_window_needs(rows: Array) -> None:
    estimator, _ = run(rows)
    needed = CONFIG.timeline.window_s * rows.shape[0] / (rows[-1, TIME] - rows[0, TIME])
    most = 1.5 * (needed + live.COARSE) + live.FEWEST
    # what is not in use takes no memory: it was never written
    assert needed < np.flatnonzero(estimator._events.any(axis=1)).max() + 1 <= most
    written = np.flatnonzero(estimator._snapshots[:, : L.HALF].any(axis=1)).max() + 1
    assert 2 * live.RING < written <= 2 * live.RING + most / live.COARSE + 1


def test_a_full_history_forgets_its_older_half_and_nothing_else(rows: Array, batch: Offline) -> None:
    # 256 of 512 events stay after a cut, two seconds: more than the lateness
    late = shuffled(rows, 3, 0.8, start=rows[0, TIME] + SETUP + 1.0)
    state, _ = run_with_history(Arrivals(batch.setup).events(late), batch.parameters, 512)
    assert differences(state, batch.state) == []


def test_of_a_long_flight_little_more_than_the_window_is_kept(rows: Array) -> None:
    estimator, _ = run(rows)
    t = estimator._events[: estimator._cursor[live.EVENTS], TIME]
    inside = int(np.count_nonzero(t >= t[-1] - CONFIG.timeline.window_s))
    assert inside < len(t) < len(rows) // 4
    assert len(t) <= (inside + live.COARSE) * 1.5 + live.FEWEST


def test_older_than_the_history_is_counted_and_dropped(rows: Array, batch: Offline) -> None:
    events = Arrivals(batch.setup).events(rows)
    held = int(np.flatnonzero((events[:, KIND] == Kind.GNSS) & (events[:, TIME] > 120.0))[0])
    # 2.9 s later, when at most 2 s of the history are left
    place = int(np.flatnonzero(np.maximum.accumulate(events[:, TIME]) > events[held, TIME] + 2.9)[0])
    for capacity in (256, 320, 384):
        late = np.concatenate([events[:held], events[held + 1 : place], events[held : held + 1], events[place:]])
        state, cursor = run_with_history(late, batch.parameters, capacity)
        assert cursor[live.LATE] == 1
        assert (
            differences(state, run_with_history(np.delete(events, held, axis=0), batch.parameters, capacity)[0]) == []
        )


def test_what_fills_the_history_and_is_older_than_what_stays_is_dropped(rows: Array, batch: Offline) -> None:
    events = in_order(Arrivals(batch.setup).events(rows))[:1000]
    capacity, held, found = 256, 500, set()
    for place in range(held + capacity // 2, held + capacity):
        late = np.concatenate([events[:held], events[held + 1 : place], events[held : held + 1]])
        state, cursor = run_with_history(late, batch.parameters, capacity)
        same = events[:place] if cursor[live.LATE] == 0 else np.delete(events[:place], held, axis=0)
        assert differences(state, run_with_history(same, batch.parameters, capacity)[0]) == [], place
        found.add(int(cursor[live.LATE]))
    assert found == {0, 1}


def test_delays_are_told_to_the_estimator(rows: Array) -> None:
    # without the configured delays the same rows make another estimate: the tests above do compare something
    assert len(DELAYS) == 3
    assert differences(run_offline(rows, Config()).state, run_offline(rows, CONFIG).state) != []


def test_precedes_is_the_order_of_order() -> None:
    random = np.random.default_rng(0)
    events = np.zeros((300, L.EVENT_WIDTH))
    events[:, TIME] = random.integers(0, 6, 300) * 0.5
    events[:, KIND] = random.choice([0.0, 3.0, 4.0, 5.0, 6.0], 300)
    events[:, SOURCE] = random.integers(0, 3, 300)
    events[:, SEQUENCE] = random.integers(0, 4, 300)
    events[:, L.EVENT_ID] = np.arange(300)
    ordered = in_order(events)
    for i, a in enumerate(ordered):
        assert not precedes(a, a)
        for b in ordered[i + 1 :]:
            assert not precedes(b, a)
            same = all(a[k] == b[k] for k in (TIME, KIND, SOURCE, SEQUENCE))
            assert precedes(a, b) != same
            assert not same or a[L.EVENT_ID] < b[L.EVENT_ID]


def test_at_one_time_a_fix_comes_before_the_imu_sample() -> None:
    fix, imu = np.zeros(L.EVENT_WIDTH), np.zeros(L.EVENT_WIDTH)
    fix[KIND], imu[KIND] = Kind.GNSS, Kind.IMU
    assert precedes(fix, imu)
    assert not precedes(imu, fix)


def test_a_batch_in_pieces_writes_the_same_poses(rows: Array) -> None:
    # an IMU that comes and goes: measurements move the state on between its samples, over the edges of output intervals
    part = rows[~((rows[:, KIND] == Kind.IMU) & (rows[:, TIME] > 108.0) & (rows[:, TIME] % 1.5 > 0.1))]
    whole = run_offline(part, CONFIG)
    events = in_order(Arrivals(whole.setup).events(part))

    def poses(room: int) -> Array:
        state, written = np.empty(L.STATE_SIZE), []
        begin(state, whole.parameters)
        out = L.buffers(timeline.ROOM + room, BUFFER, SENSORS)
        buffer, i, slot = np.empty((1000, L.POSE_WIDTH)), 0, -1
        while i < events.shape[0]:
            out[2][:] = 0
            i, n, slot = timeline.run_batch(state, events, i, slot, whole.parameters, 5.0, buffer, out)
            written.append(buffer[:n].copy())
        return np.concatenate(written)

    # a piece ends with the first innovation, or never
    np.testing.assert_array_equal(poses(1), poses(16 * BUFFER))
