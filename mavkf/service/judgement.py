"""What a live vehicle's filter shows of itself, for its status: recent innovations, the covariance, the curvature of the models."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.diagnostics.covariance import judge_condition
from mavkf.navigation import layout as L
from mavkf.service.consistency import RecentInnovations
from mavkf.service.linearisation import RecentLinearisation

Array = NDArray[np.float64]
CONDITION_EVERY = 5  # reports: eigenvalues take half a millisecond, and change slowly


class Judgement:
    """The judgement of one session, bounded in memory and the same however rows are cut into calls."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self._innovations, self._linearisation = RecentInnovations(), RecentLinearisation()
        self._reports = 0
        self._condition: tuple[float | None, str | None] = (None, None)

    def take(self, innovations: Array) -> None:
        """Note innovation rows (n, INNOVATION_WIDTH)."""
        self._innovations.take(innovations)
        self._linearisation.take(innovations)

    def report(self, now: float, row: Array, state: Array, imu_rate_hz: float) -> dict[str, Any]:
        """The fields of a Status that tell of it.

        now: s; row: the pose row (POSE_WIDTH,) of now; state: of the fold (STATE_SIZE,); imu_rate_hz: of the IMU in use.
        """
        if self._reports % CONDITION_EVERY == 0:
            condition = judge_condition(L.covariance(state))
            self._condition = condition.value if math.isfinite(condition.value) else None, condition.sentence
        self._reports += 1
        speed = math.hypot(row[L.R_V], row[L.R_V + 1])
        return {
            "innovations": self._innovations.report(now, speed, state[L.MAIN], imu_rate_hz),
            "condition": self._condition[0],
            "covariance": self._condition[1],
            "linearisation": self._linearisation.report(now, row, state),
        }
