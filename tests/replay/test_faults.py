"""Faults in sample rows against what they are by other means, and the same in a simulated log."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
from numpy.typing import NDArray

import mavkf
from mavkf.cli import main
from mavkf.errors import UsageError
from mavkf.navigation import layout as L
from mavkf.replay.boot_clock import boot_times, on_boot_clock
from mavkf.replay.faults import KINDS, Fault, apply_faults, parse_fault
from mavkf.replay.options import Options
from mavkf.replay.run import run_rows
from mavkf.replay.simulation import simulate
from mavkf.replay.simulation.sensors import isa_pressure
from mavkf.replay.tlog import read_tlog
from mavkf.samples import (
    ACCEL,
    CLOCK,
    FIELD,
    FIX,
    GYRO,
    HEIGHT_AMSL,
    HEIGHT_ELLIPSOID,
    KIND,
    LATITUDE,
    LONGITUDE,
    PRESSURE,
    ROW_WIDTH,
    SEQUENCE,
    SIGMA_HORIZONTAL,
    SOURCE,
    STAMP,
    TIME,
    VELOCITY_N,
    Clock,
    Kind,
    Source,
)

Array = NDArray[np.float64]
PLACE = math.radians(47.4), math.radians(8.5), 488.0


def some_rows() -> Array:
    """Timed rows of all sensors over 40 s, in order of time; the receivers' fixes are repeated once each."""
    t = np.arange(0.0, 40.0, 0.1)
    sensors = (
        (Kind.GNSS, Source.GPS_RAW_INT, np.repeat(t[::2], 2)),
        (Kind.GNSS, Source.GPS2_RAW, t[::2]),
        (Kind.IMU, Source.RAW_IMU, t),
        (Kind.IMU, Source.SCALED_IMU2, t),
        (Kind.MAGNETOMETER, Source.RAW_IMU, t),
        (Kind.BAROMETER, Source.SCALED_PRESSURE, t),
    )
    random = np.random.default_rng(3)
    parts = []
    for kind, source, times in sensors:
        rows = np.full((times.size, ROW_WIDTH), np.nan)
        rows[:, KIND], rows[:, SOURCE], rows[:, CLOCK] = kind, source, Clock.BOOT_US
        rows[:, STAMP] = np.rint(times * 1e6)
        rows[:, TIME] = rows[:, STAMP] * 1e-6
        value = np.round(times * 7.0)
        if kind == Kind.GNSS:
            rows[:, FIX], rows[:, SIGMA_HORIZONTAL] = 3, 0.5
            rows[:, LATITUDE], rows[:, LONGITUDE], rows[:, HEIGHT_AMSL] = PLACE
            rows[:, LATITUDE] += 1e-7 * value
            rows[:, HEIGHT_ELLIPSOID] = 530.0
            rows[:, VELOCITY_N], rows[:, VELOCITY_N + 1] = value, -value
        elif kind == Kind.BAROMETER:
            rows[:, PRESSURE] = 95_000.0 + value
        else:
            rows[:, GYRO : GYRO + 6] = random.normal(size=(times.size, 6))
        parts.append(rows)
    joined = np.concatenate(parts)
    joined = joined[np.argsort(joined[:, TIME], kind="stable")]
    joined[:, SEQUENCE] = np.arange(joined.shape[0])
    return joined


def metres(rows: Array, true: Array) -> Array:
    """North, east, down metres (n, 3) of fixes against others, by pymap3d."""
    columns = [column for part in (rows, true) for column in part[:, LATITUDE : HEIGHT_AMSL + 1].T]
    return np.stack(pymap3d.geodetic2ned(*columns, deg=False), axis=1)


def during(rows: Array, kind: Kind, begin: float = 10.0, end: float = 20.0) -> Array:
    return (rows[:, KIND] == kind) & (rows[:, TIME] >= begin) & (rows[:, TIME] < end)


