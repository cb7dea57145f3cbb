"""The routes of simulated flights: what a copter and a plane do, drawn from a seed, for a given time.

Every manoeuvre ends where it began (height, course and, for the copter, place), so flights of any length stay near
their start.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from numpy.random import Generator

from mavkf.replay.simulation.route import TICK, Route

STAND = 13.0  # s, before take-off
STAND_AFTER = 5.0  # s
QUARTER = 0.5 * math.pi


class Plan(NamedTuple):
    """A whole flight: its route, and when it leaves the ground and is back (s)."""

    route: Route
    take_off: float
    landed: float


def copter(rng: Generator, duration: float) -> Plan:
    """Plan a multirotor's flight of `duration` s: out, manoeuvres, back, land."""
    height = rng.uniform(8.0, 10.0) if duration < 150.0 else rng.uniform(12.0, 25.0)
    distance = rng.uniform(10.0, 14.0) if duration < 150.0 else rng.uniform(20.0, 40.0)
    start = Route()
    start.wait(STAND)
    start.pulse(2.0, height / 2.5 - 2.0, climb=height)
    start.wait(1.0)
    _line(start, distance, 5.0)
    end = Route()
    _turn(end, math.pi)
    _line(end, distance, 5.0)
    end.wait(1.0)
    end.pulse(2.0, height / 1.5 - 2.0, climb=-height)
    return _fill(rng, duration, start, end, [_square, _circle, _yaw_turns, _dashes, _vertical])


def plane(rng: Generator, duration: float) -> Plan:
    """Plan a fixed wing's flight of `duration` s: take-off run, climb, circuits and loiters, landing, roll-out."""
    height = min(rng.uniform(40.0, 80.0), 15.0 + 0.5 * (duration - 55.0))
    speed = rng.uniform(16.0, 20.0)
    start = Route()
    start.wait(STAND)
    start.change(9.0, speed=speed)
    start.pulse(2.0, height / 4.0 - 2.0, climb=height)
    end = Route()
    end.pulse(2.0, height / 2.5 - 2.0, climb=-height)
    end.change(9.0, speed=-speed)
    return _fill(rng, duration, start, end, [_circuit, _loiter])


def _fill(
    rng: Generator, duration: float, start: Route, end: Route, manoeuvres: list[Callable[[Generator], Route]]
) -> Plan:
    """Put manoeuvres between the start and the end, round after round in a drawn order, until none has fitted for a while."""
    route, misses = start, 0
    order = rng.permutation(len(manoeuvres))
    room = duration - end.time - STAND_AFTER
    while misses < 3:
        misses += 1
        for index in order:
            part = manoeuvres[index](rng)
            if route.time + part.time <= room:
                route.append(part)
                misses = 0
    route.wait(max(0.0, room - route.time - TICK))
    route.append(end)
    landed = route.time
    route.wait(STAND_AFTER)
    return Plan(route, STAND, landed)


def _line(route: Route, distance: float, speed: float, ramp: float = 3.0) -> None:
    route.pulse(ramp, distance / speed - ramp, speed=distance)


def _turn(route: Route, angle: float) -> None:
    """Change the course of a vehicle at rest; nothing of it is seen."""
    route.pulse(0.5, 0.0, course_rate=angle)


def _square(rng: Generator) -> Route:
    speed, side, second = rng.uniform(4.0, 7.0), rng.uniform(2.0, 4.0), rng.uniform(1.0, 3.0)
    sense = rng.choice([-1.0, 1.0])
    route = Route()
    for corner in range(4):
        if corner % 2:
            route.change(2.5, speed=speed)
            route.wait(side)
        else:  # speeds up on the way
            route.change(2.5, speed=0.5 * speed)
            route.wait(second)
            route.change(2.0, speed=0.5 * speed)
            route.wait(second)
        route.change(3.0, speed=-speed)
        _turn(route, sense * QUARTER)
    return route


def _circle(rng: Generator) -> Route:
    radius, acceleration = rng.uniform(8.0, 20.0), rng.uniform(2.0, 3.5)
    length, speed = 2.0 * math.pi * radius, math.sqrt(radius * acceleration)
    sense = rng.choice([-1.0, 1.0])
    nose = sense * 2.0 * math.pi if rng.random() < 0.5 else 0.0
    route = Route()
    # the same shape in both rates: the radius stays the same while the speed changes
    route.pulse(3.0, length / speed - 3.0, speed=length, course_rate=sense * 2.0 * math.pi, yaw_rate=nose)
    route.wait(1.0)
    return route


def _yaw_turns(rng: Generator) -> Route:
    angle, rate = rng.uniform(2.0, 5.0) * rng.choice([-1.0, 1.0]), rng.uniform(0.7, 1.6)
    route = Route()
    for part in (angle, -rng.uniform(0.3, 0.9) * angle):
        route.pulse(1.0, abs(part) / rate - 1.0, yaw_rate=part)
        route.wait(1.0)
    return route


def _dashes(rng: Generator) -> Route:
    speed, hold, first = rng.uniform(6.0, 10.0), rng.uniform(0.5, 2.0), rng.uniform(-1.5, 1.5)
    route = Route()
    for angle in (first, QUARTER, -QUARTER - first):
        _turn(route, angle)
        if angle == -QUARTER - first:
            break
        route.change(3.5, speed=speed)
        route.wait(hold)
        route.change(6.0, speed=-2.0 * speed)
        route.wait(hold)
        route.change(3.5, speed=speed)
    return route


def _vertical(rng: Generator) -> Route:
    height, yaw = rng.uniform(6.0, 12.0), rng.uniform(-3.0, 3.0)
    route = Route()
    route.pulse(2.0, height / 3.0 - 2.0, climb=height, yaw_rate=yaw)
    route.wait(1.0)
    route.pulse(2.0, height / 2.0 - 2.0, climb=-height, yaw_rate=-0.5 * yaw)
    return route


def _circuit(rng: Generator) -> Route:
    """Two equal halves that turn by half a turn each: a closed round, whatever a half contains."""
    sense, rate, snake = rng.choice([-1.0, 1.0]), rng.uniform(0.25, 0.38), rng.uniform(0.4, 1.0)
    first, second = rng.uniform(2.0, 6.0), rng.uniform(1.0, 6.0)
    climb, faster, long = rng.uniform(6.0, 15.0), rng.uniform(1.0, 4.0), rng.random() < 0.6
    quarter = {"width": 2.0, "hold": QUARTER / rate - 2.0, "course_rate": sense * QUARTER}
    route = Route()
    for _ in range(2):
        route.pulse(**quarter)
        if long:
            route.pulse(2.0, first, climb=climb)
            for angle in (snake, -snake):
                route.pulse(2.0, snake / rate - 2.0, course_rate=angle)
        route.pulse(**quarter)
        route.change(2.0, speed=faster)
        route.wait(second)
        route.change(2.0, speed=-faster)
        if long:
            route.pulse(2.0, first, climb=-climb)
    return route


def _loiter(rng: Generator) -> Route:
    angle = 2.0 * math.pi * rng.choice([-1.0, 1.0]) * rng.integers(1, 3)
    route = Route()
    route.pulse(3.0, abs(angle) / rng.uniform(0.25, 0.35) - 3.0, course_rate=angle)
    return route
