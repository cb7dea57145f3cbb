"""The diagnosis of a replay: an honest flight has nothing said of it, and what is put into one is named."""

import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from mavkf.cli import main
from mavkf.config import Config, with_settings
from mavkf.models.strapdown import DDELAY, DGNSS, Q
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.replay import linearity, plot
from mavkf.replay.diagnosis import diagnose
from mavkf.replay.faults import parse_fault
from mavkf.replay.innovations import of_one
from mavkf.replay.options import Options
from mavkf.replay.results import SessionResult
from mavkf.replay.run import run
from mavkf.replay.simulation import simulate
from mavkf.samples import Source


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("diagnosis") / "flight.tlog"
    simulate(path, seed=7, duration_s=120.0, imu_hz=100.0)
    return path


@pytest.fixture(scope="module")
def honest(log: Path) -> SessionResult:
    return run(log, Options()).sessions[0]


def said(log: Path, *settings: str, fault: str | None = None) -> str:
    options = Options(config=with_settings(Config(), settings), faults=() if fault is None else (parse_fault(fault),))
    return "\n".join(diagnose(run(log, options).sessions[0], details=False)["said"])


def test_an_honest_flight_has_nothing_said_of_it(honest: SessionResult) -> None:
    found = diagnose(honest, details=False)
    assert found["said"] == []
    assert {"gnss_position", "gnss_velocity", "magnetometer", "barometer"} <= set(found["sensors"])
    assert {sensor["verdict"] for sensor in found["sensors"].values()} <= {"fine", "unknown"}
    assert {finding["verdict"] for finding in found["linearisation"].values()} == {"fine"}
    assert "prediction" in found["linearisation"]
    assert [finding["verdict"] for finding in found["covariance"]] == ["fine", "fine"]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (["noise.gnss_colour=0"], ["gnss_position is refused", "or is given too little noise"]),
        (["noise.magnetometer_t=3e-8"], ["magnetometer has outliers", "magnetometer noise learnt as 5 times"]),
        (["vehicle.gnss_delay_s=0.4"], ["GNSS delay learnt as -0.", "set vehicle.gnss_delay_s=0.1"]),
        (
            ["vehicle.gnss_delay_s=0.4", "noise.gnss_delay_initial_s=0"],
            ["gnss_velocity", "last longer", "a wrong vehicle.gnss_delay_s"],
        ),
    ],
)
def test_a_wrong_setting_is_named(log: Path, settings: list[str], expected: list[str]) -> None:
    sentences = said(log, *settings)
    for part in expected:
        assert part in sentences


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("accelerometer-step:at=60,size=0.3,towards=x", "accelerometer bias along x learnt as +0."),
        ("gnss-noise:at=1,size=3", "gnss_position has outliers"),
        ("gnss-noise:at=1,size=6", "gnss_position is refused: 98 % of"),
        (
            "gnss-velocity:at=1,size=0.6,towards=0",
            "gnss_position is refused: 86 % of 567 were not used: it contradicts",
        ),
    ],
)
def test_a_fault_is_named(log: Path, fault: str, expected: str) -> None:
    assert expected in said(log, fault=fault)


def test_details_are_all_findings_and_plain_values(honest: SessionResult) -> None:
    found = diagnose(honest, details=True)
    written = json.loads(msgspec.json.encode(found))
    position = written["sensors"]["gnss_position"]
    assert len(position["findings"]) == 3 + 3 * 6
    keys = {"name", "axis", "value", "low", "high", "probability", "p_value", "verdict", "source", "sentence"}
    for finding in [*position["findings"], *position["consequences"], *written["covariance"]]:
        assert set(finding) == keys
    assert not diagnose(honest, details=False)["sensors"]["gnss_position"]["findings"]


def test_people_read_one_line_and_all_findings_if_they_ask(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(log)]) == 0
    short = capsys.readouterr().out
    assert "diagnosis: nothing speaks against the filter" in short
    assert "Ljung-Box" not in short
    assert main(["replay", str(log), "--diagnose", "--set", "vehicle.gnss_delay_s=0.4"]) == 0
    long = capsys.readouterr().out
    assert "  ! GNSS delay learnt" in long
    for part in ("Ljung-Box north", "cumulative periodogram", "normality", "condition of P", "prediction"):
        assert part in long


def test_the_plot_shows_how_innovations_correlate(honest: SessionResult) -> None:
    figure = pytest.importorskip("matplotlib.figure")
    axes = figure.Figure().add_subplot()
    plot._correlations(axes, honest.output.innovations, Sensor.GNSS_POSITION)
    lines = axes.get_lines()
    assert [line.get_label() for line in lines] == ["north", "east", "down"]
    used = honest.output.innovations[honest.output.innovations[:, L.I_SENSOR] == Sensor.GNSS_POSITION]
    down = used[:, L.I_R + 2] / np.sqrt(used[:, L.I_S + 8])
    assert lines[2].get_ydata()[0] == pytest.approx(np.corrcoef(down[1:], down[:-1])[0, 1], abs=0.01)
    nothing = figure.Figure().add_subplot()
    plot._correlations(nothing, honest.output.innovations[:0], Sensor.GNSS_POSITION)
    assert not nothing.get_lines()


