"""Divergence watch: innovations that grow while the filter grows surer.

The filter's own covariance does not see what it has wrong; only the innovations do (Fitzgerald, "Divergence of the Kalman Filter", IEEE
Trans. Automatic Control AC-16, 1971). The later half of a run is compared with the earlier one: the ratio of their NIS has Fisher's F
distribution where S is right, or wrong by the same factor all along.
"""

import math

import numpy as np

from mavkf.diagnostics import consistency, distributions
from mavkf.diagnostics.records import Finding

Array = np.ndarray
FEWEST = 20
NAME = "divergence"
SOURCE = "F distribution of the ratio of two halves; Fitzgerald (1971)"


def judge(r: Array, S: Array, probability: float, size: Array | None = None) -> Finding:
    """Whether NIS and innovations grew from the first half to the second while P did not. r: (n, m), S: (n, m, m), in time order.

    size: (n,) of P, any measure of it that is comparable over the run; S serves where it is not given.
    """
    n = len(r)
    half = n // 2
    nis, components = consistency.squared(r, S)
    degrees = int(components[:half].sum()), int(components[half:].sum())
    if n < FEWEST or min(degrees) == 0 or not nis[:half].sum() > 0.0:
        sentence = f"{n} innovations are too few to tell; {FEWEST} are needed."
        return Finding(NAME, "", math.nan, 0.0, math.nan, probability, math.nan, "unknown", SOURCE, sentence)
    value = float(nis[half:].sum() / degrees[1] / (nis[:half].sum() / degrees[0]))
    high = distributions.f_bound(probability, degrees[1], degrees[0])
    there = ~np.isnan(r)
    variances = np.where(there, np.diagonal(S, axis1=1, axis2=2), 0.0)
    typical = variances.sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    typical[typical == 0.0] = 1.0  # of an axis that is never there
    squares = np.nansum(r**2 / typical, axis=1)
    grown = squares[half:].sum() / degrees[1] / (squares[:half].sum() / degrees[0])
    if size is None:
        by_axis = (variances / typical).sum(axis=1)
        surer = float(by_axis[half:].sum() / degrees[1] / (by_axis[:half].sum() / degrees[0]))
    else:
        surer = float(np.mean(size[half:]) / np.mean(size[:half]))
    diverging = value > high and grown > 1.0 and surer <= 1.0
    change = f"innovations {math.sqrt(grown):.2g} times, sigma {math.sqrt(surer):.2g} times, from the first half to the second"
    if diverging:
        meaning = "The filter diverges: it grows surer while its errors grow"
    elif value > high:
        meaning = "Innovations grew by more than the filter expected, and it knows that it knows less"
    else:
        meaning = "Innovations have not outgrown what the filter expects"
    p_value = distributions.f_survival(value, degrees[1], degrees[0])
    return Finding(
        NAME,
        "",
        value,
        0.0,
        high,
        probability,
        p_value,
        "off" if diverging else "fine",
        SOURCE,
        f"{meaning} ({change}).",
    )
