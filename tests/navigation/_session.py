"""A synthetic session in plain numpy: a vehicle that stands, accelerates, climbs and turns; sample rows as the wire would give them."""

from dataclasses import dataclass
from math import radians

import numpy as np

from mavkf.config import Config, with_settings
from mavkf.navigation import layout as L
from mavkf.navigation.estimator import Output, SessionEstimator, joined
from mavkf.samples import (
    ACCEL,
    ACCEL_RESOLUTION,
    ARRIVAL,
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
    ROW_WIDTH,
    SEQUENCE,
    SIGMA_HORIZONTAL,
    SIGMA_SPEED,
    SIGMA_VERTICAL,
    SOURCE,
    TIME,
    VEHICLE_TYPE,
    VELOCITY_N,
    Kind,
    Source,
)

Array = np.ndarray
BEGIN_US = 1_750_000_000_000_000
ORIGIN = (radians(47.0), radians(8.0), 400.0)
RADII = (6_372_000.0, 6_389_800.0)  # m, at 47 degrees and 400 m; good to 1e-4
FIELD_N = np.array([2.13e-5, 1.2e-6, 4.34e-5])  # T, near what the World Magnetic Model says there
G = 9.8068
DELAYS = ("vehicle.gnss_delay_s=0.2", "vehicle.magnetometer_delay_s=0.02", "vehicle.barometer_delay_s=0.03")
CONFIG = with_settings(Config(), DELAYS)


@dataclass
class Motion:
    """Truth at times t (n,): position (n, 3) and velocity in n, and attitude matrices (n, 3, 3)."""

    t: Array
    p: Array
    v: Array
    C_nb: Array


def yaw_matrix(yaw: Array) -> Array:
    c, s, o, i = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
    return np.stack([np.stack([c, -s, o], -1), np.stack([s, c, o], -1), np.stack([o, o, i], -1)], -2)


def motion(t: Array, yaw0: float = 0.4, still: float = 10.0) -> Motion:
    """Stands until `still`, then speeds up smoothly, climbs, and turns left and right; level all the time."""
    fine = np.arange(0.0, t[-1] + 0.02, 0.001)
    active = np.clip((fine - still) / 4.0, 0.0, 1.0)
    ramp = active**2 * (3.0 - 2.0 * active)
    speed = 8.0 * ramp * (1.0 + 0.3 * np.sin(0.7 * (fine - still)))
    yaw = yaw0 + 1.2 * ramp * np.sin(0.35 * (fine - still))
    v = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), -1.0 * ramp * np.sin(0.3 * (fine - still))], -1)
    p = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]) * 0.001, axis=0)])

    def at(values: Array) -> Array:
        return np.stack([np.interp(t, fine, values[:, i]) for i in range(3)], -1)

    return Motion(t, at(p), at(v), yaw_matrix(np.interp(t, fine, yaw)))


def rows_of(kind: Kind, source: Source, t: Array, latency: Array | float, delay: float = 0.0) -> Array:
    """Empty rows of a sensor: measured at t, stamped `delay` later, arriving `latency` after the stamp."""
    rows = np.full((t.size, ROW_WIDTH), np.nan)
    rows[:, KIND], rows[:, SOURCE] = kind, source
    rows[:, TIME] = np.round((t + delay) * 1e6) * 1e-6
    rows[:, ARRIVAL] = BEGIN_US + np.round(1e6 * (rows[:, TIME] + latency))
    return rows


def session(
    duration: float = 40.0,
    seed: int = 0,
    yaw0: float = 0.4,
    rate: float = 100.0,
    antenna: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise: float = 1.0,
) -> Array:
    """Rows of all sensors in the order of arrival. The fix is stamped 0.2 s after it was measured, at the antenna (m from the IMU in b)."""
    random = np.random.default_rng(seed)
    t = 100.0 + np.arange(0.0, duration, 1.0 / rate)
    parts = []

    m = motion(t - 100.0, yaw0)
    imu = rows_of(Kind.IMU, Source.HIGHRES_IMU, t, random.uniform(0.0, 0.01, t.size))
    yaw = np.unwrap(np.arctan2(m.C_nb[:, 1, 0], m.C_nb[:, 0, 0]))
    force_n = np.gradient(m.v, 1.0 / rate, axis=0) - [0.0, 0.0, G]
    imu[:, GYRO : GYRO + 3] = [0.004, -0.003, 0.002] + noise * 5e-4 * random.normal(size=(t.size, 3))
    imu[:, GYRO + 2] += np.gradient(yaw, 1.0 / rate)
    imu[:, ACCEL : ACCEL + 3] = np.einsum("nji,nj->ni", m.C_nb, force_n) + noise * 0.03 * random.normal(
        size=(t.size, 3)
    )
    imu[:, GYRO_RESOLUTION], imu[:, ACCEL_RESOLUTION] = 0.0, 0.0
    parts.append(imu)

    t = 100.013 + np.arange(0.2, duration - 0.3, 0.2)
    m = motion(t - 100.0, yaw0)
    ahead = motion(t - 100.0 + 0.01, yaw0)
    arm = m.C_nb @ antenna
    swing = (ahead.C_nb @ antenna - arm) / 0.01
    gnss = rows_of(Kind.GNSS, Source.GPS_RAW_INT, t, random.uniform(0.0, 0.3, t.size), 0.2)
    p = m.p + arm + noise * random.normal(size=m.p.shape) * [0.8, 0.8, 1.2]
    gnss[:, FIX] = 3
    gnss[:, LATITUDE] = ORIGIN[0] + p[:, 0] / RADII[0]
    gnss[:, LONGITUDE] = ORIGIN[1] + p[:, 1] / RADII[1] / np.cos(ORIGIN[0])
    gnss[:, HEIGHT_AMSL] = ORIGIN[2] - p[:, 2]
    gnss[:, VELOCITY_N : VELOCITY_N + 3] = m.v + swing + noise * 0.15 * random.normal(size=m.v.shape)
    gnss[:, SIGMA_HORIZONTAL], gnss[:, SIGMA_VERTICAL], gnss[:, SIGMA_SPEED] = 0.8, 1.2, 0.15
    parts.append(gnss)

    t = 100.004 + np.arange(0.1, duration - 0.1, 0.1)
    m = motion(t - 100.0, yaw0)
    magnetometer = rows_of(Kind.MAGNETOMETER, Source.HIGHRES_IMU, t, random.uniform(0.0, 0.02, t.size), 0.02)
    field = np.einsum("nji,j->ni", m.C_nb, FIELD_N) + noise * 2e-7 * random.normal(size=(t.size, 3))
    magnetometer[:, FIELD : FIELD + 3] = field
    parts.append(magnetometer)
    barometer = rows_of(Kind.BAROMETER, Source.SCALED_PRESSURE, t, random.uniform(0.0, 0.02, t.size), 0.03)
    height = ORIGIN[2] + 25.0 - m.p[:, 2] + noise * 0.2 * random.normal(size=t.size)
    barometer[:, PRESSURE] = 101325.0 * (1.0 - height / 44330.769) ** (1.0 / 0.190263)
    parts.append(barometer)

    t = 100.5 + np.arange(0.0, duration - 1.0, 1.0)
    beats = rows_of(Kind.HEARTBEAT, Source.HEARTBEAT, t, 0.0)
    beats[:, VEHICLE_TYPE], beats[:, AUTOPILOT] = 2, 12
    beats[:, BASE_MODE] = np.where(t > 108.0, 128 + 1, 1)
    parts.append(beats)

    rows = np.concatenate(parts)
    rows = rows[np.argsort(rows[:, ARRIVAL], kind="stable")]
    rows[:, SEQUENCE] = np.arange(rows.shape[0]) % 256
    return rows


