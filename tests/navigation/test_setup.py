"""What is chosen from the first seconds, with its reasons in words."""

import numpy as np
import pytest

from mavkf.config import Config, with_settings
from mavkf.errors import UsageError
from mavkf.navigation.setup import MODELS, choose
from mavkf.samples import (
    ACCEL,
    AUTOPILOT,
    FIX,
    KIND,
    PARAMETER,
    PARAMETER_VALUE,
    ROW_WIDTH,
    SOURCE,
    TIME,
    VEHICLE_TYPE,
    AutopilotParameter,
    Kind,
    Source,
)

Array = np.ndarray


def sensor(kind: Kind, source: Source, rate: float, duration: float = 5.0, force: float = 9.8, fix: int = 3) -> Array:
    rows = np.full((int(rate * duration) + 1, ROW_WIDTH), np.nan)
    rows[:, KIND], rows[:, SOURCE] = kind, source
    rows[:, TIME] = 10.0 + np.arange(rows.shape[0]) / rate
    if kind == Kind.IMU:
        rows[:, ACCEL : ACCEL + 3] = [0.0, 0.0, -force]
    if kind == Kind.GNSS:
        rows[:, FIX] = fix
    return rows


def imu(source: Source, rate: float, force: float = 9.8) -> Array:
    return sensor(Kind.IMU, source, rate, force=force)


def heartbeat(autopilot: int, vehicle: int = 2) -> Array:
    rows = sensor(Kind.HEARTBEAT, Source.HEARTBEAT, 1.0)
    rows[:, AUTOPILOT], rows[:, VEHICLE_TYPE] = autopilot, vehicle
    return rows


@pytest.mark.parametrize(
    ("rates", "best"),
    [
        ({Source.RAW_IMU: 10.0, Source.SCALED_IMU2: 10.0}, Source.RAW_IMU),
        ({Source.RAW_IMU: 10.0, Source.SCALED_IMU2: 50.0}, Source.SCALED_IMU2),
        ({Source.SCALED_IMU: 50.0, Source.HIGHRES_IMU: 50.0, Source.RAW_IMU: 50.0}, Source.HIGHRES_IMU),
        ({Source.HIGHRES_IMU: 10.0, Source.RAW_IMU: 100.0}, Source.RAW_IMU),
        ({Source.SCALED_IMU3: 4.0}, Source.SCALED_IMU3),
    ],
)
def test_imu_by_rate_and_resolution(rates: dict[Source, float], best: Source) -> None:
    rows = np.concatenate([imu(source, rate) for source, rate in rates.items()])
    setup = choose(rows, Config())
    assert setup.imu is best
    assert setup.imu_rate_hz == pytest.approx(rates[best])
    assert best.name in setup.reasons[0]
    for other in rates.keys() - {best}:
        assert other.name in setup.reasons[0]


@pytest.mark.parametrize("force", [0.0, 1.0, 100.0, 9806.0])
def test_a_broken_scale_is_named_and_not_used(force: float) -> None:
    rows = np.concatenate([imu(Source.HIGHRES_IMU, 100.0, force), imu(Source.SCALED_IMU, 20.0)])
    setup = choose(rows, Config())
    assert setup.imu is Source.SCALED_IMU
    assert any("HIGHRES_IMU is not used" in reason for reason in setup.reasons)
    alone = choose(imu(Source.HIGHRES_IMU, 100.0, force), Config())
    assert alone.imu is None
    assert alone.model == "constant-velocity"


def test_a_forced_imu_is_used_whatever_it_shows() -> None:
    rows = np.concatenate([imu(Source.RAW_IMU, 20.0, 1.0), imu(Source.SCALED_IMU2, 100.0)])
    setup = choose(rows, Config(), imu=Source.RAW_IMU)
    assert setup.imu is Source.RAW_IMU
    assert any("as asked" in reason for reason in setup.reasons)


@pytest.mark.parametrize(
    ("rows", "said"), [(imu(Source.SCALED_IMU2, 10.0), "SCALED_IMU2"), (np.empty((0, ROW_WIDTH)), "no IMU message")]
)
def test_a_forced_imu_that_is_not_there_is_an_error_that_names_what_is(rows: Array, said: str) -> None:
    with pytest.raises(UsageError, match=rf"RAW_IMU.*{said}"):
        choose(rows, Config(), imu=Source.RAW_IMU)


@pytest.mark.parametrize(
    ("rate", "model", "compare"),
    [(0.5, "telemetry", True), (1.2, "telemetry", True), (2.5, "strapdown", True), (200.0, "strapdown", True)],
)
def test_model_by_rate(rate: float, model: str, compare: bool) -> None:
    setup = choose(imu(Source.RAW_IMU, rate), Config())
    assert (setup.model, setup.compare) == (model, compare)
    assert any(f"model {model}" in reason for reason in setup.reasons)
    for forced in MODELS:
        assert choose(imu(Source.RAW_IMU, rate), Config(), model=forced).model == forced
    without = choose(imu(Source.RAW_IMU, rate), with_settings(Config(), ["model.telemetry=false"]))
    assert (without.model, without.compare) == ("strapdown", False)


def test_no_strapdown_without_an_imu_even_if_asked() -> None:
    rows = sensor(Kind.GNSS, Source.GPS_RAW_INT, 5.0)
    assert choose(rows, Config(), model="strapdown").model == "constant-velocity"