def changed(before: Array, after: Array) -> Array:
    """Which rows (n) and which columns (ROW_WIDTH) differ anywhere."""
    differs = (before != after) & ~(np.isnan(before) & np.isnan(after))
    return differs


def check_only(before: Array, after: Array, kind: Kind, columns: tuple[int, ...]) -> None:
    """All rows of a kind from 10 to 20 s are changed, in these columns, and nothing else."""
    differs = changed(before, after)
    np.testing.assert_array_equal(np.flatnonzero(differs.any(axis=1)), np.flatnonzero(during(before, kind)))
    assert set(np.flatnonzero(differs.any(axis=0))) == set(columns)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("gnss-step:at=10,for=10,size=40,towards=330", lambda t: (40 * math.sqrt(0.75), -20.0, 0.0)),
        ("gnss-step:at=10,for=10,size=5,towards=up", lambda t: (0.0, 0.0, -5.0)),
        ("gnss-drift:at=10,for=10,size=0.5,towards=90", lambda t: (0.0, 0.5 * (t - 10.0), 0.0)),
    ],
)
def test_positions_move_by_metres_of_the_ellipsoid(
    text: str, expected: Callable[[float], tuple[float, float, float]]
) -> None:
    rows = some_rows()
    faulty = apply_faults(rows, [parse_fault(text)])
    hit = during(rows, Kind.GNSS)
    want = np.array([expected(t) for t in rows[hit, TIME]])
    np.testing.assert_allclose(metres(faulty[hit], rows[hit]), want, atol=2e-3)
    assert not changed(rows[~hit], faulty[~hit]).any()
    np.testing.assert_array_equal(faulty[hit, VELOCITY_N:], rows[hit, VELOCITY_N:])
    # both heights go together
    np.testing.assert_allclose(faulty[hit, HEIGHT_ELLIPSOID] - faulty[hit, HEIGHT_AMSL], 42.0, atol=1e-9)


def test_a_spoofed_velocity_is_the_derivative_of_the_spoofed_position() -> None:
    rows = some_rows()
    faulty = apply_faults(rows, [parse_fault("gnss-spoof:at=10,for=20,size=3,towards=0,acceleration=0.4")])
    hit = during(rows, Kind.GNSS, end=30.0) & (rows[:, SOURCE] == Source.GPS2_RAW)
    t = rows[hit, TIME] - 10.0
    speed = (faulty - rows)[hit, VELOCITY_N]
    np.testing.assert_allclose(speed, np.where(t < 7.5, 0.4 * t, 3.0), atol=1e-9)
    way = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (speed[1:] + speed[:-1]))])  # exact but for the corner
    np.testing.assert_allclose(metres(faulty[hit], rows[hit])[:, 0], way, atol=5e-3)
    assert way[-1] > 40.0
    assert not changed(rows[rows[:, TIME] >= 30.0], faulty[rows[:, TIME] >= 30.0]).any()


def test_a_velocity_lies_alone() -> None:
    rows = some_rows()
    faulty = apply_faults(rows, [parse_fault("gnss-velocity:at=10,for=10,size=2,towards=180")])
    hit = during(rows, Kind.GNSS)
    np.testing.assert_allclose((faulty - rows)[hit, VELOCITY_N], -2.0)
    np.testing.assert_allclose((faulty - rows)[hit, VELOCITY_N + 1], 0.0, atol=1e-12)
    np.testing.assert_array_equal(faulty[:, :VELOCITY_N], rows[:, :VELOCITY_N])


def test_a_frozen_receiver_repeats_its_last_fix_and_its_clock_goes_on() -> None:
    rows = some_rows()
    faulty = apply_faults(rows, [parse_fault("gnss-freeze:at=10,for=10,source=GPS2_RAW")])
    mine = rows[:, SOURCE] == Source.GPS2_RAW
    hit = during(rows, Kind.GNSS) & mine
    last = rows[mine & (rows[:, TIME] < 10.0)][-1]
    np.testing.assert_array_equal(faulty[hit, 8:], np.tile(last[8:], (hit.sum(), 1)))
    np.testing.assert_array_equal(faulty[:, :8], rows[:, :8])
    assert not changed(rows[~hit], faulty[~hit]).any()


