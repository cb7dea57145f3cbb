"""What a departure of a sensor's innovations means on a drone, and what to look at: words by sensor and by kind of departure."""

import math

from mavkf.navigation.codes import Sensor

NED, BODY = ("north", "east", "down"), ("x", "y", "z")
AXES: dict[Sensor, tuple[str, ...]] = {
    Sensor.GNSS_POSITION: NED,
    Sensor.GNSS_VELOCITY: NED,
    Sensor.MAGNETOMETER: BODY,
    Sensor.BAROMETER: ("",),
    Sensor.GRAVITY: NED,
    Sensor.REST_VELOCITY: NED,
    Sensor.REST_RATE: BODY,
    Sensor.GYRO: BODY,
    Sensor.ACCELEROMETER: BODY,
    Sensor.GNSS_YAW: ("",),
    Sensor.WHEELS: ("y", "z"),
    Sensor.DRAG: BODY,
    Sensor.SIDESLIP: ("",),
    Sensor.AIRSPEED: ("",),
}
"""Names of the components of each sensor's innovation."""

_DEGREES = math.degrees(1.0)
UNITS: dict[Sensor, tuple[str, float]] = {
    Sensor.GNSS_POSITION: ("m", 1.0),
    Sensor.GNSS_VELOCITY: ("m/s", 1.0),
    Sensor.MAGNETOMETER: ("microtesla", 1e6),
    Sensor.BAROMETER: ("m", 1.0),
    Sensor.GRAVITY: ("m/s^2", 1.0),
    Sensor.REST_VELOCITY: ("m/s", 1.0),
    Sensor.REST_RATE: ("deg/s", _DEGREES),
    Sensor.GYRO: ("deg/s", _DEGREES),
    Sensor.ACCELEROMETER: ("m/s^2", 1.0),
    Sensor.GNSS_YAW: ("deg", _DEGREES),
    Sensor.WHEELS: ("m/s", 1.0),
    Sensor.DRAG: ("m/s^2", 1.0),
    Sensor.SIDESLIP: ("m/s", 1.0),
    Sensor.AIRSPEED: ("m/s", 1.0),
}
"""Unit in which people are told of an innovation, and how many of it are one of the unit inside."""

LASTING = {
    Sensor.GRAVITY,
    Sensor.REST_VELOCITY,
    Sensor.REST_RATE,
    Sensor.GYRO,
    Sensor.ACCELEROMETER,
    Sensor.WHEELS,
    Sensor.DRAG,
    Sensor.SIDESLIP,
    Sensor.AIRSPEED,
}
"""What the filter takes for an error, or a motion, that lasts: successive innovations of it may agree."""

SLOW_IMU_HZ = 20.0  # Hz: above it the motion between two fixes is measured, not guessed

_SCATTER = {
    Sensor.GNSS_POSITION: "the receiver claims to be better than it is (multipath, jamming), or its delay is wrong",
    Sensor.GNSS_VELOCITY: "the receiver claims to be better than it is, its delay is wrong, or the antenna is far from the IMU",
    Sensor.MAGNETOMETER: "currents or iron near the compass, or noise.magnetometer_t is too small",
    Sensor.BAROMETER: "wind or rotor wash at its port, or noise.barometer_m is too small",
    Sensor.GNSS_YAW: "the heading of the two antennas is worse than noise.gnss_yaw_deg says",
    Sensor.REST_VELOCITY: "the vehicle is not as still as it seems",
    Sensor.REST_RATE: "the vehicle is not as still as it seems",
}
_LAST = {
    Sensor.GNSS_POSITION: "errors of the receiver that linger (multipath, few satellites; noise.gnss_colour), or a wrong "
    "vehicle.gnss_delay_s",
    Sensor.GNSS_VELOCITY: "a wrong vehicle.gnss_delay_s, a velocity that the receiver smooths, or an IMU that is off",
    Sensor.MAGNETOMETER: "a field of the vehicle that changes with motors or attitude (calibrate the compass, move it away from "
    "currents), or noise.magnetometer_t is too small",
    Sensor.BAROMETER: "wind or rotor wash at its port that changes with speed, or a wrong vehicle.barometer_delay_s",
    Sensor.GNSS_YAW: "the two antennas are not mounted along the body, or multipath",
}


def advice(sensor: Sensor, kind: str, imu_rate_hz: float) -> str:
    """What to look at. sensor: its innovations; kind: name of a finding of `diagnostics.consequence`; imu_rate_hz: of the IMU in use."""
    if kind == "refused":
        return "it contradicts the other sensors, or is given too little noise; the events say when"
    slow = f"the IMU at {imu_rate_hz:.2g} Hz does not show the motion between them: send it faster"
    if kind in ("lasting", "mean"):
        if sensor in (Sensor.GNSS_POSITION, Sensor.GNSS_VELOCITY) and 0.0 < imu_rate_hz < SLOW_IMU_HZ:
            return slow
        return _LAST.get(sensor, "the motion differs from what the model assumes")
    return _SCATTER.get(sensor, "the motion differs from what the model assumes")
