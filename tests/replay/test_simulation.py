"""Simulated flights: the truth fits itself, the sensors have the errors they say, the log is what an autopilot sends."""

import math
import struct
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pymap3d
import pytest
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavkf.cli import main
from mavkf.errors import UsageError
from mavkf.models import earth as compiled_earth
from mavkf.replay.simulation import SensorNoise, draw_noise, manoeuvres, messages, parts, sensors, simulate
from mavkf.replay.simulation.route import Channel, Route
from mavkf.replay.simulation.trajectory import Trajectory, ecef, geodetic, gravity
from mavkf.replay.tlog import read_tlog
from mavkf.replay.truth import Truth, read_truth

Floats = NDArray[np.float64]
earth: Any = compiled_earth
START = (math.radians(47.4), math.radians(8.5), 488.0, 0.5)


def trajectory(vehicle: str, seed: int, duration: float) -> Trajectory:
    plan = getattr(manoeuvres, vehicle)(np.random.default_rng(seed), duration)
    return Trajectory(plan.route, *START, winged=vehicle == "plane")


class Flight(NamedTuple):
    """A flight without sensor errors, and what pymavlink reads of it: messages by name, stamps in seconds UTC."""

    truth: Truth
    path: Path
    messages: dict[str, list[Any]]
    stamps: Floats


def read(path: Path) -> Iterator[tuple[float, Any]]:
    """The messages of a log by pymavlink's parser, which raises at the first bad byte."""
    data, at, link = path.read_bytes(), 0, dialect.MAVLink(None)
    while at < len(data):
        length = data[at + 9] + 12
        yield struct.unpack_from(">Q", data, at)[0] * 1e-6, link.decode(bytearray(data[at + 8 : at + 8 + length]))
        at += 8 + length


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    path = tmp_path_factory.mktemp("simulation") / "flight.tlog"
    truth = simulate(
        path, seed=5, duration_s=80.0, highres_imu=True, gnss_message_hz=10.0, noise=SensorNoise().scaled(0)
    )
    found, stamps = defaultdict(list), []
    for stamp, message in read(path):
        stamps.append(stamp)
        found[message.get_type()].append(message)
    return Flight(truth, path, found, np.array(stamps))


def column(messages: list[Any], names: str) -> Floats:
    return np.array([[getattr(message, name) for name in names.split()] for message in messages], np.float64)


# --- the true motion -----------------------------------------------------------------------------------------------


def rotation(euler: Floats) -> Floats:
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler), np.sin(euler)
    Z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    Y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    X = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return np.asarray(Z @ Y @ X, np.float64)


def skew(x: Floats) -> Floats:
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def strapdown(x: Floats, f_b: Floats, omega_b: Floats) -> Floats:
    """Derivative of latitude, longitude, height, v_n, C_nb (15) in frame n: Groves 2nd ed., eqs. 5.37-5.56."""
    latitude, _, height = x[:3]
    v, C = x[3:6], x[6:].reshape(3, 3)
    meridian, transverse = earth.radii(latitude)
    w_ie = earth.EARTH_RATE * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])
    east, north = v[1] / (transverse + height), v[0] / (meridian + height)
    w_en = np.array([east, -north, -east * math.tan(latitude)])
    g = np.array([0.0, 0.0, earth.gravity(latitude, height)])
    return np.concatenate(
        [
            [north, east / math.cos(latitude), -v[2]],
            C @ f_b + g - skew(2.0 * w_ie + w_en) @ v,
            (C @ skew(omega_b) - skew(w_ie + w_en) @ C).ravel(),
        ]
    )


