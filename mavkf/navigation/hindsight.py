"""What a whole flight tells of its sensors, for a second pass over it: how the receiver's error wanders, and when a fault began."""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode, Sensor
from mavkf.navigation.fusing import SLOWEST_FOR_LEARNING
from mavkf.navigation.learning import CALM
from mavkf.navigation.parameter import Parameter

Array = NDArray[np.float64]
CONSTANT = 1e4  # s: time constant of an error that does not change in any flight
SUSPICIONS = {NoteCode.GNSS_DRIFT: L.SUSPECT_POSITION, NoteCode.GNSS_VELOCITY_WRONG: L.SUSPECT_VELOCITY}
STRETCH = 100  # fixes, of which two axes show a variance to 10 % (the root of 2 over the number of values)
MOST_CORRELATED = 0.95
BEST_SPEED = 0.05  # m/s: no receiver is believed to be better than datasheets of consumer ones state (u-blox M8, M10)
AXES = (("horizontally", slice(0, 2)), ("vertically", slice(2, 3)))


class Hindsight(msgspec.Struct):
    """For `smoothing.use_hindsight`: held (k, 2) and faults (k, 3); in words: one sentence for each."""

    held: Array
    faults: Array
    words: tuple[str, ...]


NOTHING_KNOWN = Hindsight(np.empty((0, 2)), np.empty((0, 3)), ())


class Scatter:
    """Horizontal velocity innovations of one receiver, summed up as they come: how noisy its velocity has looked."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self._square, self._product = 0.0, 0.0
        self._recent = np.empty((0, 2))
        self._noisiest = 0.0

    def take(self, r: Array) -> None:
        """Take innovations (n, 2), m/s."""
        joined = np.concatenate([self._recent[-1:], r])
        self._square += float(np.sum(r * r))
        self._product += float(np.sum(joined[1:] * joined[:-1]))
        values = np.concatenate([self._recent, r])
        first = 0
        while len(values) - first >= 2 * STRETCH:
            self._noisiest = max(self._noisiest, _power(values[first : first + STRETCH]))
            first += STRETCH
        self._recent = values[first:]

    @property
    def sigma(self) -> float:
        """One sigma (m/s) of white noise that tells as little as noise of this correlation does in the noisiest stretch.

        Infinite before one is full. All of an innovation is taken for the receiver's; what lingers from fix to fix, as its own filter makes
        it, counts as `receivers.lasting` says. What lasts longer than the estimator remembers does not show.
        """
        if len(self._recent) < STRETCH:
            return math.inf
        noisiest = max(self._noisiest, _power(self._recent[:STRETCH]), _power(self._recent[-STRETCH:]))
        rho = min(max(self._product / self._square, 0.0), MOST_CORRELATED) if self._square > 0.0 else 0.0
        return math.sqrt(noisiest * (1.0 + rho) / (1.0 - rho))


def _power(r: Array) -> float:
    """Mean square of an axis of innovations (n, 2)."""
    return float(np.mean(r * r))


class Surprise:
    """How much the fixes of a flight surprised, summed up as they come: NIS of each axis of the positions, scatter of the velocities."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.count = 0
        self._nis = np.zeros(3)
        self._velocities: dict[float, Scatter] = {}

    def take(self, innovations: Array) -> None:
        """Take innovation rows (n, INNOVATION_WIDTH)."""
        fused = innovations[innovations[:, L.I_FUSED] > 0.0]
        mine = fused[fused[:, L.I_SENSOR] == Sensor.GNSS_POSITION.value]
        self.count += len(mine)
        variances = mine[:, [L.I_S, L.I_S + 4, L.I_S + 8]]
        self._nis += np.sum(mine[:, L.I_R : L.I_R + 3] ** 2 / variances, axis=0)
        velocities = fused[fused[:, L.I_SENSOR] == Sensor.GNSS_VELOCITY.value]
        for source in np.unique(velocities[:, L.I_SOURCE]):
            scatter = self._velocities.setdefault(float(source), Scatter())
            scatter.take(velocities[velocities[:, L.I_SOURCE] == source, L.I_R : L.I_R + 2])

    def mean(self, axes: slice) -> float:
        """Mean over some axes."""
        return float(np.mean(self._nis[axes])) / self.count

    @property
    def speed_sigma(self) -> float:
        """One sigma (m/s) of the velocity that every receiver has kept to; infinite where one of them has not told enough."""
        return max((scatter.sigma for scatter in self._velocities.values()), default=math.inf)


def look_back(state: Array, c: Array, surprise: Surprise, notes: Array) -> Hindsight:
    """Learn from a pass over a flight: final state, parameters, how its fixes surprised, and all notes (n, NOTE_WIDTH).

    The wander of a receiver and the motion look alike to a smoother wherever the wander is allowed to be large. A filter has to
    allow it before it knows; afterwards it is known. Where the positions surprised so little that they do not wander (`CALM`, mean NIS
    per degree of freedom), their error is a constant. Where they do, it lasts as long, and vertically is as large, as was learnt in the
    end; horizontally its size follows what happens, as in the first pass.

    Before it is known, a velocity is never believed to be better than a floor. With an IMU fast enough that innovations speak of the
    receiver, they tell afterwards where it was.
    """
    held: list[tuple[float, float]] = []
    words: list[str] = []
    for axis, (where, columns) in enumerate(AXES):
        if not surprise.count:
            break
        sigma, tau = state[L.COLOUR + axis], state[L.COLOUR_TIME + axis]
        if surprise.mean(columns) < CALM:
            held.append((L.COLOUR_TIME + axis, CONSTANT))
            words.append(f"smoothed: {where} the GNSS position does not wander, so its error is a constant")
        else:
            held.append((L.COLOUR_TIME + axis, tau))
            if axis == 1:
                held.append((L.COLOUR + axis, sigma))
            words.append(f"smoothed: {where} the GNSS position wanders, by {sigma:.1f} m in {tau:.0f} s")
    speed = max(surprise.speed_sigma, BEST_SPEED)
    if speed < c[Parameter.SPEED_FLOOR] and c[Parameter.IMU_PERIOD] <= SLOWEST_FOR_LEARNING:
        held.append((L.KNOWN_SPEED, speed))
        words.append(f"smoothed: the GNSS velocity has kept to {speed:.2f} m/s, and is weighed by that")
    faults = [
        (SUSPICIONS[NoteCode(int(note[L.NOTE_CODE]))], note[L.NOTE_START], note[L.NOTE_TIME])
        for note in notes
        if int(note[L.NOTE_CODE]) in SUSPICIONS and not math.isfinite(note[L.NOTE_END])
    ]
    words += [
        f"smoothed: a fault of GNSS found at {told:.1f} s is left out from {start:.1f} s on"
        for _, start, told in faults
    ]
    return Hindsight(np.array(held).reshape(-1, 2), np.array(faults).reshape(-1, 3), tuple(words))
