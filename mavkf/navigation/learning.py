"""What the innovations teach of the noise: variances by their NIS, the coloured part by how successive innovations correlate."""

import math

from mavkf.compiled import kernel
from mavkf.navigation import layout as L
from mavkf.navigation.parameter import Parameter

LEARNING = 0.05  # share of a normalised surprise that goes into a learnt variance
# Horizontally a drift must be followed while it happens; the height's error is mostly the atmosphere's, which takes its time.
COLOUR_LEARNING_HORIZONTAL, COLOUR_LEARNING_VERTICAL = 0.1, 0.04
WALK_LEARNING = 0.2
UNCORRELATED = 0.2  # correlation of velocity innovations that the receiver's own filter makes
MOST_WALK = 1e4  # times the variance: a bias that moves a hundred times faster
UNCOLOURED = 0.1  # correlation that a white noise assumed too large makes by itself
LEAST_SCALE, MOST_SCALE = 0.02, 25.0  # of a learnt variance against what is claimed
LEAST_IMU_SCALE = 0.3  # the floor of the GNSS velocity's noise makes innovations small that do not speak for the IMU
TIME_LEARNING = 0.2
CALM = 0.4  # NIS per degree of freedom of fixes that wander less than assumed beyond doubt
LONGEST_COLOUR = 5.0  # times the assumed time
MOST_COLOUR = 8.0  # times the floor of the coloured sigma


@kernel
def learn(scale, nis, m, share, least):
    """A variance scale after one NIS of m degrees: the gradient of its likelihood, weighted by the share R / S that is its doing."""
    surprise = min(nis / m, 10.0) - 1.0
    return min(max(scale * math.exp(LEARNING * share * surprise), least), MOST_SCALE)


@kernel
def learn_colour_time(s, c, nis, S, axis, dt):
    """Let the coloured error last longer where the fixes wander less than it would make them, after one NIS per degree of freedom.

    Its sigma keeps its floor, since a constant part of it is not seen at all; what is seen is how fast it changes, of the variance
    2 sigma^2 dt / tau from fix to fix, which is its share of S.
    """
    sigma, tau = s[L.COLOUR + axis], s[L.COLOUR_TIME + axis]
    share = min(2.0 * sigma * sigma * dt / (tau * S), 1.0)
    surprise = min(nis, 10.0) - CALM
    least = c[Parameter.COLOUR_TIME]
    s[L.COLOUR_TIME + axis] = min(max(tau * math.exp(-TIME_LEARNING * share * surprise), least), LONGEST_COLOUR * least)


@kernel
def learn_walk(s, r, variance):
    """Let the gyro bias move faster while successive velocity innovations (2,) of this variance agree: something turns unseen.

    A gyro's bias may step (shock, temperature), and a slow sampling of a vibration shows a constant that is not there.
    """
    rho = 0.5 * (r[0] * s[L.LAST_VELOCITY] + r[1] * s[L.LAST_VELOCITY + 1]) / variance
    s[L.LAST_VELOCITY], s[L.LAST_VELOCITY + 1] = r[0], r[1]
    surprise = min(max(rho, -3.0), 3.0) - UNCORRELATED
    s[L.SCALE_WALK] = min(max(s[L.SCALE_WALK] * math.exp(WALK_LEARNING * surprise), 1.0), MOST_WALK)


@kernel
def learn_colour(s, r, S, axis, first, count):
    """Let the sigma of the coloured error follow the correlation of successive position innovations, which is none where it is right."""
    rho = 0.0
    for i in range(first, first + count):
        rho += r[i] * s[L.LAST_INNOVATION + i] / S[i]
        s[L.LAST_INNOVATION + i] = r[i]
    rho = min(max(rho / count, -3.0), 3.0)
    floor = s[L.COLOUR_FLOOR + axis]
    rate = COLOUR_LEARNING_HORIZONTAL if axis == 0 else COLOUR_LEARNING_VERTICAL
    s[L.COLOUR + axis] = min(max(s[L.COLOUR + axis] * math.exp(rate * (rho - UNCOLOURED)), floor), MOST_COLOUR * floor)