@pytest.mark.parametrize(("vehicle", "seed", "begin"), [("copter", 1, 10.0), ("plane", 2, 30.0)])
def test_force_and_rate_integrate_back_to_the_flight(vehicle: str, seed: int, begin: float) -> None:
    """Given only the start, 60 s of Runge-Kutta on omega_b and f_b end where the flight does, to a millimetre."""
    n, dt = 6000, 0.01
    motion = trajectory(vehicle, seed, 120.0).at(np.linspace(begin, begin + n * dt, 2 * n + 1))
    assert np.ptp(motion.v_n, axis=0).min() > 2.0 and np.ptp(motion.euler, axis=0).min() > 0.2  # it does move
    place = np.array([motion.latitude, motion.longitude, motion.height])
    x = np.concatenate([place[:, 0], motion.v_n[0], rotation(motion.euler[0]).ravel()])
    for i in range(0, 2 * n, 2):
        f, w = motion.f_b[i : i + 3], motion.omega_b[i : i + 3]
        k1 = strapdown(x, f[0], w[0])
        k2 = strapdown(x + 0.5 * dt * k1, f[1], w[1])
        k3 = strapdown(x + 0.5 * dt * k2, f[1], w[1])
        k4 = strapdown(x + dt * k3, f[2], w[2])
        x = x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    metres = np.array([earth.SEMI_MAJOR_AXIS, earth.SEMI_MAJOR_AXIS * math.cos(x[0]), 1.0])
    assert np.abs((x[:3] - place[:, -1]) * metres).max() < 1e-3
    assert np.abs(x[3:6] - motion.v_n[-1]).max() < 1e-4
    assert np.abs(x[6:].reshape(3, 3) - rotation(motion.euler[-1])).max() < 1e-6


@pytest.mark.parametrize("duration", [60.0, 120.0, 3600.0])
@pytest.mark.parametrize("vehicle", ["copter", "plane"])
def test_flights_of_any_length_stand_fly_and_stand_again(vehicle: str, duration: float) -> None:
    for seed in range(5):
        plan = getattr(manoeuvres, vehicle)(np.random.default_rng(seed), duration)
        assert plan.route.time == pytest.approx(duration, abs=0.2)
        motion = trajectory(vehicle, seed, duration).at(np.linspace(0.0, duration, 2000))
        speed = np.linalg.norm(motion.v_n, axis=1)
        still = (motion.time <= plan.take_off) | (motion.time >= plan.landed)
        assert plan.take_off >= 12.0 and speed[still].max() < 1e-9 and np.mean(speed[~still]) > 0.5
        assert np.abs(motion.f_b[still] - [0.0, 0.0, -9.8]).max() < 0.02
        assert motion.height.min() > START[2] - 0.01 and motion.height.max() < START[2] + 120.0
        assert motion.height[-1] == pytest.approx(START[2], abs=0.01 if vehicle == "copter" else 10.0)
        assert np.degrees(np.abs(motion.euler[:, :2]).max()) < 45.0
        assert np.abs(motion.omega_b).max() < 3.0
        if vehicle == "copter":
            assert motion.latitude[-1] == pytest.approx(START[0], abs=1e-9)  # back where it began
        else:
            # in a coordinated turn no force is to the side
            assert np.abs(motion.f_b[:, 1]).max() < 1e-6
            assert duration < 100.0 or np.degrees(np.abs(motion.euler[:, 0]).max()) > 15.0


def test_a_step_and_its_integral_fit_each_other() -> None:
    channel = Channel([(1.0, 2.0, 3.0), (3.0, 1.0, -4.0), (6.0, 0.5, 1.0)])
    t = np.linspace(0.0, 8.0, 8001)
    integral, value, slope = channel.at(t)
    assert value[[0, 1000, 3000, 5000, -1]] == pytest.approx([0.0, 0.0, 3.0, -1.0, 0.0], abs=1e-12)
    assert np.gradient(integral, t)[1:-1] == pytest.approx(value[1:-1], abs=1e-5)
    assert np.gradient(value, t)[1:-1] == pytest.approx(slope[1:-1], abs=1e-4)
    with pytest.raises(ValueError, match="overlap"):
        Channel([(1.0, 2.0, 3.0), (2.5, 1.0, -4.0)])


