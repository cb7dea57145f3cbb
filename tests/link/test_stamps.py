"""Arrival stamps, which no CRC protects, against their neighbours."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavkf.link.framing import FRAME
from mavkf.link.stamps import StampRepair

T0 = 1_500_000_000_000_000
SECOND = 1_000_000
STEADY = [T0 + 20_000 * i for i in range(20)]


def repaired(stamps: list[int], cuts: tuple[int, ...] = ()) -> tuple[list[int], int]:
    frames = np.zeros(len(stamps), FRAME)
    frames["stamp"] = stamps
    repair = StampRepair()
    parts = [repair.push(part) for part in np.split(frames, cuts)]
    parts.append(repair.push(frames[:0], last=True))
    return np.concatenate([part["stamp"] for part in parts]).tolist(), repair.bad


@pytest.mark.parametrize("start", [T0, 0, 5 * SECOND, 4_000_000_000 * SECOND])
def test_a_log_of_any_year_is_believed(start: int) -> None:
    stamps = [start + 20_000 * i for i in range(20)]
    assert repaired(stamps) == (stamps, 0)


@pytest.mark.parametrize(
    "wrong", [-1, 0, T0 + 3600 * SECOND, T0 - 3600 * SECOND, T0 + 30 * SECOND, 1 << 60, T0 - 5 * SECOND]
)
def test_one_wrong_stamp_is_its_predecessors(wrong: int) -> None:
    stamps = STEADY.copy()
    stamps[10] = wrong
    assert repaired(stamps) == ([*STEADY[:10], STEADY[9], *STEADY[11:]], 1)


@pytest.mark.parametrize("wrong", [-1, T0 + 3600 * SECOND, T0 - 3600 * SECOND])
def test_a_wrong_first_stamp_is_its_successors(wrong: int) -> None:
    assert repaired([wrong, *STEADY[1:]]) == ([STEADY[1], *STEADY[1:]], 1)


@pytest.mark.parametrize("jump", [86_400 * SECOND, -7200 * SECOND, 100 * SECOND])
def test_a_jump_that_lasts_is_believed(jump: int) -> None:
    stamps = STEADY[:10] + [t + jump for t in STEADY[10:]]
    assert repaired(stamps) == (stamps, 0)


def test_a_wrong_last_stamp() -> None:
    assert repaired([*STEADY, T0 + 7200 * SECOND]) == ([*STEADY, STEADY[-1]], 1)


def test_silence_and_small_steps_backwards_are_believed() -> None:
    stamps = [*STEADY, STEADY[-1] + 40 * SECOND, STEADY[-1] + 41 * SECOND, STEADY[-1] + 41 * SECOND - 300_000]
    assert repaired(stamps) == (stamps, 0)


@given(st.lists(st.integers(-(2**63), 2**63 - 1), max_size=40))
def test_any_stamps_at_all(stamps: list[int]) -> None:
    assert 0 <= repaired(stamps)[1] <= len(stamps)


@pytest.mark.parametrize("stamp", [-1, 1 << 60])
def test_a_stamp_is_zero_where_none_is_true(stamp: int) -> None:
    assert repaired([stamp] * 20, (7,)) == ([0] * 20, 20)


near = st.one_of(st.integers(0, 10**6), st.sampled_from([70 * SECOND, -70 * SECOND, 3 * SECOND, 1 << 60]))


@given(st.lists(near, min_size=1, max_size=60), st.lists(st.integers(1, 59), max_size=8).map(sorted))
def test_it_does_not_matter_in_what_blocks_they_come(steps: list[int], cuts: list[int]) -> None:
    stamps = [T0, *(T0 + 20_000 * i + step for i, step in enumerate(steps))]
    assert repaired(stamps, tuple(cuts)) == repaired(stamps)
