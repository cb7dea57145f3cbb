"""The field at a fix against published values of the World Magnetic Model."""

from datetime import UTC, datetime
from math import atan2, degrees, hypot, isnan, nan, radians, sqrt

import pytest

from mavkf.navigation.earth_field import earth_field


def at(latitude: float, longitude: float, year: int = 2025, month: int = 1, day: int = 1) -> tuple[float, float, float]:
    utc_us = datetime(year, month, day, 12, tzinfo=UTC).timestamp() * 1e6
    return earth_field(radians(latitude), radians(longitude), utc_us)


# WMM2025 and WMM2020 test values of NCEI at height 0: declination, inclination (deg), total (nT)
@pytest.mark.parametrize(
    ("latitude", "longitude", "year", "expected"),
    [(80.0, 0.0, 2025, (1.28, 83.21, 55178.5)), (80.0, 0.0, 2020, (-1.28, 83.14, 55000.1))],
)
def test_published_values(latitude: float, longitude: float, year: int, expected: tuple[float, float, float]) -> None:
    # a year is taken as 365.25 days, so that January 1st of 2020 is still 2019; D changes by 0.001 deg in two days
    north, east, down = at(latitude, longitude, year, day=2)
    assert degrees(atan2(east, north)) == pytest.approx(expected[0], abs=0.01)
    assert degrees(atan2(down, hypot(north, east))) == pytest.approx(expected[1], abs=0.01)
    assert sqrt(north**2 + east**2 + down**2) == pytest.approx(expected[2] * 1e-9, rel=2e-4)


def test_the_same_bits_within_a_cell_and_a_day() -> None:
    here = at(47.0, 8.0)
    assert at(47.04, 8.04) == here
    assert at(46.96, 7.96) == here
    assert at(47.06, 8.0) != here
    assert at(47.0, 8.06) != here
    morning = datetime(2025, 3, 3, 0, 1, tzinfo=UTC).timestamp() * 1e6
    evening = datetime(2025, 3, 3, 23, 59, tzinfo=UTC).timestamp() * 1e6
    fix = (radians(47.0), radians(8.0))
    assert earth_field(*fix, morning) == earth_field(*fix, evening)
    assert earth_field(*fix, evening) != earth_field(*fix, evening + 2 * 60e6)


def test_the_date_line_is_no_edge() -> None:
    east, west = at(-17.0, 180.0), at(-17.0, -180.0)
    assert east == pytest.approx(west, abs=1e-12)


def test_times_outside_all_models_use_the_nearest() -> None:
    assert at(47.0, 8.0, 1970) == at(47.0, 8.0, 1980)
    assert at(47.0, 8.0, 2045) == at(47.0, 8.0, 2060)
    assert at(47.0, 8.0, 1970) != at(47.0, 8.0, 2045)


@pytest.mark.parametrize("bad", [(nan, 0.0, 0.0), (0.0, nan, 0.0), (0.0, 0.0, nan), (2.0, 0.0, 0.0), (0.0, 7.0, 0.0)])
def test_no_position_no_field(bad: tuple[float, float, float]) -> None:
    assert all(map(isnan, earth_field(*bad)))


def test_poles_have_a_field() -> None:
    assert sqrt(sum(v * v for v in at(90.0, 0.0))) == pytest.approx(5.7e-5, rel=0.05)
