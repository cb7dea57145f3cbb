"""What the integrity benchmarks draw, count and score, on numbers that are known."""

import math
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.integrity.detection import place_in_range
from benchmarks.integrity.drawing import ACCELERATIONS, AROUND, AXES, CHOICES, KINDS, SPOOF, draw_fault, seeded
from benchmarks.integrity.flights import HAPPENINGS, first_told
from benchmarks.integrity.flown import POOL, RECORDED, member
from benchmarks.integrity.intervals import clopper_pearson
from benchmarks.integrity.protection import BEGIN, FIRST_FAULT, LAST_FAULT, draw_faults, levels
from benchmarks.integrity.runs import summary
from benchmarks.integrity.scoring import Score, Track, score
from benchmarks.integrity.signs import Sign
from mavkf.navigation import layout as L
from mavkf.replay.faults import parse_fault
from mavkf.replay.truth import Truth


@pytest.mark.parametrize(
    ("hits", "count", "low", "high"),
    [  # Newcombe (1998), table I, the method of Clopper and Pearson
        (81, 263, 0.2527, 0.3676),
        (15, 148, 0.0578, 0.1617),
        (0, 20, 0.0000, 0.1684),
        (1, 29, 0.0009, 0.1776),
        (20, 20, 0.8316, 1.0000),
    ],
)
def test_the_interval_is_the_published_one(hits: int, count: int, low: float, high: float) -> None:
    assert clopper_pearson(hits, count) == (pytest.approx(low, abs=6e-5), pytest.approx(high, abs=6e-5))


def test_the_interval_of_nothing_in_five_thousand_has_its_closed_form() -> None:
    low, high = clopper_pearson(0, 5000)
    assert low == 0.0
    assert high == pytest.approx(1.0 - 0.025 ** (1.0 / 5000.0), rel=1e-9)


@pytest.mark.parametrize("name", [*KINDS, SPOOF.fault])
def test_drawn_faults_lie_in_their_ranges_and_can_be_repeated(name: str) -> None:
    kind = KINDS.get(name, SPOOF)
    drawn = [draw_fault(seeded(3, n), kind, (75.0, 110.0), 265.0) for n in range(200)]
    assert drawn == [draw_fault(seeded(3, n), kind, (75.0, 110.0), 265.0) for n in range(200)]
    assert len({fault.at for fault in drawn}) == 200
    for fault in drawn:
        assert fault.kind == kind.fault
        assert 75.0 <= fault.at <= 110.0
        assert kind.lasts[0] <= fault.lasts <= kind.lasts[1]
        assert kind.sizes is None or kind.sizes[0] <= fault.size <= kind.sizes[1]
        assert parse_fault(str(fault)) == fault
    if kind.sizes is not None:  # all of the range is used
        low, high = kind.sizes if kind.towards == AXES else np.log(kind.sizes)
        sizes = np.array([fault.size for fault in drawn])
        places = ((sizes if kind.towards == AXES else np.log(sizes)) - low) / (high - low)
        np.testing.assert_allclose(np.percentile(places, [10, 50, 90]), [0.1, 0.5, 0.9], atol=0.12)
    ways = {fault.towards for fault in drawn}
    assert len(ways) == 200 if kind.towards == AROUND else ways == set(CHOICES.get(kind.towards, ("",)))
    if kind is SPOOF:
        assert all(ACCELERATIONS[0] <= fault.acceleration <= ACCELERATIONS[1] for fault in drawn)


def test_a_fault_is_cut_where_the_flight_ends() -> None:
    outages = [draw_fault(seeded(4, n), KINDS["gnss-outage"], (75.0, 110.0), 130.0) for n in range(50)]
    assert max(fault.end for fault in outages) == pytest.approx(130.0)
    assert min(fault.lasts for fault in outages) >= 5.0


def test_a_flight_has_one_fault_each_five_minutes_and_one_at_a_time() -> None:
    flights = [[fault for _, fault in draw_faults(n, 885.0)] for n in range(300)]
    assert sum(map(len, flights)) == pytest.approx(300 * (885.0 - FIRST_FAULT - LAST_FAULT) / 300.0, rel=0.12)
    for faults in flights:
        assert all(fault.at >= FIRST_FAULT and fault.end <= 885.0 + 1e-9 for fault in faults)
        assert all(a.end <= b.at for a, b in pairwise(faults))
    assert flights[7] == [fault for _, fault in draw_faults(7, 885.0)]
    assert not any(fault.kind == SPOOF.fault for faults in flights for fault in faults)


def test_each_fourth_run_is_of_a_recorded_flight_and_all_flights_are_used() -> None:
    runs = [member(run) for run in range(300)]
    assert all((flight >= POOL) == (run % 4 == 3) for run, flight in enumerate(runs))
    assert set(runs) == set(range(POOL + len(RECORDED)))


def made_up(error_after: float = 0.5) -> Track:
    """From 100 to 160 s: 1 m, from 110 to 115 s 9 m, then 4 m, from the fault's end at 130 s 6 m for 3 s, then what is told."""
    t = np.arange(100.0, 160.0, 0.1)
    error = np.select([t < 110.0, t < 115.0, t < 130.0, t < 133.0], [1.0, 9.0, 4.0, 6.0], error_after)
    return Track(t, error, np.full_like(t, 0.5))


