"""What a replay found, as plain values for `--json` and for people: one place for both."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.navigation import layout as L
from mavkf.navigation.records import SENSOR_NAMES, RecordWriter, flag_names, validity
from mavkf.replay.diagnosis import diagnose
from mavkf.replay.results import Result, SessionResult
from mavkf.replay.stretches import sensor_of
from mavkf.replay.tally import Tally
from mavkf.samples import Kind

Array = NDArray[np.float64]
SLOW_HZ = 1.0  # Hz: rates below it are given with more digits
SENSORS = (Kind.IMU, Kind.GNSS, Kind.MAGNETOMETER, Kind.BAROMETER)


def summarise(result: Result, details: bool = False) -> dict[str, Any]:
    """The summary of a replayed log, of numbers, text and None only. details: as of `mavkf.replay.diagnosis.diagnose`."""
    flown = sum(session.tally.span[1] - session.tally.span[0] for session in result.sessions)
    total = result.total_s
    return {
        "log": result.log,
        "size_bytes": result.size,
        "damage": result.damage.as_dict(),
        "sessions": [_session(session, result, details) for session in result.sessions],
        "time": {
            "read_s": round(result.read_s, 4),
            "total_s": round(total, 4),
            "flown_s": round(flown, 3),
            "times_real_time": round(flown / total, 1) if total > 0.0 else None,
        },
    }


def estimated(session: SessionResult) -> bool:
    """Whether anything came of a session: a tilt, a position or a velocity."""
    return bool(session.tally.valid.any())


def warnings(session: SessionResult) -> list[str]:
    """What is missing, and what follows from it: one sentence each."""
    tally, setup = session.tally, session.setup
    said = []
    if not tally.has(Kind.GNSS):
        said.append("no GNSS message: attitude is estimated, position and velocity are unknown")
    elif not tally.has_3d_fix:
        said.append("GNSS never had a 3D fix: attitude is estimated, position and velocity are unknown")
    elif tally.poses and not tally.has_position:
        said.append("no fixes in a row that agree with each other: position and velocity are unknown")
    if not tally.has(Kind.IMU):
        said.append("no IMU message: position and velocity are estimated, attitude is unknown")
    elif setup.imu is None:
        said.append("no usable IMU message in the first seconds: attitude is unknown")
    elif setup.model == "constant-velocity":
        said.append(
            f"the IMU at {setup.imu_rate_hz:.2g} Hz is slow: attitude is coarse, and follows gravity rather than the motion"
        )
    if setup.imu is not None and tally.poses and not tally.has_yaw:
        why = "no heading from the magnetometer" if tally.has(Kind.MAGNETOMETER) else "no magnetometer"
        said.append(f"{why}: yaw is unknown")
    if not estimated(session):
        said.append("nothing could be estimated in this session")
    return said


def _rounded(value: float | None) -> float | None:
    return None if value is None else _number(value, 3)


def _number(value: float, digits: int = 4) -> float | None:
    return round(float(value), digits) if math.isfinite(value) else None


def _session(session: SessionResult, result: Result, details: bool) -> dict[str, Any]:
    tally = session.tally
    first, last = tally.span
    writer = RecordWriter(session.vehicle)
    clock = result.clocks[session.vehicle]
    setup = session.setup
    return {
        "vehicle": session.vehicle,
        "session": session.session,
        "from_s": round(first, 3),
        "to_s": round(last, 3),
        "autopilot": setup.autopilot,
        "vehicle_type": setup.vehicle_type,
        "setup": list(setup.reasons),
        "smoothing": list(session.hindsight),
        "filter": _filter(session),
        "delays_s": {
            "gnss": setup.gnss_delay,
            "imu": setup.imu_delay,
            "magnetometer": setup.magnetometer_delay,
            "barometer": setup.barometer_delay,
        },
        "rates_hz": _rates(tally),
        "gaps": {"clock": clock.gaps, "longest_s": _number(clock.longest_gap_s, 3), "imu": session.counts["imu_gaps"]},
        "counts": session.counts | {"late": clock.late, "bad_stamps": clock.bad_stamps, "untimed": clock.untimed},
        "sensors": _sensors(tally),
        "diagnosis": diagnose(session, details),
        "end": _end(tally.end),
        "coverage": _coverage(tally),
        "events": [
            {
                "t_s": _number(event.t_boot_s or math.nan, 3),
                "kind": event.kind,
                "start_s": _rounded(event.t_start_s),
                "end_s": _rounded(event.t_end_s),
                "size": event.size,
                "text": event.text,
            }
            for event in (writer.event(note, session.session) for note in tally.notes)
        ],
        "warnings": warnings(session),
    }


def _filter(session: SessionResult) -> dict[str, Any] | None:
    """The form and order that the flight was run with instead of the service's own, the model to begin with, and the cost of a step."""
    if session.form is None:
        return None
    run = session.form
    return {
        "form": run.form,
        "order": run.order,
        "model": session.setup.model,
        "predictions": run.predictions,
        "prediction_us": _number(run.prediction_us, 2),
        "updates": run.updates,
        "update_us": _number(run.update_us, 2),
        "restarts": run.restarts,
    }


