"""What a vehicle's class says: where it is true the pose is better for it, where it is false the pose stays within what it claims."""

from collections.abc import Callable
from math import cos

import numpy as np
import pytest

from mavkf.config import with_settings
from mavkf.models.vehicle_class import FACTOR, WIND
from mavkf.navigation import layout as L
from mavkf.navigation.classes import used_class
from mavkf.navigation.codes import Sensor
from mavkf.navigation.offline import Offline, run_offline
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.setup import choose, parameters
from mavkf.samples import DIFFERENTIAL_PRESSURE, GYRO, KIND, PRESSURE, TIME, VEHICLE_TYPE, Kind

from . import _session
from ._session import CONFIG, G, Motion

Array = np.ndarray
Way = Callable[..., Motion]
ROVER, WING, QUADROTOR, BOAT, VTOL = 10, 1, 2, 11, 21
BEGIN, END = 150.0, 200.0  # s: no fixes between
WITHOUT = with_settings(CONFIG, ["vehicle.use_class=false"])


def course(t: Array, fastest: float, climb: float) -> tuple[Array, Array, Array]:
    """Speed forward, heading, and velocity down, from 10 s on: bends, and as the fastest allows faster and slower."""
    active = np.clip((t - 10.0) / 4.0, 0.0, 1.0)
    ramp = active**2 * (3.0 - 2.0 * active)
    speed = fastest * ramp * (1.0 + 0.2 * np.sin(0.7 * (t - 10.0)))
    yaw = 0.4 + 1.5 * ramp * np.sin(0.3 * (t - 10.0)) + 0.05 * np.maximum(t - 10.0, 0.0)
    return speed, yaw, -climb * ramp * np.cos(0.2 * (t - 10.0))


def way(velocity: Callable[[Array], Array], attitude: Callable[[Array, Array, Array], Array]) -> Way:
    """A motion as `_session.motion` gives it, of its velocity in n (n, 3) and its attitude by time, velocity and acceleration."""

    def move(t: Array, yaw0: float = 0.4) -> Motion:
        fine = np.arange(0.0, t[-1] + 0.02, 0.001)
        v = velocity(fine)
        p = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]) * 0.001, axis=0)])
        a = np.gradient(v, 0.001, axis=0)

        def at(values: Array) -> Array:
            return np.stack([np.interp(t, fine, values[:, i]) for i in range(3)], -1)

        return Motion(t, at(p), at(v), attitude(t, at(v), at(a)))

    return move


def rolling(slide: float) -> Way:
    """Wheels that point ahead; slide: share of the speed that goes sideways in bends."""

    def velocity(t: Array) -> Array:
        speed, yaw, _ = course(t, 8.0, 0.0)
        side = slide * speed * np.sin(0.3 * (t - 10.0))
        return np.stack(
            [speed * np.cos(yaw) - side * np.sin(yaw), speed * np.sin(yaw) + side * np.cos(yaw), 0.0 * t], -1
        )

    return way(velocity, lambda t, v, a: _session.yaw_matrix(course(t, 8.0, 0.0)[1]))


def hovering(k: float, wind: Callable[[Array], Array]) -> Way:
    """Rotors whose axis leans so that thrust and drag make the acceleration: f = -T z - k u, u through the air."""

    def velocity(t: Array) -> Array:
        speed, yaw, down = course(t, 6.0, 1.0)
        return np.stack([speed * np.cos(yaw), speed * np.sin(yaw), down], -1)

    def attitude(t: Array, v: Array, a: Array) -> Array:
        up = a - [0.0, 0.0, G] + k * (v - wind(t)) * np.clip((t - 9.0) / 1.0, 0.0, 1.0)[:, None]
        z = -up / np.linalg.norm(up, axis=1, keepdims=True)
        yaw = course(t, 6.0, 1.0)[1]
        y = np.cross(z, np.stack([np.cos(yaw), np.sin(yaw), 0.0 * t], -1))
        y /= np.linalg.norm(y, axis=1, keepdims=True)
        return np.stack([np.cross(y, z), y, z], -1)

    return way(velocity, attitude)


def gliding(wind: tuple[float, float]) -> Way:
    """A nose that points into the air that comes."""

    def velocity(t: Array) -> Array:
        speed, yaw, down = course(t, 16.0, 1.0)
        w = np.clip((t - 10.0) / 4.0, 0.0, 1.0)[:, None] * np.array([*wind, 0.0])
        return np.stack([speed * np.cos(yaw), speed * np.sin(yaw), down], -1) + w

    return way(velocity, lambda t, v, a: _session.yaw_matrix(course(t, 16.0, 1.0)[1]))


