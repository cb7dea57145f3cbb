"""A simulated flight: the true motion, the sensors and the messages joined into a telemetry log."""

import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from mavkf.models.earth import SEMI_MAJOR_AXIS
from mavkf.replay.faults import Fault
from mavkf.replay.simulation import manoeuvres, messages, sensors
from mavkf.replay.simulation.checks import check, create
from mavkf.replay.simulation.faulty import faulty_barometer, faulty_gnss, faulty_imu
from mavkf.replay.simulation.messages import Stream
from mavkf.replay.simulation.sensors import IMU_RATE, SensorNoise
from mavkf.replay.simulation.trajectory import Motion, Trajectory
from mavkf.replay.truth import Truth
from mavkf.samples import Source

Floats = NDArray[np.float64]
Vehicle = Literal["copter", "plane"]

BOOT_UTC = datetime(2026, 6, 15, 9, 30, tzinfo=UTC)
DEFAULT_START = (47.397742, 8.545594, 488.0, 30.0)

TRUTH_RATE = 100.0  # Hz
LINK_UP = 1.0  # s since boot: the first message
FIRST_FIX = 6.0  # s since boot
POSITION_KNOWN = 9.0  # s since boot: from when the autopilot's own estimate holds a position
IMU_AGE = 1.0e-3, 1.5e-3  # s: of the newest filtered sample when it is sent
JITTER, IMU_JITTER = 1.5e-3, 3e-4  # s: messages wait for their turn in the main loop
FIELD_AGE, PRESSURE_AGE = (
    0.05,
    0.02,
)  # s: of a new value, which is a mean over the time since the one before, as ArduPilot's
ESTIMATE_AGE = 0.02  # s: lag of the autopilot's own estimate
ESTIMATE_TILT, ESTIMATE_YAW, ESTIMATE_SPEED, ESTIMATE_TIME = math.radians(0.15), math.radians(0.6), 0.05, 20.0
IMU_BLOCK = 20_000  # samples
AIR_DENSITY = 1.225  # kg/m^3


def simulate(
    path: str | Path,
    *,
    seed: int = 1,
    duration_s: float = 120.0,
    vehicle: Vehicle = "copter",
    imu_hz: float = 200.0,
    highres_imu: bool = False,
    gnss_hz: float = 5.0,
    gnss_message_hz: float = 5.0,
    gnss_delay: float = 0.085,
    noise: SensorNoise | None = None,
    start: tuple[float, float, float, float] = DEFAULT_START,
    address: tuple[int, int] = (1, 1),
    faults: Sequence[Fault] = (),
    progress: Callable[[float], object] = lambda _: None,
) -> Truth:
    """Fly a flight drawn from `seed`, write its telemetry to a tlog, and give its truth; an existing file is replaced.

    duration_s:      from boot to the last message, s, at least 60.
    imu_hz:          of RAW_IMU; of HIGHRES_IMU half of it, if `highres_imu`.
    gnss_hz:         of fixes; gnss_message_hz of GPS_RAW_INT, which repeats the newest fix.
    gnss_delay:      s from the measurement to the stamp of a fix.
    noise:           default: `SensorNoise()`.
    start:           latitude deg, longitude deg, height m above sea level, heading deg.
    address:         MAVLink system and component.
    faults:          of the sensors; the autopilot's own estimate does not follow them.
    progress:        called with the fraction done, now and then.

    The same arguments give the same file, byte for byte. Raises UsageError for a value that cannot be flown, naming
    the option of the command line, and for a file that cannot be written.
    """
    check(
        seed=seed,
        duration_s=duration_s,
        vehicle=vehicle,
        imu_hz=imu_hz,
        gnss_hz=gnss_hz,
        gnss_message_hz=gnss_message_hz,
        gnss_delay=gnss_delay,
        start=start,
        address=address,
    )
    with create(Path(path)) as file:  # first: what cannot be written need not be flown
        route_rng, imu_rng, sensor_rng, clock_rng, estimate_rng = np.random.default_rng(seed).spawn(5)
        winged = vehicle == "plane"
        plan = (manoeuvres.plane if winged else manoeuvres.copter)(route_rng, duration_s)
        latitude, longitude, height, heading = start
        trajectory = Trajectory(
            plan.route, math.radians(latitude), math.radians(longitude), height, math.radians(heading), winged=winged
        )
        flight = _Flight(
            trajectory, noise or SensorNoise(), duration_s, (plan.take_off - 2.0, plan.landed + 1.5), winged, faults
        )
        streams = [
            *flight.inertial(imu_rng, sensor_rng, imu_hz, highres_imu, lambda done: progress(0.3 * done)),
            flight.gnss(sensor_rng, gnss_hz, gnss_message_hz, gnss_delay),
            *flight.housekeeping(clock_rng),
            *flight.estimate(estimate_rng),
        ]
        boot_utc_us = int(BOOT_UTC.timestamp() * 1e6)
        messages.write_tlog(
            file,
            streams,
            clock_rng,
            boot_utc_us=boot_utc_us,
            address=address,
            progress=lambda done: progress(0.3 + 0.7 * done),
        )
    progress(1.0)
    return flight.truth()


