"""The events of a session from its sample rows: which rows the fold gets, in the body's frame, with the time of measurement."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mavkf.models.rotation import quaternion_from_euler, rotation_matrix
from mavkf.navigation import layout as L
from mavkf.navigation.earth_field import earth_field
from mavkf.navigation.setup import Setup
from mavkf.navigation.timeline import choose_events, order, place_events
from mavkf.samples import (
    ACCEL,
    ARRIVAL,
    CLOCK,
    FIELD,
    FIX,
    GNSS_SOURCES,
    GYRO,
    IMU_SOURCES,
    KIND,
    LATITUDE,
    LONGITUDE,
    ROW_WIDTH,
    SEQUENCE,
    SOURCE,
    TIME,
    Clock,
    Kind,
    Source,
)

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
KINDS, SOURCES = max(Kind) + 1, max(Source) + 1
BLOCK = 16_384  # events that are made at once
SLACK = 1e-3  # s: boot times are whole microseconds, but for rounding


def wanted(setup: Setup) -> NDArray[np.bool_]:
    """Which kinds and sources (KINDS, SOURCES) the fold gets: what is used or may have to be, all receivers, and heartbeats."""
    found = np.zeros((KINDS, SOURCES), dtype=bool)
    found[Kind.HEARTBEAT] = True
    for kind, sources in (
        (Kind.GNSS, GNSS_SOURCES),
        (Kind.IMU, setup.imus),
        (Kind.MAGNETOMETER, setup.magnetometers),
        (Kind.BAROMETER, setup.barometers),
    ):
        found[kind, list(sources)] = True
    return found


def select(rows: Array, setup: Setup) -> NDArray[np.bool_]:
    """Which rows (n, ROW_WIDTH) the fold gets."""
    use: NDArray[np.bool_] = wanted(setup)[rows[:, KIND].astype(np.int64), rows[:, SOURCE].astype(np.int64)]
    return use & np.isfinite(rows[:, TIME])


def turn_sensors(rows: Array, rotation: tuple[float, float, float]) -> None:
    """Turn what the IMU messages hold (n, ROW_WIDTH) from the sensor frame into the body, in place: v_b = C_bs v_s.

    rotation: roll, pitch, yaw (rad) of the sensor frame in the body, ZYX. Right angles are exact, so that whole counts stay whole.
    """
    if not any(rotation):
        return
    q, C = np.empty(4), np.empty((3, 3))
    quaternion_from_euler(*rotation, q)
    rotation_matrix(q, C)
    C = np.round(C, 15)
    for kind, columns in ((Kind.IMU, (GYRO, ACCEL)), (Kind.MAGNETOMETER, (FIELD,))):
        mine = (rows[:, KIND] == kind) & np.isin(rows[:, SOURCE], IMU_SOURCES)
        for k in columns:
            x, y, z = (rows[mine, k + i] for i in range(3))
            for i in range(3):
                # summed one by one: a matrix product's last bit depends on how many rows there are
                rows[mine, k + i] = C[i, 0] * x + C[i, 1] * y + C[i, 2] * z


class Arrivals:
    """Makes the events of rows as they come, a few at a time."""

    def __init__(self, setup: Setup) -> None:
        """Nothing has come yet."""
        self._wanted, self._delays, self._rotation = wanted(setup), delays(setup), setup.imu_rotation
        self._number = 0

    def events(self, rows: Array) -> Array:
        """Events (m, EVENT_WIDTH) of the rows (n, ROW_WIDTH) that the fold gets, in their order; numbers run on from call to call."""
        events = np.empty((len(rows), L.EVENT_WIDTH))
        count, fixes = choose_events(rows, self._wanted, self._delays, self._number, events)
        self._number += count
        _complete(events[:count], self._rotation, fixes > 0)
        return events[:count]


def _events_at(rows: Array, index: Whole, numbers: Whole, setup: Setup) -> Array:
    """The events (m, EVENT_WIDTH) of the rows at an index (m,), with these numbers (m,)."""
    events = np.empty((len(index), L.EVENT_WIDTH))
    place_events(rows, index, numbers, delays(setup), events)
    _complete(events, setup.imu_rotation, True)
    return events


def _complete(events: Array, rotation: tuple[float, float, float], has_fix: bool) -> None:
    """Turn what the IMU messages hold into the body, and put the earth's field beside each fix."""
    turn_sensors(events, rotation)
    if not has_fix:
        return
    for i in np.flatnonzero((events[:, KIND] == Kind.GNSS) & (events[:, FIX] >= 3)):
        events[i, L.FIELD_N : L.FIELD_N + 3] = earth_field(
            events[i, LATITUDE], events[i, LONGITUDE], events[i, ARRIVAL]
        )


def delays(setup: Setup) -> Array:
    """By how much (s) the stamps of each kind (n,) are later than the measurement."""
    found = np.zeros(KINDS)
    found[Kind.IMU], found[Kind.GNSS] = setup.imu_delay, setup.gnss_delay
    found[Kind.MAGNETOMETER], found[Kind.BAROMETER] = setup.magnetometer_delay, setup.barometer_delay
    return found


class EventOrder:
    """Puts events into the order of measurement, block by block: what might still be overtaken waits.

    No row may be older than the newest boot stamp before it by more than the window, as the boot clock has it (`mavkf.link.clocks`); a time
    that is mapped from UNIX time may be ahead of that.
    """

    def __init__(self, setup: Setup, window_s: float) -> None:
        """window_s: how late a row may be, s."""
        self._setup = setup
        self._wait = window_s + float(delays(setup).max()) + SLACK
        self._rows = np.empty((0, ROW_WIDTH))
        self._numbers = np.empty(0, dtype=np.int64)
        self._next = 0
        self._newest = -np.inf

    def push(self, rows: Array, *, last: bool = False) -> Iterator[Array]:
        """Take rows (n, ROW_WIDTH) in the order of arrival; give the events (m, EVENT_WIDTH) that nothing can come before any more.

        last: nothing follows, so that all are given. They come in blocks, by `timeline.precedes`; equal ones keep their order.
        """
        chosen = rows[select(rows, self._setup)]
        numbers = self._next + np.arange(len(chosen))
        self._next += len(chosen)
        stamped = rows[rows[:, CLOCK] != Clock.UNIX_US, TIME]
        if len(stamped):
            self._newest = max(self._newest, float(np.fmax.reduce(stamped)))
        waiting, numbers = np.concatenate([self._rows, chosen]), np.concatenate([self._numbers, numbers])
        kind = waiting[:, KIND]
        time = waiting[:, TIME] - delays(self._setup)[kind.astype(np.int64)]
        index = order(time, kind, waiting[:, SOURCE], waiting[:, SEQUENCE])
        ready = len(index) if last else int(np.searchsorted(time[index], self._newest - self._wait))
        kept = np.sort(index[ready:])
        self._rows, self._numbers = waiting[kept], numbers[kept]
        for first in range(0, ready, BLOCK):
            some = index[first : min(first + BLOCK, ready)]
            yield _events_at(waiting, some, numbers[some], self._setup)
