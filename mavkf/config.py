"""Configuration: default, unit, range and meaning of every setting in one place (hence its length); TOML in and out.

    config = read_config(Path("mavkf.toml"))
    config = with_settings(config, ["vehicle.gnss_delay_s=0.2"])

`None` (left out in TOML) means: chosen from the session's first seconds, by autopilot.
"""

import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, get_args

import msgspec
from msgspec import Meta

from mavkf.errors import UsageError

Angle = Annotated[float, Meta(ge=-180.0, le=180.0)]
Length = Annotated[float, Meta(ge=-100.0, le=100.0)]


class Timeline(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[timeline] history and set-up of a session."""

    window_s: Annotated[
        float, Meta(ge=0.5, le=30.0, description="s: a sample this much older than the newest is too late")
    ] = 3.0
    setup_s: Annotated[
        float, Meta(ge=1.0, le=60.0, description="s of boot time: sensors and model are chosen after it")
    ] = 5.0


class Vehicle(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[vehicle] what is known of this vehicle's sensors."""

    gnss_delay_s: (
        Annotated[
            float,
            Meta(
                ge=0.0,
                le=1.0,
                description="s: the fix is older than its stamp (automatic: as the autopilot's parameters say, "
                "else ArduPilot 0.085, others 0)",
            ),
        ]
        | None
    ) = None
    imu_delay_s: (
        Annotated[
            float, Meta(ge=0.0, le=1.0, description="s: low-pass of the IMU (automatic: ArduPilot 0.0125, else 0)")
        ]
        | None
    ) = None
    magnetometer_delay_s: (
        Annotated[
            float,
            Meta(
                ge=0.0,
                le=1.0,
                description="s: age of the field when sent (automatic: ArduPilot 0.055, PX4 0.05, else 0)",
            ),
        ]
        | None
    ) = None
    barometer_delay_s: (
        Annotated[
            float,
            Meta(ge=0.0, le=1.0, description="s: age of the pressure when sent (automatic: ArduPilot 0.045, else 0)"),
        ]
        | None
    ) = None
    imu_rotation_deg: Annotated[
        tuple[Angle, Angle, Angle],
        Meta(
            description="deg: roll, pitch, yaw (turns about z, then y, then x) of the sensor frame in the body, for an autopilot "
            "that does not know how it is mounted: applies to every IMU message and to the magnetic field in it"
        ),
    ] = (0.0, 0.0, 0.0)
    gnss_antenna_b_m: (
        Annotated[
            tuple[Length, Length, Length],
            Meta(
                description="m: where the GNSS antenna is from the IMU: forward, right, down (automatic: as the autopilot's "
                "parameters say, else at the IMU)"
            ),
        ]
        | None
    ) = None
    estimate_antenna: Annotated[
        bool,
        Meta(
            description="whether the antenna's place is estimated, beginning with the one that is told (one sigma 0.05 m; 0.3 m where it "
            "is all zeros); it is seen when the vehicle turns"
        ),
    ] = False
    magnetic_declination_deg: (
        Annotated[
            float,
            Meta(
                ge=-180.0, le=180.0, description="deg, east positive (automatic: World Magnetic Model at the first fix)"
            ),
        ]
        | None
    ) = None
    use_magnetometer: (
        Annotated[
            bool,
            Meta(
                description="whether the magnetometer is fused (automatic: unless the autopilot's parameters say that it uses none)"
            ),
        ]
        | None
    ) = None
    use_rest: Annotated[
        bool, Meta(description="whether standing still (disarmed, nothing moves) is used as zero velocity and rate")
    ] = True
    use_motion_yaw: Annotated[
        bool,
        Meta(description="whether yaw may be found from GNSS velocity and acceleration where no magnetometer gives it"),
    ] = True
    use_gnss_yaw: Annotated[
        bool, Meta(description="whether the heading of a receiver with two antennas is used, where it sends one")
    ] = True
    use_class: Annotated[
        bool,
        Meta(
            description="whether the vehicle's class (HEARTBEAT.type) is used: wheels do not slip, rotors drag, wings fly nose first"
        ),
    ] = True
    use_barometer: Annotated[bool, Meta(description="whether the barometer is fused")] = True


class Noise(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[noise] standard deviations and spectral densities; the defaults are those of consumer MEMS sensors."""

    gyro: Annotated[float, Meta(gt=0.0, le=1.0, description="rad/s/sqrt(Hz): white noise of the gyro")] = 1e-4
    accelerometer: Annotated[
        float, Meta(gt=0.0, le=10.0, description="m/s^2/sqrt(Hz): white noise of the accelerometer")
    ] = 4e-3
    gyro_bias_walk: Annotated[
        float, Meta(gt=0.0, le=1.0, description="rad/s/sqrt(s): random walk of the gyro bias")
    ] = 2e-4
    accelerometer_bias_walk: Annotated[
        float, Meta(gt=0.0, le=1.0, description="m/s^2/sqrt(s): random walk of the accelerometer bias")
    ] = 1e-3
    gyro_bias_initial: Annotated[
        float, Meta(gt=0.0, le=1.0, description="rad/s: gyro bias before anything is known")
    ] = 0.02
    accelerometer_bias_initial: Annotated[
        float, Meta(gt=0.0, le=5.0, description="m/s^2: accelerometer bias that the usual calibration leaves")
    ] = 0.06
    sampling: Annotated[
        float,
        Meta(
            ge=0.0,
            le=10.0,
            description="how much of what is missed between two samples is believed: times its theoretical variance",
        ),
    ] = 1.0
    gnss_horizontal_m: Annotated[float, Meta(gt=0.0, le=1000.0, description="m: where the receiver claims nothing")] = (
        2.0
    )
    gnss_vertical_m: Annotated[float, Meta(gt=0.0, le=1000.0, description="m: where the receiver claims nothing")] = 3.0
    gnss_position_floor_m: Annotated[
        float, Meta(gt=0.0, le=100.0, description="m: a claim below it is not believed")
    ] = 0.1
    gnss_speed_m_s: Annotated[float, Meta(gt=0.0, le=100.0, description="m/s: where the receiver claims nothing")] = 0.4
    gnss_speed_floor_m_s: Annotated[
        float,
        Meta(
            gt=0.0,
            le=10.0,
            description="m/s: a claim below it is not believed (where all of a flight is smoothed, once it has shown to be better, it is)",
        ),
    ] = 0.2
    gnss_course_m_s: Annotated[
        float, Meta(ge=0.0, le=10.0, description="m/s: across the course, added where the speed is small")
    ] = 0.3
    barometer_m: Annotated[float, Meta(gt=0.0, le=100.0, description="m: white noise of the pressure height")] = 0.4
    barometer_walk: Annotated[
        float, Meta(gt=0.0, le=10.0, description="m/sqrt(s): random walk of the barometer bias")
    ] = 0.03
    gnss_colour: Annotated[
        float,
        Meta(
            ge=0.0,
            le=5.0,
            description="least sigma of the horizontal GNSS error that lingers, as a share of what is claimed",
        ),
    ] = 0.85
    gnss_colour_vertical: Annotated[
        float,
        Meta(
            ge=0.0,
            le=5.0,
            description="least sigma of the vertical GNSS error that lingers, as a share of what is claimed",
        ),
    ] = 1.5
    gnss_colour_time_s: Annotated[
        float, Meta(gt=0.0, le=3600.0, description="s: how long the lingering part of the GNSS position error lasts")
    ] = 40.0
    gnss_delay_initial_s: Annotated[
        float, Meta(ge=0.0, le=1.0, description="s: one sigma of the nominal GNSS delay; 0: it is exact")
    ] = 0.03
    gnss_delay_walk: Annotated[float, Meta(ge=0.0, le=0.1, description="s/sqrt(s): random walk of the GNSS delay")] = (
        1e-4
    )
    gnss_yaw_deg: Annotated[
        float,
        Meta(
            gt=0.0,
            le=180.0,
            description="deg: heading of a receiver with two antennas; no message tells how good it is",
        ),
    ] = 2.0
    magnetometer_t: Annotated[
        float, Meta(gt=0.0, le=1e-4, description="T: white noise and changing disturbance of the magnetometer")
    ] = 7e-7
    magnetometer_bias_t: Annotated[
        float, Meta(gt=0.0, le=1e-4, description="T: the vehicle's own field that calibration has left")
    ] = 1.5e-6
    earth_field_t: Annotated[
        float,
        Meta(
            gt=0.0, le=1e-5, description="T: the earth's field where the vehicle is, against the World Magnetic Model"
        ),
    ] = 3e-7
    acceleration_m_s2: Annotated[
        float,
        Meta(gt=0.0, le=100.0, description="m/s^2: acceleration of a vehicle that is not measured (constant velocity)"),
    ] = 2.5
    acceleration_time_s: Annotated[float, Meta(gt=0.0, le=60.0, description="s: how long that acceleration lasts")] = (
        1.0
    )


class Gates(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[gates] when a measurement is refused, and when its refusal is doubted."""

    false_rejection: Annotated[
        float, Meta(gt=0.0, lt=0.5, description="probability that a right measurement is refused")
    ] = 1e-4
    reset_s: Annotated[
        float,
        Meta(
            ge=1.0,
            le=600.0,
            description="s of refused positions that agree with each other, after which the state is reset to them; where their velocity "
            "is fused and no other receiver tells, that takes integrity.suspicion_s",
        ),
    ] = 10.0
    gap_s: Annotated[float, Meta(gt=0.0, le=10.0, description="s without an IMU sample that is a gap")] = 0.6


class Integrity(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[integrity] faults that pass the gates, and how sure the protection levels are."""

    monitors: Annotated[
        bool,
        Meta(description="whether faults are looked for in what the innovations add up to (IMU at 8 Hz and faster)"),
    ] = True
    suspicion_s: Annotated[
        float,
        Meta(
            ge=1.0,
            le=3600.0,
            description="s: how long a receiver that the other sensors contradict is left out, before the state is reset to it",
        ),
    ] = 60.0
    risk: Annotated[
        float, Meta(gt=0.0, lt=0.5, description="probability that an error is larger than its protection level")
    ] = 1e-3


class Model(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[model] choice of the kinematic model."""

    telemetry: Annotated[
        bool, Meta(description="whether the telemetry model (rate and force as states) is chosen where it is likelier")
    ] = True
    even_hz: Annotated[
        float,
        Meta(
            gt=0.0,
            le=1000.0,
            description="Hz: an IMU slower than this begins with the telemetry model, a faster one with strapdown",
        ),
    ] = 2.0
    compare_hz: Annotated[
        float,
        Meta(
            ge=0.0,
            le=1000.0,
            description="Hz: with an IMU slower than this both are run, and the innovations decide; 0: the rate alone decides",
        ),
    ] = 8.0


class Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All settings, by section."""

    timeline: Timeline = Timeline()
    vehicle: Vehicle = Vehicle()
    noise: Noise = Noise()
    gates: Gates = Gates()
    integrity: Integrity = Integrity()
    model: Model = Model()


def settings() -> Iterator[tuple[str, Any, str]]:
    """Every setting as (section.key, default, description with its range), in order."""
    for section in msgspec.structs.fields(Config):
        for field in msgspec.structs.fields(section.type):
            # Annotated[T, Meta] or Annotated[T, Meta] | None
            candidates = (field.type, *get_args(field.type))
            chosen = next(candidate for candidate in candidates if hasattr(candidate, "__metadata__"))
            meta = chosen.__metadata__[0]
            # a vector's range is that of its components
            span_of = next((part.__metadata__[0] for part in get_args(chosen.__origin__)), meta)
            low = span_of.ge if span_of.ge is not None else span_of.gt
            high = span_of.le if span_of.le is not None else span_of.lt
            span = f" ({low:g} to {high:g})" if low is not None and high is not None else ""
            yield f"{section.name}.{field.name}", field.default, meta.description + span


def _checked(values: dict[str, Any], where: str) -> Config:
    try:
        return msgspec.convert(values, Config)
    except msgspec.ValidationError as error:
        text = str(error).replace("`$.", "`")
        raise UsageError(f"{where}: {text}; `mavkf replay --settings` lists what there is") from None


def read_config(path: Path) -> Config:
    """The configuration of a TOML file. Raises UsageError that names the key or value that is wrong."""
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); give the path of a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: not TOML ({error})") from None
    values.pop("serve", None)  # sources and options of a command, which reads them itself
    return _checked(values, str(path))


def with_settings(config: Config, assignments: Iterable[str]) -> Config:
    """The configuration with `section.key=value` (or `key=value`) settings applied. Raises UsageError."""
    values: dict[str, dict[str, Any]] = msgspec.to_builtins(config)
    known = [name for name, _, _ in settings()]
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        matches = [name for name in known if name == key or name.endswith("." + key)]
        if not equals or len(matches) != 1 or "\n" in text:
            raise UsageError(f"--set {assignment}: expected key=value with one of these keys: {', '.join(known)}")
        section, name = matches[0].split(".")
        try:
            value: Any = tomllib.loads(f"v = {text}")["v"]
        except tomllib.TOMLDecodeError:
            raise UsageError(f"--set {assignment}: {text!r} is not a number, true/false or [a, b, c]") from None
        values[section][name] = value
        _checked(values, f"--set {assignment}")
    return _checked(values, "--set")
