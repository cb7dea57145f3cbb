"""Pose records: what is not finite in a row is not known in the record, and nothing else."""

import math

import numpy as np
import pytest
from msgspec.structs import asdict

from mavkf.estimate import Pose
from mavkf.navigation import layout as L
from mavkf.navigation.records import RecordWriter

FIELDS = {
    "lat_deg": (L.R_LATITUDE, 1),
    "lon_deg": (L.R_LONGITUDE, 1),
    "alt_amsl_m": (L.R_HEIGHT, 1),
    "alt_ellipsoid_m": (L.R_UNDULATION, 1),
    "origin": (L.R_ORIGIN_LATITUDE, 3),
    "position_ned_m": (L.R_NED, 3),
    "velocity_ned_m_s": (L.R_V, 3),
    "quaternion_nb": (L.R_Q, 4),
    "angular_rate_b_rad_s": (L.R_RATE, 3),
    "gyro_bias_b_rad_s": (L.R_BG, 3),
    "accel_bias_b_m_s2": (L.R_BA, 3),
    "velocity_covariance": (L.R_VELOCITY_COVARIANCE, 9),
    "pl_h_m": (L.R_PL_H, 1),
    "pl_v_m": (L.R_PL_V, 1),
}


def row() -> np.ndarray:
    values = 0.001 * np.arange(1.0, L.POSE_WIDTH + 1.0)
    values[[L.R_MODE, L.R_FLAGS, L.R_VALID]] = 3.0, 5.0, 7.0
    return values


def record(values: np.ndarray) -> Pose:
    return RecordWriter("1-1").pose(values, 0)


def test_every_number_is_in_its_place_in_the_units_of_the_outside() -> None:
    values, whole = row(), record(row())
    for name, (first, count) in FIELDS.items():
        wanted = values[first : first + count]
        found = getattr(whole, name)
        if name == "origin":
            found = math.radians(found.lat_deg), math.radians(found.lon_deg), found.alt_amsl_m
        elif name == "alt_ellipsoid_m":
            wanted = wanted + values[L.R_HEIGHT]
        elif name in ("lat_deg", "lon_deg"):
            found = math.radians(found)
        np.testing.assert_allclose(np.ravel(found), wanted, rtol=1e-12, err_msg=name)
    assert whole.euler_deg is not None
    np.testing.assert_allclose(
        np.radians(np.array(whole.euler_deg, float)), values[L.R_EULER : L.R_EULER + 3], rtol=1e-12
    )
    assert whole.pose_covariance == tuple(values[L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36])
    assert (whole.mode, whole.flags, whole.valid.yaw, whole.valid.position) == (
        "navigating",
        ("no_imu", "no_magnetometer"),
        False,
        True,
    )


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", FIELDS)
def test_what_is_not_finite_is_unknown_and_nothing_else(name: str, bad: float) -> None:
    first, count = FIELDS[name]
    for k in range(first, first + count):
        values = row()
        values[k] = bad
        changed = {field for field, value in asdict(record(values)).items() if value != asdict(record(row()))[field]}
        assert getattr(record(values), name) is None
        assert changed == {name} | ({"alt_ellipsoid_m"} if name == "alt_amsl_m" else set())


def test_angles_and_the_covariance_are_unknown_one_by_one() -> None:
    values = row()
    values[[L.R_EULER + 2, L.R_POSE_COVARIANCE + 7]] = math.nan
    found = record(values)
    assert found.euler_deg is not None and found.pose_covariance is not None
    assert [each is None for each in found.euler_deg] == [False, False, True]
    assert [k for k, each in enumerate(found.pose_covariance) if each is None] == [7]
    values[L.R_EULER] = math.nan
    values[L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36] = math.nan
    assert (record(values).euler_deg, record(values).pose_covariance) == (None, None)
