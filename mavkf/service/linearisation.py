"""Whether the first order is enough for a live vehicle, for its status: judged at a state now and then, told of the last few."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from mavkf.diagnostics.linearisation import judge
from mavkf.estimate import Linearisation
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.replay.linearity import LONGEST, shares_at
from mavkf.replay.states import JUDGED, KNOWN

Array = NDArray[np.float64]
EVERY = 10.0  # s between two states that are judged
STATES = 8  # that the findings are of
_JUDGED = {float(sensor.value): sensor for sensor in JUDGED}
_POSITION = float(Sensor.GNSS_POSITION.value)


class RecentLinearisation:
    """The shares outside the region of 95 % at the last states, by sensor and for the prediction."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self._newest: dict[Sensor, Array] = {}
        self._between_fixes = LONGEST
        self._shares: dict[str, deque[float]] = {}
        self._judged = -np.inf
        self._found: dict[str, Linearisation] = {}

    def take(self, rows: Array) -> None:
        """Note innovation rows (n, INNOVATION_WIDTH)."""
        for row, sensor in zip(rows, rows[:, L.I_SENSOR].tolist(), strict=True):
            if sensor not in _JUDGED:
                continue
            before = self._newest.get(_JUDGED[sensor])
            if sensor == _POSITION and before is not None and row[L.I_TIME] > before[L.I_TIME]:
                self._between_fixes = min(float(row[L.I_TIME] - before[L.I_TIME]), LONGEST)
            self._newest[_JUDGED[sensor]] = row

    def report(self, now: float, row: Array, state: Array) -> dict[str, Linearisation]:
        """By name. now: s; row: the pose row (POSE_WIDTH,) of now; state: of the fold (STATE_SIZE,)."""
        if now - self._judged >= EVERY and np.all(np.isfinite(row[KNOWN])):
            self._judged = now
            is_integrated = row[L.R_MODEL] == L.STRAPDOWN and state[L.PERIOD] <= L.SLOW
            found = shares_at(
                state[L.X : L.P],
                L.covariance(state),
                state[L.ACCELERATION : L.ACCELERATION + 3],
                row[L.R_RATE : L.R_RATE + 3],
                self._newest,
                self._between_fixes if is_integrated else None,
            )
            for name, share in found:
                self._shares.setdefault(name, deque(maxlen=STATES)).append(share)
            self._found = {name: _finding(name, shares) for name, shares in sorted(self._shares.items())}
        return self._found


def _finding(name: str, shares: deque[float]) -> Linearisation:
    finding = judge(np.array(shares), "prediction" if name == "prediction" else "measurement")
    return Linearisation(outside=finding.value, verdict=finding.verdict, sentence=finding.sentence)