def test_a_pulse_adds_up_to_what_was_asked() -> None:
    route = Route()
    route.pulse(2.0, 3.14159, climb=12.0)
    assert Channel(route.steps["climb"]).at(np.array([route.time]))[0] == pytest.approx(12.0)


def test_places_on_the_ellipsoid_are_those_of_pymap3d() -> None:
    random = np.random.default_rng(0)
    lat, lon, h = random.uniform(-1.5, 1.5, 500), random.uniform(-3.1, 3.1, 500), random.uniform(-400.0, 9000.0, 500)
    theirs = np.stack(pymap3d.geodetic2ecef(lat, lon, h, deg=False), axis=1)
    assert ecef(lat, lon, h) == pytest.approx(theirs, abs=1e-6)
    back = geodetic(theirs)
    assert back[0] == pytest.approx(lat, abs=1e-14 * 100)
    assert back[1] == pytest.approx(lon, abs=1e-14 * 100)
    assert back[2] == pytest.approx(h, abs=1e-7)
    assert gravity(lat, h) == pytest.approx([earth.gravity(a, b) for a, b in zip(lat, h, strict=True)], rel=1e-14)


# --- the sensors ---------------------------------------------------------------------------------------------------


def test_gauss_markov_has_its_variance_and_its_correlation() -> None:
    """Sums of squares of 4000 independent series lie within four sigma of the mean of their chi-square."""
    n, sigma, tau = 4000, 2.0, 30.0
    t = np.array([0.0, 0.2, 1.0, 31.0, 131.0])
    x = sensors.gauss_markov(np.random.default_rng(7), t, sigma, tau, n)
    bound = 4.0 * math.sqrt(2.0 * n)
    for row in x:
        assert abs(np.sum(row**2) / sigma**2 - n) < bound
    for before, after, dt in zip(x, x[1:], np.diff(t), strict=False):
        kept = math.exp(-dt / tau)
        assert abs(np.sum((after - kept * before) ** 2) / (sigma**2 * (1.0 - kept**2)) - n) < bound
        assert np.sum(before * after) / (n * sigma**2) == pytest.approx(kept, abs=4.0 / math.sqrt(n))


def test_white_noise_bias_and_walk_of_the_imu_have_their_sizes() -> None:
    noise = SensorNoise().scaled(0)
    noise = SensorNoise(**{**vars(noise), "gyro_density": 1e-3, "accel_walk": 1e-2, "accel_bias": 0.5})
    motion = trajectory("copter", 1, 60.0).at(np.arange(8000) / sensors.IMU_RATE)
    running = np.zeros(8000, np.bool_)
    walked, biases, white = [], [], []
    for seed in range(40):
        imu = sensors.Imu(noise, np.random.default_rng(seed))
        biases.append(imu.bias[3:])
        measured = imu.measure(motion, running)
        walked.append(imu.bias[3:] - biases[-1])
        white.append(np.var(measured[1000:, :3] - motion.omega_b[1000:], axis=0))
    for values, sigma in ((walked, 1e-2 * math.sqrt(8.0)), (biases, 0.5)):
        assert abs(np.sum((np.array(values) / sigma) ** 2) - 120) < 4.0 * math.sqrt(240)
    # the two-pole Butterworth filter lets through as much as an ideal one of pi / (2 sqrt(2)) times its cut-off
    bandwidth = sensors.IMU_CUTOFF * math.pi / (2.0 * math.sqrt(2.0))
    assert np.sqrt(np.mean(white)) == pytest.approx(1e-3 * math.sqrt(2.0 * bandwidth), rel=0.03)


