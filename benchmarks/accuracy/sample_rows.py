"""Sample rows (`mavkf.samples`) of recordings that are not MAVLink: as if an autopilot of no known make had sent them."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.accuracy.common import Array
from mavkf.samples import (
    ACCEL,
    ACCEL_RESOLUTION,
    ARRIVAL,
    AUTOPILOT,
    BASE_MODE,
    CLOCK,
    FIX,
    GYRO,
    GYRO_RESOLUTION,
    HEIGHT_AMSL,
    KIND,
    LATITUDE,
    LONGITUDE,
    ROW_WIDTH,
    SEQUENCE,
    SIGMA_HORIZONTAL,
    SIGMA_SPEED,
    SIGMA_VERTICAL,
    SOURCE,
    STAMP,
    VEHICLE_TYPE,
    VELOCITY_N,
    Clock,
    Kind,
    Source,
)

GROUND_ROVER, GENERIC = 10, 0  # MAV_TYPE, MAV_AUTOPILOT
ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED


def _rows(kind: Kind, source: Source, t: Array, latency: float, boot_utc_us: float) -> Array:
    """Rows stamped t (n), s of boot time, that arrive `latency` s later; boot_utc_us: UTC at boot."""
    rows = np.full((t.size, ROW_WIDTH), np.nan)
    rows[:, KIND], rows[:, SOURCE], rows[:, CLOCK] = kind, source, Clock.BOOT_US
    rows[:, STAMP] = np.round(t * 1e6)
    rows[:, ARRIVAL] = np.round(boot_utc_us + (t + latency) * 1e6)
    rows[:, SEQUENCE] = np.arange(t.size) % 256
    return rows


def imu(
    t: Array, omega_b: Array, f_b: Array, resolution: tuple[float, float], latency: float, boot_utc_us: float
) -> Array:
    """IMU rows of angular rate (n, 3), rad/s, and specific force (n, 3), m/s^2, frame b; resolution: one count of each."""
    rows = _rows(Kind.IMU, Source.HIGHRES_IMU, t, latency, boot_utc_us)
    rows[:, GYRO : GYRO + 3], rows[:, ACCEL : ACCEL + 3] = omega_b, f_b
    rows[:, GYRO_RESOLUTION], rows[:, ACCEL_RESOLUTION] = resolution
    return rows


def gnss(
    t: Array,
    place: tuple[Array, Array, Array],
    v_n: Array,
    fix: NDArray[np.int64],
    sigma: tuple[Array | float, Array | float, Array | float],
    latency: float,
    boot_utc_us: float,
) -> Array:
    """GNSS rows of latitude, longitude (rad), height (m), velocity v_n (n, 3; NaN: not given) and MAVLink fix type.

    sigma: one sigma of the position per horizontal axis and vertically, m, and of the velocity per axis, m/s.
    """
    rows = _rows(Kind.GNSS, Source.GPS_RAW_INT, t, latency, boot_utc_us)
    rows[:, LATITUDE], rows[:, LONGITUDE], rows[:, HEIGHT_AMSL] = place
    rows[:, VELOCITY_N : VELOCITY_N + 3] = v_n
    rows[:, FIX] = fix
    rows[:, SIGMA_HORIZONTAL], rows[:, SIGMA_VERTICAL], rows[:, SIGMA_SPEED] = sigma
    return rows


def heartbeats(first: float, last: float, boot_utc_us: float) -> Array:
    """One a second from `first` to `last`, s of boot time: a car, which is armed, for it may drive off at any time."""
    rows = _rows(Kind.HEARTBEAT, Source.HEARTBEAT, np.arange(first, last), 0.0, boot_utc_us)
    rows[:, VEHICLE_TYPE], rows[:, AUTOPILOT], rows[:, BASE_MODE] = GROUND_ROVER, GENERIC, ARMED
    return rows


def in_order_of_arrival(*parts: Array) -> Array:
    """All rows of a vehicle in one array."""
    rows = np.concatenate(parts)
    sorted_rows: Array = rows[np.argsort(rows[:, ARRIVAL], kind="stable")]
    return sorted_rows
