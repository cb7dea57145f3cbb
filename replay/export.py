"""Estimates as columns and as CSV: degrees and metres, blank where nothing is known."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import UsageError
from mavkf.estimate import Pose
from mavkf.navigation import layout as L
from mavkf.navigation.records import MODES
from mavkf.replay.run import SessionResult

Array = NDArray[np.float64]
FORMATS = {
    "time_boot_s": "%.6f",
    "lat_deg": "%.10f",
    "lon_deg": "%.10f",
    "alt_amsl_m": "%.4f",
    "alt_ellipsoid_m": "%.4f",
    "vn_ms": "%.5f",
    "ve_ms": "%.5f",
    "vd_ms": "%.5f",
    "roll_deg": "%.5f",
    "pitch_deg": "%.5f",
    "yaw_deg": "%.5f",
    "sigma_n_m": "%.4f",
    "sigma_e_m": "%.4f",
    "sigma_d_m": "%.4f",
    "sigma_vn_ms": "%.5f",
    "sigma_ve_ms": "%.5f",
    "sigma_vd_ms": "%.5f",
    "sigma_roll_deg": "%.5f",
    "sigma_pitch_deg": "%.5f",
    "sigma_yaw_deg": "%.5f",
    "pl_h_m": "%.3f",
    "pl_v_m": "%.3f",
}


BLOCK = 10_000  # rows that are written at once


def columns(poses: Array) -> dict[str, Array]:
    """Columns by the names of FORMATS, each (n,), of pose rows (n, POSE_WIDTH); NaN where nothing is known."""
    pose = poses[:, L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36]
    velocity = poses[:, L.R_VELOCITY_COVARIANCE : L.R_VELOCITY_COVARIANCE + 9]
    values = [
        poses[:, L.R_TIME],
        *np.degrees(poses[:, L.R_LATITUDE : L.R_LONGITUDE + 1]).T,
        poses[:, L.R_HEIGHT],
        poses[:, L.R_HEIGHT] + poses[:, L.R_UNDULATION],
        *poses[:, L.R_V : L.R_V + 3].T,
        *np.degrees(poses[:, L.R_EULER : L.R_EULER + 3]).T,
        *np.sqrt(pose[:, [0, 7, 14]]).T,
        *np.sqrt(velocity[:, [0, 4, 8]]).T,
        *np.degrees(poses[:, L.R_SIGMA_EULER : L.R_SIGMA_EULER + 3]).T,
        *poses[:, L.R_PL_H : L.R_PL_V + 1].T,
    ]
    return dict(zip(FORMATS, values, strict=True))


def pose_columns(poses: Sequence[Pose]) -> dict[str, Array]:
    """Columns by the names of FORMATS, each (n,), of pose records; NaN where nothing is known."""
    nothing = (math.nan,) * 3

    def numbers(values: Sequence[float | None] | None) -> list[float]:
        return [math.nan if value is None else value for value in (nothing if values is None else values)]

    rows = []
    for pose in poses:
        covariance = numbers(pose.pose_covariance or (None,) * 36)
        velocity = numbers(pose.velocity_covariance or (None,) * 9)
        rotation = np.array([covariance[6 * i + j] for i in range(3, 6) for j in range(3, 6)]).reshape(3, 3)
        angles = numbers(pose.euler_deg)
        rows.append(
            numbers((pose.t_boot_s, pose.lat_deg, pose.lon_deg, pose.alt_amsl_m, pose.alt_ellipsoid_m))
            + numbers(pose.velocity_ned_m_s)
            + angles
            + [math.sqrt(covariance[k]) for k in (0, 7, 14)]
            + [math.sqrt(velocity[k]) for k in (0, 4, 8)]
            + _euler_sigmas(rotation, np.radians(angles))
            + numbers((pose.pl_h_m, pose.pl_v_m))
        )
    table = np.array(rows, dtype=np.float64).reshape(len(rows), len(FORMATS))
    return dict(zip(FORMATS, table.T, strict=True))


def _euler_sigmas(rotation: Array, angles: Array) -> list[float]:
    """One sigma (deg) of roll, pitch, yaw from the covariance (3, 3; rad^2) of the rotation about n."""
    yaw = angles[2] if math.isfinite(angles[2]) else 0.0
    known = np.nan_to_num(rotation)
    c, s, cp, tp = math.cos(yaw), math.sin(yaw), math.cos(angles[1]), math.tan(angles[1])
    rows = np.array([[c / cp, s / cp, 0.0], [-s, c, 0.0], [c * tp, s * tp, 1.0]])
    sigmas = np.degrees(np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", rows, known, rows), 0.0)))
    return [sigma if math.isfinite(angle) else math.nan for sigma, angle in zip(sigmas, angles, strict=True)]


def write_csv(path: Path, sessions: Iterable[SessionResult]) -> int:
    """Write the estimates of sessions to a CSV file; returns the number of rows. Raises UsageError where it cannot be written.

    Columns: vehicle, session, then those of FORMATS, then mode.
    """
    count = 0
    pattern = ",".join(FORMATS.values())
    try:
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.write("vehicle,session," + ",".join(FORMATS) + ",mode\n")
            for result in sessions:
                head = f"{result.vehicle},{result.session},"
                for first in range(0, result.output.poses.shape[0], BLOCK):
                    poses = result.output.poses[first : first + BLOCK]
                    table = np.column_stack(list(columns(poses).values()))
                    modes = [MODES[int(mode)] for mode in poses[:, L.R_MODE]]
                    # NaN prints as nan: the only letters in the numbers, so they can be taken out as text
                    file.writelines(
                        head + (pattern % tuple(row)).replace("nan", "") + "," + mode + "\n"
                        for row, mode in zip(table.tolist(), modes, strict=True)
                    )
                    count += poses.shape[0]
    except OSError as error:
        raise UsageError(
            f"{path}: cannot be written ({error.strerror}); give the path of a file in a folder that exists"
        ) from None
    return count
