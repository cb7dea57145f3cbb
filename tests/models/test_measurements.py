"""H of every measurement against finite differences of its own prediction on the manifold, over random states."""

from collections.abc import Callable
from math import pi, radians
from typing import NamedTuple

import numpy as np
import pytest

from mavkf.models import barometer, gnss, magnetometer, vehicle_class
from mavkf.models.order import ANTENNA, CLASS, DANTENNA, STATES_MOST, X_SIZE
from mavkf.models.rotation import quaternion_from_euler, rotation_matrix
from mavkf.models.strapdown import (
    BARO,
    DELAY,
    EARTH_FIELD,
    GNSS,
    HEIGHT,
    IRON,
    LATITUDE,
    LONGITUDE,
    N,
    Q,
    V,
    offset,
    retract,
)
from mavkf.models.telemetry import FORCE
from mavkf.models.vehicle_class import WIND

Array = np.ndarray


class Case(NamedTuple):
    """A state, and what the measurements take beside it: acceleration in n, body rate in b."""

    x: Array
    a: Array
    w: Array


class Measurement(NamedTuple):
    """Prediction (m,) of a state near a case's, and H (m, n) at the case's."""

    predict: Callable[[Case, Array], Array]
    jacobian: Callable[[Case, Array], None]
    size: int


def attitude(x: Array) -> Array:
    C = np.empty((3, 3))
    rotation_matrix(x[Q : Q + 4], C)
    return C


def position(case: Case, y: Array) -> Array:
    x, z_hat, moved = case.x, np.empty(3), np.empty(3)
    gnss.predict_position(y, case.a, attitude(y), case.w, z_hat)
    offset(*y[LATITUDE : HEIGHT + 1], *x[LATITUDE : HEIGHT + 1], moved)
    return moved + z_hat


def velocity(case: Case, y: Array) -> Array:
    z_hat = np.empty(3)
    gnss.predict_velocity(y, case.a, attitude(y), case.w, z_hat)
    return z_hat


def field(case: Case, y: Array) -> Array:
    z_hat = np.empty(3)
    magnetometer.predict(y, attitude(y), z_hat)
    return z_hat


def slip(case: Case, y: Array) -> Array:
    h = np.empty(2)
    vehicle_class.predict_slip(y, attitude(y), case.w, h)
    return h


def through_air(y: Array) -> Array:
    u = np.empty(3)
    vehicle_class.body_velocity(y, attitude(y), y[WIND], y[WIND + 1], u)
    return u


def drag(case: Case, y: Array, is_state: bool) -> Array:
    f, h = np.empty(3), np.empty(2)
    vehicle_class.specific_force(y, case.a, is_state, f)
    vehicle_class.predict_drag(y, through_air(y), f, h)
    return h


def drag_jacobian(case: Case, H: Array, is_state: bool) -> None:
    vehicle_class.drag_jacobian(case.x, attitude(case.x), through_air(case.x), is_state, H)


MEASUREMENTS = {
    "position": Measurement(
        position, lambda case, H: gnss.position_jacobian(case.x, case.a, attitude(case.x), case.w, H), 3
    ),
    "velocity": Measurement(
        velocity, lambda case, H: gnss.velocity_jacobian(case.x, case.a, attitude(case.x), case.w, H), 3
    ),
    "field": Measurement(field, lambda case, H: magnetometer.jacobian(case.x, attitude(case.x), H), 3),
    "yaw": Measurement(
        lambda case, y: np.array([gnss.predict_yaw(attitude(y))]),
        lambda case, H: gnss.yaw_jacobian(attitude(case.x), H),
        1,
    ),
    "pressure_height": Measurement(
        lambda case, y: np.array([barometer.predict(y)]), lambda case, H: barometer.jacobian(H), 1
    ),
}
# of what a vehicle's class says, which needs the states of the class
CLASS_MEASUREMENTS = {
    "slip": Measurement(slip, lambda case, H: vehicle_class.slip_jacobian(case.x, attitude(case.x), case.w, H), 2),
    "drag_of_a_sample": Measurement(
        lambda case, y: drag(case, y, False), lambda case, H: drag_jacobian(case, H, False), 2
    ),
    "drag_of_the_state": Measurement(
        lambda case, y: drag(case, y, True), lambda case, H: drag_jacobian(case, H, True), 2
    ),
    "airspeed": Measurement(
        lambda case, y: np.array([vehicle_class.predict_airspeed(y, through_air(y))]),
        lambda case, H: vehicle_class.airspeed_jacobian(case.x, attitude(case.x), through_air(case.x), H),
        1,
    ),
    "sideslip": Measurement(
        lambda case, y: np.array([vehicle_class.predict_sideslip(y, through_air(y))]),
        lambda case, H: vehicle_class.sideslip_jacobian(case.x, attitude(case.x), through_air(case.x), H),
        1,
    ),
}
CASES = [(name, states) for name in MEASUREMENTS for states in (N, DANTENNA + 3)]
CASES += [(name, STATES_MOST) for name in (*MEASUREMENTS, *CLASS_MEASUREMENTS)]


