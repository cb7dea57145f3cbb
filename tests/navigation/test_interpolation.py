"""A measurement between two IMU samples is met at its own time, by samples interpolated to it."""

import numpy as np
import pytest

from mavkf.config import Config
from mavkf.models.strapdown import LATITUDE, N, Q, V
from mavkf.navigation import layout as L
from mavkf.navigation.fold import interpolate
from mavkf.navigation.propagation import begin
from mavkf.navigation.setup import choose, parameters
from mavkf.samples import FIELD, KIND, TIME, Kind

DT = 0.1
IMU0 = np.array([0.1, 0.0, -0.2, 0.5, 0.0, -9.8])
IMU1 = np.array([0.1, 0.0, 1.0, 4.5, 2.0, -5.8])


def between(shares: list[float]) -> np.ndarray:
    """The state at the second sample, with measurements that tell nothing (a field, where no declination is known) on the way."""
    config = Config()
    c = parameters(config, choose(np.empty((0, 24)), config))
    out = L.buffers(16, 16, 64)
    s = np.empty(L.STATE_SIZE)
    begin(s, c)
    s[L.T] = s[L.T_IMU] = 10.0
    s[L.ALIGNED], s[L.MODEL] = 1.0, L.STRAPDOWN
    s[L.IMU : L.IMU + 6] = IMU0
    s[L.X + LATITUDE] = 0.8
    waiting = s[L.PENDING : L.HALF].reshape(-1, L.EVENT_WIDTH)
    for i, share in enumerate(shares):
        waiting[i, [KIND, TIME]] = Kind.MAGNETOMETER, 10.0 + share * DT
        waiting[i, FIELD : FIELD + 3] = [2e-5, 0.0, 4e-5]
    s[L.PENDING_COUNT] = len(shares)
    interpolate(s, IMU1, 10.0 + DT, c, out)
    assert s[L.PENDING_COUNT] == 0.0
    if shares:
        assert s[L.T_FIELD] == 10.0 + shares[-1] * DT
    return s


@pytest.mark.parametrize("shares", [[0.25], [0.9], [0.0], [1.0], [0.2, 0.2, 0.7]])
def test_a_measurement_that_tells_nothing_changes_nothing(shares: list[float]) -> None:
    whole, cut = between([]), between(shares)
    assert cut[L.T] == whole[L.T] == pytest.approx(10.1)
    # force and rate are linear in between: the trapezoid is exact but for the rotation of the force, of the third order in dt
    np.testing.assert_allclose(cut[L.X + Q : L.X + Q + 4], whole[L.X + Q : L.X + Q + 4], rtol=0, atol=2e-5)
    np.testing.assert_allclose(cut[L.X + V : L.X + V + 3], whole[L.X + V : L.X + V + 3], rtol=0, atol=4e-3)
    # a sample held or taken early would be wrong by half of its change: 0.03 rad and 0.1 m/s
    P = cut[L.P : L.P + N * N], whole[L.P : L.P + N * N]
    np.testing.assert_allclose(*P, rtol=0, atol=2e-2 * np.abs(P[1]).max() * DT)


def test_velocity_is_the_mean_force_times_the_time() -> None:
    s = between([0.5])
    expected = 0.5 * (IMU0 + IMU1)[3:] * DT + [0.0, 0.0, 9.81 * DT]
    np.testing.assert_allclose(s[L.X + V : L.X + V + 3], expected, atol=0.03)
