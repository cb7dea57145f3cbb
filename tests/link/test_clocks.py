"""The boot clock: what each row's time and session are, whatever order and whatever pieces the rows come in."""

from math import nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavkf.link.clocks import HELD_ROWS, VehicleClock
from mavkf.samples import CLOCK, KIND, ROW_WIDTH, SEQUENCE, SESSION, STAMP, TIME, UNIX_US, Clock, Kind

UNIX0 = 1_700_000_000_000_000


def row(seconds: float = nan, clock: Clock = Clock.BOOT_US, kind: Kind = Kind.IMU, unix_us: float = nan) -> np.ndarray:
    out = np.full(ROW_WIDTH, nan)
    out[STAMP] = np.round(seconds * 1e6)
    out[CLOCK], out[KIND], out[UNIX_US] = clock, kind, unix_us
    return out


def untimed() -> np.ndarray:
    return row(clock=Clock.NONE, kind=Kind.HEARTBEAT)


def stack(*rows: np.ndarray) -> np.ndarray:
    out = np.array(rows).reshape(-1, ROW_WIDTH)
    out[:, SEQUENCE] = np.arange(len(out))
    return out


def times(*seconds: float) -> np.ndarray:
    return stack(*[row(t) for t in seconds])


def run(rows: np.ndarray, window_s: float = 3.0) -> tuple[VehicleClock, list[tuple[float, int]]]:
    """The clock after all rows, and (TIME, SESSION) of those taken."""
    clock = VehicleClock(window_s)
    out = np.concatenate([clock.push(rows), clock.flush()])
    return clock, [(round(t, 6), int(s)) for t, s in zip(out[:, TIME], out[:, SESSION], strict=True)]


def test_time_is_the_stamp_in_seconds() -> None:
    rows = stack(row(12.345678), row(12.346, Clock.BOOT_MS))
    clock, out = run(rows)
    assert out == [(12.345678, 0), (12.346, 0)]
    assert (clock.counts.rows, clock.counts.reboots, clock.counts.gaps) == (2, 0, 0)
    assert np.isnan(rows[:, TIME]).all()


def test_milliseconds_wrap_after_49_days() -> None:
    wrap = 2**32 * 1e-3
    before, after = wrap - 0.5, 0.5
    clock, out = run(
        stack(row(before, Clock.BOOT_MS), row(after, Clock.BOOT_MS), row(wrap + 1.0), row(1.2, Clock.BOOT_MS))
    )
    assert out == [(before, 0), (round(wrap + 0.5, 6), 0), (round(wrap + 1.0, 6), 0), (round(wrap + 1.2, 6), 0)]
    assert clock.counts.reboots == 0


def test_a_late_row_across_the_wrap() -> None:
    wrap = 2**32 * 1e-3
    _, out = run(stack(*[row(t, Clock.BOOT_MS) for t in (wrap - 0.5, 0.5, wrap - 0.25)]))
    assert out[2] == (round(wrap - 0.25, 6), 0)


def test_a_reboot_after_weeks_is_no_wrap() -> None:
    weeks = 40 * 86400.0
    rows = [row(weeks + 0.1 * i, Clock.BOOT_MS) for i in range(5)] + [row(2 + 0.1 * i, Clock.BOOT_MS) for i in range(5)]
    clock, out = run(stack(*rows))
    assert out[5:] == [(2.0, 1), (2.1, 1), (2.2, 1), (2.3, 1), (2.4, 1)]
    assert clock.counts.reboots == 1


def test_a_reboot_needs_five_rows_and_begins_with_them() -> None:
    clock, out = run(times(100.0, 100.1, 1.0, 1.1, 1.2, 1.3))
    assert out == [(100.0, 0), (100.1, 0)]
    assert (clock.counts.reboots, clock.counts.late) == (0, 4)
    clock, out = run(times(100.0, 100.1, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5))
    assert out[2:] == [(1.0, 1), (1.1, 1), (1.2, 1), (1.3, 1), (1.4, 1), (1.5, 1)]
    assert (clock.counts.reboots, clock.counts.late, clock.counts.gaps) == (1, 0, 0)


