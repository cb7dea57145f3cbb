"""Two sensors of the height that have nothing in common: where fixes and pressure move together, it is the filter that has moved."""

import math

import numpy as np

from mavkf.compiled import kernel
from mavkf.models.strapdown import DBA, POS, VEL
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.disturbances import end_fault
from mavkf.navigation.fusing import note
from mavkf.navigation.monitors import stop_monitors

MEMORY = 20.0  # s: of how far the two are apart
APART = 0.3  # of a shift that only one of them shows
RECENT = 1.0  # s


@kernel
def compare_heights(s, height, dt):
    """At a fix of the main receiver: keep how far its height (m) is below the pressure's, now and in the mean; dt: s since the last."""
    if not s[L.T] - s[L.T_BAROMETER] < RECENT:
        s[L.HEIGHTS_APART] = np.nan
        return
    s[L.HEIGHTS_APART] = s[L.PRESSURE_HEIGHT] - height
    if not math.isfinite(s[L.HEIGHTS_MEAN]):
        s[L.HEIGHTS_MEAN] = s[L.HEIGHTS_APART]
    weight = 1.0 - math.exp(-min(dt, MEMORY) / MEMORY) if dt > 0.0 else 0.0
    s[L.HEIGHTS_MEAN] += weight * (s[L.HEIGHTS_APART] - s[L.HEIGHTS_MEAN])


@kernel
def heights_agree(s, shift):
    """Whether pressure and fixes are as far apart as before, though one of them is said to have shifted by so much (m)."""
    return abs(s[L.HEIGHTS_APART] - s[L.HEIGHTS_MEAN]) < APART * abs(shift)


@kernel
def doubt_height(s, out, r, since):
    """Widen the height, its rate and the accelerometer's bias by what r (m) of error since a time (s) tells: a = 2 r / t^2.

    Two sensors that have nothing in common say the same: it is the accelerometer that is wrong, along the vertical.
    """
    P = L.covariance(s)
    lasted = max(s[L.T] - since, RECENT)
    rate, force = 2.0 * r / lasted, 2.0 * r / (lasted * lasted)
    note(out, NoteCode.ACCELEROMETER_STEP, since, s[L.T], abs(force), r, 0.0)
    P[POS + 2, POS + 2] += r * r
    P[VEL + 2, VEL + 2] += rate * rate
    for i in range(3):
        P[DBA + i, DBA + i] += force * force
    s[L.PRESSURE_REFUSED_SINCE] = np.nan
    end_fault(s, out, NoteCode.BAROMETER_DISTURBANCE)
    stop_monitors(s)