def random_case(random: np.random.Generator) -> Case:
    x = np.zeros(X_SIZE)
    # pitch away from 90 deg, where there is no yaw
    quaternion_from_euler(random.uniform(-pi, pi), random.uniform(-1.3, 1.3), random.uniform(-pi, pi), x[Q : Q + 4])
    x[V : V + 3] = random.uniform(-30.0, 30.0, 3)
    x[LATITUDE], x[LONGITUDE] = radians(random.uniform(-75.0, 75.0)), random.uniform(-3.0, 3.0)
    x[HEIGHT], x[BARO], x[DELAY] = random.uniform(-50.0, 5000.0), random.normal(), random.normal() * 0.05
    x[GNSS : GNSS + 3], x[ANTENNA : ANTENNA + 3] = random.normal(size=3), random.normal(size=3)
    x[EARTH_FIELD : EARTH_FIELD + 3], x[IRON : IRON + 3] = random.normal(size=3), random.normal(size=3)
    x[FORCE : FORCE + 3], x[CLASS:ANTENNA] = random.normal(size=3) * 5.0, random.normal(size=ANTENNA - CLASS) * 0.3
    return Case(x, random.uniform(-10.0, 10.0, 3), random.uniform(-3.0, 3.0, 3))


@pytest.mark.parametrize(("name", "states"), CASES)
def test_jacobian_is_the_derivative_of_the_prediction(name: str, states: int) -> None:
    measurement = (MEASUREMENTS | CLASS_MEASUREMENTS)[name]
    for seed in range(50):
        case = random_case(np.random.default_rng(seed))
        H, numeric = np.full((measurement.size, states), np.nan), np.empty((measurement.size, states))
        measurement.jacobian(case, H)
        for j in range(states):
            ends = []
            # position in steps of 1 m: an ulp of longitude is 3e-9 m
            epsilon = 1.0 if 6 <= j < 9 else 1e-4
            for sign in (1.0, -1.0):
                y, dx = case.x.copy(), np.zeros(states)
                dx[j] = sign * epsilon
                retract(y, dx)
                ends.append(measurement.predict(case, y))
            difference = ends[0] - ends[1]
            if name == "yaw":
                difference = np.angle(np.exp(1j * difference))
            numeric[:, j] = difference / (2.0 * epsilon)
        np.testing.assert_allclose(H, numeric, rtol=2e-6, atol=2e-6, err_msg=f"seed {seed}")


def test_the_lever_arm_in_plain_vectors() -> None:
    for seed in range(20):
        case = random_case(np.random.default_rng(seed))
        x, C = case.x, attitude(case.x)
        arm = np.array([gnss.lever(x, C, case.w, i) for i in range(3)])
        np.testing.assert_allclose(arm[:, 0], C @ x[ANTENNA : ANTENNA + 3], atol=1e-12)
        np.testing.assert_allclose(arm[:, 1], C @ np.cross(case.w, x[ANTENNA : ANTENNA + 3]), atol=1e-12)
