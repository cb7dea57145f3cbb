"""The GNSS receivers of a vehicle: a book of each in the state, what they claim, and which of them is the main one.

The main receiver's coloured error is a state, and position and velocity may be reset to its fixes. Another receiver's coloured error is
independent and has no state: it is fused with the white noise that carries as little information (`lasting`). When the main one has no
3D fix for a while and another does, they change places.
"""

import math

import numpy as np

from mavkf.compiled import kernel
from mavkf.models.strapdown import DDELAY, DGNSS, GNSS, offset
from mavkf.navigation import layout as L
from mavkf.navigation.antenna import unknown_lever
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.fusing import forget, note
from mavkf.navigation.parameter import Parameter
from mavkf.samples import (
    HEIGHT_AMSL,
    LATITUDE,
    LONGITUDE,
    SIGMA_HORIZONTAL,
    SIGMA_VERTICAL,
    SOURCE,
    TIME,
    VELOCITY_E,
    VELOCITY_N,
    Source,
)

FIRST_SOURCE = int(Source.GPS_RAW_INT)
SILENT = 2.0  # s without a 3D fix, after which another receiver becomes the main one
STEADY = 1.0  # s of fixes that such a one must have behind it
LONGEST_WAY = 3.0  # s between two fixes, of which the way is taken for a velocity
REDRAW = 1e9  # m: more than any lever arm, so that the coloured error is begun anew


@kernel
def book_of(source):
    """Where the book of a receiver begins, by its source."""
    return L.BOOKS + (int(source) - FIRST_SOURCE) * L.BOOK


@kernel
def begin_books(s, c):
    """The books of receivers that have not been heard yet."""
    s[L.MAIN] = c[Parameter.GNSS_SOURCE]
    for k in range(L.RECEIVERS):
        b = L.BOOKS + k * L.BOOK
        for i in (L.F_T, L.F_T_BEFORE, L.F_SINCE, L.F_T_POSITION, L.F_T_VELOCITY, L.F_REFUSED_SINCE):
            s[b + i] = np.nan
        for i in (L.F_SCALE_VELOCITY, L.F_SCALE_COLOUR, L.F_SCALE_POSITION, L.F_SCALE_POSITION + 1):
            s[b + i] = 1.0


@kernel
def claimed(e, column, default):
    """One sigma of a fix as the receiver claims it in a column of the row, or the default."""
    sigma = e[column]
    return sigma if sigma > 0.0 else default


@kernel
def way_since(s, e, b, v):
    """Fill v (3,) with the mean velocity (m/s in n) since the receiver's last fix, of which its book b tells.

    Returns the time between the two fixes, s; zero where there is none, or it is too long ago.
    """
    dt = e[TIME] - s[b + L.F_T_BEFORE]
    if not 0.0 < dt < LONGEST_WAY:
        return 0.0
    k = b + L.F_FIX
    offset(e[LATITUDE], e[LONGITUDE], e[HEIGHT_AMSL], s[k], s[k + 1], s[k + 2], v)
    for i in range(3):
        v[i] /= dt
    return dt


@kernel
def coloured_sigma(e, c, vertical):
    """The least sigma (m) of the coloured error, by the claim of a fix: it cannot be seen in the innovations."""
    if vertical:
        return c[Parameter.COLOUR_VERTICAL] * claimed(e, SIGMA_VERTICAL, c[Parameter.GNSS_VERTICAL])
    return c[Parameter.COLOUR] * claimed(e, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL])


@kernel
def white_variance(s, e, c, b, vertical):
    """Variance (m^2) of the white part of a fix: what is claimed, scaled by what was learnt, not below the floor. b: its book."""
    if vertical:
        sigma = claimed(e, SIGMA_VERTICAL, c[Parameter.GNSS_VERTICAL])
        return max(sigma * sigma * s[b + L.F_SCALE_POSITION + 1], c[Parameter.GNSS_FLOOR] ** 2)
    sigma = claimed(e, SIGMA_HORIZONTAL, c[Parameter.GNSS_HORIZONTAL])
    return max(sigma * sigma * s[b + L.F_SCALE_POSITION], c[Parameter.GNSS_FLOOR] ** 2)