def _rates(tally: Tally) -> dict[str, float]:
    return {
        f"{kind.name.lower()} {source.name}": round(rate, 1 if rate >= SLOW_HZ else 3)
        for kind in SENSORS
        for source, rate in tally.rates_hz(kind).items()
    }


def _sensors(tally: Tally) -> dict[str, dict[str, Any]]:
    """By sensor: measurements, share refused, mean NIS for each degree of freedom (1 where the filter is right)."""
    found: dict[str, dict[str, Any]] = {}
    for sensor, name in enumerate(SENSOR_NAMES):
        mine = [kept for kind, kept in tally.innovations.kept.items() if sensor_of(kind) == sensor]
        if mine:
            count, refused = sum(kept.count for kept in mine), sum(kept.refused for kept in mine)
            nis = sum(kept.nis for kept in mine) / (count - refused) if count > refused else None
            found[name] = {"count": count, "refused": refused, "nis": None if nis is None else _number(nis)}
    return found


def _coverage(tally: Tally) -> dict[str, float | None]:
    """Share of the pose rows in which each part is valid."""
    shares = [round(count / tally.poses, 4) if tally.poses else None for count in tally.valid.tolist()]
    return dict(zip(("position", "velocity", "tilt", "yaw"), shares, strict=True))


def _end(row: Array | None) -> dict[str, Any] | None:
    """The last pose: where, how sure, and what the slow errors were found to be."""
    if row is None:
        return None
    degrees = np.degrees
    pose = row[L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36]
    return {
        "t_s": _number(row[L.R_TIME], 3),
        "lat_deg": _number(degrees(row[L.R_LATITUDE]), 7),
        "lon_deg": _number(degrees(row[L.R_LONGITUDE]), 7),
        "alt_amsl_m": _number(row[L.R_HEIGHT], 2),
        "euler_deg": [_number(degrees(a), 2) for a in row[L.R_EULER : L.R_EULER + 3]],
        "sigma_position_m": [_number(math.sqrt(v), 3) for v in pose[[0, 7, 14]]],
        "sigma_euler_deg": [_number(degrees(a), 3) for a in row[L.R_SIGMA_EULER : L.R_SIGMA_EULER + 3]],
        "gyro_bias_b_rad_s": [_number(b, 5) for b in row[L.R_BG : L.R_BG + 3]],
        "accel_bias_b_m_s2": [_number(b, 4) for b in row[L.R_BA : L.R_BA + 3]],
        "valid": {name: getattr(validity(row[L.R_VALID]), name) for name in ("position", "velocity", "tilt", "yaw")},
        "flags": list(flag_names(row[L.R_FLAGS])),
    }
