"""What is chosen for a session from its first seconds: sensors, model, delays; each choice with its reason in words."""

import math
from collections.abc import Iterable

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.config import Config
from mavkf.filters.chi_square import limit
from mavkf.navigation import layout as L
from mavkf.navigation.choose_imu import IMU_QUALITY, choose_imu, period
from mavkf.navigation.classes import class_reason, used_class
from mavkf.navigation.delays import ARDUPILOT, DELAYS, NO_DELAYS
from mavkf.navigation.parameter import PARAMETERS, Parameter
from mavkf.navigation.reserves import BAROMETER_SOURCES, imus_with_reserve, with_reserve
from mavkf.navigation.stated import compass_words, stated, values_of
from mavkf.samples import (
    AUTOPILOT,
    FIX,
    GNSS_SOURCES,
    IMU_SOURCES,
    KIND,
    SOURCE,
    VEHICLE_TYPE,
    Kind,
    Source,
)

ANTENNA_TOLD, ANTENNA_UNTOLD = 0.05, 0.3  # m: one sigma of where the antenna is, configured or not
MODELS = {"constant-velocity": L.CONSTANT_VELOCITY, "strapdown": L.STRAPDOWN, "telemetry": L.TELEMETRY}
UNKNOWN = -1  # of a source


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    """The choices for one session. Sources are None where nothing is known of them; rates are those of the first seconds, Hz.

    imu, gnss, magnetometer, barometer: what is used first; imus, magnetometers, barometers: what the fold gets, since it
    may have to take another when that falls silent.
    imu_period: s, median between the samples of the first seconds; 0: no IMU. imu_rotation: roll, pitch, yaw
    of the sensor frame in the body, rad. antenna: m from the IMU in the body; stated: the values of the autopilot's parameters, by
    `AutopilotParameter`, that had come. model: one of MODELS, to begin with;
    compare: whether the other of strapdown and telemetry is tried beside it while the IMU is slow.
    """

    imu: Source | None
    imus: tuple[Source, ...]
    imu_rate_hz: float
    imu_period: float
    imu_rotation: tuple[float, float, float]
    gnss: Source
    magnetometer: Source | None
    magnetometers: tuple[Source, ...]
    use_magnetometer: bool
    barometer: Source | None
    barometers: tuple[Source, ...]
    autopilot: int | None
    vehicle_type: int | None
    gnss_delay: float
    imu_delay: float
    magnetometer_delay: float
    barometer_delay: float
    antenna: tuple[float, float, float]
    stated: dict[int, float]
    model: str
    compare: bool
    reasons: tuple[str, ...]


def _choose_gnss(rows: NDArray[np.float64]) -> Source:
    """The receiver with the most 3D fixes; before any fix, the first that speaks."""
    gnss = rows[rows[:, KIND] == Kind.GNSS]
    fixes = {source: int(np.sum((gnss[:, SOURCE] == source) & (gnss[:, FIX] >= 3))) for source in GNSS_SOURCES}
    best = max(GNSS_SOURCES, key=lambda source: fixes[source])
    if fixes[best]:
        return best
    return next((source for source in GNSS_SOURCES if np.any(gnss[:, SOURCE] == source)), Source.GPS_RAW_INT)


def _first_of(rows: NDArray[np.float64], kind: Kind, order: Iterable[Source], default: Source | None) -> Source | None:
    present = set(rows[rows[:, KIND] == kind, SOURCE])
    return next((source for source in order if source in present), default)


def _latest(rows: NDArray[np.float64], column: int) -> int | None:
    beats = rows[rows[:, KIND] == Kind.HEARTBEAT]
    return int(beats[-1, column]) if beats.shape[0] else None


