"""Mean and trend of innovations: both are zero where nothing is left out of the model.

Student's t of the mean and of the slope of a straight line over time (any text of statistics; Draper and Smith, "Applied Regression
Analysis"). They take innovations to be independent: where whiteness fails these say where the error is, not how sure that is.
"""

import math

import numpy as np

from mavkf.diagnostics import distributions
from mavkf.diagnostics.records import Finding

Array = np.ndarray
FEWEST = 3
SOURCE = "Student's t; Draper and Smith, Applied Regression Analysis"


def _unknown(name: str, axis: str, probability: float, sentence: str) -> Finding:
    return Finding(name, axis, math.nan, math.nan, math.nan, probability, math.nan, "unknown", SOURCE, sentence)


def judge_mean(u: Array, probability: float, axis: str = "") -> Finding:
    """The mean of normalised innovations u (n,) of one axis, in parts of their standard deviation."""
    n = len(u)
    if n < FEWEST:
        return _unknown("mean", axis, probability, f"{n} innovations are too few to tell.")
    value, error = float(u.mean()), float(u.std(ddof=1)) / math.sqrt(n)
    high = distributions.student_bound(probability, n - 1) * error
    p_value = distributions.student_two_sided(value / error, n - 1) if error > 0.0 else float(value == 0.0)
    fine = abs(value) <= high
    meaning = "Innovations have no bias" if fine else "The sensor or the model is biased: innovations have a mean"
    sentence = f"{meaning} ({value:+.2f} of their sigma, bound {high:.2f})."
    return Finding("mean", axis, value, -high, high, probability, p_value, "fine" if fine else "off", SOURCE, sentence)


def judge_trend(t: Array, u: Array, probability: float, axis: str = "") -> Finding:
    """The slope over the whole time of normalised innovations u (n,) at times t (n, s): by how many sigma they drift from end to end."""
    n, span = len(u), float(t[-1] - t[0]) if len(t) else 0.0
    if n <= FEWEST or not span > 0.0:
        return _unknown("trend", axis, probability, f"{n} innovations over {span:.3g} s are too few to tell.")
    centred = (t - t.mean()) / span
    power = float(centred @ centred)
    value = float(centred @ u) / power
    rest = u - u.mean() - value * centred
    error = math.sqrt(float(rest @ rest) / (n - 2) / power)
    high = distributions.student_bound(probability, n - 2) * error
    p_value = distributions.student_two_sided(value / error, n - 2) if error > 0.0 else float(value == 0.0)
    fine = abs(value) <= high
    meaning = "Innovations do not drift" if fine else "Innovations drift: an error grows that the model does not have"
    sentence = f"{meaning} ({value:+.2f} of their sigma over {span:.3g} s, bound {high:.2f})."
    return Finding("trend", axis, value, -high, high, probability, p_value, "fine" if fine else "off", SOURCE, sentence)
