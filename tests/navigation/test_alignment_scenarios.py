"""Starts that are not a rest on level ground: what is claimed is kept, what is not known is said, and all of it is found in the end."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from mavkf.config import Config
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode
from mavkf.replay.boot_clock import on_boot_clock
from mavkf.replay.simulation.flight import simulate
from mavkf.replay.tlog import read_tlog
from mavkf.samples import (
    ACCEL,
    ACCEL_RESOLUTION,
    AUTOPILOT,
    BASE_MODE,
    FIELD,
    FIX,
    GYRO,
    GYRO_RESOLUTION,
    HEIGHT_AMSL,
    KIND,
    LATITUDE,
    LONGITUDE,
    PRESSURE,
    SIGMA_HORIZONTAL,
    SIGMA_SPEED,
    SIGMA_VERTICAL,
    TIME,
    VEHICLE_TYPE,
    VELOCITY_N,
    Kind,
    Source,
)

from ._session import CONFIG, FIELD_N, ORIGIN, RADII, G, merged, rows_of, run

Array = np.ndarray
Function = Callable[[Array], Array]
MOST_SIGMAS = 4.0  # of a yaw that is claimed: with thousands of poses, one in a hundred thousand
QUADROTOR, ROVER = 2, 10


def zero(t: Array) -> Array:
    return np.zeros_like(t)


@dataclass
class Ride:
    """A motion by its speed (m/s), heading, roll and pitch (rad), as functions of the time since the log's begin, s."""

    speed: Function = zero
    yaw: Function = zero
    roll: Function = zero
    pitch: Function = zero
    duration: float = 90.0
    fine: Array = field(init=False)
    euler: Array = field(init=False)
    v: Array = field(init=False)
    p: Array = field(init=False)

    def __post_init__(self) -> None:
        t = self.fine = np.arange(0.0, self.duration + 0.02, 0.001)
        self.euler = np.stack([self.roll(t), self.pitch(t), self.yaw(t)], -1)
        self.v = np.stack([self.speed(t) * np.cos(self.yaw(t)), self.speed(t) * np.sin(self.yaw(t)), zero(t)], -1)
        self.p = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (self.v[1:] + self.v[:-1]) * 0.001, axis=0)])

    def at(self, values: Array, t: Array) -> Array:
        return np.stack([np.interp(t, self.fine, values[:, i]) for i in range(3)], -1)

    def imu(self, t: Array) -> tuple[Array, Array]:
        """omega_b (n, 3), rad/s, and f_b (n, 3), m/s^2."""
        C = matrices(self.euler)
        W = np.einsum("nji,njk->nik", C, np.gradient(C, 0.001, axis=0))
        omega = 0.5 * np.stack([W[:, i, j] - W[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], -1)
        force = np.einsum("nji,nj->ni", C, np.gradient(self.v, 0.001, axis=0) - [0.0, 0.0, G])
        return self.at(omega, t), self.at(force, t)


def matrices(euler: Array) -> Array:
    """C_nb (n, 3, 3) of roll, pitch, yaw (n, 3), rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler.T), np.sin(euler.T)
    rows = (
        (cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy),
        (cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy),
        (-sp, sr * cp, cr * cp),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def sensors(
    ride: Ride,
    seed: int,
    compass: bool = False,
    armed: bool = True,
    vehicle: int = ROVER,
    field_error: Callable[[Array, Array], Array] = lambda t, field_b: np.zeros_like(field_b),
) -> Array:
    """Rows of consumer sensors from 100 s on the boot clock, in the order of arrival; biases are drawn from the seed.

    field_error: of the magnetometer, T, by time since the begin (n) and true field (n, 3), both in b.
    """
    random = np.random.default_rng(seed)
    gyro_bias, accel_bias = 0.01 * random.normal(size=3), 0.04 * random.normal(size=3)
    t = np.arange(0.0, ride.duration, 0.01)
    imu = rows_of(Kind.IMU, Source.HIGHRES_IMU, 100.0 + t, random.uniform(0.0, 0.01, t.size))
    omega, force = ride.imu(t)
    imu[:, GYRO : GYRO + 3] = omega + gyro_bias + 5e-4 * random.normal(size=omega.shape)
    imu[:, ACCEL : ACCEL + 3] = force + accel_bias + 0.03 * random.normal(size=force.shape)
    imu[:, GYRO_RESOLUTION], imu[:, ACCEL_RESOLUTION] = 0.0, 0.0

    t = 0.013 + np.arange(0.2, ride.duration - 0.3, 0.2)
    gnss = rows_of(Kind.GNSS, Source.GPS_RAW_INT, 100.0 + t, random.uniform(0.0, 0.3, t.size), 0.2)
    p = ride.at(ride.p, t) + random.normal(size=(t.size, 3)) * [0.8, 0.8, 1.2]
    gnss[:, FIX] = 3
    gnss[:, LATITUDE] = ORIGIN[0] + p[:, 0] / RADII[0]
    gnss[:, LONGITUDE] = ORIGIN[1] + p[:, 1] / RADII[1] / np.cos(ORIGIN[0])
    gnss[:, HEIGHT_AMSL] = ORIGIN[2] - p[:, 2]
    gnss[:, VELOCITY_N : VELOCITY_N + 3] = ride.at(ride.v, t) + 0.15 * random.normal(size=(t.size, 3))
    gnss[:, SIGMA_HORIZONTAL], gnss[:, SIGMA_VERTICAL], gnss[:, SIGMA_SPEED] = 0.8, 1.2, 0.15

    t = 0.004 + np.arange(0.1, ride.duration - 0.1, 0.1)
    barometer = rows_of(Kind.BAROMETER, Source.SCALED_PRESSURE, 100.0 + t, random.uniform(0.0, 0.02, t.size), 0.03)
    height = ORIGIN[2] + 25.0 + 0.2 * random.normal(size=t.size)
    barometer[:, PRESSURE] = 101325.0 * (1.0 - height / 44330.769) ** (1.0 / 0.190263)
    magnetometer = rows_of(Kind.MAGNETOMETER, Source.HIGHRES_IMU, 100.0 + t, random.uniform(0.0, 0.02, t.size), 0.02)
    true = np.einsum("nji,j->ni", matrices(ride.at(ride.euler, t)), FIELD_N)
    magnetometer[:, FIELD : FIELD + 3] = true + field_error(t, true) + 2e-7 * random.normal(size=true.shape)

    beats = rows_of(Kind.HEARTBEAT, Source.HEARTBEAT, 100.5 + np.arange(0.0, ride.duration - 1.0), 0.0)
    beats[:, VEHICLE_TYPE], beats[:, AUTOPILOT], beats[:, BASE_MODE] = vehicle, 12, 128 + 1 if armed else 1
    return merged(imu, gnss, barometer, beats, *([magnetometer] if compass else []))


@dataclass
class Errors:
    """Errors of pose rows (n), NaN where nothing is claimed: m, m/s, rad, rad; the notes; and what yaw and tilt claim, rad."""

    t: Array
    position: Array
    velocity: Array
    tilt: Array
    yaw: Array
    sigma_tilt: Array
    sigma_yaw: Array
    notes: Array

    @property
    def yaw_known(self) -> Array:
        return np.isfinite(self.yaw)

    def first_yaw(self) -> float:
        return float(self.t[self.yaw_known][0])


def judged(rows: Array, config: Config, truth: Callable[[Array], tuple[Array, Array, Array]]) -> Errors:
    """Run as live; truth: latitude, longitude, height (n, 3), velocity (n, 3) and euler angles (n, 3) at boot times (n).

    What is unknown in a pose row is NaN, so any other NaN would show as one part of a vector being known.
    """
    _, output = run(rows, config=config)
    poses = output.poses
    t = poses[:, L.R_TIME]
    place, v, euler = truth(t)
    valid = poses[:, L.R_VALID].astype(int)
    for bit, columns in (
        (L.VALID_POSITION, [*range(L.R_LATITUDE, L.R_HEIGHT + 1), *range(L.R_NED, L.R_NED + 3)]),
        (L.VALID_VELOCITY, [*range(L.R_V, L.R_V + 3), *range(L.R_VELOCITY_COVARIANCE, L.R_VELOCITY_COVARIANCE + 9)]),
        (L.VALID_TILT, [L.R_EULER, L.R_EULER + 1, *range(L.R_BG, L.R_BG + 6)]),
        (L.VALID_YAW, [L.R_EULER + 2, L.R_SIGMA_EULER + 2, *range(L.R_Q, L.R_Q + 4)]),
    ):
        known = np.isfinite(poses[:, columns])
        assert np.array_equal(known.all(axis=1), known.any(axis=1))
        assert np.array_equal(known.all(axis=1), (valid & bit) > 0)
    north = (poses[:, L.R_LATITUDE] - place[:, 0]) * RADII[0]
    east = (poses[:, L.R_LONGITUDE] - place[:, 1]) * RADII[1] * np.cos(place[:, 0])
    estimated = matrices(np.nan_to_num(poses[:, L.R_EULER : L.R_EULER + 3]))[:, 2]
    tilt = np.arccos(np.clip(np.sum(estimated * matrices(euler)[:, 2], axis=1), -1.0, 1.0))
    covariance = poses[:, L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36]
    return Errors(
        t,
        np.hypot(north, east),
        np.linalg.norm(poses[:, L.R_V : L.R_V + 2] - v[:, :2], axis=1),
        np.where(np.isfinite(poses[:, L.R_EULER]), tilt, np.nan),
        np.angle(np.exp(1j * (poses[:, L.R_EULER + 2] - euler[:, 2]))),
        np.sqrt(np.maximum(covariance[:, 21], covariance[:, 28])),
        poses[:, L.R_SIGMA_EULER + 2],
        output.notes,
    )


def ridden(ride: Ride, rows: Array) -> Errors:
    def truth(t: Array) -> tuple[Array, Array, Array]:
        p = ride.at(ride.p, t - 100.0)
        place = np.stack(
            [ORIGIN[0] + p[:, 0] / RADII[0], ORIGIN[1] + p[:, 1] / RADII[1] / np.cos(ORIGIN[0]), ORIGIN[2] - p[:, 2]],
            -1,
        )
        return place, ride.at(ride.v, t - 100.0), ride.at(ride.euler, t - 100.0)

    return judged(rows, CONFIG, truth)


def assert_position_and_velocity(errors: Errors) -> None:
    """Known all the time from a second after the first pose on, and as good as the receiver."""
    late = errors.t > errors.t[0] + 1.0
    assert np.all(errors.position[late] < 5.0)
    assert np.all(errors.velocity[late] < 4.0)
    assert np.sqrt(np.mean(errors.velocity[late] ** 2)) < 1.0


def assert_honest(errors: Errors, most_tilt: float = MOST_SIGMAS) -> None:
    known = errors.yaw_known
    assert np.all(np.abs(errors.yaw[known]) < MOST_SIGMAS * errors.sigma_yaw[known])
    known = np.isfinite(errors.tilt)
    assert np.all(errors.tilt[known] < most_tilt * errors.sigma_tilt[known])


def notes(errors: Errors, code: NoteCode) -> Array:
    return errors.notes[errors.notes[:, L.NOTE_CODE] == code]


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, int], tuple[Array, object]]:
    """Flights full of manoeuvres, of both kinds of vehicle, with their truths."""
    made = {}
    for vehicle, seed in (("copter", 1), ("copter", 2), ("plane", 1), ("plane", 3)):
        path: Path = tmp_path_factory.mktemp("flights") / f"{vehicle}{seed}.tlog"
        truth = simulate(path, seed=seed, duration_s=150.0, vehicle=vehicle, imu_hz=100.0)
        log = read_tlog(path)
        made[vehicle, seed] = on_boot_clock(log.rows[log.vehicles()[0]], 3.0)[0], truth
    return made


# A compass gives the first heading at once, by a field that is levelled with the bank of the turn for gravity: more than a linear update
# can put right within what it claims.
STEEP_TURN = pytest.mark.xfail(reason="first heading by compass in a steep turn: 4.2 sigma, and a reset", strict=False)


@pytest.mark.parametrize(
    ("flight", "start", "compass"),
    [
        pytest.param(
            (vehicle, seed),
            start,
            compass,
            marks=[STEEP_TURN] if vehicle == "plane" and start == 70.0 and compass else [],
        )
        for vehicle, seed in (("copter", 1), ("copter", 2), ("plane", 1), ("plane", 3))
        for start in (45.0, 70.0)
        for compass in (True, False)
    ],
)
def test_a_log_that_begins_in_mid_air(
    flights: dict[tuple[str, int], tuple[Array, object]], flight: tuple[str, int], start: float, compass: bool
) -> None:
    # given a vehicle that manoeuvres; the plane circles for half a minute, so that its force points at its floor all the time
    rows, truth = flights[flight]
    rows = rows[(rows[:, TIME] > start) & (rows[:, TIME] < 125.0)]
    if not compass:
        rows = rows[rows[:, KIND] != Kind.MAGNETOMETER]

    def true(t: Array) -> tuple[Array, Array, Array]:
        columns = np.column_stack([truth.lat, truth.lon, truth.alt, truth.velocity, np.unwrap(truth.euler, axis=0)])
        values = np.stack([np.interp(t, truth.time_boot_s, column) for column in columns.T], -1)
        return values[:, :3], values[:, 3:6], values[:, 6:]

    # when the log begins in the middle of it
    errors = judged(rows, Config(), true)
    # then
    assert_position_and_velocity(errors)
    assert_honest(errors)
    assert errors.first_yaw() < start + (6.0 if compass else 25.0)
    assert np.degrees(abs(errors.yaw[-1])) < 4.0
    assert np.degrees(errors.tilt[-1]) < 1.0


@pytest.mark.parametrize("compass", [True, False])
@pytest.mark.parametrize(("roll", "pitch"), [(180.0, 0.0), (174.0, 17.0)])
def test_upside_down_at_rest(roll: float, pitch: float, compass: bool) -> None:
    # given a vehicle on its back that stands
    ride = Ride(
        yaw=lambda t: np.full_like(t, 1.0),
        roll=lambda t: np.full_like(t, np.radians(roll)),
        pitch=lambda t: np.full_like(t, np.radians(pitch)),
        duration=40.0,
    )
    # when its log begins
    errors = ridden(ride, sensors(ride, seed=4, compass=compass, armed=False, vehicle=QUADROTOR))
    # then
    assert_position_and_velocity(errors)
    assert_honest(errors)
    assert np.all(errors.yaw_known) if compass else not np.any(errors.yaw_known)
    assert np.degrees(np.nanmax(errors.tilt)) < 1.5


RIDES: dict[str, Ride] = {
    # nothing tells the heading but that cars drive forward, which is not claimed of what is unarmed, drifts or reverses
    "straight": Ride(speed=lambda t: np.full_like(t, 12.0)),
    "speeds up and slows down": Ride(speed=lambda t: 12.5 + 2.0 * np.sin(0.3 * t)),
    # the accelerometer sees it as still as on a slope of eight degrees
    "brakes from the first moment on": Ride(
        speed=lambda t: 15.0 - 4.0 * np.clip(t / 3.0, 0.0, 1.0) + 4.0 * np.clip((t - 20.0) / 4.0, 0.0, 1.0),
        yaw=lambda t: 0.5 * np.clip((t - 40.0) / 4.0, 0.0, 1.0),
    ),
    "a bend": Ride(speed=lambda t: np.full_like(t, 12.0), yaw=lambda t: 1.5 * np.clip((t - 20.0) / 8.0, 0.0, 1.0)),
    "round and round": Ride(speed=lambda t: np.full_like(t, 10.0), yaw=lambda t: 0.3 * t),
}
FINDS_YAW = ("speeds up and slows down", "round and round")


@pytest.mark.parametrize("heading", [0.0, 1.2, 2.9, -2.0])
@pytest.mark.parametrize("name", RIDES)
def test_in_motion_from_the_beginning_without_a_compass(name: str, heading: float) -> None:
    # given a car at 10 to 15 m/s in any direction
    base = RIDES[name]
    ride = Ride(speed=base.speed, yaw=lambda t: heading + base.yaw(t))
    # when its log begins
    errors = ridden(ride, sensors(ride, seed=round(10 * heading) + 20))
    # then
    assert_position_and_velocity(errors)
    assert_honest(errors, 5.0 if name == "round and round" else MOST_SIGMAS)
    if name == "straight":
        assert not np.any(errors.yaw_known)
    if name in FINDS_YAW:
        assert np.any(errors.yaw_known)
        assert np.degrees(abs(errors.yaw[-1])) < 5.0
    assert np.degrees(errors.tilt[-1]) < 2.0


def moves_from(start: float) -> Ride:
    """Stands, then speeds up and turns left and right."""

    def ramp(t: Array) -> Array:
        active = np.clip((t - start) / 4.0, 0.0, 1.0)
        return active**2 * (3.0 - 2.0 * active)

    return Ride(
        speed=lambda t: 8.0 * ramp(t) * (1.0 + 0.3 * np.sin(0.7 * (t - start))),
        yaw=lambda t: 0.4 + 1.2 * ramp(t) * np.sin(0.35 * (t - start)),
    )


def turned_field(angle: float, until: float) -> Callable[[Array, Array], Array]:
    """The field of a level vehicle turned by an angle (rad) about down until a time (s): right in strength and dip."""
    c, s = np.cos(angle), np.sin(angle)

    def error(t: Array, true: Array) -> Array:
        turned = np.stack([c * true[:, 0] - s * true[:, 1], s * true[:, 0] + c * true[:, 1], true[:, 2]], -1)
        return np.where(t[:, None] < until, turned - true, 0.0)

    return error


@pytest.mark.parametrize("angle", [40.0, -40.0])
def test_a_compass_that_begins_disturbed_is_a_doubt_when_its_field_changes(angle: float) -> None:
    # given a vehicle that stands beside iron which turns its field without changing strength or dip: nothing can tell
    ride = moves_from(40.0)
    # when the iron goes away after 20 s
    rows = sensors(
        ride, seed=5, compass=True, vehicle=QUADROTOR, field_error=turned_field(np.radians(angle), until=20.0)
    )
    errors = ridden(ride, rows)
    # then the change is a doubt about a heading that nothing but the field has told
    relearnt = notes(errors, NoteCode.MAGNETOMETER_RELEARNT)
    assert relearnt[0, L.NOTE_END] == pytest.approx(125.0, abs=0.5)
    standing = (errors.t > relearnt[0, L.NOTE_END] + 0.2) & (errors.t < 140.0)
    assert np.all(errors.position[standing] < 4.0)
    known = standing & errors.yaw_known
    assert np.all(np.abs(errors.yaw[known]) < 7.0 * errors.sigma_yaw[known])


@pytest.mark.parametrize("angle", [40.0, -40.0])
def test_motion_puts_a_compass_right_that_begins_disturbed(angle: float) -> None:
    # given the same, when the vehicle sets off as soon as the iron has gone
    ride = moves_from(25.0)
    rows = sensors(
        ride, seed=5, compass=True, vehicle=QUADROTOR, field_error=turned_field(np.radians(angle), until=20.0)
    )
    errors = ridden(ride, rows)
    # then
    assert_position_and_velocity(errors)
    assert np.degrees(abs(errors.yaw[-1])) < 2.0
    assert np.degrees(errors.tilt[-1]) < 1.0
