"""True motion: its files, and errors against it made by hand."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mavkf.errors import LogError, UsageError
from mavkf.models import earth
from mavkf.replay.truth import COLUMNS, Truth, errors, read_truth

FLIGHTS = os.environ.get("MAVKF_FLIGHTS")
Floats = NDArray[np.float64]
radii: Any = earth.radii


def motion(n: int = 201) -> Truth:
    """A flight of 20 s that crosses the antimeridian, turns through south and banks."""
    t = np.linspace(10.0, 30.0, n)
    lon = np.radians(179.99995) + 1e-7 * (t - 10.0)
    lon = np.arctan2(np.sin(lon), np.cos(lon))
    yaw = 3.0 + 0.05 * (t - 10.0)
    euler = np.column_stack([0.2 * np.sin(t), 0.1 * np.cos(t), np.arctan2(np.sin(yaw), np.cos(yaw))])
    velocity = np.column_stack([np.sin(t), np.cos(t), 0.1 * t])
    return Truth(t, np.full(n, math.radians(-35.0)), lon, 500.0 + t, velocity, euler)


def matrix(euler: Floats) -> Floats:
    """C_nb of one attitude."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler), np.sin(euler)
    Z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    Y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    X = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return np.asarray(Z @ Y @ X, np.float64)


def estimate(
    truth: Truth, north: float = 0.0, east: float = 0.0, down: float = 0.0, turn: Floats | None = None
) -> dict[str, Floats]:
    """The truth as an estimate, displaced by metres and turned by a rotation matrix in n."""
    meridian, transverse = radii(float(truth.lat[0]))
    columns = {
        "time_boot_s": truth.time_boot_s.copy(),
        "lat_deg": np.degrees(truth.lat + north / meridian),
        "lon_deg": np.degrees(truth.lon + east / (transverse * math.cos(truth.lat[0]))),
        "alt_amsl_m": truth.alt - down,
    }
    for i, name in enumerate(("vn_ms", "ve_ms", "vd_ms")):
        columns[name] = truth.velocity[:, i].copy()
    C = np.stack([(np.eye(3) if turn is None else turn) @ matrix(angles) for angles in truth.euler])
    columns["roll_deg"] = np.degrees(np.arctan2(C[:, 2, 1], C[:, 2, 2]))
    columns["pitch_deg"] = np.degrees(-np.arcsin(C[:, 2, 0]))
    columns["yaw_deg"] = np.degrees(np.arctan2(C[:, 1, 0], C[:, 0, 0])) % 360.0
    return columns


def test_the_truth_has_no_error() -> None:
    found = errors(estimate(motion()), motion())
    assert set(found.statistics) == {
        *("north_m", "east_m", "horizontal_m", "down_m", "vn_ms", "ve_ms", "vd_ms"),
        *("roll_deg", "pitch_deg", "yaw_deg", "tilt_deg"),
    }
    for name, statistics in found.statistics.items():
        assert statistics.max < 1e-8, name
        assert statistics.coverage == 1.0
        assert math.isnan(statistics.error_over_sigma)


def test_errors_of_position_and_velocity_have_their_signs_and_sigmas() -> None:
    columns = estimate(motion(), north=2.0, east=-3.0, down=1.0)
    columns["ve_ms"] += np.where(np.arange(201) % 2, 0.5, -0.5)
    columns |= {"sigma_n_m": np.full(201, 4.0), "sigma_e_m": np.full(201, 1.0), "sigma_ve_ms": np.full(201, 0.5)}
    found = errors(columns, motion())
    assert found.values["north_m"] == pytest.approx(2.0, abs=1e-6)
    assert found.values["east_m"] == pytest.approx(-3.0, abs=1e-6)
    assert found.values["down_m"] == pytest.approx(1.0, abs=1e-9)
    s = found.statistics
    assert s["horizontal_m"].rms == pytest.approx(math.sqrt(13.0))
    assert (s["ve_ms"].rms, s["ve_ms"].p95, s["ve_ms"].max) == pytest.approx((0.5, 0.5, 0.5))
    assert s["north_m"].error_over_sigma == pytest.approx(0.5)
    assert s["horizontal_m"].error_over_sigma == pytest.approx(math.sqrt((0.25 + 9.0) / 2))
    assert s["horizontal_m"].inside_95 == pytest.approx(0.5)
    assert s["ve_ms"].error_over_sigma == pytest.approx(1.0)