@kernel
def set_colour(s, e, c):
    """Let the sigma of the main receiver's coloured error be at least what its fix allows."""
    lever = unknown_lever(s, c)
    for i in range(2):
        floor = coloured_sigma(e, c, i == 1)
        s[L.COLOUR_FLOOR + i] = math.sqrt(floor * floor + lever * lever) if lever > 0.0 else floor
        s[L.COLOUR + i] = max(s[L.COLOUR + i], s[L.COLOUR_FLOOR + i])
    if lever < s[L.UNKNOWN_LEVER]:
        # from now on the lever arm is no part of the error that lingers, or the receiver is another one
        for i in range(3):
            s[L.COLOUR + i // 2] = s[L.COLOUR_FLOOR + i // 2]
            s[GNSS + i] = 0.0
            forget(s, DGNSS + i, 1, s[L.COLOUR + i // 2] ** 2)
    s[L.UNKNOWN_LEVER] = lever


@kernel
def lasting(dt, tau):
    """How many times its variance an error of time constant tau (s) must be given where it is taken as white every dt (s).

    The mean of n samples of an autoregressive process of first order has the variance sigma^2 / n (1 + phi) / (1 - phi), phi =
    exp(-dt / tau) (Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series", Supplement to the
    Journal of the Royal Statistical Society 8(1), 1946); that of white samples sigma^2 / n. For short dt it is 2 tau / dt: the spectral
    density 2 sigma^2 tau of the one at frequency zero, and R dt of the other. For long dt it is 1. (Of n samples the first tells
    1 / sigma^2 of a constant and every other one (1 - phi) / (1 + phi) of that: the sum of the inverse of their covariance.)
    """
    return 1.0 / math.tanh(0.5 * max(dt, 1e-3) / tau)


@kernel
def same_fix(s, e):
    """Whether a fix is the main receiver's last one, told by another message."""
    k = book_of(s[L.MAIN]) + L.F_FIX
    place = e[LATITUDE] == s[k] and e[LONGITUDE] == s[k + 1] and e[HEIGHT_AMSL] == s[k + 2]
    untold = not (math.isfinite(e[VELOCITY_N]) or math.isfinite(s[k + 3]))
    return place and (untold or (e[VELOCITY_N] == s[k + 3] and e[VELOCITY_E] == s[k + 4]))


@kernel
def become_main(s, c, out, source, since):
    """Let a receiver be the main one from now on; its coloured error begins with its next fix."""
    note(out, NoteCode.RECEIVER_CHANGED, since, s[L.T], s[L.T] - since, s[L.MAIN], source)
    s[L.MAIN] = source
    for i in range(2):
        s[L.COLOUR + i] = 0.0
        s[L.COLOUR_TIME + i] = c[Parameter.COLOUR_TIME]
        s[L.LAST_VELOCITY + i] = 0.0
    for i in range(3):
        s[L.LAST_INNOVATION + i] = 0.0
    s[L.UNKNOWN_LEVER] = REDRAW
    # another receiver, another delay
    P = L.covariance(s)
    P[DDELAY, DDELAY] += c[Parameter.DELAY] ** 2


@kernel
def is_main(s, e, c, out):
    """Whether a 3D fix is the main receiver's; if that one has had none for a while, this one's becomes it."""
    if e[SOURCE] == s[L.MAIN]:
        return True
    b = book_of(e[SOURCE])
    last = s[book_of(s[L.MAIN]) + L.F_T]
    if not math.isfinite(last):
        last = s[b + L.F_SINCE]
    if not (e[TIME] - last > SILENT and e[TIME] - s[b + L.F_SINCE] >= STEADY):
        return False
    become_main(s, c, out, e[SOURCE], last)
    return True


@kernel
def other_in_agreement(s):
    """The source of a receiver that is not the main one and whose positions are being fused; -1: there is none."""
    for k in range(L.RECEIVERS):
        source = FIRST_SOURCE + k
        if source != int(s[L.MAIN]) and s[L.T] - s[L.BOOKS + k * L.BOOK + L.F_T_POSITION] < SILENT:
            return source
    return -1
