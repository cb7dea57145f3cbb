"""What is left of a session when its rows have gone by: enough to summarise and to judge it, and small however long it was."""

import numpy as np
from numpy.typing import NDArray

from mavkf.link.heard import BEST_FIX, COUNT, FIRST, LAST, empty_table, hear
from mavkf.navigation import layout as L
from mavkf.navigation.estimator import Output
from mavkf.replay.states import States
from mavkf.replay.stretches import Stretches
from mavkf.samples import Kind, Source

Array = NDArray[np.float64]
FIX_3D = 3  # GPS_FIX_TYPE_3D_FIX
VALID = (L.VALID_POSITION, L.VALID_VELOCITY, L.VALID_TILT, L.VALID_YAW)


class Tally:
    """Takes sample rows and outputs of a session as they come."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self._heard = empty_table()
        self.poses = 0
        self.valid = np.zeros(len(VALID), dtype=np.int64)
        """Pose rows in which position, velocity, tilt and yaw are valid."""
        self.has_position = self.has_yaw = False
        self.first_pose_s = np.nan
        self.end: Array | None = None
        """The last pose row (POSE_WIDTH,)."""
        self.innovations = Stretches()
        self.states = States()
        self._notes: list[Array] = [np.empty((0, L.NOTE_WIDTH))]

    @property
    def span(self) -> tuple[float, float]:
        """Times of the first and the last row, s."""
        return float(self._heard[:, :, FIRST].min()), float(self._heard[:, :, LAST].max())

    @property
    def has_3d_fix(self) -> bool:
        """Whether a receiver had one."""
        return bool(self._heard[Kind.GNSS, :, BEST_FIX].max() >= FIX_3D)

    @property
    def flown_s(self) -> float:
        """From the first pose to the last, s."""
        return float(self.end[L.R_TIME] - self.first_pose_s) if self.end is not None else 0.0

    @property
    def notes(self) -> Array:
        """All notes (n, NOTE_WIDTH)."""
        return np.concatenate(self._notes)

    def has(self, kind: Kind) -> bool:
        """Whether a row of a kind has come."""
        return bool(self._heard[kind, :, COUNT].any())

    def rates_hz(self, kind: Kind) -> dict[Source, float]:
        """Rows a second of a kind, by source, where there are two at least."""
        found = {}
        for source in Source:
            count, first, last, _ = self._heard[kind, source].tolist()
            if count > 1.0 and last > first:
                found[source] = (count - 1.0) / (last - first)
        return found

    def take_rows(self, rows: Array) -> None:
        """Take timed sample rows (n, ROW_WIDTH)."""
        hear(rows, self._heard)

    def take(self, output: Output) -> None:
        """Take what the fold wrote."""
        poses = output.poses
        if len(output.notes):
            self._notes.append(output.notes)
        self.innovations.take(output.innovations, poses)
        self.states.take(poses, output.innovations)
        if not len(poses):
            return
        if not self.poses:
            self.first_pose_s = float(poses[0, L.R_TIME])
        self.poses += len(poses)
        bits = poses[:, L.R_VALID].astype(np.int64)
        self.valid += [int(np.count_nonzero(bits & bit)) for bit in VALID]
        self.has_position |= bool(np.any(np.isfinite(poses[:, L.R_LATITUDE])))
        self.has_yaw |= bool(np.any(np.isfinite(poses[:, L.R_EULER + 2])))
        self.end = poses[-1].copy()

    def finish(self) -> None:
        """Take it that nothing follows."""
        self.innovations.finish()
        self.states.finish()