def test_p95_and_max_see_the_tail() -> None:
    columns = estimate(motion())
    columns["alt_amsl_m"][:12] -= 10.0
    down = errors(columns, motion()).statistics["down_m"]
    assert down.max == pytest.approx(10.0)
    assert down.p95 == pytest.approx(10.0)
    assert down.rms == pytest.approx(10.0 * math.sqrt(12 / 201))


def test_a_turn_about_the_vertical_is_yaw_and_one_about_north_is_tilt() -> None:
    yaw = errors(estimate(motion(), turn=matrix(np.radians([0.0, 0.0, 2.0]))), motion())
    assert yaw.values["yaw_deg"] == pytest.approx(2.0)
    assert yaw.values["tilt_deg"] == pytest.approx(0.0, abs=1e-9)
    tilt = errors(estimate(motion(), turn=matrix(np.radians([1.5, 0.0, 0.0]))), motion())
    assert tilt.values["tilt_deg"] == pytest.approx(1.5)
    assert tilt.values["yaw_deg"] == pytest.approx(0.0, abs=1e-9)


def test_tilt_needs_no_yaw() -> None:
    columns = estimate(motion(), turn=matrix(np.radians([1.5, 0.0, 0.0])))
    columns["yaw_deg"][:] = np.nan
    found = errors(columns, motion())
    assert found.statistics["tilt_deg"].rms == pytest.approx(1.5)
    assert "yaw_deg" not in found.statistics


def test_the_truth_is_interpolated_and_what_is_outside_of_it_left_out() -> None:
    columns = estimate(motion())
    columns["time_boot_s"] += 0.05  # half of a step late, climbing at 1 m/s: 5 cm too low
    found = errors(columns, motion(), end=20.0)
    assert found.time_boot_s[0] == pytest.approx(10.05) and found.time_boot_s[-1] <= 20.0
    assert found.values["down_m"] == pytest.approx(0.05)
    assert found.values["east_m"] == pytest.approx(-0.05 * 1e-7 * 6384e3 * math.cos(math.radians(35.0)), rel=1e-2)
    with pytest.raises(LogError, match="no time from 40 s"):
        errors(columns, motion(), begin=40.0)


def test_coverage_counts_the_seconds_with_a_value() -> None:
    columns = estimate(motion())
    columns["lat_deg"][(columns["time_boot_s"] > 14.5) & (columns["time_boot_s"] < 19.5)] = np.nan
    found = errors(columns, motion()).statistics
    assert found["north_m"].coverage == pytest.approx(16 / 20)
    assert found["down_m"].coverage == 1.0


def test_a_file_gives_back_what_was_written(tmp_path: Path) -> None:
    truth = motion()
    truth.velocity[5, 1] = np.nan
    truth.write_csv(tmp_path / "truth.csv")
    assert (tmp_path / "truth.csv").read_text().splitlines()[0] == ",".join(COLUMNS)
    again = read_truth(tmp_path / "truth.csv")
    assert again.time_boot_s == pytest.approx(truth.time_boot_s, abs=1e-6)
    assert again.lon == pytest.approx(truth.lon, abs=1e-11)
    assert again.velocity == pytest.approx(truth.velocity, abs=1e-5, nan_ok=True)
    assert again.quaternion * np.sign(again.quaternion[:, :1] * truth.quaternion[:, :1]) == pytest.approx(
        truth.quaternion, abs=1e-6
    )
    with pytest.raises(UsageError, match="existing folder"):
        truth.write_csv(tmp_path / "nowhere" / "truth.csv")