def run(
    rows: Array, chunks: list[int] | None = None, config: Config = CONFIG, **options
) -> tuple[SessionEstimator, Output]:
    """A live run of rows in the order given, cut after each of these counts of rows."""
    estimator = SessionEstimator(config, **options)
    outputs = [output for part in np.split(rows, chunks or []) for output in estimator.push(part)]
    outputs += estimator.finish()
    return estimator, joined(outputs)


def position_error(poses: Array) -> Array:
    """Horizontal distance (m) of pose rows (n, POSE_WIDTH) from the truth at their times."""
    truth = motion(poses[:, L.R_TIME] - 100.0).p
    north = (poses[:, L.R_LATITUDE] - ORIGIN[0]) * RADII[0] - truth[:, 0]
    east = (poses[:, L.R_LONGITUDE] - ORIGIN[1]) * RADII[1] * np.cos(ORIGIN[0]) - truth[:, 1]
    return np.asarray(np.hypot(north, east))


def differences(a: Array, b: Array) -> list[int]:
    """Where two states (STATE_SIZE,) differ in any bit; the running numbers and arrival stamps of waiting events left out."""
    which = np.flatnonzero(a.view(np.uint64) != b.view(np.uint64))
    return [int(i) for i in which if i < L.PENDING or (i - L.PENDING) % L.EVENT_WIDTH not in (L.EVENT_ID, ARRIVAL)]


def second_receiver(duration: float = 40.0, seed: int = 50, source: Source = Source.GPS2_RAW, **options) -> Array:
    """Rows of another receiver, with errors of its own, measured 0.07 s after the first one's."""
    rows = session(duration, seed, **options)
    rows = rows[rows[:, KIND] == Kind.GNSS]
    moved = motion(rows[:, TIME] + 0.07 - 0.2 - 100.0, options.get("yaw0", 0.4))
    there = motion(rows[:, TIME] - 0.2 - 100.0, options.get("yaw0", 0.4))
    step = moved.p - there.p
    rows[:, LATITUDE] += step[:, 0] / RADII[0]
    rows[:, LONGITUDE] += step[:, 1] / RADII[1] / np.cos(ORIGIN[0])
    rows[:, HEIGHT_AMSL] -= step[:, 2]
    rows[:, VELOCITY_N : VELOCITY_N + 3] += moved.v - there.v
    rows[:, TIME] += 0.07
    rows[:, ARRIVAL] += 0.07e6
    rows[:, SOURCE] = source
    return rows


def copied(rows: Array, kind: Kind, source: Source, every: int = 1, later: float = 0.001) -> Array:
    """Every so-manieth row of a kind, once more from another source."""
    copy = rows[rows[:, KIND] == kind][::every].copy()
    copy[:, SOURCE] = source
    copy[:, TIME] += later
    copy[:, ARRIVAL] += later * 1e6
    return copy


def merged(*parts: Array) -> Array:
    """Rows of several senders in the order of arrival."""
    rows = np.concatenate(parts)
    return rows[np.argsort(rows[:, ARRIVAL], kind="stable")]


def without(rows: Array, source: Source, start: float, end: float = np.inf, kind: Kind | None = None) -> Array:
    """Rows without those of a source (and kind) between two boot times."""
    gone = (rows[:, SOURCE] == source) & (rows[:, TIME] > start) & (rows[:, TIME] < end)
    if kind is not None:
        gone &= rows[:, KIND] == kind
    return rows[~gone]