def test_blocks_of_the_imu_join_without_a_seam() -> None:
    motion = trajectory("copter", 1, 60.0)
    t, noise = np.arange(14000, 16000) / sensors.IMU_RATE, SensorNoise().scaled(0)
    whole = sensors.Imu(noise, np.random.default_rng(0)).measure(motion.at(t), t > 0)
    parts = sensors.Imu(noise, np.random.default_rng(0))
    joined = np.concatenate([parts.measure(motion.at(part), part > 0) for part in np.split(t, [700, 900])])
    assert joined == pytest.approx(whole, abs=1e-12)


def test_the_filter_delays_by_eleven_milliseconds() -> None:
    response = sensors.low_pass()
    assert np.sum(response * np.arange(len(response))) / sensors.IMU_RATE == pytest.approx(0.01125, abs=2e-4)


def test_the_magnetometer_sees_the_field_in_the_body() -> None:
    motion, field = trajectory("copter", 3, 120.0).at(np.linspace(20.0, 100.0, 50)), np.array([2.1e-5, 1e-6, 4.3e-5])
    measured = sensors.magnetometer(SensorNoise().scaled(0), np.random.default_rng(0), motion, field)
    assert measured == pytest.approx(np.stack([rotation(angles).T @ field for angles in motion.euler]), abs=1e-15)


def test_pressure_is_that_of_the_standard_atmosphere() -> None:
    # ISO 2533, table 1
    assert sensors.isa_pressure(np.array([0.0, 500.0, 2000.0])) == pytest.approx([101325.0, 95461.0, 79501.0], abs=2.0)


def test_the_velocity_error_lingers_as_long_as_it_says() -> None:
    t = 0.2 * np.arange(20_000)
    noise = SensorNoise(gnss_speed_horizontal=0.1, gnss_speed_vertical=0.2, gnss_speed_time_constant=0.4)
    errors = sensors.gnss(noise, np.random.default_rng(3), t)[1]
    assert np.std(errors, axis=0) == pytest.approx([0.1, 0.1, 0.2], rel=0.05)
    kept = np.mean(errors[1:] * errors[:-1], axis=0) / np.var(errors, axis=0)
    assert kept == pytest.approx([math.exp(-0.5)] * 3, abs=0.03)
    white = sensors.gnss(SensorNoise(), np.random.default_rng(3), t)[1]
    assert np.abs(np.mean(white[1:] * white[:-1], axis=0) / np.var(white, axis=0)).max() < 0.03


def test_drawn_sensors_lie_between_the_parts_and_differ() -> None:
    rng = np.random.default_rng(1)
    drawn = [vars(draw_noise(rng)) for _ in range(300)]
    for name, (low, high) in parts.RANGES.items():
        values = np.array([each[name] for each in drawn])
        assert low <= values.min() < low * (high / low) ** 0.1 and low * (high / low) ** 0.9 < values.max() <= high
        assert np.median(values) == pytest.approx(math.sqrt(low * high), rel=0.15 * math.log(high / low))
    for name in ("", "drift_", "speed_"):
        ratio = np.array([each[f"gnss_{name}vertical"] / each[f"gnss_{name}horizontal"] for each in drawn])
        assert ratio.min() >= 1.2 and ratio.max() <= 1.8
    assert vars(draw_noise(np.random.default_rng(1))) == drawn[0]


def test_what_a_receiver_claims_is_a_multiple_of_its_errors(tmp_path: Path) -> None:
    noise = SensorNoise(gnss_horizontal=0.3, gnss_drift_horizontal=0.4, gnss_speed_horizontal=0.1, gnss_claim=2.0)
    simulate(tmp_path / "flight.tlog", duration_s=60.0, noise=noise)
    claims = [m for _, m in read(tmp_path / "flight.tlog") if m.get_type() == "GPS_RAW_INT" and m.fix_type >= 3]
    assert (claims[-1].h_acc, claims[-1].vel_acc) == (1000, 200)
    assert SensorNoise(gnss_claim=1.2).scaled(0).gnss_claim == 1.2


# --- the log -------------------------------------------------------------------------------------------------------