def test_a_receiver_frozen_from_the_beginning_repeats_its_first_fix() -> None:
    rows = some_rows()
    faulty = apply_faults(rows, [Fault(kind="gnss-freeze", at=-1.0)])
    for source in (Source.GPS_RAW_INT, Source.GPS2_RAW):
        mine = rows[:, SOURCE] == source
        np.testing.assert_array_equal(faulty[mine, 8:], np.tile(rows[mine][0, 8:], (mine.sum(), 1)))


def test_an_outage_says_no_fix_or_nothing() -> None:
    rows = some_rows()
    hit = during(rows, Kind.GNSS)
    lost = apply_faults(rows, [parse_fault("gnss-outage:at=10,for=10")])
    assert np.all(lost[hit, FIX] == 1) and np.isnan(lost[hit, STAMP]).all()
    assert not changed(rows[~hit], lost[~hit]).any()
    silent = apply_faults(rows, [parse_fault("gnss-outage:at=10,for=10,silent=1")])
    np.testing.assert_array_equal(silent, rows[~hit])


def test_a_jammed_receiver_is_white_and_claims_what_it_did() -> None:
    rows = some_rows()
    fault = parse_fault("gnss-noise:at=0,size=8")
    faulty = apply_faults(rows, [fault])
    fixes = rows[:, KIND] == Kind.GNSS
    main = rows[:, SOURCE] == Source.GPS_RAW_INT
    off = metres(faulty[main], rows[main])
    np.testing.assert_array_equal(off[::2], off[1::2])  # the same fix, repeated
    assert np.std(off[::2], axis=0) == pytest.approx(np.full(3, 8.0), rel=0.15)
    assert abs(np.mean(off[2::2, 0] * off[:-2:2, 0])) < 0.2 * 64.0
    other = metres(faulty[rows[:, SOURCE] == Source.GPS2_RAW], rows[rows[:, SOURCE] == Source.GPS2_RAW])
    assert abs(np.corrcoef(other[:, 0], off[::2, 0])[0, 1]) < 0.2
    np.testing.assert_array_equal(faulty[:, SIGMA_HORIZONTAL], rows[:, SIGMA_HORIZONTAL])
    assert not changed(rows[~fixes], faulty[~fixes]).any()
    # in pieces, the same; of another seed, another
    half = rows.shape[0] // 2
    pieces = np.concatenate([apply_faults(rows[:half], [fault]), apply_faults(rows[half:], [fault])])
    np.testing.assert_array_equal(pieces, faulty)
    assert changed(faulty, apply_faults(rows, [parse_fault("gnss-noise:at=0,size=8,seed=2")])).any()


@pytest.mark.parametrize(
    ("text", "kind", "column", "by"),
    [
        ("magnetometer:at=10,for=10,size=20,towards=-y", Kind.MAGNETOMETER, FIELD + 1, -2e-5),
        ("gyro-step:at=10,for=10,size=3,towards=x", Kind.IMU, GYRO, math.radians(3.0)),
        ("accelerometer-step:at=10,for=10,size=-0.5,towards=z", Kind.IMU, ACCEL + 2, -0.5),
    ],
)
def test_body_sensors_are_off_on_one_axis(text: str, kind: Kind, column: int, by: float) -> None:
    rows = some_rows()
    faulty = apply_faults(rows, [parse_fault(text)])
    hit = during(rows, kind)
    check_only(rows, faulty, kind, (column,))
    np.testing.assert_allclose((faulty - rows)[hit, column], by, rtol=1e-9)


