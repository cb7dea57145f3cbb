"""Whether the values of an event can be measurements at all: what no sensor can show is counted and left out."""

import math

from mavkf.compiled import kernel
from mavkf.samples import (
    ACCEL_RESOLUTION,
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
    VELOCITY_N,
    Kind,
)

POLE = math.radians(86.0)  # beyond it north is no direction to navigate by
# What no sensor of a drone shows: rad/s, m/s^2, m, m/s, m (or m/s), T, Pa.
MOST_RATE, MOST_FORCE, MOST_HEIGHT, MOST_SPEED, MOST_SIGMA, MOST_FIELD = 100.0, 1000.0, 1e5, 1000.0, 1e5, 1e-2
LEAST_PRESSURE, MOST_PRESSURE = 1e3, 2e5
IMU_KIND, GNSS_KIND, MAGNETOMETER_KIND, BAROMETER_KIND, HEARTBEAT_KIND = (
    int(Kind.IMU),
    int(Kind.GNSS),
    int(Kind.MAGNETOMETER),
    int(Kind.BAROMETER),
    int(Kind.HEARTBEAT),
)


@kernel
def plausible(e):
    """Whether the values of an event can be measurements at all: finite, and within what sensors can show. NaN stands for not known."""
    kind = int(e[KIND])
    if kind == IMU_KIND:
        for i in range(6):
            # a NaN fails every comparison
            if not abs(e[GYRO + i]) < (MOST_RATE if i < 3 else MOST_FORCE):
                return False
        return 0.0 <= e[GYRO_RESOLUTION] < 1.0 and 0.0 <= e[ACCEL_RESOLUTION] < 10.0
    if kind == GNSS_KIND:
        if e[FIX] >= 3.0:
            if not (abs(e[LATITUDE]) <= POLE and abs(e[LONGITUDE]) <= 2.0 * math.pi):
                return False
            if not abs(e[HEIGHT_AMSL]) < MOST_HEIGHT:
                return False
        for i in range(3):
            if abs(e[VELOCITY_N + i]) > MOST_SPEED or e[SIGMA_HORIZONTAL + i] > MOST_SIGMA:
                return False
    elif kind == MAGNETOMETER_KIND:
        for i in range(3):
            if not abs(e[FIELD + i]) < MOST_FIELD:
                return False
    elif kind == BAROMETER_KIND:
        return LEAST_PRESSURE < e[PRESSURE] < MOST_PRESSURE
    return True
