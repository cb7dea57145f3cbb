"""Sensors of a simulated vehicle: what they measure of a true motion, with errors drawn from a seed."""

import math
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from mavkf.replay.simulation.trajectory import Motion

Floats = NDArray[np.float64]

IMU_RATE = 1000  # Hz: at which the IMU is sampled, ahead of its filter
IMU_CUTOFF = 20.0  # Hz: of its low-pass filter, as ArduPilot sets it for copters and planes
TAPS = 256  # the filter's response has fallen to 1e-9 by then
NOT_DEVIATIONS = ("gnss_time_constant", "baro_time_constant", "gnss_speed_time_constant", "gnss_claim")


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """Standard deviations of the errors of all sensors, one sigma per axis; the defaults are those of consumer parts.

    Densities are those of Kalibr and most INS texts: white noise sampled every dt seconds has density / sqrt(dt).

    gyro_density, accel_density:    white noise, rad/s/sqrt(Hz), m/s^2/sqrt(Hz) (InvenSense ICM-20602: 7e-5, 1e-3).
    gyro_vibration, accel_vibration: white noise on top while the motors run; same units.
    gyro_bias, accel_bias:          bias at boot, constant but for its walk, rad/s, m/s^2 (after the usual calibration).
    gyro_walk, accel_walk:          random walk of the bias, rad/s/sqrt(s), m/s^2/sqrt(s).
    magnetometer_noise, hard_iron:  white noise and constant offset, tesla.
    baro_noise, baro_drift:         white noise and Gauss-Markov drift, Pa; baro_time_constant its time constant, s.
    gnss_horizontal, gnss_vertical: white position noise, m.
    gnss_drift_horizontal, gnss_drift_vertical: Gauss-Markov position error, m; gnss_time_constant its time constant, s.
    gnss_speed_horizontal, gnss_speed_vertical: velocity error, m/s; gnss_speed_time_constant its time constant, s, 0: it is white.
    gnss_claim:                     what the receiver claims its errors to be, as a multiple of what they are.
    """

    gyro_density: float = 1e-4
    accel_density: float = 1.5e-3
    gyro_vibration: float = 5e-4
    accel_vibration: float = 1e-2
    gyro_bias: float = 1e-3
    accel_bias: float = 0.03
    gyro_walk: float = 1e-5
    accel_walk: float = 1e-4
    magnetometer_noise: float = 3e-7
    hard_iron: float = 4e-7
    baro_noise: float = 2.0
    baro_drift: float = 6.0
    baro_time_constant: float = 200.0
    gnss_horizontal: float = 0.1
    gnss_vertical: float = 0.2
    gnss_drift_horizontal: float = 0.5
    gnss_drift_vertical: float = 0.9
    gnss_time_constant: float = 60.0
    gnss_speed_horizontal: float = 0.05
    gnss_speed_vertical: float = 0.08
    gnss_speed_time_constant: float = 0.0
    gnss_claim: float = 1.0

    def scaled(self, factor: float) -> Self:
        """Give the same with every standard deviation multiplied; 0 makes all sensors perfect but for their delays."""
        names = [f.name for f in fields(self) if f.name not in NOT_DEVIATIONS]
        return replace(self, **{name: factor * getattr(self, name) for name in names})


def gauss_markov(rng: Generator, t: Floats, sigma: float, time_constant: float, axes: int = 1) -> Floats:
    """Draw a stationary first-order Gauss-Markov process at rising times t (n), s: (n, axes), exactly discretised.

    Its autocorrelation is sigma^2 exp(-|dt| / time_constant).
    """
    result = rng.standard_normal((len(t), axes)) * sigma
    kept = np.exp(-np.diff(t) / time_constant)
    fresh = np.sqrt(1.0 - kept**2)
    for i in range(1, len(t)):
        result[i] = kept[i - 1] * result[i - 1] + fresh[i - 1] * result[i]
    return result


def low_pass() -> Floats:
    """Impulse response (TAPS), sampled at IMU_RATE, of the two-pole Butterworth filter: it delays by 11.25 ms."""
    omega = 2.0 * math.pi * IMU_CUTOFF / math.sqrt(2.0)
    t = np.arange(TAPS) / IMU_RATE
    response: Floats = np.exp(-omega * t) * np.sin(omega * t)
    response /= response.sum()
    return response