def test_delays_by_autopilot_and_by_configuration() -> None:
    def delays(rows: Array, config: Config) -> tuple[float, ...]:
        s = choose(rows, config)
        return s.gnss_delay, s.imu_delay, s.magnetometer_delay, s.barometer_delay

    assert delays(heartbeat(3), Config()) == (0.085, 0.0125, 0.055, 0.045)
    assert delays(heartbeat(12), Config()) == (0.0, 0.0, 0.05, 0.0)
    assert delays(heartbeat(0), Config()) == (0.0, 0.0, 0.0, 0.0)
    assert delays(np.empty((0, ROW_WIDTH)), Config()) == (0.0, 0.0, 0.0, 0.0)
    config = with_settings(Config(), ["gnss_delay_s=0.22", "imu_delay_s=0"])
    assert delays(heartbeat(3), config) == (0.22, 0.0, 0.055, 0.045)
    assert choose(heartbeat(3, vehicle=10), Config()).vehicle_type == 10


def test_receiver_with_the_most_fixes() -> None:
    first, second = (sensor(Kind.GNSS, source, 5.0) for source in (Source.GPS_RAW_INT, Source.GPS2_RAW))
    assert choose(np.concatenate([second, first]), Config()).gnss is Source.GPS_RAW_INT
    blind = sensor(Kind.GNSS, Source.GPS_RAW_INT, 5.0, fix=1)
    assert choose(np.concatenate([blind, second]), Config()).gnss is Source.GPS2_RAW
    assert choose(sensor(Kind.GNSS, Source.GPS2_RAW, 5.0, fix=0), Config()).gnss is Source.GPS2_RAW
    assert choose(np.empty((0, ROW_WIDTH)), Config()).gnss is Source.GPS_RAW_INT


def test_magnetometer_of_the_chosen_imu_first() -> None:
    fields = [sensor(Kind.MAGNETOMETER, source, 10.0) for source in (Source.RAW_IMU, Source.SCALED_IMU2)]
    rows = np.concatenate([*fields, imu(Source.SCALED_IMU2, 100.0), imu(Source.RAW_IMU, 5.0)])
    assert choose(rows, Config()).magnetometer is Source.SCALED_IMU2
    assert choose(np.concatenate([*fields, imu(Source.SCALED_IMU3, 5.0)]), Config()).magnetometer is Source.RAW_IMU
    # one that starts later is used, and looked for where it most likely comes
    assert choose(imu(Source.RAW_IMU, 5.0), Config()).magnetometer is Source.RAW_IMU
    assert choose(imu(Source.RAW_IMU, 5.0), Config()).barometer is Source.SCALED_PRESSURE
    assert choose(sensor(Kind.BAROMETER, Source.SCALED_PRESSURE3, 5.0), Config()).barometer is Source.SCALED_PRESSURE3


@pytest.mark.parametrize(
    ("vehicle", "said"),
    [(2, "multirotor"), (1, "fixed wing"), (10, "rover"), (11, "none: nothing is known of HEARTBEAT.type 11")],
)
def test_the_class_is_told_with_its_reason(vehicle: int, said: str) -> None:
    rows = np.concatenate([imu(Source.RAW_IMU, 50.0), heartbeat(3, vehicle)])
    told = [reason for reason in choose(rows, Config()).reasons if reason.startswith("vehicle class")]
    assert len(told) == 1
    assert said in told[0]
    assert f"HEARTBEAT.type {vehicle}" in told[0]


def test_no_class_is_told_with_its_reason() -> None:
    assert any("class none: no HEARTBEAT" in reason for reason in choose(imu(Source.RAW_IMU, 50.0), Config()).reasons)
    off = with_settings(Config(), ["vehicle.use_class=false"])
    rows = np.concatenate([imu(Source.RAW_IMU, 50.0), heartbeat(3, 2)])
    assert any("class none: its use is switched off" in reason for reason in choose(rows, off).reasons)


def test_the_parameters_of_the_first_receiver_are_not_those_of_the_second() -> None:
    fixes = sensor(Kind.GNSS, Source.GPS2_RAW, 5.0)
    stated = sensor(Kind.PARAMETER, Source.PARAM_VALUE, 1.0)[:4]
    names = ("GPS1_POS_X", "GPS1_POS_Y", "GPS1_POS_Z", "GPS1_DELAY_MS")
    stated[:, PARAMETER] = [AutopilotParameter[name] for name in names]
    stated[:, PARAMETER_VALUE] = [0.3, 0.0, -0.1, 150.0]
    setup = choose(np.concatenate([stated, fixes]), Config())
    assert (setup.antenna, setup.gnss_delay) == ((0.0, 0.0, 0.0), 0.0)
    fixes[:, SOURCE] = Source.GPS_RAW_INT
    setup = choose(np.concatenate([stated, fixes]), Config())
    assert (setup.antenna, setup.gnss_delay) == ((0.3, 0.0, -0.1), 0.15)


def test_a_place_that_is_not_known_in_all_axes_is_none() -> None:
    stated = sensor(Kind.PARAMETER, Source.PARAM_VALUE, 1.0)[:2]
    stated[:, PARAMETER] = [AutopilotParameter.GPS1_POS_X, AutopilotParameter.GPS1_POS_Z]
    stated[:, PARAMETER_VALUE] = 0.3
    assert choose(stated, Config()).antenna == (0.0, 0.0, 0.0)
