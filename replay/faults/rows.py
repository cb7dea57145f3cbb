"""Faults in sample rows: the one way in which they are computed, for recorded and for simulated flights."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mavkf.models.barometer import pressure_at, pressure_height
from mavkf.models.earth import radii
from mavkf.replay.faults.kinds import KINDS, Fault, kind_is_scale
from mavkf.samples import (
    ACCEL,
    CLOCK,
    FIELD,
    FIX,
    GYRO,
    HEIGHT_AMSL,
    HEIGHT_ELLIPSOID,
    IMU_SOURCES,
    KIND,
    LATITUDE,
    LONGITUDE,
    PRESSURE,
    ROW_WIDTH,
    SATELLITES,
    SESSION,
    SOURCE,
    STAMP,
    TIME,
    VELOCITY_N,
    Clock,
    Kind,
)

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

UNITS = {"magnetometer": 1e-6, "gyro-step": np.pi / 180.0, "accelerometer-step": 1.0}  # SI of a size
VECTORS = {
    "magnetometer": FIELD,
    "gyro-step": GYRO,
    "gyro-scale": GYRO,
    "accelerometer-step": ACCEL,
    "accelerometer-scale": ACCEL,
}
VALUES = SESSION + 1  # the first column of what a sensor said
NO_FIX, SATELLITES_WITHOUT = 1.0, 2.0


def apply_faults(rows: Array, faults: Iterable[Fault], times: Array | None = None) -> Array:
    """A copy of sample rows (n, ROW_WIDTH) with faults in them, one after the other, in the order in which the rows came.

    times: boot times (n) of the rows, s, NaN where there is none (such a row is left as it is); None: their TIME. STAMP and TIME of
    what stays are not touched, but that a fix that is lost has no stamp, as `mavkf.link` reads it. Messages that do not come are left
    out.
    """
    rows = rows.copy()
    times = rows[:, TIME].copy() if times is None else times
    for fault in faults:
        with np.errstate(invalid="ignore"):  # no time: no fault
            during = (times >= fault.at) & (times < fault.end)
        kept = _put(rows, times, during & _has(rows, fault), fault)
        rows, times = rows[kept], times[kept]
    return rows


def _has(rows: Array, fault: Fault) -> Bools:
    """Which rows are of the sensor, and of the message, that has a fault."""
    sensor = KINDS[fault.kind].sensor
    if fault.kind == "imu-gap":  # its messages carry other sensors' values too
        return np.isin(rows[:, SOURCE], IMU_SOURCES if fault.source is None else (fault.source,))
    mine: Bools = rows[:, KIND] == sensor
    return mine if fault.source is None else mine & (rows[:, SOURCE] == fault.source)


def _put(rows: Array, times: Array, hit: Bools, fault: Fault) -> Bools:
    """Put a fault into the rows that are hit (n), in place; returns which rows stay (n)."""
    stay = np.ones(rows.shape[0], np.bool_)
    if fault.kind == "imu-gap" or (fault.kind == "gnss-outage" and fault.silent):
        return ~hit
    if fault.kind == "gnss-outage":
        _lose(rows, hit)
    elif fault.kind == "gnss-freeze":
        _freeze(rows, hit)
    elif KINDS[fault.kind].sensor == Kind.GNSS:
        fixed = hit & (rows[:, FIX] > NO_FIX)
        _move(rows, fixed, position_offset(fault, times[fixed], rows[fixed, SOURCE]))
        rows[fixed, VELOCITY_N : VELOCITY_N + 3] += velocity_offset(fault, times[fixed])
    elif fault.kind == "barometer":
        rows[hit, PRESSURE] = risen(rows[hit, PRESSURE], height_offset(fault, times[hit]))
    else:
        first = VECTORS[fault.kind]
        if kind_is_scale(fault.kind):
            rows[hit, first : first + 3] *= np.where(fault.direction != 0.0, fault.size, 1.0)
        else:
            rows[hit, first : first + 3] += UNITS[fault.kind] * fault.size * fault.direction
    return stay


def position_offset(fault: Fault, t: Array, sources: Array) -> Array:
    """How far a fault moves the positions (n, 3) of fixes stamped at times t (n), s, while it lasts: m, frame n.

    sources: of their messages (n). The noise depends on message and stamp alone, so a repeated fix has the same.
    """
    since = t - fault.at
    if fault.kind == "gnss-noise":
        keys = np.stack([sources, np.rint(t * 1e6)], axis=1).astype(np.int64)
        unique, inverse = np.unique(keys, axis=0, return_inverse=True)
        drawn = [np.random.default_rng([int(fault.seed), *key]).standard_normal(3) for key in np.abs(unique).tolist()]
        return fault.size * np.array(drawn).reshape(-1, 3)[inverse.reshape(-1)]
    if fault.kind == "gnss-step":
        way = np.full(t.shape, fault.size)
    elif fault.kind == "gnss-drift":
        way = fault.size * since
    elif fault.kind == "gnss-spoof":
        full = abs(fault.size) / fault.acceleration  # s until the velocity has its size
        rising = np.minimum(since, full)
        way = np.sign(fault.size) * fault.acceleration * (0.5 * rising**2 + full * (since - rising))
    else:
        way = np.zeros(t.shape)
    return way[:, None] * fault.direction


def velocity_offset(fault: Fault, t: Array) -> Array:
    """By how much a fault changes the velocities (n, 3) of fixes stamped at times t (n), s, while it lasts: m/s, frame n."""
    speed = np.zeros(t.shape)
    if fault.kind == "gnss-velocity":
        speed += fault.size
    elif fault.kind == "gnss-spoof":
        speed += np.sign(fault.size) * np.minimum(fault.acceleration * (t - fault.at), abs(fault.size))
    return speed[:, None] * (fault.direction if speed.any() else np.zeros(3))


def height_offset(fault: Fault, t: Array) -> Array:
    """How much higher (n), m, the pressure at times t (n), s, makes the vehicle seem while a fault lasts."""
    share = np.minimum((t - fault.at) / fault.rise, 1.0) if fault.rise > 0.0 else np.ones(t.shape)
    return fault.size * share


def risen(pressure: Array, height: Array) -> Array:
    """The static pressures (n), Pa, that the standard atmosphere has some metres (n) above others."""
    above: Array = pressure_at(pressure_height(pressure) + height)
    return above


def _move(rows: Array, fixed: Bools, offset: Array) -> None:
    """Move fixes in place by metres in n (k, 3)."""
    latitude, height = rows[fixed, LATITUDE], rows[fixed, HEIGHT_AMSL]
    meridian, transverse = np.array([radii(each) for each in latitude]).reshape(-1, 2).T
    rows[fixed, LATITUDE] += offset[:, 0] / (meridian + height)
    rows[fixed, LONGITUDE] += offset[:, 1] / ((transverse + height) * np.cos(latitude))
    rows[fixed, HEIGHT_AMSL] -= offset[:, 2]
    rows[fixed, HEIGHT_ELLIPSOID] -= offset[:, 2]


def _lose(rows: Array, hit: Bools) -> None:
    """Let fixes say that there is none, in place, as a receiver does that has not had one yet."""
    rows[hit, VALUES:ROW_WIDTH] = np.nan
    rows[hit, FIX], rows[hit, SATELLITES] = NO_FIX, SATELLITES_WITHOUT
    rows[hit, LATITUDE : HEIGHT_AMSL + 1] = 0.0
    rows[hit, VELOCITY_N : VELOCITY_N + 2] = 0.0
    rows[hit, STAMP], rows[hit, CLOCK] = np.nan, Clock.NONE


def _freeze(rows: Array, hit: Bools) -> None:
    """Let rows repeat, in place, what their message said last before them and not in the fault; if nothing, what it says first in it."""
    for source in np.unique(rows[hit, SOURCE]):
        mine = np.flatnonzero((rows[:, KIND] == Kind.GNSS) & (rows[:, SOURCE] == source))
        right = ~hit[mine]
        right[0] = True
        held = np.maximum.accumulate(np.where(right, np.arange(mine.size), 0))
        rows[mine, VALUES:] = rows[mine[held], VALUES:]
