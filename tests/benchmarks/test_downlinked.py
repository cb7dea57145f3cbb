"""The comparison with the autopilot's downlinked estimate, on a simulated flight whose autopilot errs by known amounts."""

import numpy as np
import pytest

from benchmarks.accuracy.downlinked import differences, messages_of
from mavkf.config import Config
from mavkf.link.clocks import ClockCounts
from mavkf.navigation.estimator import Output
from mavkf.navigation.setup import choose
from mavkf.replay.boot_clock import on_boot_clock
from mavkf.replay.results import SessionResult
from mavkf.replay.simulation import simulate
from mavkf.replay.simulation.flight import ESTIMATE_AGE, ESTIMATE_SPEED
from mavkf.replay.tally import Tally
from mavkf.replay.tlog import Log, read_tlog
from mavkf.replay.truth import SPEEDS, Truth


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Truth, Log, SessionResult]:
    path = tmp_path_factory.mktemp("downlinked") / "flight.tlog"
    truth = simulate(path, seed=2, duration_s=120.0, imu_hz=10.0)
    log = read_tlog(path)
    rows, counts = on_boot_clock(log.rows[1, 1], 3.0)
    assert isinstance(counts, ClockCounts)
    nothing = np.empty((0, 0))
    return (
        truth,
        log,
        SessionResult(
            "1-1", 0, choose(rows, Config()), Tally(), rows, Output(nothing, nothing, nothing), {}, nothing, nothing
        ),
    )


def true_pose(truth: Truth, lag: float) -> dict[str, np.ndarray]:
    """The truth as a pose at 10 Hz that is late by `lag`, s."""
    euler, place = np.degrees(truth.euler), np.degrees([truth.lat, truth.lon])
    columns = {
        "time_boot_s": truth.time_boot_s + lag,
        "lat_deg": place[0],
        "lon_deg": place[1],
        "alt_amsl_m": truth.alt,
        **{name: truth.velocity[:, i] for i, name in enumerate(SPEEDS)},
        **{name: euler[:, i] for i, name in enumerate(("roll_deg", "pitch_deg", "yaw_deg"))},
    }
    return {name: column[3::10] for name, column in columns.items()}


def test_the_difference_is_the_autopilots_own_error(flight: tuple[Truth, Log, SessionResult]) -> None:
    truth, log, session = flight
    apart = differences(log, session, true_pose(truth, ESTIMATE_AGE), 10.0)
    assert apart.counts["velocity_ms"] == pytest.approx(4.0 * 110.0, abs=5)
    assert apart.rms("velocity_ms") == pytest.approx(ESTIMATE_SPEED * np.sqrt(3.0), rel=0.4)
    assert 0.1 < apart.rms("tilt_deg") < 0.4
    assert 0.3 < apart.rms("yaw_deg") < 1.2
    assert 0.3 < apart.rms("horizontal_m") < 1.5
    assert 0.3 < apart.rms("down_m") < 2.0


def test_only_settled_poses_and_messages_of_the_session_count(flight: tuple[Truth, Log, SessionResult]) -> None:
    truth, log, session = flight
    apart = differences(log, session, true_pose(truth, 0.0), 100.0)
    assert apart.counts["tilt_deg"] == pytest.approx(4.0 * 20.0, abs=3)
    assert messages_of(log, session, "ATTITUDE").size == pytest.approx(4.0 * 119.0, abs=3)
    both = apart.plus(apart)
    assert both.counts["yaw_deg"] == 2 * apart.counts["yaw_deg"] and both.rms("yaw_deg") == apart.rms("yaw_deg")
    assert np.isnan(apart.rms("nothing"))