def test_the_five_rows_are_held_back_until_it_is_decided() -> None:
    clock = VehicleClock()
    clock.push(times(100.0))
    assert len(clock.push(times(1.0, 1.1, 1.2, 1.3))) == 0
    assert [round(r[TIME], 6) for r in clock.push(times(1.4))] == [1.0, 1.1, 1.2, 1.3, 1.4]


def test_fewer_than_five_and_back_to_the_old_clock_is_lateness() -> None:
    clock, out = run(times(100.0, 1.0, 1.1, 1.2, 1.3, 100.1, 1.4, 100.2))
    assert out == [(100.0, 0), (100.1, 0), (100.2, 0)]
    assert (clock.counts.reboots, clock.counts.late, clock.counts.bad_stamps) == (0, 5, 0)


def test_five_fallen_rows_that_do_not_agree_are_no_reboot() -> None:
    clock, out = run(times(500.0, 1.0, 100.0, 300.0, 2.0, 200.0, 500.1))
    assert out == [(500.0, 0), (500.1, 0)]
    assert clock.counts.late == 5


def test_one_stamp_far_ahead_is_bad_and_five_are_a_gap() -> None:
    clock, out = run(times(10.0, 5000.0, 10.1))
    assert out == [(10.0, 0), (10.1, 0)]
    assert (clock.counts.bad_stamps, clock.counts.gaps) == (1, 0)
    clock, out = run(times(10.0, 5000.0, 5000.1, 5000.2, 5000.3, 5000.4))
    assert [s for _, s in out] == [0] * 6
    assert (clock.counts.bad_stamps, clock.counts.gaps, clock.counts.longest_gap_s) == (0, 1, 4990.0)


def test_gaps_over_a_second_are_counted() -> None:
    clock, _ = run(times(1.0, 2.0, 3.5, 33.5, 33.6))
    assert (clock.counts.gaps, clock.counts.longest_gap_s) == (2, 30.0)


def test_lateness_within_the_window_is_kept_and_beyond_is_dropped() -> None:
    clock, out = run(times(10.0, 7.5, 10.1, 6.9, 10.2, 7.3, 10.3))
    assert [t for t, _ in out] == [10.0, 7.5, 10.1, 10.2, 7.3, 10.3]
    assert (clock.counts.late, clock.counts.reboots) == (1, 0)


def test_the_window_is_what_was_asked_for() -> None:
    clock, _ = run(times(10.0, 8.5, 10.1), window_s=1.0)
    assert clock.counts.late == 1


def steps(start: float, stop: float, step: float = 0.02) -> list[float]:
    return [round(t, 6) for t in np.arange(start, stop, step)]


def test_a_small_fall_that_goes_on_for_a_window_is_a_reboot() -> None:
    clock, out = run(times(*steps(1.0, 2.5), *steps(0.8, 6.0)))
    assert clock.counts.reboots == 1
    sessions = np.array(out)
    first = sessions[sessions[:, 1] == 1][0, 0]
    assert first == pytest.approx(3.8, abs=0.03)
    assert clock.counts.rows == len(out) == len(steps(1.0, 2.5)) + len(steps(0.8, 6.0))


def test_a_small_fall_while_the_old_clock_goes_on_is_lateness() -> None:
    clock, out = run(times(*[t for on in steps(10.0, 20.0)[:500] for t in (on, on - 1.4)]))
    assert (clock.counts.reboots, clock.counts.late, len(out)) == (0, 0, 1000)


def test_a_burst_that_fills_its_own_hole_is_lateness() -> None:
    clock, _ = run(times(*steps(5.0, 10.0), 12.0, *steps(10.0, 12.0), *steps(12.02, 20.0)))
    assert (clock.counts.reboots, clock.counts.late) == (0, 0)


def test_a_few_late_rows_are_lateness_though_the_old_clock_seems_to_go_on_from_them() -> None:
    clock, _ = run(times(*steps(5.0, 10.0), 9.5, 9.7, 9.9, *steps(10.0, 20.0)))
    assert clock.counts.reboots == 0


def test_rows_without_a_time_take_that_of_the_timed_row_before() -> None:
    clock, out = run(stack(untimed(), row(5.0), untimed(), row(4.5), untimed(), row(5.1)))
    assert out == [(5.0, 0), (5.0, 0), (4.5, 0), (4.5, 0), (5.1, 0)]
    assert clock.counts.untimed == 1