def test_scale_errors_multiply_one_axis_or_all() -> None:
    rows = some_rows()
    hit = during(rows, Kind.IMU)
    for text, columns, factor in (
        ("gyro-scale:at=10,for=10,size=0.8,towards=y", (GYRO + 1,), 0.8),
        ("accelerometer-scale:at=10,for=10,size=1.2", (ACCEL, ACCEL + 1, ACCEL + 2), 1.2),
    ):
        faulty = apply_faults(rows, [parse_fault(text)])
        check_only(rows, faulty, Kind.IMU, columns)
        np.testing.assert_allclose(faulty[hit][:, columns], factor * rows[hit][:, columns])


def test_a_barometer_shows_another_height() -> None:
    rows = some_rows()
    hit = during(rows, Kind.BAROMETER)
    heights = np.linspace(0.0, 5000.0, hit.sum())
    rows[hit, PRESSURE] = isa_pressure(heights)
    faulty = apply_faults(rows, [parse_fault("barometer:at=10,for=10,size=12")])
    check_only(rows, faulty, Kind.BAROMETER, (PRESSURE,))
    # the standard's pressure height is geopotential: 0.2 % of a difference at 5 km
    np.testing.assert_allclose(faulty[hit, PRESSURE], isa_pressure(heights + 12.0), atol=0.3)
    rising = apply_faults(rows, [parse_fault("barometer:at=10,for=10,size=12,rise=4")])
    share = (rows - rising)[hit, PRESSURE] / (rows - faulty)[hit, PRESSURE]
    np.testing.assert_allclose(share, np.clip((rows[hit, TIME] - 10.0) / 4.0, 0.0, 1.0), atol=1e-3)


def test_a_gap_takes_whole_messages_of_the_imu() -> None:
    rows = some_rows()
    gap = (rows[:, TIME] >= 10.0) & (rows[:, TIME] < 20.0)
    raw, second = rows[:, SOURCE] == Source.RAW_IMU, rows[:, SOURCE] == Source.SCALED_IMU2
    both = apply_faults(rows, [parse_fault("imu-gap:at=10,for=10")])
    np.testing.assert_array_equal(both, rows[~(gap & (raw | second))])
    one = apply_faults(rows, [parse_fault("imu-gap:at=10,for=10,source=raw_imu")])
    np.testing.assert_array_equal(one, rows[~(gap & raw)])


def test_faults_add_up_and_leave_the_rows_given_as_they_were() -> None:
    rows = some_rows()
    kept = rows.copy()
    faults = [Fault(kind="gnss-step", at=10.0, size=3.0, towards=0.0), Fault(kind="gnss-freeze", at=15.0)]
    faulty = apply_faults(rows, faults)
    np.testing.assert_array_equal(rows, kept)
    after = during(rows, Kind.GNSS, 15.0, 40.0) & (rows[:, SOURCE] == Source.GPS2_RAW)
    last = rows[(rows[:, SOURCE] == Source.GPS2_RAW) & (rows[:, TIME] < 15.0)][-1:]
    np.testing.assert_allclose(metres(faulty[after], np.repeat(last, after.sum(), axis=0))[:, 0], 3.0, atol=1e-3)


def test_rows_without_a_time_are_left_and_arrival_is_what_orders() -> None:
    rows = some_rows()
    raw = rows.copy()
    raw[:, TIME] = np.nan
    order = np.argsort(rows[:, STAMP] + np.random.default_rng(1).uniform(0, 3e5, rows.shape[0]))
    raw, timed = raw[order], rows[order]
    raw[7, STAMP], raw[7, CLOCK] = 1e12, Clock.BOOT_US  # far ahead, and nothing confirms it
    times = boot_times(raw, 3.0)
    assert np.isnan(times[7]) and np.isfinite(np.delete(times, 7)).all()
    np.testing.assert_array_equal(np.delete(times, 7), np.delete(timed[:, TIME], 7))
    fault = parse_fault("gyro-step:at=10,for=10,size=3,towards=x")
    faulty = apply_faults(raw, [fault], times)
    assert np.isnan(faulty[:, TIME]).all()
    np.testing.assert_array_equal(
        np.delete(faulty, 7, 0)[:, TIME + 2 :], np.delete(apply_faults(timed, [fault]), 7, 0)[:, TIME + 2 :]
    )


