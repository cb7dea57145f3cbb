"""The innovations of one sensor, and what they say: of a whole session, or of the last minute of a live one.

What the filter fuses as an error that lasts (what is known of the vehicle's class, gravity, rest, a second receiver) has means and
correlations that say nothing, and is judged by its size only. So are velocities of a receiver that knows speed and course while it is
slow: it then shows the size of its noise along the course that it holds.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mavkf.diagnostics import Finding, distributions
from mavkf.diagnostics.consequence import FEWEST, weigh, weigh_refusals
from mavkf.diagnostics.linearisation import MARGINAL
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.replay.advice import AXES, LASTING, NED, UNITS, advice
from mavkf.samples import Source

Array = NDArray[np.float64]
PROBABILITY = 0.01  # that a right filter has anything said of a sensor
SLOW = 2.0  # m/s
# Share outside the region of 95 % from which people are told without asking. What sensors' errors do in the long run is never quite
# white: that is told from where sigma is 1.5 times too small for the mean of many.
TOLD, TOLD_LASTING = MARGINAL, 0.2


@dataclass(frozen=True)
class Innovations:
    """Innovation rows (n, INNOVATION_WIDTH) of one sensor and source, in time order.

    other: it stands beside a main one; along: (n,) whose single components mean something.
    """

    sensor: Sensor
    source: Source
    other: bool
    rows: Array
    along: NDArray[np.bool_]

    def some(self, chosen: NDArray[np.intp]) -> "Innovations":
        """Those of some rows."""
        return replace(self, rows=self.rows[chosen], along=self.along[chosen])

    @property
    def name(self) -> str:
        """What people call it."""
        return self.sensor.name.lower() + (f" {self.source.name}" if self.other else "")

    @property
    def t(self) -> Array:
        """Times (n,), s."""
        return self.rows[:, L.I_TIME]

    @property
    def fused(self) -> NDArray[np.bool_]:
        """Whether each was fused (n,)."""
        return np.asarray(self.rows[:, L.I_FUSED] > 0.0)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the components, of as many as the largest has."""
        return AXES[self.sensor][: int(self.rows[:, L.I_SIZE].max())]

    @property
    def gate(self) -> float:
        """Probability with which a right one is refused."""
        return _probability_beyond(float(self.rows[-1, L.I_LIMIT]), int(self.rows[-1, L.I_SIZE]))

    def vectors(self) -> tuple[Array, Array]:
        """r (n, m) and S (n, m, m), NaN where a smaller one has no component."""
        most = len(self.axes)
        n, sizes = len(self.rows), self.rows[:, L.I_SIZE].astype(int)
        r, S = np.full((n, most), np.nan), np.full((n, most, most), np.nan)
        for m in np.unique(sizes):
            some = sizes == m
            r[some, :m] = self.rows[some, L.I_R : L.I_R + m]
            S[some, :m, :m] = self.rows[some, L.I_S : L.I_S + m * m].reshape(-1, m, m)
        return r, S

    def consequences(self) -> tuple[Finding, ...]:
        """What refusals, and departures of those that were fused, cost, in the units of people; none where there are too few."""
        used = self.fused
        count = int(np.count_nonzero(used))
        if len(used) < FEWEST:
            return ()
        refusals = weigh_refusals(len(used) - count, len(used), PROBABILITY, self.gate)
        if not count:
            return (refusals,)
        r, S = self.vectors()
        unit, scale = UNITS[self.sensor]
        departures = weigh(
            scale * r[used],
            scale**2 * np.diagonal(S[used], axis1=1, axis2=2),
            self.rows[used, L.I_NIS],
            self.rows[used, L.I_SIZE].astype(int),
            self.axes,
            unit=unit,
            probability=PROBABILITY,
            gate=self.gate,
            along=self.along[used],
        )
        return (refusals, *departures)

    def sentence(self, consequences: tuple[Finding, ...], imu_rate_hz: float) -> str | None:
        """The worst of them as one sentence with what to look at, None where people need not be told."""
        told = [
            finding for finding in consequences if finding.verdict == "broken" and finding.value > _told(finding.name)
        ]
        if not told:
            return None
        worst = max(told, key=lambda finding: finding.value)
        return f"{self.name} {worst.sentence}: {advice(self.sensor, worst.name, imu_rate_hz)}"


def _told(kind: str) -> float:
    return TOLD_LASTING if kind == "lasting" else TOLD


@lru_cache(64)
def _probability_beyond(limit: float, components: int) -> float:
    return distributions.chi_square_survival(limit, components)


def kinds(rows: Array) -> Array:
    """A number (n,) for the sensor and source of each innovation row (n, INNOVATION_WIDTH)."""
    return np.asarray(rows[:, L.I_SENSOR] * len(Source) + rows[:, L.I_SOURCE])


def of_one(rows: Array, speed: Array, main: float) -> Innovations:
    """Innovation rows (n, INNOVATION_WIDTH; at least one) of one sensor and source.

    speed: (n,) horizontal speed of the vehicle at each, m/s, NaN where it is not known; main: source of the main receiver.
    """
    sensor, source = Sensor(int(rows[0, L.I_SENSOR])), Source(int(rows[0, L.I_SOURCE]))
    other = sensor in (Sensor.GNSS_POSITION, Sensor.GNSS_VELOCITY) and source != main
    along = np.full(len(rows), not other and sensor not in LASTING)
    if sensor is Sensor.GNSS_VELOCITY:
        along &= (rows[:, L.I_SIZE] == len(NED)) | (speed >= SLOW)
    return Innovations(sensor, source, other, rows, along)
