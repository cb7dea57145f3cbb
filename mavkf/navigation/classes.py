"""Of which vehicles something is known by their class."""

from mavkf.navigation.use_class import ROTORS, ROVER, WING

# MAV_TYPE to the class. A boat drifts, and a VTOL does not say which of its two ways of flight it is in.
CLASSES = {10: ROVER, 1: WING, **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35), ROTORS)}

CLASS_NAMES = {
    ROVER: "rover: wheels do not slip",
    WING: "fixed wing: it flies nose first",
    ROTORS: "multirotor: rotors drag",
}


def used_class(vehicle_type: int | None) -> float:
    """The value of Parameter.CLASS for a MAV_TYPE; 0 where nothing is known of it."""
    return CLASSES.get(vehicle_type, 0.0) if vehicle_type is not None else 0.0


def class_reason(vehicle_type: int | None, use: bool) -> str:
    """What is taken for true of a vehicle of a MAV_TYPE (None: no heartbeat), and why; use: whether the class may be used at all."""
    if not use:
        return "vehicle class none: its use is switched off"
    if vehicle_type is None:
        return "vehicle class none: no HEARTBEAT in the first seconds"
    name = CLASS_NAMES.get(used_class(vehicle_type))
    if name is None:
        return f"vehicle class none: nothing is known of HEARTBEAT.type {vehicle_type}"
    return f"vehicle class {name} (HEARTBEAT.type {vehicle_type})"
