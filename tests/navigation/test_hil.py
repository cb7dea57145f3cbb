"""A simulator's streams alone: HIL_SENSOR and HIL_GPS, from bytes to a full pose; and GPS_INPUT in the place of HIL_GPS."""

from collections.abc import Iterator
from math import degrees
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavkf.link.clocks import VehicleClock
from mavkf.link.decode import decode
from mavkf.link.framing import scan_records
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.navigation.offline import Offline, run_offline
from mavkf.samples import (
    ACCEL,
    FIELD,
    GYRO,
    HEIGHT_AMSL,
    KIND,
    LATITUDE,
    LONGITUDE,
    PRESSURE,
    TIME,
    VELOCITY_N,
    Kind,
    Source,
)

from ._session import BEGIN_US, CONFIG, Motion, motion, position_error, session

Array = np.ndarray
INERTIAL, MAGNETIC, PRESSURES, RESET = 0x3F, 0x1C0, 0x1E00, 1 << 31


def hil_sensor(values: dict[Kind, Array], updated: int, us: int) -> Any:
    """HIL_SENSOR with what was measured last of each kind; units of the wire: gauss, hectopascal."""
    imu, field, pressure = values[Kind.IMU], values[Kind.MAGNETOMETER], values[Kind.BAROMETER]
    return dialect.MAVLink_hil_sensor_message(
        us,
        *imu[ACCEL : ACCEL + 3],
        *imu[GYRO : GYRO + 3],
        *(1e4 * field[FIELD : FIELD + 3]),
        pressure[PRESSURE] / 100.0,
        0.0,
        0.0,
        20.0,
        updated,
    )


def fix(row: Array, us: int, name: str) -> Any:
    """A fix as HIL_GPS (mm, cm/s) or GPS_INPUT (m, m/s; without accuracies)."""
    place = round(degrees(row[LATITUDE]) * 1e7), round(degrees(row[LONGITUDE]) * 1e7)
    v = row[VELOCITY_N : VELOCITY_N + 3]
    if name == "HIL_GPS":
        cm = [round(100.0 * float(x)) for x in v]
        speed = round(100.0 * float(np.hypot(v[0], v[1])))
        return dialect.MAVLink_hil_gps_message(
            us, 3, *place, round(1e3 * row[HEIGHT_AMSL]), 80, 120, speed, *cm, 65535, 12
        )
    ignored = 2 | 4 | 32 | 64 | 128  # dilutions and accuracies
    return dialect.MAVLink_gps_input_message(
        us, 0, ignored, 0, 0, 3, *place, row[HEIGHT_AMSL], 0, 0, *v, 9.0, 9.0, 9.0, 12
    )


def wire(name: str) -> Iterator[tuple[int, bytes]]:
    """Records (arrival us, frame) of a simulator that flies the session; only what changed is flagged as updated."""
    sender = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    latest: dict[Kind, Array] = {}
    rows = session(seed=4)
    rows = rows[np.argsort(rows[:, TIME], kind="stable")]
    pending = RESET
    flags = {Kind.MAGNETOMETER: MAGNETIC, Kind.BAROMETER: PRESSURES, Kind.IMU: INERTIAL}
    for row in rows:
        kind = Kind(int(row[KIND]))
        us = round(1e6 * row[TIME])
        arrival = BEGIN_US + round(1e6 * row[TIME])
        if kind in flags:
            latest[kind] = row
            pending |= flags[kind]
            if kind is Kind.IMU and len(latest) == len(flags):
                yield arrival, hil_sensor(latest, pending, us).pack(sender)
                pending = 0
        elif kind is Kind.GNSS:
            yield arrival, fix(row, us, name).pack(sender)
        sender.seq = (sender.seq + 1) % 256


def flown(name: str) -> tuple[Array, Offline]:
    """Timed rows of the one sender, and their estimate."""
    log = b"".join(arrival.to_bytes(8, "big") + frame for arrival, frame in wire(name))
    data = np.frombuffer(log, np.uint8)
    frames, _ = scan_records(data)
    clock = VehicleClock()
    rows = decode(data, frames)[1, 1]
    timed = np.concatenate([clock.push(rows), clock.flush()])
    return timed, run_offline(timed, CONFIG)


@pytest.mark.parametrize("name", ["HIL_GPS", "GPS_INPUT"])
def test_a_simulator_alone_gives_a_full_pose(name: str) -> None:
    rows, result = flown(name)
    assert {int(k) for k in rows[:, KIND]} == {Kind.IMU, Kind.MAGNETOMETER, Kind.BAROMETER, Kind.GNSS}
    # the flags count: the field comes ten times a second, the inertial values a hundred times
    assert np.sum(rows[:, KIND] == Kind.MAGNETOMETER) == pytest.approx(
        0.1 * np.sum(rows[:, KIND] == Kind.IMU), rel=0.02
    )
    setup = result.setup
    assert (setup.imu, setup.gnss, setup.magnetometer) == (Source.HIL_SENSOR, Source[name], Source.HIL_SENSOR)
    poses = result.output.poses[result.output.poses[:, L.R_TIME] > 112.0]
    assert np.all(poses[:, L.R_VALID] == 15.0)
    assert position_error(poses).max() < 3.0
    truth: Motion = motion(poses[:, L.R_TIME] - 100.0)
    assert np.abs(poses[:, L.R_V : L.R_V + 3] - truth.v).max() < 0.6
    yaw = np.arctan2(truth.C_nb[:, 1, 0], truth.C_nb[:, 0, 0])
    assert np.degrees(np.abs(np.angle(np.exp(1j * (poses[:, L.R_EULER + 2] - yaw))))).max() < 4.0
    assert np.degrees(np.abs(poses[:, L.R_EULER : L.R_EULER + 2])).max() < 1.5
    velocities = result.output.innovations[result.output.innovations[:, L.I_SENSOR] == Sensor.GNSS_VELOCITY]
    assert np.all(velocities[:, L.I_SIZE] == 3)  # with the vertical one