def still_air(t: Array) -> Array:
    return np.zeros((t.size, 3))


def breeze(t: Array) -> Array:
    return np.tile([4.0, -2.0, 0.0], (t.size, 1))


def squall(t: Array) -> Array:
    """Gusts of some seconds, and a wind that turns while there are no fixes."""
    turn = np.clip((t - (BEGIN - 100.0)) / 10.0, 0.0, 1.0)
    north = 4.0 + 1.5 * np.sin(1.3 * t) - 6.0 * turn
    return np.stack([north, -2.0 + 1.5 * np.sin(0.9 * t) + 2.0 * turn, 0.0 * t], -1)


def rows_of_a(vehicle: int, move: Way, seed: int, monkeypatch: pytest.MonkeyPatch, duration: float = 101.0) -> Array:
    """A session of this class that moves like this, without fixes from BEGIN to END."""
    monkeypatch.setattr(_session, "motion", move)
    rows = _session.session(duration, seed)
    imu = np.flatnonzero(rows[:, KIND] == Kind.IMU)
    t = rows[imu, TIME] - 100.0
    order = np.argsort(t)
    C0, C1 = move(t[order] - 0.005).C_nb, move(t[order] + 0.005).C_nb
    turned = np.einsum("nji,njk->nik", C0, C1)
    omega = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], -1) / 0.01
    random = np.random.default_rng(seed + 1000)
    rows[imu[order], GYRO : GYRO + 3] = omega + [0.004, -0.003, 0.002] + 5e-4 * random.normal(size=omega.shape)
    rows[rows[:, KIND] == Kind.HEARTBEAT, VEHICLE_TYPE] = vehicle
    silent = (rows[:, KIND] == Kind.GNSS) & (rows[:, TIME] - 0.2 > BEGIN) & (rows[:, TIME] - 0.2 < END)
    return rows[~silent]


def with_pitot(rows: Array, move: Way, wind: tuple[float, float], factor: float) -> Array:
    """The same with a pitot tube that shows this factor times the true airspeed, 0.5 m/s of noise on it."""
    rows = rows.copy()
    pressure = rows[:, KIND] == Kind.BAROMETER
    order = np.argsort(rows[pressure, TIME])
    mine = np.flatnonzero(pressure)[order]
    t = rows[mine, TIME] - 100.03
    u = move(t).v - np.array([*wind, 0.0]) * np.clip((t - 10.0) / 4.0, 0.0, 1.0)[:, None]
    shown = factor * np.linalg.norm(u, axis=1) + 0.5 * np.random.default_rng(1).normal(size=t.size)
    density = rows[mine, PRESSURE] / (287.05287 * 288.15 * (rows[mine, PRESSURE] / 101325.0) ** 0.190263)
    rows[mine, DIFFERENTIAL_PRESSURE] = 0.5 * density * shown**2
    return rows


def end_of_outage(result: Offline) -> tuple[float, float]:
    """Horizontal error (m) where the fixes come back, and that over sigma, rms of north and east."""
    pose = result.output.poses[result.output.poses[:, L.R_TIME] < END][-1:]
    truth = _session.motion(pose[:, L.R_TIME] - 100.0).p
    north = (pose[0, L.R_LATITUDE] - _session.ORIGIN[0]) * _session.RADII[0] - truth[0, 0]
    east = (pose[0, L.R_LONGITUDE] - _session.ORIGIN[1]) * _session.RADII[1] * cos(_session.ORIGIN[0]) - truth[0, 1]
    variances = pose[0, L.R_POSE_COVARIANCE], pose[0, L.R_POSE_COVARIANCE + 7]
    ratio = np.sqrt(0.5 * (north**2 / variances[0] + east**2 / variances[1]))
    return float(np.hypot(north, east)), float(ratio)


def yaw_error(result: Offline, after: float) -> tuple[float, float]:
    """Root mean square of the heading's error (rad), and of that over sigma."""
    poses = result.output.poses[result.output.poses[:, L.R_TIME] > after]
    C = _session.motion(poses[:, L.R_TIME] - 100.0).C_nb
    error = np.angle(np.exp(1j * (poses[:, L.R_EULER + 2] - np.arctan2(C[:, 1, 0], C[:, 0, 0]))))
    sigma = poses[:, L.R_SIGMA_EULER + 2]
    return float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean((error / sigma) ** 2)))


def nis(result: Offline, sensor: Sensor) -> float:
    """Mean NIS per component while there were fixes, from 20 s on."""
    rows = result.output.innovations
    t = rows[:, L.I_TIME]
    rows = rows[(rows[:, L.I_SENSOR] == sensor) & (t > 120.0) & (t < BEGIN)]
    assert rows.shape[0] > 10
    return float(np.mean(rows[:, L.I_NIS] / rows[:, L.I_SIZE]))