def test_a_new_magnetometer_value_is_as_old_as_the_mean_it_stands_for(flight: Flight) -> None:
    found = column(flight.messages["RAW_IMU"], "time_usec xmag ymag zmag")
    new = np.flatnonzero(np.any(np.diff(found[:, 1:], axis=0), axis=1)) + 1
    t, measured = found[new, 0] * 1e-6, found[new, 1:] + 0.5 * np.sign(found[new, 1:])  # cut toward zero, milligauss

    def spread(age: float) -> float:
        angles = np.array([np.interp(t - age, flight.truth.time_boot_s, np.unwrap(a)) for a in flight.truth.euler.T]).T
        turned = np.stack([rotation(each) @ field for each, field in zip(angles, measured, strict=True)])
        return float(np.sum(np.var(turned, axis=0)))

    ages = np.arange(0.0, 0.1, 0.002)
    assert ages[np.argmin([spread(age) for age in ages])] == pytest.approx(0.055, abs=0.005)


def test_the_log_holds_every_message_at_its_rate(flight: Flight) -> None:
    rates = {name: len(found) / 79.0 for name, found in flight.messages.items()}
    assert rates == pytest.approx(
        {
            "HEARTBEAT": 1.0,
            "SYSTEM_TIME": 2.0,
            "RAW_IMU": 200.0,
            "HIGHRES_IMU": 100.0,
            "SCALED_PRESSURE": 20.0,
            "GPS_RAW_INT": 10.0,
            "ATTITUDE": 4.0,
            "GLOBAL_POSITION_INT": 4.0,
        },
        rel=0.02,
    )
    everything = [message for found in flight.messages.values() for message in found]
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in everything} == {(1, 1)}
    assert not any(message.get_type() == "BAD_DATA" for message in everything)
    log = read_tlog(flight.path)
    assert log.damage.frame_bytes == log.size
    assert len(log.frames) == len(everything) and set(log.rows) == {(1, 1)}
    assert np.array_equal(log.frames["sequence"], np.arange(len(everything)) % 256)


def test_arrival_follows_boot_time_closely_and_never_goes_back(flight: Flight) -> None:
    assert (np.diff(flight.stamps) >= 0).all()
    log = read_tlog(flight.path)
    imu, arrival = log.messages(1, 1, "RAW_IMU")
    sent = imu["time_usec"].astype(np.int64)
    late = (arrival - sent) - (arrival - sent).min()
    assert 5e2 < late.std() < 5e3 and late.max() < 5e4
    clock = flight.messages["SYSTEM_TIME"]
    assert clock[0].time_unix_usec == 0
    assert abs(clock[-1].time_unix_usec * 1e-6 - flight.stamps[-1]) < 1.0
    assert 4900 < np.median(np.diff(sent)) < 5100 and np.diff(sent).max() < 7000 and np.diff(sent).min() > 2000


def test_it_is_an_ardupilot_that_arms_flies_and_disarms(flight: Flight) -> None:
    beats = flight.messages["HEARTBEAT"]
    assert {(beat.type, beat.autopilot) for beat in beats} == {(2, 3)}
    armed = [bool(beat.base_mode & 128) for beat in beats]
    changes = [i for i, (before, after) in enumerate(pairwise(armed)) if before != after]
    assert not armed[0] and not armed[-1] and len(changes) == 2
    moving = flight.truth.time_boot_s[np.linalg.norm(flight.truth.velocity, axis=1) > 0.01]
    assert changes[0] < moving[0] and changes[1] + 2 > moving[-1]


def test_raw_imu_is_cut_toward_zero() -> None:
    imu = np.array([[0.0019, -0.0019, 0.0009, 0.0399 * 9.80665 * 0.1, -9.80665 * 1.0009, 1e6]])
    stream = messages.raw_imu(np.array([1.5]), imu, np.array([[2.29e-6, -2.29e-6, 0.0]]), np.array([25.678]))
    values = [int(np.asarray(c).ravel()[0]) for c in stream.columns]
    assert values == [1_500_000, 3, -1000, 32767, 1, -1, 0, 22, -22, 0, 0, 2567]


