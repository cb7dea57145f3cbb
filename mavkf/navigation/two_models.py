"""Which model a slow IMU supports: both are run side by side, and what the other sensors find likelier leads.

The rate gives the odds to begin with; each measurement of GNSS, magnetometer and barometer adds the difference of its logarithmic
likelihoods, -(r' S^-1 r + log det S) / 2, under the two (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and
Navigation", section 11.6). What is long past counts less and less, since the motion and the link change. The one that leads is in the
first half of the state array, where everybody looks; when the other becomes likelier by more than HYSTERESIS they change places.
"""

import math

from mavkf.compiled import kernel
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.covariance import bring_up
from mavkf.navigation.fusing import note
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.slow_imu import enter, leave

FORGETTING = 60.0  # s
HYSTERESIS = 5.0  # natural logarithm of the odds
PRIOR = 10.0  # and what a rate twice as high is worth
MOST_ODDS = 50.0
APART = 1.25  # times the rate below which both are run: above it the second is given up


@kernel
def prior_odds(s, c):
    """Logarithm of the odds of telemetry against strapdown by the rate alone."""
    return PRIOR * math.log(max(s[L.PERIOD], 1e-3) * c[Parameter.EVEN_HZ]) / math.log(2.0)


@kernel
def begin_second(s, e, c, out):
    """Start the other model beside the one that leads, from the same state."""
    bring_up(s, c, out)
    for i in range(L.HALF):
        s[L.HALF + i] = s[i]
    s[L.SECOND] = 1.0
    second = s[L.HALF :]
    if s[L.MODEL] == L.STRAPDOWN:
        second[L.WANTED] = L.TELEMETRY
        second[L.MODEL] = L.TELEMETRY
        enter(second, e, c)
    else:
        second[L.WANTED] = L.STRAPDOWN
        second[L.MODEL] = L.STRAPDOWN
        leave(second)
    s[L.LIKELIHOOD] = 0.0
    second[L.LIKELIHOOD] = 0.0
    s[L.ODDS] = 0.0
    s[L.T_ODDS] = s[L.T]


@kernel
def end_second(s):
    """Give the other model up."""
    s[L.SECOND] = 0.0
    for i in range(L.HALF):
        s[L.HALF + i] = 0.0


@kernel
def change_places(s, out):
    """Let the other model lead."""
    for i in range(L.HALF):
        first = s[i]
        s[i] = s[L.HALF + i]
        s[L.HALF + i] = first
    s[L.SECOND] = 1.0
    s[L.ODDS] = s[L.HALF + L.ODDS]
    s[L.T_ODDS] = s[L.HALF + L.T_ODDS]
    note(out, NoteCode.MODEL_CHANGED, s[L.T], s[L.T], s[L.ODDS], s[L.MODEL], 1.0 / max(s[L.PERIOD], 1e-3))


@kernel
def weigh_models(s, e, c, out):
    """After an IMU event of both halves: begin or end the second, or let it lead."""
    if c[Parameter.COMPARE_HZ] == 0.0:
        return
    rate = 1.0 / max(s[L.PERIOD], 1e-3)
    fast = rate > APART * c[Parameter.COMPARE_HZ]
    carried = s[L.MODEL] != L.CONSTANT_VELOCITY
    if s[L.SECOND] == 0.0:
        if carried and s[L.RESTING] == 0.0 and s[L.MODEL] == s[L.WANTED] and rate < c[Parameter.COMPARE_HZ]:
            begin_second(s, e, c, out)
        elif fast:
            s[L.WANTED] = L.STRAPDOWN
        return
    if fast and s[L.WANTED] == L.TELEMETRY and carried and s[L.HALF + L.MODEL] != L.CONSTANT_VELOCITY:
        change_places(s, out)
    if fast or not carried or s[L.HALF + L.MODEL] == L.CONSTANT_VELOCITY:
        end_second(s)
        return
    forgotten = math.exp(-(s[L.T] - s[L.T_ODDS]) / FORGETTING)
    s[L.T_ODDS] = s[L.T]
    leads = s[L.LIKELIHOOD] - s[L.HALF + L.LIKELIHOOD]
    s[L.LIKELIHOOD] = 0.0
    s[L.HALF + L.LIKELIHOOD] = 0.0
    telemetry_leads = s[L.WANTED] == L.TELEMETRY
    s[L.ODDS] = s[L.ODDS] * forgotten + (leads if telemetry_leads else -leads)
    s[L.ODDS] = min(max(s[L.ODDS], -MOST_ODDS), MOST_ODDS)
    odds = s[L.ODDS] + prior_odds(s, c)
    if (odds > HYSTERESIS and not telemetry_leads) or (odds < -HYSTERESIS and telemetry_leads):
        change_places(s, out)
