"""The events of a session from its sample rows: which rows the fold gets, in the body's frame, with the time of measurement."""

import numpy as np
from numpy.typing import NDArray

from mavkf.models.rotation import quaternion_from_euler, rotation_matrix
from mavkf.navigation import layout as L
from mavkf.navigation.earth_field import earth_field
from mavkf.navigation.setup import Setup
from mavkf.navigation.timeline import order
from mavkf.samples import (
    ACCEL,
    ARRIVAL,
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
    Kind,
)

Array = NDArray[np.float64]


def select(rows: Array, setup: Setup) -> NDArray[np.bool_]:
    """Which rows (n, ROW_WIDTH) the fold gets: what is used or may have to be, all receivers, and heartbeats."""
    kind, source = rows[:, KIND], rows[:, SOURCE]
    use = kind == Kind.HEARTBEAT
    for wanted, sources in (
        (Kind.GNSS, GNSS_SOURCES),
        (Kind.IMU, setup.imus),
        (Kind.MAGNETOMETER, setup.magnetometers),
        (Kind.BAROMETER, setup.barometers),
    ):
        use |= (kind == wanted) & np.isin(source, sources)
    chosen_rows: NDArray[np.bool_] = use & np.isfinite(rows[:, TIME])
    return chosen_rows


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


def to_events(rows: Array, setup: Setup, first_id: int) -> Array:
    """Events (n, EVENT_WIDTH) of selected rows: measured time in TIME, the earth's field beside each fix, running numbers."""
    events = np.full((rows.shape[0], L.EVENT_WIDTH), np.nan)
    events[:, :ROW_WIDTH] = rows
    turn_sensors(events, setup.imu_rotation)
    subtract_delays(events[:, KIND], events[:, TIME], setup)
    events[:, L.EVENT_ID] = np.arange(first_id, first_id + rows.shape[0])
    for i in np.flatnonzero((events[:, KIND] == Kind.GNSS) & (events[:, FIX] >= 3)):
        events[i, L.FIELD_N : L.FIELD_N + 3] = earth_field(
            events[i, LATITUDE], events[i, LONGITUDE], events[i, ARRIVAL]
        )
    return events


def subtract_delays(kind: Array, time: Array, setup: Setup) -> None:
    """Turn stamps (n), s, of rows of these kinds into times of measurement, in place."""
    for each, delay in (
        (Kind.IMU, setup.imu_delay),
        (Kind.GNSS, setup.gnss_delay),
        (Kind.MAGNETOMETER, setup.magnetometer_delay),
        (Kind.BAROMETER, setup.barometer_delay),
    ):
        time[kind == each] -= delay


class SortedEvents:
    """The events of rows (n, ROW_WIDTH; in the order of arrival) in the order of measurement, made as they are needed."""

    def __init__(self, rows: Array, setup: Setup) -> None:
        """rows are kept, not copied."""
        self._rows, self._setup = rows, setup
        chosen = np.flatnonzero(select(rows, setup))
        kind, time = rows[chosen, KIND], rows[chosen, TIME]
        subtract_delays(kind, time, setup)
        self._number = order(time, kind, rows[chosen, SOURCE], rows[chosen, SEQUENCE])
        self._index = chosen[self._number]

    def __len__(self) -> int:
        return len(self._index)

    def block(self, first: int, last: int) -> Array:
        """Events first..last (m, EVENT_WIDTH), by `timeline.precedes`; equal ones keep their order."""
        events = to_events(self._rows[self._index[first:last]], self._setup, 0)
        events[:, L.EVENT_ID] = self._number[first:last]
        return events