class Imu:
    """Gyros and accelerometers, sampled at IMU_RATE and filtered; a block of samples goes on where the last one ended."""

    def __init__(self, noise: SensorNoise, rng: Generator) -> None:
        self._rng = rng
        self._white = np.repeat([noise.gyro_density, noise.accel_density], 3) * math.sqrt(IMU_RATE)
        self._vibration = np.repeat([noise.gyro_vibration, noise.accel_vibration], 3) * math.sqrt(IMU_RATE)
        self._walk = np.repeat([noise.gyro_walk, noise.accel_walk], 3) / math.sqrt(IMU_RATE)
        self.bias: Floats = np.repeat([noise.gyro_bias, noise.accel_bias], 3) * rng.standard_normal(6)
        self._response = low_pass()
        self._tail: Floats | None = None

    def measure(self, motion: Motion, running: NDArray[np.bool_]) -> Floats:
        """Measure omega_b, f_b (n, 6), rad/s and m/s^2, at n times 1 / IMU_RATE apart; `running` (n): the motors run."""
        shape = (len(motion.time), 6)
        bias = self.bias + np.cumsum(self._walk * self._rng.standard_normal(shape), axis=0)
        self.bias = bias[-1]
        raw = np.concatenate([motion.omega_b, motion.f_b], axis=1) + bias
        raw += np.hypot(self._white, running[:, None] * self._vibration) * self._rng.standard_normal(shape)
        if self._tail is None:  # it has stood still before
            self._tail = np.repeat(raw[:1], TAPS - 1, axis=0)
        raw = np.concatenate([self._tail, raw])
        self._tail = raw[1 - TAPS :]
        return np.stack([np.convolve(raw[:, i], self._response, "valid") for i in range(6)], axis=1)


def magnetometer(noise: SensorNoise, rng: Generator, motion: Motion, field_n: Floats) -> Floats:
    """Measure the field (n, 3), tesla, frame b; field_n (3) is the earth's, frame n."""
    offset = noise.hard_iron * rng.standard_normal(3)
    white = noise.magnetometer_noise * rng.standard_normal((len(motion.time), 3))
    roll, pitch, yaw = motion.euler.T
    # C_nb' m, one angle after the other
    north = np.cos(yaw) * field_n[0] + np.sin(yaw) * field_n[1]
    east = np.cos(yaw) * field_n[1] - np.sin(yaw) * field_n[0]
    x = np.cos(pitch) * north - np.sin(pitch) * field_n[2]
    below = np.sin(pitch) * north + np.cos(pitch) * field_n[2]
    y = np.cos(roll) * east + np.sin(roll) * below
    z = np.cos(roll) * below - np.sin(roll) * east
    result: Floats = np.stack([x, y, z], axis=1) + offset + white
    return result


def isa_pressure(height: Floats) -> Floats:
    """Compute the static pressure, Pa, of the standard atmosphere at a height above sea level, m (ISO 2533, below 11 km)."""
    geopotential = 6356766.0 * height / (6356766.0 + height)
    result: Floats = 101325.0 * (1.0 - 0.0065 * geopotential / 288.15) ** 5.25588
    return result


def barometer(noise: SensorNoise, rng: Generator, motion: Motion) -> Floats:
    """Measure the static pressure (n), Pa."""
    white = noise.baro_noise * rng.standard_normal(len(motion.time))
    drift = gauss_markov(rng, motion.time, noise.baro_drift, noise.baro_time_constant)[:, 0]
    return isa_pressure(motion.height) + white + drift


def gnss(noise: SensorNoise, rng: Generator, t: Floats) -> tuple[Floats, Floats]:
    """Draw the errors of fixes at times t (n), s: north, east, down position, m (n, 3), and velocity, m/s (n, 3)."""
    drift = gauss_markov(rng, t, 1.0, noise.gnss_time_constant, 3)
    shape = (len(t), 3)
    coloured = np.array([noise.gnss_drift_horizontal] * 2 + [noise.gnss_drift_vertical]) * drift
    white = np.array([noise.gnss_horizontal] * 2 + [noise.gnss_vertical]) * rng.standard_normal(shape)
    if noise.gnss_speed_time_constant > 0.0:
        unit = gauss_markov(rng, t, 1.0, noise.gnss_speed_time_constant, 3)
    else:
        unit = rng.standard_normal(shape)
    speed = np.array([noise.gnss_speed_horizontal] * 2 + [noise.gnss_speed_vertical]) * unit
    return coloured + white, speed
