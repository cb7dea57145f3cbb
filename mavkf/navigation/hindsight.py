"""What a whole flight tells of its sensors, for a second pass over it: how the receiver's error wanders, and when a fault began."""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode, Sensor
from mavkf.navigation.learning import CALM

Array = NDArray[np.float64]
CONSTANT = 1e4  # s: time constant of an error that does not change in any flight
SUSPICIONS = {NoteCode.GNSS_DRIFT: L.SUSPECT_POSITION, NoteCode.GNSS_VELOCITY_WRONG: L.SUSPECT_VELOCITY}
AXES = (("horizontally", slice(0, 2)), ("vertically", slice(2, 3)))


class Hindsight(msgspec.Struct):
    """For `smoothing.use_hindsight`: held (k, 2) and faults (k, 3); in words: one sentence for each."""

    held: Array
    faults: Array
    words: tuple[str, ...]


NOTHING_KNOWN = Hindsight(np.empty((0, 2)), np.empty((0, 3)), ())


class Surprise:
    """How much the fused positions of a flight surprised: NIS of each axis, summed up as they come."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.count = 0
        self._nis = np.zeros(3)

    def take(self, innovations: Array) -> None:
        """Take innovation rows (n, INNOVATION_WIDTH)."""
        position = innovations[:, L.I_SENSOR] == Sensor.GNSS_POSITION.value
        mine = innovations[position & (innovations[:, L.I_FUSED] > 0.0)]
        self.count += len(mine)
        variances = mine[:, [L.I_S, L.I_S + 4, L.I_S + 8]]
        self._nis += np.sum(mine[:, L.I_R : L.I_R + 3] ** 2 / variances, axis=0)

    def mean(self, axes: slice) -> float:
        """Mean over some axes."""
        return float(np.mean(self._nis[axes])) / self.count


def look_back(state: Array, surprise: Surprise, notes: Array) -> Hindsight:
    """Learn from a pass over a flight: its final state, how its positions surprised, and all notes (n, NOTE_WIDTH).

    The wander of a receiver and the motion look alike to a smoother wherever the wander is allowed to be large. A filter has to
    allow it before it knows; afterwards it is known. Where the positions surprised so little that they do not wander (`CALM`, mean NIS
    per degree of freedom), their error is a constant. Where they do, it lasts as long, and vertically is as large, as was learnt in the
    end; horizontally its size follows what happens, as in the first pass.
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
