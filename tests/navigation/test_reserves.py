"""What the fold gets of each kind of sensor: the first, one in reserve, and what begins later."""

import numpy as np
import pytest

from mavkf.config import Config
from mavkf.navigation.events import select
from mavkf.navigation.setup import choose
from mavkf.samples import ACCEL, IMU_SOURCES, KIND, ROW_WIDTH, SOURCE, TIME, Kind, Source

Array = np.ndarray


def sensor(kind: Kind, source: Source, rate: float, force: float = 9.8) -> Array:
    rows = np.full((int(5.0 * rate) + 1, ROW_WIDTH), np.nan)
    rows[:, KIND], rows[:, SOURCE] = kind, source
    rows[:, TIME] = 10.0 + np.arange(rows.shape[0]) / rate
    if kind == Kind.IMU:
        rows[:, ACCEL : ACCEL + 3] = [0.0, 0.0, -force]
    return rows


def later(kind: Kind, sources: tuple[Source, ...]) -> Array:
    """One row of each source, after the set-up."""
    rows = np.full((len(sources), ROW_WIDTH), np.nan)
    rows[:, KIND], rows[:, SOURCE], rows[:, TIME] = kind, sources, 99.0
    return rows


MAGNETOMETERS = {Source.RAW_IMU: 200.0, Source.HIGHRES_IMU: 100.0, Source.SCALED_IMU2: 50.0, Source.SCALED_IMU3: 5.0}


@pytest.mark.parametrize(
    ("rates", "reserve"),
    [
        (MAGNETOMETERS, Source.SCALED_IMU3),
        (MAGNETOMETERS | {Source.SCALED_IMU3: 1.0}, Source.SCALED_IMU2),
        ({Source.RAW_IMU: 4.0, Source.SCALED_IMU2: 1.0, Source.SCALED_IMU3: 2.0}, Source.SCALED_IMU3),
        ({Source.RAW_IMU: 50.0}, None),
    ],
)
def test_a_field_in_reserve_is_the_slowest_that_is_fast_enough(
    rates: dict[Source, float], reserve: Source | None
) -> None:
    rows = np.concatenate([sensor(Kind.MAGNETOMETER, source, rate) for source, rate in rates.items()])
    setup = choose(rows, Config())
    assert setup.magnetometer is Source.RAW_IMU
    absent = {source for source in IMU_SOURCES if source not in rates}
    assert set(setup.magnetometers) == {Source.RAW_IMU} | absent | ({reserve} if reserve is not None else set())
    got = later(Kind.MAGNETOMETER, IMU_SOURCES)[select(later(Kind.MAGNETOMETER, IMU_SOURCES), setup), SOURCE]
    assert set(got) == set(setup.magnetometers)


def test_an_imu_in_reserve_is_the_best_of_the_others_that_are_not_broken() -> None:
    rows = np.concatenate(
        [
            sensor(Kind.IMU, Source.HIGHRES_IMU, 100.0),
            sensor(Kind.IMU, Source.RAW_IMU, 200.0, force=980.0),
            sensor(Kind.IMU, Source.SCALED_IMU2, 50.0),
            sensor(Kind.IMU, Source.SCALED_IMU3, 5.0),
        ]
    )
    setup = choose(rows, Config())
    assert setup.imu is Source.HIGHRES_IMU
    # those that begin later may be used too
    assert setup.imus == (Source.SCALED_IMU, Source.SCALED_IMU2, Source.HIGHRES_IMU, Source.HIL_SENSOR)
    assert choose(rows, Config(), imu=Source.SCALED_IMU3).imus == (Source.SCALED_IMU3,)
    assert choose(sensor(Kind.IMU, Source.RAW_IMU, 50.0, force=980.0), Config()).imus == ()


def test_receivers_and_heartbeats_all_come() -> None:
    setup = choose(sensor(Kind.BAROMETER, Source.SCALED_PRESSURE, 10.0), Config())
    receivers = later(Kind.GNSS, (Source.GPS_RAW_INT, Source.GPS2_RAW, Source.GPS_INPUT, Source.HIL_GPS))
    assert select(receivers, setup).all()
    assert select(later(Kind.HEARTBEAT, (Source.HEARTBEAT,)), setup).all()
    assert not select(later(Kind.SYSTEM_TIME, (Source.SYSTEM_TIME,)), setup).any()
