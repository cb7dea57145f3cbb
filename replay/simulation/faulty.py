"""Faults in what the sensors of a simulated vehicle say: laid out as sample rows, so that one code puts them into any flight."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.replay.faults import Fault, apply_faults
from mavkf.samples import (
    ACCEL,
    FIELD,
    FIX,
    GYRO,
    HEIGHT_AMSL,
    KIND,
    LATITUDE,
    LONGITUDE,
    PRESSURE,
    ROW_WIDTH,
    SEQUENCE,
    SOURCE,
    STAMP,
    TIME,
    VELOCITY_N,
    Kind,
    Source,
)

Floats = NDArray[np.float64]


def faulty_imu(
    faults: Sequence[Fault], source: Source, times: Floats, imu: Floats, field: Floats
) -> tuple[Floats, Floats, Floats]:
    """Times (n), omega_b and f_b (n, 6; rad/s, m/s^2) and field (n, 3; T) of an IMU message with faults in them; n may be less then."""
    if not faults:
        return times, imu, field
    rows = _rows(Kind.IMU, source, _stamped(times, 1.0))
    rows[:, GYRO : GYRO + 3], rows[:, ACCEL : ACCEL + 3] = imu[:, :3], imu[:, 3:]
    fields = _rows(Kind.MAGNETOMETER, source, rows[:, TIME])
    fields[:, FIELD : FIELD + 3] = field
    rows, fields = apply_faults(rows, faults), apply_faults(fields, faults)
    return (
        times[_numbers(rows)],
        np.concatenate([rows[:, GYRO : GYRO + 3], rows[:, ACCEL : ACCEL + 3]], axis=1),
        fields[:, FIELD : FIELD + 3],
    )


def faulty_barometer(faults: Sequence[Fault], source: Source, times: Floats, pressure: Floats) -> Floats:
    """Static pressure (n), Pa, of a message sent at times (n) with faults in it."""
    rows = _rows(Kind.BAROMETER, source, _stamped(times, 1.0 if source == Source.HIGHRES_IMU else 1e3))
    rows[:, PRESSURE] = pressure
    return apply_faults(rows, [fault for fault in faults if fault.kind != "imu-gap"])[:, PRESSURE]


def faulty_gnss(
    faults: Sequence[Fault], sent: Floats, stamps: Floats, place: tuple[Floats, ...], v_n: Floats
) -> tuple[Floats, Floats, tuple[Floats, Floats, Floats], Floats]:
    """Times of sending, stamps (NaN: no fix), place (rad, rad, m), v_n of GPS_RAW_INT (n; v_n (n, 3)) with faults in them.

    What is repeated has the fault that it had first; n may be less then.
    """
    rows = _rows(Kind.GNSS, Source.GPS_RAW_INT, _stamped(stamps, 1e3))
    rows[:, FIX] = np.where(np.isfinite(stamps), 3.0, 1.0)
    rows[:, LATITUDE], rows[:, LONGITUDE], rows[:, HEIGHT_AMSL] = place
    rows[:, VELOCITY_N : VELOCITY_N + 3] = v_n
    rows[:, STAMP] = stamps
    rows = apply_faults(rows, faults)
    fixed = rows[:, FIX] > 1.0
    return (
        sent[_numbers(rows)],
        np.where(fixed, rows[:, STAMP], math.nan),
        (rows[:, LATITUDE], rows[:, LONGITUDE], rows[:, HEIGHT_AMSL]),
        np.where(fixed[:, None], rows[:, VELOCITY_N : VELOCITY_N + 3], 0.0),
    )


def _rows(kind: Kind, source: Source, times: Floats) -> Floats:
    """Sample rows (n, ROW_WIDTH) without values, numbered."""
    rows = np.full((times.size, ROW_WIDTH), math.nan)
    rows[:, KIND], rows[:, SOURCE], rows[:, TIME], rows[:, SEQUENCE] = kind, source, times, np.arange(times.size)
    return rows


def _stamped(times: Floats, count_us: float) -> Floats:
    """Times (n), s, as a stamp that counts in so many microseconds tells them, and as `mavkf.link` reads it."""
    stamped: Floats = np.floor(times * (1e6 / count_us)) * count_us * 1e-6
    return stamped


def _numbers(rows: Floats) -> NDArray[Any]:
    return rows[:, SEQUENCE].astype(np.int64)