TRUE = {
    "wheels": (ROVER, rolling(0.0), Sensor.WHEELS, 0.3),
    "rotors in still air": (QUADROTOR, hovering(0.3, still_air), Sensor.DRAG, 0.8),
    "rotors in a breeze": (QUADROTOR, hovering(0.3, breeze), Sensor.DRAG, 0.8),
}


@pytest.mark.parametrize("case", TRUE)
def test_what_is_true_of_the_class_bounds_an_outage(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle, move, sensor, gain = TRUE[case]
    with_it, without, ratios = [], [], []
    for seed in range(4):
        rows = rows_of_a(vehicle, move, seed, monkeypatch)
        result = run_offline(rows, CONFIG)
        error, ratio = end_of_outage(result)
        with_it.append(error)
        ratios.append(ratio)
        without.append(end_of_outage(run_offline(rows, WITHOUT))[0])
        assert nis(result, sensor) < 1.5
    assert np.sqrt(np.mean(np.square(with_it))) < gain * np.sqrt(np.mean(np.square(without)))
    assert np.sqrt(np.mean(np.square(ratios))) < 2.0


FALSE = {
    "wheels that drift": (ROVER, rolling(0.1)),
    "wheels that slide": (ROVER, rolling(0.25)),
    "rotors in a squall": (QUADROTOR, hovering(0.3, squall)),
    "rotors that are something else": (QUADROTOR, rolling(0.0)),
}


@pytest.mark.parametrize("case", FALSE)
def test_what_is_false_of_this_vehicle_leaves_the_errors_within_what_is_claimed(
    case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle, move = FALSE[case]
    ratios = []
    for seed in range(4):
        result = run_offline(rows_of_a(vehicle, move, seed, monkeypatch), CONFIG)
        ratios.append(end_of_outage(result)[1])
        assert yaw_error(result, 125.0)[1] < 1.5
    assert np.sqrt(np.mean(np.square(ratios))) < 1.5


def test_a_wing_finds_the_wind_and_keeps_its_velocity_by_it(monkeypatch: pytest.MonkeyPatch) -> None:
    wind, factor = (4.0, -3.0), 1.08
    move = gliding(wind)
    with_it, without, ratios = [], [], []
    for seed in range(4):
        rows = with_pitot(rows_of_a(WING, move, seed, monkeypatch), move, wind, factor)
        result = run_offline(rows, CONFIG)
        np.testing.assert_allclose(result.state[WIND : WIND + 2], wind, atol=1.0)
        assert np.exp(result.state[FACTOR]) == pytest.approx(factor, abs=0.05)
        error, ratio = end_of_outage(result)
        with_it.append(error)
        ratios.append(ratio)
        without.append(end_of_outage(run_offline(rows, WITHOUT))[0])
        assert nis(result, Sensor.SIDESLIP) < 1.5
        assert nis(result, Sensor.AIRSPEED) < 1.5
    assert np.sqrt(np.mean(np.square(with_it))) < 0.9 * np.sqrt(np.mean(np.square(without)))
    assert np.sqrt(np.mean(np.square(ratios))) < 2.0


def test_while_fixes_and_a_fast_imu_tell_the_motion_the_air_corrects_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows = rows_of_a(QUADROTOR, hovering(0.3, squall), 0, monkeypatch, duration=48.0)
    result, without = run_offline(rows, CONFIG), run_offline(rows, WITHOUT)
    assert np.any(result.output.innovations[:, L.I_SENSOR] == Sensor.DRAG)
    assert np.hypot(*result.state[WIND : WIND + 2]) > 1.0
    for column in (L.R_NED, L.R_V, L.R_EULER, L.R_POSE_COVARIANCE):
        np.testing.assert_allclose(
            result.output.poses[:, column : column + 3],
            without.output.poses[:, column : column + 3],
            rtol=1e-5,  # the covariance is brought up at other times too
            atol=1e-6,
        )


def test_the_states_of_the_class_are_there_only_where_they_are_used() -> None:
    for vehicle in (BOAT, VTOL, 0, None):
        assert used_class(vehicle) == 0.0
    rows = _session.session(duration=12.0)
    for vehicle, config in ((BOAT, CONFIG), (QUADROTOR, WITHOUT)):
        rows[rows[:, KIND] == Kind.HEARTBEAT, VEHICLE_TYPE] = vehicle
        assert parameters(config, choose(rows, config))[Parameter.CLASS] == 0.0
        state = run_offline(rows, config).state
        assert state[L.STATES] == 26.0
        assert not np.any(state[WIND : WIND + 4])