# --- how it is written ---------------------------------------------------------------------------------------------


def example(kind: str) -> str:
    towards = {"n": ",towards=123.5", "b": ",towards=-z", "all": ",towards=y", "": ""}[KINDS[kind].towards]
    options = {"acceleration": 0.5, "rise": 2.0, "silent": 1.0, "seed": 4.0}
    size = ",size=2.5" if KINDS[kind].unit else ""
    more = "".join(f",{name}={options[name]}" for name in KINDS[kind].options)
    return f"{kind}:at=30.25,for=8.0{size}{towards}{more}"


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_read_as_it_is_written(kind: str) -> None:
    fault = parse_fault(example(kind))
    assert str(fault) == example(kind) and parse_fault(str(fault)) == fault and fault.end == 38.25
    if KINDS[kind].towards == "n":
        assert fault.direction == pytest.approx(
            (math.cos(math.radians(123.5)), math.sin(math.radians(123.5)), 0.0), abs=1e-12
        )


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("gnss-jump:at=3", "choose one of gnss-step"),
        ("gnss-step", "add at=SECONDS"),
        ("gnss-step:size=3,towards=0", "add at=SECONDS"),
        ("gnss-step:at=3,towards=0", "must be size=M"),
        ("gnss-step:at=3,size=3", "towards=DEGREES"),
        ("gnss-step:at=3,size=3,towards=x", "towards=DEGREES"),
        ("gyro-step:at=3,size=3,towards=30", "towards=x, y, z"),
        ("gyro-scale:at=3", "add size=FACTOR"),
        ("gnss-freeze:at=3,size=1", "is not one of at=, for=, source="),
        ("gnss-freeze:at=3,at=4", "given twice"),
        ("gnss-freeze:at=soon", "is not a number"),
        ("gnss-freeze:at=nan", "at=SECONDS"),
        ("gnss-freeze:at=3,for=0", "for=SECONDS, above 0"),
        ("gnss-freeze:at=3,source=RAW_IMU", "source=GPS_RAW_INT|"),
        ("gnss-freeze:at=3,source=GPS", "no message is called"),
        ("gnss-step:at=3,size=inf,towards=0", "a number"),
        ("gnss-spoof:at=3,size=1,towards=0,acceleration=0", "above 0 m/s^2"),
        ("gnss-outage:at=3,silent=2", "0 or 1"),
        ("barometer:at=3,size=1,rise=-1", "0 s or more"),
        ("gnss-noise:at=3,size=1,seed=1.5", "a whole number"),
    ],
)
def test_what_is_wrong_is_said_with_its_remedy(text: str, sentence: str) -> None:
    with pytest.raises(UsageError) as error:
        parse_fault(text)
    assert sentence in str(error.value) and text in str(error.value) and "\n" not in str(error.value)


def test_a_fault_made_by_hand_is_checked_too() -> None:
    with pytest.raises(UsageError, match="towards=DEGREES"):
        Fault(kind="gnss-step", at=1.0, size=3.0)
    with pytest.raises(UsageError, match="no size"):
        Fault(kind="imu-gap", at=1.0, size=3.0)


# --- simulated and recorded flights --------------------------------------------------------------------------------

SHORT: dict[str, Any] = {"seed": 4, "duration_s": 62.0, "imu_hz": 20.0, "highres_imu": True, "gnss_message_hz": 10.0}


