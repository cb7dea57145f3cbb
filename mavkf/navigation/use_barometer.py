"""The barometer in the fold: a height with a slowly wandering bias."""

import math

import numpy as np

from mavkf.compiled import NOTHING, VECTOR, compiled_apart
from mavkf.models import barometer
from mavkf.models.strapdown import BARO, DBARO, HEIGHT, POS
from mavkf.navigation import layout as L
from mavkf.navigation.codes import NoteCode, Reason, Sensor
from mavkf.navigation.covariance import prepare
from mavkf.navigation.disturbances import begin_fault, end_fault
from mavkf.navigation.fusing import fuse
from mavkf.navigation.heights import doubt_height, heights_agree
from mavkf.navigation.layout import OUT
from mavkf.navigation.learning import LEAST_SCALE, learn
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.sources import changed
from mavkf.navigation.tape import attend, is_recording, record_link
from mavkf.samples import PRESSURE
from mavkf.stack import matrix, vector

DISTURBED_AFTER = 0.5  # s of refusals, after which it is told
RELEARN_AFTER = 30.0  # s of refusals, after which its bias is taken to have changed
FLOOR = 0.2  # m: gusts and the rounding to whole counts


@compiled_apart(NOTHING, VECTOR, VECTOR, VECTOR, OUT)
def use_barometer(s, e, c, out):
    """Fuse a pressure; the first one after a position was found sets the bias."""
    if s[L.POSITION_KNOWN] == 0.0 or c[Parameter.USE_BAROMETER] == 0.0:
        return
    if math.isfinite(s[L.T_BAROMETER]) and not s[L.T] > s[L.T_BAROMETER] + 1e-6:
        s[L.DUPLICATES] += 1.0
        return
    prepare(s, e, c, out)
    if changed(s, e, out, NoteCode.BAROMETER_CHANGED, L.PRESSURE_USED, s[L.T_BAROMETER]):
        s[L.BAROMETER_KNOWN] = 0.0
        s[L.SCALE_BARO] = 1.0
    x = s[L.X : L.P]
    P = L.covariance(s)
    height = barometer.pressure_height(e[PRESSURE])
    s[L.T_BAROMETER] = s[L.T]
    s[L.PRESSURE_HEIGHT] = height
    sigma = c[Parameter.BARO]
    if s[L.BAROMETER_KNOWN] == 0.0:
        # bias = pressure height - height: it carries the error of the height it is measured against (dp is down)
        if is_recording(out):
            attend(s, out)
        x[BARO] = height - x[HEIGHT]
        for j in range(P.shape[0]):
            P[DBARO, j] = P[POS + 2, j]
            P[j, DBARO] = P[POS + 2, j]
        P[DBARO, DBARO] = P[POS + 2, POS + 2] + sigma * sigma
        if is_recording(out):
            record_link(s, out, DBARO, POS + 2, 1.0)
        s[L.BAROMETER_KNOWN] = 1.0
        return
    r = vector(1)
    H = matrix(1, P.shape[0])
    R = matrix(1, 1)
    r[0] = height - barometer.predict(x)
    barometer.jacobian(H)
    R[0, 0] = max(sigma * sigma * s[L.SCALE_BARO], FLOOR**2)
    S = R[0, 0] + P[POS + 2, POS + 2] - 2.0 * P[POS + 2, DBARO] + P[DBARO, DBARO]
    nis = fuse(s, e, c, out, Sensor.BAROMETER, r, H, R, Reason.FUSED)
    if nis >= 0.0:
        s[L.SCALE_BARO] = learn(s[L.SCALE_BARO], nis, 1, R[0, 0] / S, LEAST_SCALE)
        s[L.PRESSURE_REFUSED_SINCE] = np.nan
        end_fault(s, out, NoteCode.BAROMETER_DISTURBANCE)
    elif not math.isfinite(s[L.PRESSURE_REFUSED_SINCE]):
        s[L.PRESSURE_REFUSED_SINCE] = s[L.T]
    else:
        lasted = s[L.T] - s[L.PRESSURE_REFUSED_SINCE]
        if lasted >= DISTURBED_AFTER and heights_agree(s, r[0]):
            doubt_height(s, out, r[0], s[L.PRESSURE_REFUSED_SINCE] - DISTURBED_AFTER)
        elif lasted >= DISTURBED_AFTER:
            begin_fault(s, out, NoteCode.BAROMETER_DISTURBANCE, s[L.PRESSURE_REFUSED_SINCE], abs(r[0]), 0.0, 0.0)
        if lasted >= RELEARN_AFTER:
            # it shows another height for good: a new bias, from what the others say
            s[L.BAROMETER_KNOWN] = 0.0
            s[L.PRESSURE_REFUSED_SINCE] = np.nan