def test_standing_still_raw_imu_shows_gravity_and_no_rate(flight: Flight) -> None:
    still = column(flight.messages["RAW_IMU"], "xacc yacc zacc xgyro ygyro zgyro xmag ymag zmag")[:2000]
    assert (still[:, :6] == [0, 0, -1000, 0, 0, 0]).all()  # 9.8075 m/s^2 is 1000.09 mG
    assert 450 < np.linalg.norm(still[0, 6:]) < 520  # mgauss in Switzerland
    fine = column(flight.messages["HIGHRES_IMU"], "zacc xmag ymag zmag")[:1000]
    assert fine[:, 0] == pytest.approx(-earth.gravity(math.radians(47.397742), 488.0), abs=1e-5)
    assert fine[0, 1:] == pytest.approx(still[0, 6:] * 1e3, abs=1e3)


def late_by(t: Floats, measured: Floats, truth_t: Floats, true: Floats, candidates: Floats) -> float:
    """The delay among the candidates at which the truth fits a measurement best; both of shape (n, m)."""
    misfits = [
        sum(np.sum((measured[:, i] - np.interp(t - d, truth_t, true[:, i])) ** 2) for i in range(true.shape[1]))
        for d in candidates
    ]
    return float(candidates[int(np.argmin(misfits))])


def test_fixes_are_late_by_their_delay_and_repeated_until_the_next(flight: Flight) -> None:
    m = column(flight.messages["GPS_RAW_INT"], "time_usec fix_type lat lon alt vel cog")
    none, fixes = m[m[:, 1] < 3], m[m[:, 1] >= 3]
    assert len(none) > 40 and (none[:, [0, 2, 3, 4]] == 0).all()
    times, counts = np.unique(fixes[:, 0], return_counts=True)
    assert np.median(np.diff(times)) == 200_000 and (times % 1000 == 0).all()
    assert (counts[1:-1] == 2).all() and len(np.unique(fixes, axis=0)) == len(times)
    truth, angle = flight.truth, np.radians(fixes[:, 6] * 1e-2)
    v = fixes[:, 5:6] * 1e-2 * np.column_stack([np.cos(angle), np.sin(angle)])
    candidates = np.arange(0.0, 0.2, 0.005)
    assert late_by(fixes[:, 0] * 1e-6, v, truth.time_boot_s, truth.velocity[:, :2], candidates) == pytest.approx(0.085)
    place = fixes[:, 2:5] * [1e-7, 1e-7 * math.cos(truth.lat[0]), 1e-3 / 111e3]
    true = np.degrees(np.column_stack([truth.lat, truth.lon * math.cos(truth.lat[0]), truth.alt / 6.371e6]))
    true[:, 2] = truth.alt / 111e3
    assert late_by(fixes[:, 0] * 1e-6, place, truth.time_boot_s, true, candidates) == pytest.approx(0.085)


def test_the_imu_is_late_by_its_filter(flight: Flight) -> None:
    imu = column(flight.messages["HIGHRES_IMU"], "time_usec xgyro ygyro")
    truth = flight.truth
    C = np.stack([rotation(angles) for angles in truth.euler])
    turned = np.swapaxes(C[:-1], 1, 2) @ C[1:]
    rate = 50.0 * np.stack([turned[:, 2, 1] - turned[:, 1, 2], turned[:, 0, 2] - turned[:, 2, 0]], axis=1)
    middle = truth.time_boot_s[:-1] + 0.005
    late = late_by(imu[:, 0] * 1e-6, imu[:, 1:], middle, rate, np.arange(0.0, 0.03, 0.0005))
    assert late == pytest.approx(0.0125, abs=0.001)


