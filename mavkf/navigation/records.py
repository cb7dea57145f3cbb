"""From the numbers of the fold to the records of `mavkf.estimate`: units of the outside, None for what is not known, words for events."""

import math
from collections import defaultdict
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mavkf.estimate import FLAGS, Event, Innovation, Mode, Origin, Pose, SmoothedPose, Validity
from mavkf.navigation import layout as L
from mavkf.navigation import outward
from mavkf.navigation.codes import NoteCode, Reason, Sensor
from mavkf.navigation.outward import turn_outward
from mavkf.navigation.words import words
from mavkf.samples import Source

Array = NDArray[np.float64]
MODES = tuple(Mode)
SENSOR_NAMES = tuple(sensor.name.lower() for sensor in Sensor)
REASONS: dict[int, str] = {
    Reason.GATE: "outlier",
    Reason.DISTURBED: "disturbed",
    Reason.SINGULAR: "singular",
    Reason.SUSPECTED: "suspected",
}
INSTANCES: dict[int, int] = {
    Source.SCALED_IMU2: 1,
    Source.SCALED_IMU3: 2,
    Source.GPS2_RAW: 1,
    Source.SCALED_PRESSURE2: 1,
    Source.SCALED_PRESSURE3: 2,
}
P = TypeVar("P", bound=Pose)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _slice(values: list[float], first: int, count: int) -> Any:
    return tuple(values[first : first + count])


@cache
def flag_names(bits: float) -> tuple[str, ...]:
    """Names of the flags set in a pose row's R_FLAGS."""
    return tuple(name for i, name in enumerate(FLAGS) if int(bits) >> i & 1)


@cache
def validity(bits: float) -> Validity:
    """What a pose row's R_VALID says."""
    b = int(bits)
    return Validity(
        position=bool(b & L.VALID_POSITION),
        velocity=bool(b & L.VALID_VELOCITY),
        tilt=bool(b & L.VALID_TILT),
        yaw=bool(b & L.VALID_YAW),
    )


def model_name(row: Array) -> str | None:
    """The model that a pose row was made by, None before there is one."""
    if row[L.R_MODEL] != L.CONSTANT_VELOCITY:
        return "telemetry" if row[L.R_MODEL] == L.TELEMETRY else "strapdown"
    return "constant-velocity" if math.isfinite(row[L.R_LATITUDE]) else None


class RecordWriter:
    """Makes the records of one vehicle, with a running number for each key and session."""

    def __init__(self, vehicle: str) -> None:
        """vehicle: the name in the key."""
        self.vehicle = vehicle
        self.utc: Callable[[float], int | None] = lambda t: None
        self._counts: defaultdict[tuple[str, int], int] = defaultdict(int)
        self._outward = np.empty(L.POSE_WIDTH)

    def head(self, key: str, session: int, t: float | None) -> dict[str, Any]:
        """The fields that every record begins with; takes the key's next number."""
        seq = self._counts[key, session]
        self._counts[key, session] = seq + 1
        return {
            "vehicle": self.vehicle,
            "session": session,
            "seq": seq,
            "t_boot_s": t,
            "utc_ns": None if t is None else self.utc(t),
        }

    def pose(self, row: Array, session: int) -> Pose:
        """The Pose of a pose row (POSE_WIDTH,)."""
        return self._pose(Pose, "pose", row, session)

    def smoothed_pose(self, row: Array, session: int) -> SmoothedPose:
        """The SmoothedPose of a pose row (POSE_WIDTH,)."""
        return self._pose(SmoothedPose, "pose/smoothed", row, session)

    def _pose(self, kind: type[P], key: str, row: Array, session: int) -> P:
        known = turn_outward(row, self._outward)
        v: list[float] = self._outward.tolist()
        covariance: list[float] = v[L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36]
        if known & outward.POSE_COVARIANCE:
            pose_covariance: tuple[float | None, ...] | None = tuple(covariance)
        else:
            pose_covariance = tuple(map(_number, covariance)) if any(map(math.isfinite, covariance)) else None
        euler: Any = None
        if known & outward.ROLL:
            roll, pitch, yaw = v[L.R_EULER : L.R_EULER + 3]
            euler = roll, pitch if known & outward.PITCH else None, yaw if known & outward.YAW else None
        return kind(
            **self.head(key, session, v[L.R_TIME]),
            lat_deg=v[L.R_LATITUDE] if known & outward.LATITUDE else None,
            lon_deg=v[L.R_LONGITUDE] if known & outward.LONGITUDE else None,
            alt_amsl_m=v[L.R_HEIGHT] if known & outward.HEIGHT else None,
            alt_ellipsoid_m=v[L.R_UNDULATION] if known & outward.ELLIPSOID else None,
            origin=Origin(
                lat_deg=v[L.R_ORIGIN_LATITUDE], lon_deg=v[L.R_ORIGIN_LONGITUDE], alt_amsl_m=v[L.R_ORIGIN_HEIGHT]
            )
            if known & outward.ORIGIN
            else None,
            position_ned_m=_slice(v, L.R_NED, 3) if known & outward.NED else None,
            velocity_ned_m_s=_slice(v, L.R_V, 3) if known & outward.VELOCITY else None,
            quaternion_nb=_slice(v, L.R_Q, 4) if known & outward.ATTITUDE else None,
            euler_deg=euler,
            angular_rate_b_rad_s=_slice(v, L.R_RATE, 3) if known & outward.RATE else None,
            gyro_bias_b_rad_s=_slice(v, L.R_BG, 3) if known & outward.GYRO_BIAS else None,
            accel_bias_b_m_s2=_slice(v, L.R_BA, 3) if known & outward.ACCEL_BIAS else None,
            pose_covariance=pose_covariance,
            pl_h_m=v[L.R_PL_H] if known & outward.PL_H else None,
            pl_v_m=v[L.R_PL_V] if known & outward.PL_V else None,
            velocity_covariance=_slice(v, L.R_VELOCITY_COVARIANCE, 9) if known & outward.VELOCITY_COVARIANCE else None,
            valid=validity(v[L.R_VALID]),
            mode=MODES[int(v[L.R_MODE])],
            flags=flag_names(v[L.R_FLAGS]),
        )

    def innovation(self, row: Array, session: int) -> Innovation:
        """The Innovation of an innovation row (INNOVATION_WIDTH,)."""
        v: list[float] = row.tolist()
        m = int(v[L.I_SIZE])
        sensor = SENSOR_NAMES[int(v[L.I_SENSOR])]
        return Innovation(
            **self.head("innovation/" + sensor, session, v[L.I_TIME]),
            sensor=sensor,
            instance=INSTANCES.get(int(v[L.I_SOURCE]), 0),
            r=tuple(map(_number, v[L.I_R : L.I_R + m])),
            S=tuple(map(_number, v[L.I_S : L.I_S + m * m])),
            nis=_number(v[L.I_NIS]),
            limit=v[L.I_LIMIT],
            fused=bool(v[L.I_FUSED]),
            reason=REASONS.get(int(v[L.I_REASON])),
        )

    def event(self, note: Array, session: int) -> Event:
        """The Event of a note row (NOTE_WIDTH,)."""
        code = NoteCode(int(note[L.NOTE_CODE]))
        told, start, end, size, a, b = (float(x) for x in note[L.NOTE_TIME : L.NOTE_WIDTH])
        evidence, text = words(code, start, end, size, a, b)
        return Event(
            **self.head("event", session, told),
            kind=code.name.lower(),
            t_start_s=_number(start),
            t_end_s=_number(end),
            size=_number(size),
            evidence=evidence,
            text=text,
        )
