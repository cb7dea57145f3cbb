"""Where the sensors are: an IMU that is mounted askew, and an antenna away from it."""

from math import cos, radians, sin

import numpy as np
import pytest

from mavkf.config import settings, with_settings
from mavkf.navigation import layout as L
from mavkf.navigation.estimator import Offline, run_offline
from mavkf.samples import ACCEL, FIELD, GYRO, KIND, Kind

from ._session import CONFIG, run

Array = np.ndarray


def about(axis: int, degrees: float) -> Array:
    """The matrix of a turn about one axis, written out."""
    c, s = cos(radians(degrees)), sin(radians(degrees))
    return np.array(
        [
            [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]],
            [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
            [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
        ][axis]
    )


def mounted(rows: Array, roll: float, pitch: float, yaw: float) -> Array:
    """Rows as a board shows them whose frame is turned by these angles (deg) in the body."""
    C_bs = about(2, yaw) @ about(1, pitch) @ about(0, roll)
    turned = rows.copy()
    for kind, columns in ((Kind.IMU, (GYRO, ACCEL)), (Kind.MAGNETOMETER, (FIELD,))):
        mine = rows[:, KIND] == kind
        for k in columns:
            turned[mine, k : k + 3] = rows[mine, k : k + 3] @ C_bs
    return turned


@pytest.mark.parametrize("angles", [(180.0, 0.0, 0.0), (0.0, -90.0, 0.0), (0.0, 0.0, 45.0), (20.0, -70.0, 130.0)])
def test_a_turned_board_gives_the_same_estimate_once_it_is_told(
    rows: Array, batch: Offline, angles: tuple[float, ...]
) -> None:
    config = with_settings(CONFIG, [f"vehicle.imu_rotation_deg={list(angles)}"])
    turned = run_offline(mounted(rows, *angles), config)
    np.testing.assert_allclose(turned.state[: L.T], batch.state[: L.T], rtol=1e-6, atol=1e-9)


def test_a_turned_board_is_the_same_row_by_row(rows: Array) -> None:
    config = with_settings(CONFIG, ["imu_rotation_deg=[20, -70, 130]"])
    first = rows[:1200]
    assert run(first, list(range(1, 1200)), config)[0].state.tobytes() == run(first, config=config)[0].state.tobytes()


def test_settings_of_vectors_say_their_range() -> None:
    said = {name: text for name, _, text in settings()}
    assert said["vehicle.imu_rotation_deg"].endswith("(-180 to 180)")