def test_columns_may_be_missing_and_rows_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    path.write_text("# time_boot_s, alt_amsl_m,extra\n2.0,20,x\n\n1.0,10,y\n3.0,,z\n,5,\n")
    truth = read_truth(path)
    assert truth.time_boot_s.tolist() == [1.0, 2.0, 3.0]
    assert truth.alt[:2].tolist() == [10.0, 20.0] and math.isnan(truth.alt[2])
    assert np.isnan(truth.euler).all() and truth.euler.shape == (3, 3)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "no column time_boot_s"),
        ("time,lat_deg\n1,2\n", "no column time_boot_s"),
        ("time_boot_s,lat_deg\n", "no rows"),
        ("time_boot_s,lat_deg\n,2\n", "no rows"),
        ("time_boot_s,lat_deg\n1,2\n2,north\n", "line 3 "),
        ("time_boot_s,lat_deg\n1,2\n\n2\n", "line 4 "),
        (b"\xff\xfe\x00", "not text"),
        (None, "No such file"),
    ],
)
def test_a_bad_file_is_one_clear_sentence(tmp_path: Path, text: str | bytes | None, sentence: str) -> None:
    path = tmp_path / "truth.csv"
    if text is not None:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(LogError, match=sentence):
        read_truth(path)


@pytest.mark.skipif(not FLIGHTS, reason="MAVKF_FLIGHTS names no folder of recorded flights")
def test_the_same_numbers_as_the_flights_own_scorer(tmp_path: Path) -> None:
    scorer = Path(FLIGHTS or "").parent / "tools" / "score.py"
    source = Path(FLIGHTS or "") / "ap01_copter_highrate.truth.csv"
    if not scorer.exists() or not source.exists():
        pytest.skip("the folder has no scorer beside it")
    truth, random = read_truth(source), np.random.default_rng(3)
    n = len(truth.time_boot_s)
    columns = {
        "time_boot_s": truth.time_boot_s + 0.003,
        **{
            name: np.degrees(v) + 1e-5 * random.standard_normal(n)
            for name, v in (("lat_deg", truth.lat), ("lon_deg", truth.lon))
        },
        "alt_amsl_m": truth.alt + random.standard_normal(n),
        **{f"v{k}_ms": truth.velocity[:, i] + random.standard_normal(n) for i, k in enumerate("ned")},
        **{
            f"{k}_deg": np.degrees(truth.euler[:, i]) + 2 * random.standard_normal(n)
            for i, k in enumerate(("roll", "pitch", "yaw"))
        },
        "sigma_n_m": np.full(n, 1.2),
        "sigma_e_m": np.full(n, 0.9),
        "sigma_yaw_deg": np.full(n, 2.0),
    }
    columns["lat_deg"][3000:4000] = np.nan
    columns["yaw_deg"][:2500] = np.nan
    path = tmp_path / "estimate.csv"
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", fmt="%.12f", header=",".join(columns), comments="")
    output = subprocess.run([sys.executable, scorer, path, source, "--json"], capture_output=True, check=True).stdout
    theirs, ours = json.loads(output)["errors"], errors(columns, truth).statistics
    assert set(theirs) == set(ours)
    for name, numbers in theirs.items():
        mine = ours[name]
        assert (mine.rms, mine.p95, mine.max) == pytest.approx(
            (numbers["rms"], numbers["p95"], numbers["max"]), rel=1e-5
        )
        assert mine.coverage == pytest.approx(numbers["coverage"], abs=0.01)
        assert mine.error_over_sigma == pytest.approx(
            numbers.get("error_over_sigma_rms", math.nan), rel=1e-5, nan_ok=True
        )
        assert mine.inside_95 == pytest.approx(numbers.get("inside_95", math.nan), abs=1e-4, nan_ok=True)