def test_rows_without_a_time_follow_the_row_before_them_into_the_new_session() -> None:
    rows = [row(100.0), row(1.0), untimed(), row(1.1), row(1.2), row(1.3), row(1.4)]
    _, out = run(stack(*rows))
    assert out == [(100.0, 0), (1.0, 1), (1.0, 1), (1.1, 1), (1.2, 1), (1.3, 1), (1.4, 1)]


def test_rows_without_a_time_after_a_bad_stamp_belong_to_the_row_before_it() -> None:
    _, out = run(stack(row(100.0), row(1.0), untimed(), row(100.2)))
    assert out == [(100.0, 0), (100.0, 0), (100.2, 0)]


def unix(seconds: float) -> np.ndarray:
    return row(UNIX0 * 1e-6 + seconds, Clock.UNIX_US, Kind.GNSS)


def system_time(seconds: float, offset_s: float = 0.0) -> np.ndarray:
    return row(seconds, Clock.BOOT_MS, Kind.SYSTEM_TIME, UNIX0 + round((seconds + offset_s) * 1e6))


def test_unix_stamps_are_mapped_by_system_time() -> None:
    _, out = run(stack(row(10.0), unix(9.9), system_time(10.1), unix(10.05)))
    assert out == [(10.0, 0), (10.0, 0), (10.1, 0), (10.05, 0)]


def test_unix_stamps_far_off_are_dropped() -> None:
    clock, out = run(stack(system_time(10.0), unix(2.0), unix(500.0), row(10.1)))
    assert out == [(10.0, 0), (10.1, 0)]
    assert (clock.counts.late, clock.counts.bad_stamps) == (1, 1)


def test_a_new_session_forgets_the_mapping() -> None:
    fallen = [row(1.0 + 0.1 * i) for i in range(5)]
    _, out = run(stack(system_time(100.0), *fallen, unix(1.0), system_time(1.5, 7.0), unix(8.4)))
    assert out[-3:] == [(1.4, 1), (1.5, 1), (1.4, 1)]


def test_nothing_known_gives_nothing() -> None:
    clock, out = run(stack(untimed(), unix(1.0)))
    assert out == []
    assert clock.counts.untimed == 2


def test_memory_is_bounded_while_a_stamp_is_in_doubt() -> None:
    clock = VehicleClock()
    clock.push(stack(row(100.0), row(1.0), *[untimed() for _ in range(500)]))
    out = clock.push(times(100.1))
    assert len(out) < HELD_ROWS
    assert clock.counts.untimed + len(out) == 501


stamps = st.one_of(
    st.floats(0, 200).map(row),
    st.floats(90, 110).map(row),
    st.floats(0, 5).map(row),
    st.floats(0, 4_294_967).map(lambda t: row(t, Clock.BOOT_MS)),
    st.floats(-5, 120).map(unix),
    st.floats(0, 120).map(system_time),
    st.just(untimed()),
)
runs = st.tuples(st.floats(0, 300), st.floats(0.001, 2.0), st.integers(1, 12)).map(
    lambda r: [row(r[0] + r[1] * i) for i in range(r[2])]
)
streams = st.lists(st.one_of(stamps.map(lambda r: [r]), runs), max_size=25).map(
    lambda parts: stack(*(one for part in parts for one in part))
)


@given(streams, st.lists(st.integers(0, 7), min_size=1, max_size=20))
def test_the_pieces_do_not_matter(rows: np.ndarray, cuts: list[int]) -> None:
    whole, pieces = VehicleClock(), VehicleClock()
    expected = np.concatenate([whole.push(rows), whole.flush()])
    parts, at, i = [], 0, 0
    while at < len(rows):
        size = cuts[i % len(cuts)] or 1
        parts.append(pieces.push(rows[at : at + size]))
        at, i = at + size, i + 1
    out = np.concatenate([*parts, pieces.flush()])
    assert out.tobytes() == expected.tobytes()
    assert pieces.counts == whole.counts
    counts = whole.counts
    assert len(expected) == counts.rows == len(rows) - counts.late - counts.bad_stamps - counts.untimed
    assert np.isfinite(expected[:, TIME]).all()
    assert (np.diff(expected[:, SESSION]) >= 0).all()
    assert (np.diff(expected[:, SEQUENCE]) > 0).all()
