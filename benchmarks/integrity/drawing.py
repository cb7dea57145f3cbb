"""Which faults are drawn: their ranges, what names each of them right, and the error by which it is judged."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from mavkf.replay.faults import Fault

AROUND, UPRIGHT, BODY, AXES, NOWHERE = "around", "upright", "body", "axes", ""
HORIZONTAL, DOWN, YAW = "horizontal_m", "down_m", "yaw_deg"
POSITION, VELOCITY, FIELD, PRESSURE = "gnss_position", "gnss_velocity", "magnetometer", "barometer"


@dataclass(frozen=True)
class Kind:
    """A row of the table: a kind of fault with the ranges from which it is drawn.

    fault:   one of `mavkf.replay.faults.KINDS`.
    sizes:   in the unit of the fault, uniform in the logarithm (factors: uniform); None: it has none. lasts: s, uniform.
    towards: AROUND: any course; UPRIGHT: up or down; BODY: along an axis of b; AXES: one axis of b or all; NOWHERE.
    error:   the quantity of `mavkf.replay.truth.errors` by which it is judged.
    events:  kinds of events that name it right. gates: sensors whose refusal by a plain gate names it right.
    """

    fault: str
    sizes: tuple[float, float] | None
    lasts: tuple[float, float]
    towards: str
    error: str
    events: tuple[str, ...]
    gates: tuple[str, ...]


SHORT, SLOW = (10.0, 40.0), (20.0, 60.0)  # s
FIX = (POSITION, VELOCITY)
FORCE = ("accelerometer_step", "accelerometer_scale")
KINDS = {
    "gnss-step": Kind("gnss-step", (3.0, 100.0), SHORT, AROUND, HORIZONTAL, ("gnss_jump", "gnss_drift"), (POSITION,)),
    "gnss-step, vertical": Kind(
        "gnss-step",
        (3.0, 100.0),
        SHORT,
        UPRIGHT,
        DOWN,
        ("gnss_jump", "gnss_drift", "gnss_height_drift"),
        (POSITION,),
    ),
    "gnss-drift": Kind("gnss-drift", (0.2, 5.0), SLOW, AROUND, HORIZONTAL, ("gnss_drift", "gnss_jump"), (POSITION,)),
    "gnss-drift, vertical": Kind(
        "gnss-drift", (0.2, 5.0), SLOW, UPRIGHT, DOWN, ("gnss_height_drift", "gnss_drift", "gnss_jump"), (POSITION,)
    ),
    "gnss-velocity": Kind(
        "gnss-velocity", (0.5, 10.0), SHORT, AROUND, HORIZONTAL, ("gnss_velocity_wrong",), (VELOCITY,)
    ),
    "gnss-freeze": Kind("gnss-freeze", None, (5.0, 60.0), NOWHERE, HORIZONTAL, ("gnss_frozen",), FIX),
    "gnss-outage": Kind("gnss-outage", None, (5.0, 120.0), NOWHERE, HORIZONTAL, ("gnss_outage",), ("gnss_outage",)),
    "gnss-noise": Kind(
        "gnss-noise", (5.0, 50.0), SHORT, NOWHERE, HORIZONTAL, ("gnss_jammed", "gnss_jump"), (POSITION,)
    ),
    "magnetometer": Kind("magnetometer", (5.0, 60.0), SHORT, BODY, YAW, ("magnetic_disturbance",), (FIELD,)),
    "barometer": Kind("barometer", (2.0, 30.0), SHORT, NOWHERE, DOWN, ("barometer_disturbance",), (PRESSURE,)),
    "gyro-step": Kind("gyro-step", (0.2, 5.0), SHORT, BODY, HORIZONTAL, ("gyro_step",), (*FIX, FIELD)),
    "accelerometer-step": Kind("accelerometer-step", (0.1, 2.0), SHORT, BODY, HORIZONTAL, FORCE, (*FIX, PRESSURE)),
    "gyro-scale": Kind("gyro-scale", (0.7, 1.3), SHORT, AXES, HORIZONTAL, ("gyro_step",), (*FIX, FIELD)),
    "accelerometer-scale": Kind("accelerometer-scale", (0.7, 1.3), SHORT, AXES, HORIZONTAL, FORCE, (*FIX, PRESSURE)),
}
"""All kinds but a drift of position and velocity that agree with each other."""

SPOOF = Kind(
    "gnss-spoof",
    (0.3, 10.0),
    SLOW,
    AROUND,
    HORIZONTAL,
    ("gnss_jump", "gnss_drift", "gnss_velocity_wrong"),
    FIX,
)
ACCELERATIONS = (0.02, 1.0)  # m/s^2, with which the velocity of a SPOOF builds up, uniform in the logarithm
CHOICES = {
    UPRIGHT: ("up", "down"),
    BODY: ("x", "y", "z", "-x", "-y", "-z"),
    AXES: ("", "", "", "x", "y", "z"),
}
"""What `towards` of a fault is drawn from; half of the errors of scale are of all axes."""
LEAST_BURST = 5.0  # s: no fault is cut to less


def draw_fault(rng: Generator, kind: Kind, at: tuple[float, float], until: float) -> Fault:
    """Draw a fault that begins between two times and ends by a third, s of boot time."""
    begin = float(rng.uniform(*at))
    lasts = min(float(rng.uniform(*kind.lasts)), max(LEAST_BURST, until - begin))
    size, towards = _size(rng, kind), _towards(rng, kind)
    fault = Fault(kind=kind.fault, at=begin, lasts=lasts, size=size, towards=towards)
    if kind.fault == "gnss-outage":
        return replace(fault, silent=float(rng.integers(2)))
    if kind.fault == "gnss-noise":
        return replace(fault, seed=float(rng.integers(1_000_000)))
    return replace(fault, acceleration=_between(rng, *ACCELERATIONS)) if kind is SPOOF else fault


def _size(rng: Generator, kind: Kind) -> float:
    if kind.sizes is None:
        return 0.0
    return float(rng.uniform(*kind.sizes)) if kind.towards == AXES else _between(rng, *kind.sizes)


def _towards(rng: Generator, kind: Kind) -> float | str:
    if kind.towards == AROUND:
        return float(rng.uniform(0.0, 360.0))
    choice = CHOICES.get(kind.towards, ("",))
    return choice[int(rng.integers(len(choice)))]


def _between(rng: Generator, low: float, high: float) -> float:
    """Draw a number that is uniform in its logarithm."""
    return low * math.exp(math.log(high / low) * float(rng.random()))


def seeded(*key: int) -> Generator:
    """Random numbers of a key."""
    return np.random.default_rng([27, *key])
