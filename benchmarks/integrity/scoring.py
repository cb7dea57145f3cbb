"""From errors and signs of one run to what it counts: when its fault was told, the errors before and after, the recovery."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.integrity.common import Array
from benchmarks.integrity.drawing import HORIZONTAL
from benchmarks.integrity.signs import Sign
from mavkf.replay.export import columns
from mavkf.replay.truth import SIGMAS, Truth, errors

LEAD = 0.5  # s: a fix is fused at the time of its measurement, which is that much or less before its stamp
WITHIN, STAYS = 3.0, 5.0  # claimed sigmas, s: an error that stays within them for so long has recovered
AHEAD = 20.0  # s
NOTHING = math.nan


@dataclass(frozen=True)
class Score:
    """What one run with one fault counts; NaN: not, or not known.

    told:     s from the fault's begin to the first sign of any fault.
    named:    s from the fault's begin to the first sign that names it right.
    before:   the largest error until `told`, or until the fault ends.
    after:    the largest error from `told` until the fault ends.
    early:    whether there was a sign in the AHEAD seconds before the fault, when nothing was wrong.
    recovery: s from the fault's end until the error is within WITHIN sigma for STAYS seconds; infinite: not while the run lasted.
    """

    told: float
    named: float
    before: float
    after: float
    recovery: float
    early: bool


@dataclass(frozen=True)
class Track:
    """The error of one quantity at times t (n), s: its size (n) and its claimed sigma (n), in its unit."""

    t: Array
    error: Array
    sigma: Array


def track(poses: Array, truth: Truth, quantity: str, begin: float, end: float) -> Track:
    """The error of a quantity of pose rows (n, POSE_WIDTH) between two times, s.

    Sigma of `horizontal_m` is the root of the sum of squares of its parts'.
    """
    begin, end = max(begin, float(truth.time_boot_s[0])), min(end, float(truth.time_boot_s[-1]))
    pose = columns(poses)
    use = (pose["time_boot_s"] >= begin) & (pose["time_boot_s"] <= end)
    pose = {name: column[use] for name, column in pose.items()}
    error = np.abs(errors(pose, truth).values[quantity])
    parts = ("sigma_n_m", "sigma_e_m") if quantity == HORIZONTAL else (SIGMAS[quantity],)
    sigma = np.sqrt(np.sum([pose[name] ** 2 for name in parts], axis=0))
    return Track(pose["time_boot_s"], error, sigma)


def score(run: Track, begin: float, end: float, signs: Sequence[Sign], right: Sequence[str]) -> Score:
    """Score a run whose fault lasts from `begin` to `end`, s; right: the kinds of signs that name it."""
    during = [sign for sign in signs if begin - LEAD <= sign.t < end]
    told = _first(during, begin)
    named = _first([sign for sign in during if sign.kind in right], begin)
    split = begin + told if math.isfinite(told) else end
    early = (run.t >= begin) & (run.t < split)
    late = (run.t >= split) & (run.t < end)
    sooner = any(begin - LEAD - AHEAD <= sign.t < begin - LEAD for sign in signs)
    return Score(told, named, _largest(run.error[early]), _largest(run.error[late]), _recovery(run, end), sooner)


def _first(signs: Sequence[Sign], begin: float) -> float:
    return max(0.0, min(sign.t for sign in signs) - begin) if signs else NOTHING


def _largest(error: Array) -> float:
    known = error[np.isfinite(error)]
    return float(known.max()) if known.size else NOTHING


def _recovery(run: Track, end: float) -> float:
    """Time from the end of the fault to the first time from which on the error is within sigma for STAYS seconds."""
    after = run.t >= end
    t = run.t[after]
    if not t.size:
        return math.inf
    with np.errstate(invalid="ignore"):  # what is not known is not within
        outside = t[~(run.error[after] <= WITHIN * run.sigma[after])]
    # the stretches between times outside: the first that is long enough
    starts = np.concatenate([[end], outside])
    ends = np.concatenate([outside, [t[-1]]])
    long = np.flatnonzero(ends - starts >= STAYS)
    return float(starts[long[0]] - end) if long.size else math.inf