def _choose_model(
    imu: Source | None, rate: float, config: Config, forced: str | None, reasons: list[str]
) -> tuple[str, bool]:
    """The model to begin with, and whether another is tried beside it."""
    if imu is None:
        reasons.append(
            "model constant-velocity: without an IMU there is no attitude, and between fixes the velocity is assumed to last"
        )
        return "constant-velocity", False
    if forced is not None:
        reasons.append(f"model {forced}, as asked")
        return forced, False
    if not config.model.telemetry:
        reasons.append("model strapdown: the telemetry model is switched off")
        return "strapdown", False
    slow = rate < config.model.even_hz
    name = "telemetry" if slow else "strapdown"
    if rate >= config.model.compare_hz:
        reasons.append(f"model {name}: the IMU at {rate:.3g} Hz is fast enough to be integrated")
    else:
        reasons.append(
            f"model {name} to begin with: the IMU at {rate:.2g} Hz is slow; {'strapdown' if slow else 'telemetry'} runs beside it and "
            "leads when the other sensors find it likelier"
        )
    return name, config.model.compare_hz > 0.0


def choose(rows: NDArray[np.float64], config: Config, imu: Source | None = None, model: str | None = None) -> Setup:
    """Choose from a session's first rows (n, ROW_WIDTH), in order of arrival.

    imu: a message to use whatever its merits; model: one of MODELS, to force it.
    Raises UsageError where the forced IMU is not there.
    """
    reasons: list[str] = []
    broken: set[Source] = set()
    source, rate = choose_imu(rows, imu, reasons, broken)
    autopilot = _latest(rows, AUTOPILOT)
    delays = DELAYS.get(autopilot, NO_DELAYS) if autopilot is not None else NO_DELAYS
    vehicle = config.vehicle
    roll, pitch, yaw = vehicle.imu_rotation_deg
    chosen, compare = _choose_model(source, rate, config, model, reasons)
    usable = {message: quality for message, quality in IMU_QUALITY.items() if message not in broken}
    # one that starts later comes most likely in these messages
    order = ([source] if source is not None else []) + list(IMU_SOURCES)
    gnss = _choose_gnss(rows)
    values = values_of(rows)
    said = stated(values, vehicle, gnss)
    fields = [message for message in order if message not in said.compasses_off]
    magnetometer = _first_of(rows, Kind.MAGNETOMETER, fields, source if source in fields else None)
    barometer = _first_of(rows, Kind.BAROMETER, BAROMETER_SOURCES, Source.SCALED_PRESSURE)

    reasons.append(class_reason(_latest(rows, VEHICLE_TYPE), vehicle.use_class))
    reasons += said.reasons
    reasons += compass_words(said.compasses_off, set(rows[rows[:, KIND] == Kind.MAGNETOMETER, SOURCE]))

    def delay(configured: float | None, name: str) -> float:
        return delays[name] if configured is None else configured

    return Setup(
        imu=source,
        imus=imus_with_reserve(rows, source, imu is not None, usable),
        imu_rate_hz=rate,
        imu_period=period(rows, source),
        imu_rotation=(math.radians(roll), math.radians(pitch), math.radians(yaw)),
        gnss=gnss,
        magnetometer=magnetometer,
        magnetometers=with_reserve(rows, Kind.MAGNETOMETER, magnetometer, [m for m in IMU_SOURCES if m in fields]),
        use_magnetometer=vehicle.use_magnetometer is not False and bool(fields),
        barometer=barometer,
        barometers=with_reserve(rows, Kind.BAROMETER, barometer, BAROMETER_SOURCES),
        autopilot=autopilot,
        vehicle_type=_latest(rows, VEHICLE_TYPE),
        gnss_delay=delay(vehicle.gnss_delay_s if said.gnss_delay is None else said.gnss_delay, "gnss"),
        imu_delay=delay(vehicle.imu_delay_s, "imu"),
        magnetometer_delay=delay(vehicle.magnetometer_delay_s, "magnetometer"),
        barometer_delay=delay(vehicle.barometer_delay_s, "barometer"),
        antenna=vehicle.gnss_antenna_b_m or said.antenna or (0.0, 0.0, 0.0),
        stated=values,
        model=chosen,
        compare=compare,
        reasons=tuple(reasons),
    )