class _Flight:
    """One flight being measured. Times of messages are s since boot; `armed` is from when to when the motors run."""

    def __init__(
        self,
        trajectory: Trajectory,
        noise: SensorNoise,
        duration: float,
        armed: tuple[float, float],
        winged: bool,
        faults: Sequence[Fault],
    ) -> None:
        self._trajectory, self._noise, self._duration, self._winged = trajectory, noise, duration, winged
        self._arm, self._disarm = armed
        self._faults = faults
        self._start = trajectory.at(np.zeros(1))

    def inertial(
        self, imu_rng: Generator, rng: Generator, imu_hz: float, highres: bool, progress: Callable[[float], object]
    ) -> list[Stream]:
        """RAW_IMU, HIGHRES_IMU and SCALED_PRESSURE: what the board itself measures."""
        taken = np.floor(self._schedule(rng, imu_hz, IMU_JITTER) * IMU_RATE).astype(np.int64)
        times = taken / IMU_RATE + imu_rng.uniform(*IMU_AGE, len(taken))
        imu = self._imu(imu_rng, taken, progress)
        sampled = self._samples(rng, 10.0)
        field = sensors.magnetometer(self._noise, rng, self._trajectory.at(sampled - FIELD_AGE), self._field())
        field = field[_newest(sampled, times)]
        sound = times, imu, field
        times, imu, field = faulty_imu(self._faults, Source.RAW_IMU, *sound)
        streams = [messages.raw_imu(times, imu, field, _temperature(times))]

        sampled = self._samples(rng, 20.0)
        motion = self._trajectory.at(sampled - PRESSURE_AGE)
        pressure = sensors.barometer(self._noise, rng, motion)
        flow = np.sum(motion.v_n**2, axis=1) * (0.5 * AIR_DENSITY * self._winged)
        sent = self._schedule(rng, 20.0)
        held = _newest(sampled, sent)
        shown = faulty_barometer(self._faults, Source.SCALED_PRESSURE, sent, pressure[held])
        streams.append(messages.scaled_pressure(sent, shown, flow[held], _temperature(sent) - 3.0))
        if highres:
            times, imu, field = faulty_imu(self._faults, Source.HIGHRES_IMU, *(part[::2] for part in sound))
            held = _newest(sampled, times)
            climbed = (motion.height - self._start.height)[held]
            shown = faulty_barometer(self._faults, Source.HIGHRES_IMU, times, pressure[held])
            streams.append(messages.highres_imu(times, imu, field, (shown, climbed), _temperature(times)))
        return streams

    def gnss(self, rng: Generator, fix_hz: float, message_hz: float, delay: float) -> Stream:
        """GPS_RAW_INT: late, repeated, and nothing before the first fix."""
        measured = self._samples(rng, fix_hz)
        measured = measured[measured >= 0.0]
        errors, speed_errors = sensors.gnss(self._noise, rng, measured)
        motion = self._trajectory.at(measured)
        place = _moved(motion, errors)
        stamps = np.where(measured + delay >= FIRST_FIX, measured + delay, np.nan)
        sent = self._schedule(rng, message_hz)
        held = _newest(measured + delay, sent)
        n = self._noise
        accuracies = (
            n.gnss_claim * max(0.3, math.hypot(n.gnss_horizontal, n.gnss_drift_horizontal)),
            n.gnss_claim * max(0.3, math.hypot(n.gnss_vertical, n.gnss_drift_vertical)),
            n.gnss_claim * max(0.05, n.gnss_speed_horizontal),
        )
        latitude, longitude, height = place
        v_n = motion.v_n + speed_errors
        place = latitude[held], longitude[held], height[held]
        return messages.gps_raw_int(*faulty_gnss(self._faults, sent, stamps[held], place, v_n[held]), accuracies)

    def housekeeping(self, rng: Generator) -> list[Stream]:
        """HEARTBEAT and SYSTEM_TIME."""
        beat, clock = self._schedule(rng, 1.0), self._schedule(rng, 2.0)
        quadrotor, fixed_wing, guided, auto = 2, 1, 4, 10
        vehicle, mode = (fixed_wing, auto) if self._winged else (quadrotor, guided)
        return [
            messages.heartbeat(beat, vehicle, mode, self._running(beat)),
            messages.system_time(clock, int(BOOT_UTC.timestamp() * 1e6), clock > FIRST_FIX),
        ]

    def estimate(self, rng: Generator) -> list[Stream]:
        """ATTITUDE and GLOBAL_POSITION_INT: an estimate such as the autopilot's own; for comparison only."""
        times = self._schedule(rng, 4.0)
        motion = self._trajectory.at(times - ESTIMATE_AGE)
        drift = sensors.gauss_markov(rng, times, 1.0, ESTIMATE_TIME, 9)
        euler = motion.euler + drift[:, :3] * [ESTIMATE_TILT, ESTIMATE_TILT, ESTIMATE_YAW]
        n = self._noise
        place = _moved(
            motion, drift[:, 3:6] * [n.gnss_drift_horizontal, n.gnss_drift_horizontal, n.gnss_drift_vertical]
        )
        v_n = motion.v_n + ESTIMATE_SPEED * drift[:, 6:]
        climbed = place[2] - self._start.height
        euler[:, 2] = np.arctan2(np.sin(euler[:, 2]), np.cos(euler[:, 2]))
        return [
            messages.attitude(times, euler, motion.omega_b),
            messages.global_position_int(
                times, place, climbed, np.column_stack([v_n, euler[:, 2]]), times >= POSITION_KNOWN
            ),
        ]

    def truth(self) -> Truth:
        """Give the true motion from boot on, at TRUTH_RATE."""
        motion = self._trajectory.at(np.arange(math.floor(self._duration * TRUTH_RATE) + 1) / TRUTH_RATE)
        return Truth(motion.time, motion.latitude, motion.longitude, motion.height, motion.v_n, motion.euler)

    def _imu(self, rng: Generator, taken: NDArray[np.int64], progress: Callable[[float], object]) -> Floats:
        """Give the filtered IMU (n, 6) at the samples `taken` (n), computed block by block."""
        imu, result, last = sensors.Imu(self._noise, rng), [], int(taken[-1]) + 1
        for first in range(0, last, IMU_BLOCK):
            t = np.arange(first, min(first + IMU_BLOCK, last)) / IMU_RATE
            block = imu.measure(self._trajectory.at(t), self._running(t))
            low, high = np.searchsorted(taken, (first, first + len(t)))
            result.append(block[taken[low:high] - first])
            progress(first / last)
        return np.concatenate(result)

    def _field(self) -> Floats:
        """Give the earth's magnetic field at the start (3), tesla, frame n, from the World Magnetic Model."""
        from pygeomag import GeoMag

        year = BOOT_UTC.year + BOOT_UTC.timetuple().tm_yday / 365.0
        model = GeoMag(base_year=datetime(5 * (BOOT_UTC.year // 5), 1, 1))
        place = math.degrees(self._start.latitude[0]), math.degrees(self._start.longitude[0])
        field = model.calculate(*place, self._start.height[0] * 1e-3, year)
        return np.array([field.x, field.y, field.z]) * 1e-9

    def _running(self, t: Floats) -> NDArray[np.bool_]:
        running: NDArray[np.bool_] = (t >= self._arm) & (t < self._disarm)
        return running

    def _schedule(self, rng: Generator, rate: float, jitter: float = JITTER) -> Floats:
        """When messages are sent: a drawn phase, some jitter, from when the link is up."""
        times = LINK_UP + (rng.random() + np.arange(math.ceil((self._duration - LINK_UP) * rate))) / rate
        times += min(jitter, 0.3 / rate) * rng.random(len(times))
        return np.asarray(times[times < self._duration - 0.01], np.float64)

    def _samples(self, rng: Generator, rate: float) -> Floats:
        """When a sensor samples: a drawn phase, from before the first message."""
        return np.asarray((rng.random() + np.arange(-1, math.ceil(self._duration * rate))) / rate, np.float64)


def _newest(sampled: Floats, times: Floats) -> NDArray[np.intp]:
    """Find the index of the newest sample at each time."""
    return np.maximum(np.searchsorted(sampled, times, side="right") - 1, 0)


def _temperature(times: Floats) -> Floats:
    """Degrees Celsius of a board that warms up."""
    result: Floats = 45.0 - 20.0 * np.exp(-times / 200.0)
    return result


def _moved(motion: Motion, error: Floats) -> tuple[Floats, Floats, Floats]:
    """Latitude, longitude, height of a motion displaced by north, east, down metres (n, 3); some metres, so a sphere does."""
    latitude = motion.latitude + error[:, 0] / SEMI_MAJOR_AXIS
    longitude = motion.longitude + error[:, 1] / (SEMI_MAJOR_AXIS * np.cos(motion.latitude))
    return latitude, longitude, motion.height - error[:, 2]