def test_a_known_detection_is_scored() -> None:
    signs = [Sign(50.0, "gnss_jump"), Sign(112.0, "gnss_outage"), Sign(117.0, "gnss_drift"), Sign(131.0, "gnss_jump")]
    found = score(made_up(), 105.0, 130.0, signs, ("gnss_jump", "gnss_drift"))
    assert found.told == pytest.approx(7.0) and found.named == pytest.approx(12.0)
    assert (found.before, found.after, found.early) == (9.0, 9.0, False)
    assert found.recovery == pytest.approx(2.95, abs=0.06)  # the last error outside three sigma is at 132.9 s
    late = score(made_up(), 105.0, 130.0, signs[2:], ("gnss_frozen",))
    assert late.told == pytest.approx(12.0) and math.isnan(late.named)
    assert (late.before, late.after) == (9.0, 4.0)


def test_nothing_told_is_scored_as_all_before() -> None:
    found = score(made_up(), 105.0, 130.0, [Sign(104.0, "gnss_jump"), Sign(130.5, "gnss_jump")], ("gnss_jump",))
    assert math.isnan(found.told) and math.isnan(found.named) and math.isnan(found.after)
    assert found.before == 9.0 and found.early


def test_a_fix_is_fused_before_its_stamp() -> None:
    found = score(made_up(), 105.0, 130.0, [Sign(104.9, "gnss_jump")], ("gnss_jump",))
    assert found.told == 0.0 and found.named == 0.0


def test_an_error_that_stays_outside_or_unknown_never_recovers() -> None:
    assert score(made_up(1.51), 105.0, 130.0, [], ()).recovery == math.inf
    assert score(made_up(math.nan), 105.0, 130.0, [], ()).recovery == math.inf
    assert score(made_up(1.49), 105.0, 130.0, [], ()).recovery < 3.0
    run = made_up()
    run.error[(run.t > 136.0) & (run.t < 136.15)] = 2.0  # back for three seconds only
    assert score(run, 105.0, 130.0, [], ()).recovery == pytest.approx(6.1, abs=0.06)


def test_many_scores_add_up() -> None:
    never = Score(math.nan, math.nan, 30.0, math.nan, math.inf, True)
    scores = [Score(1.0, 2.0, 3.0, 4.0, 0.0, False), Score(3.0, math.nan, 5.0, 6.0, 8.0, False), never, never]
    found = summary(vars(each) | {"never": each.recovery == math.inf} for each in scores)
    assert (found["named"], found["told"], found["never"]) == (0.25, 0.5, 2)
    assert found["early"] == 0.5
    assert found["told_s"] == (2.0, pytest.approx(2.8))
    assert found["before"][0] == 17.5 and found["after"][0] == 5.0 and found["recovery_s"][0] == 4.0


def test_sizes_are_sorted_into_their_ranges() -> None:
    step, scale = KINDS["gnss-step"], KINDS["gyro-scale"]
    assert [place_in_range(step, size) for size in (3.0, math.sqrt(300.0), 100.0)] == pytest.approx([0.0, 0.5, 1.0])
    assert [place_in_range(scale, size) for size in (0.7, 1.0, 1.15)] == pytest.approx([1.0, 0.0, 0.5])


def test_an_outage_that_lasts_when_the_loss_begins_tells_it() -> None:
    loss = HAPPENINGS[2]
    told, back = Sign(171.3, "gnss_outage"), Sign(173.0, "gnss_back")
    assert first_told([Sign(105.0, "gnss_outage"), Sign(112.0, "gnss_back"), told], loss) is told
    late = Sign(177.4, "gnss_outage")
    assert first_told([told, back, late], loss) is late
    assert first_told([told, back], loss) is None


def test_levels_are_held_against_the_error_of_their_own_axis() -> None:
    """A vehicle 3 m north and 4 m east of the truth and 2 m above it."""
    poses = np.zeros((3, L.POSE_WIDTH))
    poses[:, L.R_TIME] = [BEGIN - 1.0, BEGIN + 1.0, BEGIN + 2.0]
    poses[:, L.R_LATITUDE], poses[:, L.R_LONGITUDE], poses[:, L.R_HEIGHT] = 3.0 / 6_335_439.3, 4.0 / 6_378_137.0, 102.0
    poses[:, L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36] = np.diag([9.0, 16.0, 4.0, 1.0, 1.0, 1.0]).reshape(-1)
    poses[:, L.R_VELOCITY_COVARIANCE : L.R_VELOCITY_COVARIANCE + 9] = np.eye(3).reshape(-1)
    poses[:, L.R_SIGMA_EULER : L.R_SIGMA_EULER + 3] = 1.0
    t, nothing = np.array([0.0, 100.0]), np.zeros(2)
    found = levels(poses, Truth(t, nothing, nothing, nothing + 100.0, np.zeros((2, 3)), np.zeros((2, 3))))
    np.testing.assert_allclose(found["time"], [BEGIN + 1.0, BEGIN + 2.0])
    np.testing.assert_allclose(found["horizontal_error"], 5.0, atol=1e-5)
    np.testing.assert_allclose(found["vertical_error"], 2.0, atol=1e-9)
    np.testing.assert_allclose(found["horizontal_sigma"], 5.0)
    np.testing.assert_allclose(found["vertical_sigma"], 2.0)
