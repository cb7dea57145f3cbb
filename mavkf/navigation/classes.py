"""Of which vehicles something is known by their class."""

from mavkf.navigation.use_class import ROTORS, ROVER, WING

# MAV_TYPE to the class. A boat drifts, and a VTOL does not say which of its two ways of flight it is in.
CLASSES = {10: ROVER, 1: WING, **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35), ROTORS)}


def used_class(vehicle_type: int | None) -> float:
    """The value of Parameter.CLASS for a MAV_TYPE; 0 where nothing is known of it."""
    return CLASSES.get(vehicle_type, 0.0) if vehicle_type is not None else 0.0