def test_the_autopilots_own_estimate_is_near_the_truth(flight: Flight) -> None:
    m = column(flight.messages["ATTITUDE"], "time_boot_ms roll pitch")
    for i in range(2):
        error = m[:, 1 + i] - np.interp(m[:, 0] * 1e-3, flight.truth.time_boot_s, flight.truth.euler[:, i])
        assert 0.01 < np.degrees(error.std()) < 1.0
    p = column(flight.messages["GLOBAL_POSITION_INT"], "time_boot_ms lat alt vz")
    assert (p[:4, 1:3] == 0).all() and p[-1, 1] * 1e-7 == pytest.approx(math.degrees(flight.truth.lat[-1]), abs=1e-5)


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a.tlog", "b.tlog", "c.tlog")]
    truths = [
        simulate(path, seed=seed, duration_s=60.0, imu_hz=50.0, vehicle="plane", address=(7, 1))
        for path, seed in zip(paths, (3, 3, 4), strict=True)
    ]
    first, second, third = (path.read_bytes() for path in paths)
    assert first == second != third
    assert np.array_equal(truths[0].velocity, truths[1].velocity)
    sent = read_tlog(paths[0])
    assert sent.vehicles() == [(7, 1)] and (sent.messages(7, 1, "HEARTBEAT")[0]["type"] == 1).all()
    flow = sent.messages(7, 1, "SCALED_PRESSURE")[0]["press_diff"]
    assert flow[0] == 0.0 and flow.max() == pytest.approx(0.5 * 1.225 * 17.0**2 / 100.0, rel=0.5)


# --- the command ---------------------------------------------------------------------------------------------------


def test_the_command_writes_a_flight_and_its_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, truth = tmp_path / "f.tlog", tmp_path / "f.csv"
    log.write_text("something older")
    options = "--duration 60 --imu-hz 20 --seed 2 --lat -35 --lon 149 --alt 600 --heading 90 --system-id 3"
    assert main(["simulate", str(log), "--truth", str(truth), *options.split()]) == 0
    output = capsys.readouterr()
    assert output.out == "" and "60 s of a copter" in output.err and "6001 times" in output.err
    first = read_truth(truth)
    assert np.degrees([first.lat[0], first.lon[0], first.euler[0, 2]]) == pytest.approx([-35.0, 149.0, 90.0])
    assert first.alt[0] == pytest.approx(600.0) and read_tlog(log).vehicles() == [(3, 1)]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["f.tlog", "--duration", "30"], "--duration is 30.0, but must be 60 s"),
        (["f.tlog", "--duration", "nan"], "--duration is nan"),
        (["f.tlog", "--imu-hz", "1000"], "--imu-hz is 1000.0, but must be 1 to 400 Hz"),
        (["f.tlog", "--lat", "89"], "--lat is 89.0"),
        (["f.tlog", "--heading", "inf"], "--heading is inf"),
        (["f.tlog", "--seed", "-1"], "--seed is -1"),
        (["f.tlog", "--system-id", "0"], "--system-id is 0"),
        (["f.tlog", "--noise", "-1"], "--noise is -1"),
        (["f.tlog", "--vehicle", "boat"], "--vehicle"),
        (["f.tlog", "--truth", "f.tlog"], "--truth is f.tlog"),
        (["f.tlog", "--truth", "nowhere/f.csv"], "--truth is nowhere/f.csv"),
        (["."], "is a folder"),
        (["nowhere/f.tlog"], "existing folder"),
    ],
)
def test_a_bad_value_is_one_sentence_and_nothing_is_written(
    options: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", *options]) == 2
    error = capsys.readouterr().err
    assert sentence in error and len(error.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_vehicle_that_is_not_known_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--vehicle is boat, but must be copter or plane"):
        simulate(tmp_path / "f.tlog", vehicle="boat")  # type: ignore[arg-type]
