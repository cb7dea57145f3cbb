"""Estimates as columns and as CSV: degrees and metres, blank where nothing is known."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import UsageError
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
}


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
    ]
    return dict(zip(FORMATS, values, strict=True))


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
                poses = result.output.poses
                table = np.column_stack(list(columns(poses).values()))
                head = f"{result.vehicle},{result.session},"
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