def rows_of(path: Path) -> Array:
    return on_boot_clock(read_tlog(path).rows[1, 1], 3.0)[0]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("faults") / "clean.tlog"
    simulate(path, **SHORT)
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_a_simulated_log_holds_the_fault_that_its_rows_would_get(kind: str, clean: Path, tmp_path: Path) -> None:
    faults = [parse_fault(example(kind))]
    path = tmp_path / "faulty.tlog"
    simulate(path, faults=faults, **SHORT)
    simulated, expected = rows_of(path), apply_faults(rows_of(clean), faults)
    assert path.read_bytes() != clean.read_bytes()
    for sensor, columns, step in (
        (Kind.GNSS, (FIX,), 0.0),
        (Kind.GNSS, (LATITUDE, LONGITUDE), 2.1e-9),
        (Kind.GNSS, (HEIGHT_AMSL, SIGMA_HORIZONTAL), 1.1e-3),
        (Kind.GNSS, (VELOCITY_N, VELOCITY_N + 1), 0.011),
        (Kind.IMU, (GYRO, GYRO + 1, GYRO + 2), 2.6e-3),  # cut before it is scaled, or after
        (Kind.IMU, (ACCEL, ACCEL + 1, ACCEL + 2), 0.026),
        (Kind.MAGNETOMETER, (FIELD, FIELD + 1, FIELD + 2), 1.1e-7),
        (Kind.BAROMETER, (PRESSURE,), 0.02),
    ):
        # arrival differs where messages are fewer, so what is compared is in the order of its own messages
        a, b = (
            rows[rows[:, KIND] == sensor][np.lexsort((rows[rows[:, KIND] == sensor][:, SOURCE],))]
            for rows in (simulated, expected)
        )
        if kind not in ("gnss-outage",) or sensor != Kind.GNSS:
            np.testing.assert_array_equal(a[:, TIME], b[:, TIME])
        np.testing.assert_allclose(a[:, columns], b[:, columns], atol=step)


def test_the_same_faults_give_the_same_bytes_and_none_the_old_ones(clean: Path, tmp_path: Path) -> None:
    faults = [parse_fault(example(kind)) for kind in ("gnss-noise", "gyro-step", "imu-gap")]
    for name in ("a", "b"):
        simulate(tmp_path / name, faults=faults, **SHORT)
    simulate(tmp_path / "none", **SHORT)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert (tmp_path / "none").read_bytes() == clean.read_bytes()


@pytest.mark.parametrize("as_live", [True, False])
def test_a_replay_with_faults_is_that_of_rows_with_faults(clean: Path, as_live: bool) -> None:
    fault = "gnss-step:at=40,for=6,size=60,towards=up"
    raw = read_tlog(clean).rows[1, 1]
    faulty = apply_faults(raw, [parse_fault(fault)], boot_times(raw, 3.0))
    expected = run_rows("1-1", faulty, Options(as_live=as_live))[0][0].output.poses
    found = mavkf.replay(clean, as_live=as_live, faults=[fault])["1-1"][0]
    np.testing.assert_array_equal(found["alt_amsl_m"], expected[:, L.R_HEIGHT])
    sound = mavkf.replay(clean, as_live=as_live)["1-1"][0]
    before = sound["time_boot_s"] < 39.0
    assert found["alt_amsl_m"][-1] != sound["alt_amsl_m"][-1]
    np.testing.assert_array_equal(found["alt_amsl_m"][before], sound["alt_amsl_m"][before])


def test_the_commands_take_faults_and_say_so(clean: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "--faults"]) == 0
    listed = capsys.readouterr().out
    assert all(f"{kind}:at=" in listed for kind in KINDS)
    out = tmp_path / "f.tlog"
    fault = "gnss-step:at=30.0,for=8.0,size=40.0,towards=330.0"
    more = ["--fault", "imu-gap:at=50,for=1"]
    assert main(["simulate", str(out), "--duration", "60", "--imu-hz", "20", "--fault", fault, *more]) == 0
    said = capsys.readouterr().err
    assert f"has a fault: {fault}" in said and "has a fault: imu-gap:at=50.0,for=1.0" in said
    assert main(["replay", str(clean), "--fault", fault, *more]) == 0
    assert f"put into {clean}: {fault}" in capsys.readouterr().err
    assert main(["simulate", str(tmp_path / "g.tlog"), "--fault", "gnss-step"]) == 2
    assert not (tmp_path / "g.tlog").exists()
    assert main(["replay", str(clean), "--fault", "gnss-step"]) == 2
