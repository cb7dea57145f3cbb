"""The records that mavkf publishes, replays and exports: `Pose`, `Status`, `Innovation`, `Event`.

`None` is "not known": a number is never a guess. Vectors are tuples. Frames: `n` is north-east-down at the vehicle, `b`
is body forward-right-down. Altitudes are positive up. Every record begins with the fields of `Head`. Later versions of
the schema only add fields. This module imports nothing heavy, so that a subscriber starts at once.
"""

from enum import StrEnum
from typing import Annotated

from msgspec import Meta, Struct

SCHEMA_VERSION = 1

FLAGS: tuple[str, ...] = (
    "no_imu",
    "no_gnss",
    "no_magnetometer",
    "yaw_unknown",
    "imu_slow",
    "constant_velocity",
    "gnss_refused",
    "gnss_suspected",
    "magnetometer_disturbed",
)
"""The names that may stand in `flags`: no sample of a sensor for two seconds (`no_...`); heading not known yet; IMU too slow to be
integrated; velocity and position from GNSS and barometer alone; the last fixes were refused by the gate; the receiver is under suspicion
(an event says why); the magnetic field is not the earth's."""

Vector3 = tuple[float, float, float]
PartialVector3 = tuple[float | None, float | None, float | None]
Quaternion = tuple[float, float, float, float]
Matrix3 = Annotated[tuple[float, ...], Meta(min_length=9, max_length=9)]
PartialMatrix6 = Annotated[tuple[float | None, ...], Meta(min_length=36, max_length=36)]


class Mode(StrEnum):
    """What the estimator is doing."""

    WAITING = "waiting"
    """Nothing usable has arrived yet."""
    ALIGNING = "aligning"
    """Finding the first attitude."""
    ATTITUDE = "attitude"
    """Attitude only: position was never known in this session, or was given up."""
    NAVIGATING = "navigating"
    """Attitude, velocity and position, held by measurements."""
    DEAD_RECKONING = "dead_reckoning"
    """No position measurement is being fused: position drifts, and its covariance says how far."""


class Validity(Struct, frozen=True, kw_only=True):
    """Which parts of the estimate may be used.

    position: latitude, longitude, altitude, `position_ned_m`.
    velocity: `velocity_ned_m_s`.
    tilt: roll and pitch.
    yaw: the heading from true north.
    """

    position: bool = False
    velocity: bool = False
    tilt: bool = False
    yaw: bool = False


class Origin(Struct, frozen=True, kw_only=True):
    """The fixed point that `position_ned_m` is measured from.

    lat_deg, lon_deg: WGS-84, degrees.
    alt_amsl_m: metres above mean sea level, as the receiver reports it.
    """

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


class Head(Struct, frozen=True, kw_only=True):
    """The fields that every record begins with.

    schema_version: of this record.
    vehicle: `<sysid>-<compid>`, or the name that the user gave.
    session: the vehicle's boot that the record belongs to, counted from 0.
    seq: counts the records of one key within a session, so that a reader sees what it missed.
    t_boot_s: the time that the record is about, seconds on the vehicle's boot clock (wraps unrolled).
    utc_ns: the same instant, nanoseconds since 1970 UTC.
    """

    schema_version: int = SCHEMA_VERSION
    vehicle: str
    session: int
    seq: int
    t_boot_s: float | None = None
    utc_ns: int | None = None


class Pose(Head, frozen=True, kw_only=True):
    """The fused pose at `t_boot_s`, the measurement time of the newest IMU sample.

    lat_deg, lon_deg: WGS-84, degrees.
    alt_amsl_m: metres above mean sea level, as the receiver reports it.
    alt_ellipsoid_m: metres above the WGS-84 ellipsoid; only where a message carries it.
    origin: where `position_ned_m` is zero.
    position_ned_m: north, east, down from `origin`, metres.
    velocity_ned_m_s: over ground in n, m/s.
    quaternion_nb: w, x, y, z (Hamilton), turns vectors of b into n; unknown while yaw is.
    euler_deg: roll, pitch, yaw, degrees; turns about z, y, x in that order; yaw from true north in [-180, 180].
    angular_rate_b_rad_s: in b, bias removed, rad/s.
    gyro_bias_b_rad_s: what the gyroscope reads too much, in b, rad/s.
    accel_bias_b_m_s2: what the accelerometer reads too much, in b, m/s^2.
    pose_covariance: 6x6 row-major: position north, east, down (m), then rotation about north, east, down (rad); the
        rows and columns of what is unknown hold nulls.
    velocity_covariance: 3x3 row-major, of `velocity_ned_m_s`, m^2/s^2.
    pl_h_m, pl_v_m: protection levels, m: the horizontal and the vertical error of the position are larger with the risk
        `integrity.risk` at most, undetected faults counted in.
    valid: which parts may be used.
    mode: what the estimator is doing.
    flags: conditions that hold now, names out of `FLAGS`.
    """

    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_amsl_m: float | None = None
    alt_ellipsoid_m: float | None = None
    origin: Origin | None = None
    position_ned_m: Vector3 | None = None
    velocity_ned_m_s: Vector3 | None = None
    quaternion_nb: Quaternion | None = None
    euler_deg: PartialVector3 | None = None
    angular_rate_b_rad_s: Vector3 | None = None
    gyro_bias_b_rad_s: Vector3 | None = None
    accel_bias_b_m_s2: Vector3 | None = None
    pose_covariance: PartialMatrix6 | None = None
    velocity_covariance: Matrix3 | None = None
    pl_h_m: float | None = None
    pl_v_m: float | None = None
    valid: Validity = Validity()
    mode: Mode = Mode.WAITING
    flags: tuple[str, ...] = ()


