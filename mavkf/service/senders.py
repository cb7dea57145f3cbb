"""Who sends: by its HEARTBEATs a vehicle or something else. The one rule, for live links and for logs."""

import numpy as np
from numpy.typing import NDArray

from mavkf.samples import AUTOPILOT, KIND, VEHICLE_TYPE, Kind

NO_AUTOPILOT = 8
"""MAV_AUTOPILOT_INVALID, which says that a component flies nothing."""
NO_VEHICLES = frozenset((6, 18, 26, 27, *range(30, 35), *range(36, 43), 44, 48))
"""The MAV_TYPEs of ground stations, companions, gimbals, ADS-B receivers, cameras and other parts that some send with the number of an
autopilot."""


def is_autopilot(vehicle_type: float, autopilot: float) -> bool:
    """Whether the HEARTBEAT of a MAV_TYPE and a MAV_AUTOPILOT is that of an autopilot."""
    return autopilot != NO_AUTOPILOT and vehicle_type not in NO_VEHICLES


def is_vehicle(rows: NDArray[np.float64]) -> bool | None:
    """Whether one sender's heartbeats among rows (n, ROW_WIDTH) say that it is a vehicle; None: there are none.

    One of an autopilot is enough: others may borrow its address.
    """
    beats = rows[rows[:, KIND] == Kind.HEARTBEAT]
    if not len(beats):
        return None
    return any(is_autopilot(*said) for said in np.unique(beats[:, [VEHICLE_TYPE, AUTOPILOT]], axis=0).tolist())
