"""Accuracy against truth: a simulated flight always, recorded flights where MAVKF_FLIGHTS names their folder."""

import os
from pathlib import Path

import numpy as np
import pytest

from mavkf.replay.export import columns
from mavkf.replay.options import Options
from mavkf.replay.run import run
from mavkf.replay.simulation import simulate
from mavkf.replay.truth import Errors, errors, read_truth

FLIGHTS = os.environ.get("MAVKF_FLIGHTS")

# name, truth, from (s), and bars: horizontal m, down m, tilt deg, yaw deg (root mean square)
BARS = [
    ("ap01_copter_highrate", 50.0, (0.025, 0.025, 0.06, 0.12)),
    ("ap02_copter_gcs4hz", 50.0, (0.05, 0.05, 0.45, 0.75)),
    ("ap05_plane_mission", 50.0, (0.20, 0.09, 0.27, 0.30)),
    ("ap07_copter_long_stationary", 50.0, (0.95, 0.45, 0.08, 0.90)),
    ("sih_quad_box_orbit", 50.0, (0.085, 0.035, 0.16, 0.33)),
]
MOST_ERROR_OVER_SIGMA = 2.5


def score(log: Path, truth: Path, begin: float, as_live: bool) -> Errors:
    (session,) = run(log, Options(as_live=as_live)).sessions
    return errors(columns(session.output.poses), read_truth(truth), begin=begin)


@pytest.mark.skipif(
    FLIGHTS is None, reason="MAVKF_FLIGHTS does not name the folder of recorded flights: accuracy on them is NOT tested"
)
@pytest.mark.parametrize("as_live", [False, True], ids=["offline", "as-live"])
@pytest.mark.parametrize(("name", "begin", "bars"), BARS, ids=[bar[0] for bar in BARS])
def test_recorded_flight(name: str, begin: float, bars: tuple[float, ...], as_live: bool) -> None:
    folder = Path(FLIGHTS or "")
    found = score(folder / f"{name}.tlog", folder / f"{name}.truth.csv", begin, as_live).statistics
    for quantity, bar in zip(("horizontal_m", "down_m", "tilt_deg", "yaw_deg"), bars, strict=True):
        assert found[quantity].rms < bar, quantity
        assert found[quantity].coverage >= 0.99, quantity
    for quantity, statistics in found.items():
        assert not statistics.error_over_sigma > MOST_ERROR_OVER_SIGMA, quantity


@pytest.fixture(scope="module", params=["copter", "plane"])
def simulated(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("flight")
    log, truth = folder / "flight.tlog", folder / "truth.csv"
    simulate(log, seed=3, duration_s=100.0, vehicle=request.param).write_csv(truth)
    return log, truth


@pytest.mark.parametrize("as_live", [False, True], ids=["offline", "as-live"])
def test_simulated_flight(simulated: tuple[Path, Path], as_live: bool) -> None:
    # the simulator's receiver wanders by 0.5 m horizontally and 0.9 m vertically: three sigma of that cannot be seen by anyone
    found = score(*simulated, begin=30.0, as_live=as_live).statistics
    assert found["horizontal_m"].rms < 3 * 0.5 * np.sqrt(2.0)
    assert found["down_m"].rms < 3 * 0.9
    assert found["vn_ms"].rms < 0.2
    assert found["tilt_deg"].rms < 0.8
    assert found["yaw_deg"].rms < 3.0
    assert found["horizontal_m"].coverage > 0.99
