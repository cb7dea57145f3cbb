"""Estimates as columns and as CSV: degrees and metres, blank where nothing is known."""

import math
import os
import stat
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np
from numpy.typing import NDArray

from mavkf.decimals import lines
from mavkf.errors import UsageError
from mavkf.estimate import Pose
from mavkf.navigation import layout as L
from mavkf.navigation.records import MODES
from mavkf.navigation.spool import needs_room

Array = NDArray[np.float64]
DECIMALS = {
    "time_boot_s": 6,
    "lat_deg": 10,
    "lon_deg": 10,
    "alt_amsl_m": 4,
    "alt_ellipsoid_m": 4,
    "vn_ms": 5,
    "ve_ms": 5,
    "vd_ms": 5,
    "roll_deg": 5,
    "pitch_deg": 5,
    "yaw_deg": 5,
    "sigma_n_m": 4,
    "sigma_e_m": 4,
    "sigma_d_m": 4,
    "sigma_vn_ms": 5,
    "sigma_ve_ms": 5,
    "sigma_vd_ms": 5,
    "sigma_roll_deg": 5,
    "sigma_pitch_deg": 5,
    "sigma_yaw_deg": 5,
    "pl_h_m": 3,
    "pl_v_m": 3,
}


BLOCK = 4096  # rows that are written at once
PIECE = 1 << 20  # bytes that are copied at once
_MODES = [mode.encode() for mode in MODES]


def columns(poses: Array) -> dict[str, Array]:
    """Columns by the names of DECIMALS, each (n,), of pose rows (n, POSE_WIDTH); NaN where nothing is known."""
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
    return dict(zip(DECIMALS, values, strict=True))


def pose_columns(poses: Sequence[Pose]) -> dict[str, Array]:
    """Columns by the names of DECIMALS, each (n,), of pose records; NaN where nothing is known."""
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
    table = np.array(rows, dtype=np.float64).reshape(len(rows), len(DECIMALS))
    return dict(zip(DECIMALS, table.T, strict=True))


def _euler_sigmas(rotation: Array, angles: Array) -> list[float]:
    """One sigma (deg) of roll, pitch, yaw from the covariance (3, 3; rad^2) of the rotation about n."""
    yaw = angles[2] if math.isfinite(angles[2]) else 0.0
    known = np.nan_to_num(rotation)
    c, s, cp, tp = math.cos(yaw), math.sin(yaw), math.cos(angles[1]), math.tan(angles[1])
    rows = np.array([[c / cp, s / cp, 0.0], [-s, c, 0.0], [c * tp, s * tp, 1.0]])
    sigmas = np.degrees(np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", rows, known, rows), 0.0)))
    return [sigma if math.isfinite(angle) else math.nan for sigma, angle in zip(sigmas, angles, strict=True)]


class CsvFile:
    """Writes pose rows to a CSV file as they come, those of each vehicle behind each other.

    Columns: vehicle, session, then those of DECIMALS, then mode. What a log's senders are is known when it is read, so the rows of each
    wait in a temporary file until then.
    """

    def __init__(self, path: Path) -> None:
        """Raises UsageError where the file cannot be written. What is in it stays until `finish`."""
        self._path = path
        self._parts: dict[str, IO[bytes]] = {}
        self._ends = ExitStack()
        try:
            self._file = self._ends.enter_context(path.open("ab"))
        except OSError as error:
            raise self._unwritable(error) from None

    def __enter__(self) -> "CsvFile":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(OSError):  # of what `finish` could not write
            self._ends.close()

    def take(self, vehicle: str, session: int, poses: Array) -> None:
        """Take pose rows (n, POSE_WIDTH) of a session of a vehicle. Raises UsageError where the disk is full."""
        if vehicle not in self._parts:
            with needs_room():
                self._parts[vehicle] = self._ends.enter_context(tempfile.TemporaryFile())  # noqa: SIM115 (closed by the stack)
        for first in range(0, len(poses), BLOCK):
            some = poses[first : first + BLOCK]
            head, modes = f"{vehicle},{session},".encode(), some[:, L.R_MODE].astype(np.int64)
            text = lines(np.column_stack(list(columns(some).values())), list(DECIMALS.values()), head, _MODES, modes)
            with needs_room():
                self._parts[vehicle].write(text)

    def finish(self, vehicles: Iterable[str]) -> int:
        """Write the rows of vehicles, in this order; returns their number. Raises UsageError."""
        count = 0
        with needs_room():
            for each in self._parts.values():
                each.seek(0)
        try:
            if stat.S_ISREG(os.fstat(self._file.fileno()).st_mode):
                self._file.truncate(0)
            self._file.write(("vehicle,session," + ",".join(DECIMALS) + ",mode\n").encode())
            for vehicle in vehicles:
                part = self._parts.get(vehicle)
                if part is not None:
                    while piece := part.read(PIECE):
                        count += piece.count(b"\n")
                        self._file.write(piece)
            self._file.flush()
        except OSError as error:
            raise self._unwritable(error) from None
        return count

    def _unwritable(self, error: OSError) -> UsageError:
        return UsageError(
            f"{self._path}: cannot be written ({error.strerror}); give the path of a file in a folder that exists"
        )