def parameters(config: Config, setup: Setup) -> NDArray[np.float64]:
    """The parameter array of the fold."""
    noise, gates = config.noise, config.gates
    antenna_sigma = ANTENNA_TOLD if any(setup.antenna) else ANTENNA_UNTOLD
    declination = config.vehicle.magnetic_declination_deg
    values = {
        Parameter.MODEL: MODELS[setup.model],
        Parameter.COMPARE_HZ: config.model.compare_hz if setup.compare else 0.0,
        Parameter.EVEN_HZ: config.model.even_hz,
        Parameter.GYRO: noise.gyro,
        Parameter.ACCEL: noise.accelerometer,
        Parameter.GYRO_WALK: noise.gyro_bias_walk,
        Parameter.ACCEL_WALK: noise.accelerometer_bias_walk,
        Parameter.GYRO_BIAS: noise.gyro_bias_initial,
        Parameter.ACCEL_BIAS: noise.accelerometer_bias_initial,
        Parameter.SAMPLING: noise.sampling,
        Parameter.GNSS_HORIZONTAL: noise.gnss_horizontal_m,
        Parameter.GNSS_VERTICAL: noise.gnss_vertical_m,
        Parameter.GNSS_FLOOR: noise.gnss_position_floor_m,
        Parameter.SPEED: noise.gnss_speed_m_s,
        Parameter.SPEED_FLOOR: noise.gnss_speed_floor_m_s,
        Parameter.COURSE: noise.gnss_course_m_s,
        Parameter.BARO: noise.barometer_m,
        Parameter.BARO_WALK: noise.barometer_walk,
        Parameter.COLOUR: noise.gnss_colour,
        Parameter.COLOUR_VERTICAL: noise.gnss_colour_vertical,
        Parameter.COLOUR_TIME: noise.gnss_colour_time_s,
        Parameter.MAGNETOMETER: noise.magnetometer_t,
        Parameter.IRON: noise.magnetometer_bias_t,
        Parameter.EARTH_FIELD: noise.earth_field_t,
        Parameter.DELAY: noise.gnss_delay_initial_s,
        Parameter.DELAY_WALK: noise.gnss_delay_walk,
        Parameter.TRUNCATION: float(setup.autopilot == ARDUPILOT),
        Parameter.REST: float(config.vehicle.use_rest),
        Parameter.CLASS: used_class(setup.vehicle_type) if config.vehicle.use_class else 0.0,
        Parameter.USE_MOTION_YAW: float(config.vehicle.use_motion_yaw),
        Parameter.ANTENNA_X: setup.antenna[0],
        Parameter.ANTENNA_Y: setup.antenna[1],
        Parameter.ANTENNA_Z: setup.antenna[2],
        Parameter.ANTENNA_SIGMA: antenna_sigma if config.vehicle.estimate_antenna else 0.0,
        Parameter.IMU_SOURCE: float(UNKNOWN if setup.imu is None else setup.imu),
        Parameter.GNSS_SOURCE: float(setup.gnss),
        Parameter.FIELD_SOURCE: float(UNKNOWN if setup.magnetometer is None else setup.magnetometer),
        Parameter.PRESSURE_SOURCE: float(UNKNOWN if setup.barometer is None else setup.barometer),
        Parameter.USE_GNSS_YAW: float(config.vehicle.use_gnss_yaw),
        Parameter.GNSS_YAW: math.radians(noise.gnss_yaw_deg),
        Parameter.ACCELERATION: noise.acceleration_m_s2,
        Parameter.ACCELERATION_TIME: noise.acceleration_time_s,
        Parameter.LIMIT_1: limit(gates.false_rejection, 1),
        Parameter.LIMIT_2: limit(gates.false_rejection, 2),
        Parameter.LIMIT_3: limit(gates.false_rejection, 3),
        Parameter.RESET: gates.reset_s,
        Parameter.MONITORS: float(config.integrity.monitors),
        Parameter.SUSPICION: config.integrity.suspicion_s,
        Parameter.RISK: config.integrity.risk,
        Parameter.GAP: gates.gap_s,
        Parameter.DECLINATION: math.nan if declination is None else math.radians(declination),
        Parameter.USE_MAGNETOMETER: float(setup.use_magnetometer),
        Parameter.USE_BAROMETER: float(config.vehicle.use_barometer),
        # to a power of two, so that it does not hang on which samples happened to arrive in the first seconds
        Parameter.IMU_PERIOD: 2.0 ** round(math.log2(setup.imu_period)) if setup.imu_period > 0.0 else 0.0,
    }
    array = np.empty(PARAMETERS)
    for parameter, value in values.items():
        array[parameter] = value
    return array