def rows(sensor: Sensor, source: Source, size: int, count: int, **r: float) -> Any:
    found = np.zeros((count, L.INNOVATION_WIDTH))
    found[:, L.I_TIME] = np.arange(count)
    found[:, L.I_SENSOR], found[:, L.I_SOURCE], found[:, L.I_SIZE] = sensor, source, size
    found[:, L.I_R : L.I_R + size] = np.random.default_rng(1).normal(size=(count, size)) + r.get("mean", 0.0)
    found[:, L.I_S : L.I_S + size * size] = np.eye(size).ravel()
    found[:, L.I_NIS] = np.sum(found[:, L.I_R : L.I_R + size] ** 2, axis=1)
    found[:, L.I_LIMIT], found[:, L.I_FUSED] = 25.0, 1.0
    return found


@pytest.mark.parametrize(
    ("speed", "size", "judged"), [(0.5, 2, False), (5.0, 2, True), (0.5, 3, True), (np.nan, 2, False)]
)
def test_the_course_that_a_slow_receiver_holds_is_no_bias(speed: float, size: int, judged: bool) -> None:
    """It shows the size of its noise along that course; one that measures all three components does not."""
    held = rows(Sensor.GNSS_VELOCITY, Source.GPS_RAW_INT, size, 200, mean=1.0)
    found = of_one(held, np.full(200, speed), float(Source.GPS_RAW_INT)).consequences()
    assert any(finding.name == "mean" for finding in found) is judged


def test_a_second_receiver_is_judged_by_its_size_only() -> None:
    found = of_one(
        rows(Sensor.GNSS_POSITION, Source.GPS2_RAW, 3, 200, mean=1.0), np.full(200, 5.0), float(Source.GPS_RAW_INT)
    )
    assert found.name == "gnss_position GPS2_RAW"
    assert {finding.name for finding in found.consequences()} == {"refused", "size", "coverage", "growth"}


def test_hessians_are_those_of_the_measurement(honest: SessionResult) -> None:
    """Against second differences of the prediction itself along random errors of attitude, delay and velocity."""
    x = honest.state[L.X : L.P].copy()
    x[Q : Q + 4] = (0.8, 0.36, -0.36, 0.32)
    x[Q : Q + 4] /= np.linalg.norm(x[Q : Q + 4])
    n = len(L.covariance(honest.state))
    for sensor, predict in linearity_predictions().items():
        jacobian = linearity._measurements(np.array([1.0, 2.0, 0.5]), np.array([0.1, 0.2, -0.3]), n)[sensor]
        found = linearity.hessians(jacobian, x, (*linearity.TURNS, DDELAY))
        for seed in range(5):
            dx = np.random.default_rng(seed).normal(size=n) * 1e-2
            dx[DGNSS:DDELAY], dx[9:DGNSS] = 0.0, 0.0
            dx[DDELAY + 1 :] *= 1e-4
            ahead, behind = x.copy(), x.copy()
            linearity.retract(ahead, dx)
            linearity.retract(behind, -dx)
            second = predict(ahead) - 2.0 * predict(x) + predict(behind)
            expected = np.einsum("aij,i,j->a", found, dx, dx)
            np.testing.assert_allclose(expected, second, rtol=2e-3, atol=2e-3 * np.abs(second).max())


def linearity_predictions() -> dict[Sensor, Any]:
    from mavkf.models import gnss, magnetometer
    from mavkf.models.rotation import rotation_matrix

    a, rate = np.array([1.0, 2.0, 0.5]), np.array([0.1, 0.2, -0.3])

    def predicted(compiled: Any, *arguments: Any) -> Any:
        def predict(x: Any) -> Any:
            C, z_hat = np.empty((3, 3)), np.empty(3)
            rotation_matrix(x[Q : Q + 4], C)
            compiled(x, *(C if argument is rotation_matrix else argument for argument in arguments), z_hat)
            return z_hat

        return predict

    return {
        Sensor.GNSS_POSITION: predicted(gnss.predict_position, a, rotation_matrix, rate),
        Sensor.MAGNETOMETER: predicted(magnetometer.predict, rotation_matrix),
    }


def test_a_filter_that_knows_little_is_told_that_the_first_order_is_not_enough(honest: SessionResult) -> None:
    doubtful = deepcopy(honest)
    for state in doubtful.tally.states.found.values():
        for k in range(3, 6):
            state.row[L.R_POSE_COVARIANCE + 7 * k] = 0.5  # rad^2
    assert linearity.judge_linearity(doubtful)["prediction"].verdict == "broken"
