"""Logs without truth: how large the innovations are against what was expected, and how far the pose is from the autopilot's own."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.accuracy.common import Settings, cell, head, row, say
from benchmarks.accuracy.downlinked import EKF, Differences, differences, messages_of
from mavkf.errors import MavkfError
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.navigation.records import model_name
from mavkf.replay.export import columns
from mavkf.replay.options import Options
from mavkf.replay.results import Result
from mavkf.replay.run import run as replay
from mavkf.replay.summary import estimated
from mavkf.replay.tlog import Log, read_tlog

FOLDER = "public"
SENSORS = (Sensor.GNSS_POSITION, Sensor.GNSS_VELOCITY, Sensor.MAGNETOMETER, Sensor.BAROMETER)
NIS_BAND = (0.3, 1.5)  # mean of each sensor, per degree of freedom
LEAST_ACCEPTED = 95.0  # % of the fixes
SETTLED = 50.0  # s of a session, before the pose is compared
QUANTITIES = ("horizontal_m", "down_m", "velocity_ms", "tilt_deg", "yaw_deg")


def measure(log: Log, result: Result) -> dict[str, Any]:
    """The figures of a log, all its sessions together."""
    sessions = [session for session in result.sessions if estimated(session)]
    innovations = np.concatenate([session.output.innovations for session in sessions])
    apart = Differences({}, {})
    reports: dict[str, list[NDArray[Any]]] = {name: [] for name in EKF}
    for session in sessions:
        poses = session.output.poses
        apart = apart.plus(differences(log, session, columns(poses), float(poses[0, L.R_TIME]) + SETTLED))
        for name in EKF:
            reports[name].append(messages_of(log, session, "EKF_STATUS_REPORT")[name])
    fixes = innovations[innovations[:, L.I_SENSOR] == Sensor.GNSS_POSITION]
    longest = max(sessions, key=lambda session: session.output.poses.shape[0])
    sent = {name: np.concatenate(values) for name, values in reports.items()}
    return {
        "imu_hz": longest.setup.imu_rate_hz,
        "model": model_name(longest.output.poses[-1]) or "attitude only",
        "sessions": len(sessions),
        "flown_s": sum(float(np.ptp(session.output.poses[:, L.R_TIME])) for session in sessions),
        "nis": {sensor.name.lower(): _nis(innovations, sensor) for sensor in SENSORS},
        "accepted_percent": 100.0 * float(np.mean(fixes[:, L.I_FUSED])) if fixes.shape[0] else np.nan,
        "autopilot": {name: float(np.mean(values)) if values.size else np.nan for name, values in sent.items()},
        "difference": {name: apart.rms(name) for name in QUANTITIES},
        "compared": apart.counts,
    }


def _nis(innovations: NDArray[np.float64], sensor: Sensor) -> float:
    """Mean NIS for each degree of freedom of what was fused of a sensor; NaN where nothing was."""
    mine = innovations[(innovations[:, L.I_SENSOR] == sensor) & (innovations[:, L.I_FUSED] > 0)]
    return float(np.mean(mine[:, L.I_NIS] / mine[:, L.I_SIZE])) if mine.shape[0] else np.nan


def run(settings: Settings) -> dict[str, Any]:
    """Replay all logs and print both tables."""
    results: dict[str, Any] = {}
    for log in sorted((settings.folder / FOLDER).rglob("*.tlog")):
        name = f"{log.parent.name}/{log.stem[:24]}"
        try:
            result = replay(log, Options(as_live=settings.as_live, config=settings.config))
        except MavkfError as error:
            say(f"{name}: {error}")
            continue
        if not any(estimated(session) for session in result.sessions):
            say(f"{name}: nothing could be estimated")
            continue
        results[name] = measure(read_tlog(log), result)
    _innovations(results)
    _differences(results)
    return results


def _innovations(results: dict[str, Any]) -> None:
    head(
        "public: mean NIS per degree of freedom; the autopilot's own test ratios",
        (
            *("log", "IMU Hz", "model", "s", "position", "velocity", "magnetometer", "barometer", "fixes accepted %"),
            *("its velocity", "its position", "its compass"),
        ),
    )
    low, high = NIS_BAND
    for name, result in results.items():
        row(
            name,
            f"{result['imu_hz']:.1f}",
            result["model"],
            f"{result['flown_s']:.0f}",
            *(_known(value, high, low) for value in result["nis"].values()),
            _known(result["accepted_percent"], least=LEAST_ACCEPTED, digits=1),
            *(_known(value, digits=3) for value in result["autopilot"].values()),
        )


def _differences(results: dict[str, Any]) -> None:
    head(
        f"public: pose less the autopilot's downlinked one after {SETTLED:g} s of each session, rms",
        ("log", "horizontal m", "height m", "velocity m/s", "tilt deg", "yaw deg"),
    )
    for name, result in results.items():
        row(name, *(_known(result["difference"][quantity]) for quantity in QUANTITIES))


def _known(value: float, most: float = np.inf, least: float = -np.inf, digits: int = 2) -> str:
    return cell(value, most, least, digits) if np.isfinite(value) else ""
