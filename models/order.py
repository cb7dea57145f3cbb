"""The order of the states behind those of `strapdown`: first what most sessions have from begin to end, last what comes and goes.

So most sessions carry no zeros for states that they do not use. Each group is in the nominal state and in the error state:

    CLASS, DCLASS       what the vehicle's class has (4): see `vehicle_class`
    ANTENNA, DANTENNA   where the antenna is from the IMU, in b (3, m), where it is estimated: see `gnss`
    MOTION, DMOTION     body rate (3, rad/s) and specific force (3, m/s^2), where the IMU measures them: see `telemetry`
"""

from mavkf.models import strapdown

CLASS, DCLASS = strapdown.X_SIZE, strapdown.N
ANTENNA, DANTENNA = CLASS + 4, DCLASS + 4
MOTION, DMOTION = ANTENNA + 3, DANTENNA + 3
X_SIZE, STATES_MOST = MOTION + 6, DMOTION + 6
