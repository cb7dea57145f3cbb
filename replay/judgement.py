"""The judgement of a session by its own innovations: what each sensor shows, in words for people and in findings for machines.

A sensor that is in use twice (two receivers) is judged twice. What the filter fuses as an error that lasts (what is known of the
vehicle's class, gravity, rest, a second receiver) has means and correlations that say nothing, and is judged by its size only. So are
velocities of a receiver that knows speed and course while it is slow: it then shows the size of its noise along the course that it holds.

A sensor with more than MOST measurements is judged by STRETCHES stretches of measurements in a row, evenly spread over the session.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavkf.diagnostics import Finding, consistency, distributions, judge_sensor
from mavkf.diagnostics.consequence import weigh
from mavkf.diagnostics.linearisation import MARGINAL
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.replay.advice import AXES, LASTING, NED, UNITS, advice
from mavkf.replay.run import SessionResult
from mavkf.samples import Source

Array = NDArray[np.float64]
MOST, STRETCHES = 20_000, 20
PROBABILITY = 0.01  # that a right filter has anything said of a sensor
GRADES = ("fine", "marginal", "broken")
SLOW = 2.0  # m/s
# Share outside the region of 95 % from which people are told without asking. What sensors' errors do in the long run is never quite
# white: that is told from where sigma is 1.5 times too small for the mean of many.
TOLD, TOLD_LASTING = MARGINAL, 0.2


@dataclass(frozen=True)
class Innovations:
    """Those of one sensor, (n, 3) and (n, 3, 3) with NaN beyond its own size, in time order; used and rejected: how many there are."""

    sensor: Sensor
    source: Source
    other: bool  # beside a main one
    t: Array
    r: Array
    S: Array
    fused: NDArray[np.bool_]
    gate: float
    along: NDArray[np.bool_]  # whose single components mean something

    @property
    def name(self) -> str:
        """What people call it."""
        return self.sensor.name.lower() + (f" {self.source.name}" if self.other else "")


@dataclass(frozen=True)
class Judgement:
    """What is found of one sensor.

    verdict: fine, marginal, broken, or unknown (too few); sentence: of the worst, None where there is nothing to say; consequences:
    departures by what they cost; findings: of all tests, whether it costs anything or not.
    """

    sensor: str
    source: str
    used: int
    refused: int
    verdict: str
    sentence: str | None
    consequences: tuple[Finding, ...]
    findings: tuple[Finding, ...]


def judge_session(session: SessionResult, details: bool = True) -> list[Judgement]:
    """All sensors of a session. details: with the findings of all tests, which take most of the time."""
    return [_judge(innovations, session.setup.imu_rate_hz, details) for innovations in by_sensor(session)]


def by_sensor(session: SessionResult) -> Iterator[Innovations]:
    """The innovations of a session, a sensor and source at a time."""
    rows = session.output.innovations
    main = session.state[L.MAIN]
    for sensor in Sensor:
        mine = rows[rows[:, L.I_SENSOR] == sensor]
        for source in np.unique(mine[:, L.I_SOURCE]):
            chosen = mine[mine[:, L.I_SOURCE] == source]
            other = sensor in (Sensor.GNSS_POSITION, Sensor.GNSS_VELOCITY) and source != main
            yield _innovations(sensor, Source(int(source)), chosen, other, session.output.poses)


def _innovations(sensor: Sensor, source: Source, rows: Array, other: bool, poses: Array) -> Innovations:
    """Innovation rows (n, INNOVATION_WIDTH) of one sensor as vectors and matrices, thinned to what is judged."""
    if len(rows) > MOST:
        each = MOST // STRETCHES
        starts = np.linspace(0, len(rows) - each, STRETCHES).astype(int)
        rows = rows[(starts[:, None] + np.arange(each)).ravel()]
    n, sizes = len(rows), rows[:, L.I_SIZE].astype(int)
    r, S = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    for m in np.unique(sizes):
        some = sizes == m
        r[some, :m] = rows[some, L.I_R : L.I_R + m]
        S[some, :m, :m] = rows[some, L.I_S : L.I_S + m * m].reshape(-1, m, m)
    gate = distributions.chi_square_survival(float(rows[-1, L.I_LIMIT]), int(sizes[-1]))
    m = int(sizes.max())
    t = rows[:, L.I_TIME]
    along = np.full(n, not other and sensor not in LASTING)
    if sensor is Sensor.GNSS_VELOCITY and m < len(NED):
        along &= _speed(t, poses) >= SLOW
    return Innovations(sensor, source, other, t, r[:, :m], S[:, :m, :m], rows[:, L.I_FUSED] > 0.0, gate, along)


def _speed(t: Array, poses: Array) -> Array:
    """Horizontal speed (n,), m/s, at times (n,), NaN where it is not known."""
    if not len(poses):
        return np.full(len(t), np.nan)
    k = np.clip(np.searchsorted(poses[:, L.R_TIME], t), 0, len(poses) - 1)
    return np.asarray(np.hypot(poses[k, L.R_V], poses[k, L.R_V + 1]))


def _judge(found: Innovations, imu_rate_hz: float, details: bool) -> Judgement:
    axes = AXES[found.sensor][: found.r.shape[1]]
    used = found.fused & np.isfinite(found.r).any(axis=1)
    r, S = found.r[used], found.S[used]
    nis, components = consistency.squared(r, S)
    unit, scale = UNITS[found.sensor]
    variances = np.diagonal(S, axis1=1, axis2=2)
    consequences = weigh(
        r * scale,
        variances * scale**2,
        nis,
        components,
        axes,
        unit=unit,
        probability=PROBABILITY,
        gate=found.gate,
        along=found.along[used],
    )
    findings = (
        judge_sensor(
            found.name, found.t, found.r, found.S, found.fused, axes=axes, probability=PROBABILITY, gate=found.gate
        ).findings
        if details
        else ()
    )
    verdict = max((finding.verdict for finding in consequences), key=GRADES.index, default="unknown")
    told = [
        f for f in consequences if f.verdict == "broken" and f.value > (TOLD_LASTING if f.name == "lasting" else TOLD)
    ]
    worst = max(told, key=lambda finding: finding.value, default=None)
    sentence = (
        None if worst is None else f"{found.name} {worst.sentence}: {advice(found.sensor, worst.name, imu_rate_hz)}"
    )
    return Judgement(
        found.name, found.source.name, len(r), int(np.sum(~found.fused)), verdict, sentence, consequences, findings
    )
