"""Which of several sensors of one kind is in use: one that falls silent gives way to one that speaks, and comes back when that one dies.

It is decided by the events, in the order in which they were measured, so it is the same live and in batch.
"""

import math

import numpy as np

from mavkf.compiled import kernel
from mavkf.models.earth import STANDARD_GRAVITY
from mavkf.models.strapdown import BA, BG, DBA, DBG
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode
from mavkf.navigation.covariance import bring_up
from mavkf.navigation.disturbances import end_fault
from mavkf.navigation.fusing import forget, note
from mavkf.navigation.parameter import Parameter
from mavkf.samples import ACCEL, SOURCE, TIME

SILENT = 2.0  # s without a value, after which another magnetometer or barometer is taken
CONFIRMATIONS = 3.0  # samples of another in a row; of an IMU, that show a plausible force
LEAST_FORCE, MOST_FORCE = 0.4, 2.5  # times gravity


@kernel
def begin_sources(s, c):
    """What is in use when a session begins."""
    s[L.IMU_SOURCE] = c[Parameter.IMU_SOURCE]
    s[L.FIELD_SOURCE] = c[Parameter.FIELD_SOURCE]
    s[L.PRESSURE_SOURCE] = c[Parameter.PRESSURE_SOURCE]
    for slot in (L.FIELD_LAST, L.PRESSURE_LAST):
        s[slot] = np.nan
    for slot in (L.FIELD_USED, L.PRESSURE_USED):
        s[slot] = -1.0


@kernel
def in_use(s, e, source, last, standby):
    """Whether a field or pressure is of the sensor in use. source, last: where that is kept, and when it was heard last.

    One that is silent while others speak gives way; a link that is silent says nothing of it. standby: where those are counted.
    """
    if e[SOURCE] == s[source]:
        s[last] = e[TIME]
        s[standby] = 0.0
        return True
    s[standby] += 1.0
    if not math.isfinite(s[last]):
        # the chosen one has as long to begin
        s[last] = e[TIME]
    if not e[TIME] - s[last] > SILENT or s[standby] < CONFIRMATIONS:
        return False
    s[standby] = 0.0
    s[source] = e[SOURCE]
    s[last] = e[TIME]
    return True


@kernel
def changed(s, e, out, code, used, since):
    """Whether the sensor in use is another one than the last time (which is told); `used`: where its source is kept."""
    before = s[used]
    s[used] = e[SOURCE]
    if before < 0.0 or before == e[SOURCE]:
        return False
    note(out, code, since, s[L.T], s[L.T] - since, before, e[SOURCE])
    return True


@kernel
def imu_in_use(s, e, c, out):
    """Whether a sample is of the IMU in use; one that has been silent for as long as a gap gives way to one that shows a plausible force.

    The other IMU has biases of its own.
    """
    if e[SOURCE] == s[L.IMU_SOURCE]:
        for k in range(L.IMUS):
            s[L.STANDBY + k] = 0.0
        return True
    t = e[TIME]
    silence = t - s[L.T_IMU]
    if not silence > max(c[Parameter.GAP], 3.0 * s[L.PERIOD]):
        return False
    k = int(e[SOURCE])
    x, y, z = e[ACCEL], e[ACCEL + 1], e[ACCEL + 2]
    force = math.sqrt(x * x + y * y + z * z) / STANDARD_GRAVITY
    period = t - s[L.STANDBY_T + k]
    if LEAST_FORCE < force < MOST_FORCE and period > 1e-6:
        s[L.STANDBY + k] += 1.0
    elif not LEAST_FORCE < force < MOST_FORCE:
        s[L.STANDBY + k] = 0.0
    s[L.STANDBY_T + k] = t
    if s[L.STANDBY + k] < CONFIRMATIONS or not period > 1e-6:
        return False
    end_fault(s, out, NoteCode.ACCELEROMETER_SCALE)
    note(out, NoteCode.IMU_CHANGED, s[L.T_IMU], t, silence, s[L.IMU_SOURCE], e[SOURCE])
    s[L.IMU_SOURCE] = e[SOURCE]
    s[L.PERIOD] = period
    bring_up(s, c, out)
    s[L.ALIGN_COUNT] = 0.0
    for i in range(3):
        s[BG + i] = 0.0
        s[BA + i] = 0.0
    forget(s, DBG, 3, c[Parameter.GYRO_BIAS] ** 2)
    forget(s, DBA, 3, c[Parameter.ACCEL_BIAS] ** 2)
    for k in range(L.IMUS):
        s[L.STANDBY + k] = 0.0
    return True
