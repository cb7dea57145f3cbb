"""What is left of a session when its rows have gone by: enough to summarise and to judge it, and small however long it was."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mavkf.navigation import layout as L
from mavkf.navigation.estimator import Output
from mavkf.replay.states import States
from mavkf.replay.stretches import Stretches
from mavkf.samples import FIX, KIND, SOURCE, TIME, Kind, Source

Array = NDArray[np.float64]
VALID = (L.VALID_POSITION, L.VALID_VELOCITY, L.VALID_TILT, L.VALID_YAW)


class Heard:
    """The rows of one sensor: how many, and the first and last of their times (s)."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.count = 0
        self.first, self.last = np.inf, -np.inf

    @property
    def rate_hz(self) -> float | None:
        """Rows a second, None for less than two."""
        span = self.last - self.first
        return (self.count - 1) / span if self.count > 1 and span > 0.0 else None


class Tally:
    """Takes sample rows and outputs of a session as they come."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.heard: dict[tuple[Kind, Source], Heard] = {}
        self.has_3d_fix = False
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
        times = self.heard.values()
        return min(each.first for each in times), max(each.last for each in times)

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
        return any(each is kind for each, _ in self.heard)

    def take_rows(self, rows: Array) -> None:
        """Take timed sample rows (n, ROW_WIDTH)."""
        for kind, source, mine in _by_source(rows):
            heard = self.heard.setdefault((kind, source), Heard())
            heard.count += len(mine)
            heard.first = min(heard.first, float(mine[:, TIME].min()))
            heard.last = max(heard.last, float(mine[:, TIME].max()))
            if kind is Kind.GNSS and not self.has_3d_fix:
                self.has_3d_fix = bool(np.any(mine[:, FIX] >= 3))  # noqa: PLR2004 (GPS_FIX_TYPE_3D_FIX)

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


def _by_source(rows: Array) -> Iterator[tuple[Kind, Source, Array]]:
    """The rows of each kind and source."""
    key = rows[:, KIND].astype(np.int64) * len(Source) + rows[:, SOURCE].astype(np.int64)
    for each in np.flatnonzero(np.bincount(key)).tolist():
        kind, source = divmod(each, len(Source))
        yield Kind(kind), Source(source), rows[key == each]