class Consistency(Struct, frozen=True, kw_only=True):
    """What a sensor's innovations of the last minute say of it and of the filter: the newest 256 at most.

    count: that were fused.
    refused: that were not.
    nis: their mean NIS for each degree of freedom: 1 where errors are as large as the filter says, None where none was fused.
    sentence: the worst that is wrong; None where nothing is, or where there is too little to tell. Judged every few seconds.
    """

    count: int
    refused: int
    nis: float | None = None
    sentence: str | None = None


class Linearisation(Struct, frozen=True, kw_only=True):
    """Whether the first order, by which the filter works, is enough for a sensor or for the prediction, at the last few states.

    outside: share of the innovations (or predicted errors) that fall outside the filter's region of 95 %: 0.05 where all is linear.
    verdict: fine, marginal or broken.
    sentence: what that means.
    """

    outside: float
    verdict: str
    sentence: str


class SmoothedPose(Pose, frozen=True, kw_only=True):
    """A pose of a few seconds ago, by what has come since: mode, flags and protection levels are those of its own time."""


class Status(Head, frozen=True, kw_only=True):
    """How the estimator and its inputs are doing.

    mode, flags, valid: as in `Pose`.
    model: the motion model in use, None before the first choice.
    rates_hz: by input or output, per second.
    counts: since the session began: lost, late, corrupt, refused, published, ...
    age_s: by sensor, seconds of boot time since its last sample; None if it never sent one.
    silent_s: None while the vehicle is heard; else the record is the last one again, and this long, by the service's clock, nothing has
        come: what it says is stale.
    innovations: by sensor (names as of the keys of innovations; a second receiver has its message behind), of the last minute.
    condition: condition number of the covariance, each state in units of its sigma; 1e8 costs half of the digits; None: not a covariance.
        Judged every five seconds.
    covariance: what that means, in one sentence.
    linearisation: by sensor whose model is not linear, and "prediction"; judged every ten seconds.
    """

    mode: Mode = Mode.WAITING
    flags: tuple[str, ...] = ()
    valid: Validity = Validity()
    model: str | None = None
    rates_hz: dict[str, float | None] = {}
    counts: dict[str, int] = {}
    age_s: dict[str, float | None] = {}
    innovations: dict[str, Consistency] = {}
    silent_s: float | None = None
    condition: float | None = None
    covariance: str | None = None
    linearisation: dict[str, Linearisation] = {}


class Innovation(Head, frozen=True, kw_only=True):
    """One measurement held against its prediction, whether it was fused or not.

    sensor: its name, the last part of the key.
    instance: which of several sensors of this kind, from 0.
    r: measured less predicted, in the units of the measurement.
    S: covariance of `r`, row-major, units of `r` squared.
    nis: r' S^-1 r, without unit.
    limit: the largest `nis` that is fused.
    fused: whether it changed the estimate.
    reason: why not, None when it was fused.
    """

    sensor: str
    instance: int = 0
    r: tuple[float | None, ...] = ()
    S: tuple[float | None, ...] = ()
    nis: float | None = None
    limit: float | None = None
    fused: bool
    reason: str | None = None


class Event(Head, frozen=True, kw_only=True):
    """Something that happened and is worth telling: a reset, a glitch, a reboot, a sensor that broke.

    kind: its name.
    t_start_s, t_end_s: its span, seconds of boot time; the end is None while it lasts.
    size: how large, in the unit that `text` names.
    evidence: the numbers that it was decided on.
    text: one sentence for people.
    """

    kind: str
    t_start_s: float | None = None
    t_end_s: float | None = None
    size: float | None = None
    evidence: dict[str, float | int | str | bool | None] = {}
    text: str = ""


Record = Pose | SmoothedPose | Status | Innovation | Event
