"""Phi of every kinematic model against finite differences of its own `propagate` on the manifold.

A model joins this test by being a module of mavkf.models that has `propagate` and `transition`.
"""

import importlib
import pkgutil
from math import pi, radians
from types import ModuleType

import numpy as np
import pytest

import mavkf.models
from mavkf.models import strapdown
from mavkf.models.rotation import quaternion_from_euler, rotation_matrix
from mavkf.models.strapdown import BA, BARO, BG, HEIGHT, LATITUDE, LONGITUDE, SUMS, TOP, X_SIZE, N, Q, V

Array = np.ndarray
# A step of finite differences for each error state (rad, m/s, m, rad/s, m/s^2, m): large enough for an ulp of latitude, 1.4e-9 m.
EPSILON = np.array([1e-3] * 3 + [1.0] * 3 + [10.0] * 3 + [0.1] * 3 + [1.0] * 3 + [1.0] * (N - 15))
ULP = 3e-9  # m
BLOCKS = {"theta": slice(0, 3), "v": slice(3, 6), "p": slice(6, 9), "dbg": slice(9, 12), "dba": slice(12, 15)}


def models() -> list[ModuleType]:
    names = [info.name for info in pkgutil.iter_modules(mavkf.models.__path__)]
    modules = [importlib.import_module("mavkf.models." + name) for name in names]
    return [module for module in modules if hasattr(module, "propagate") and hasattr(module, "transition")]


def test_discovery() -> None:
    assert {"strapdown", "constant_velocity"} <= {module.__name__.rsplit(".", 1)[1] for module in models()}


def random_case(random: np.random.Generator) -> tuple[Array, Array, Array]:
    """A state, and the samples at both ends of an interval: up to 3 g and 170 deg/s, changing."""
    x = np.zeros(X_SIZE)
    quaternion_from_euler(*random.uniform(-pi, pi, 3), x[Q : Q + 4])
    x[V : V + 3] = random.uniform(-30.0, 30.0, 3)
    x[LATITUDE], x[LONGITUDE] = radians(random.uniform(-75.0, 75.0)), random.uniform(-3.0, 3.0)
    x[HEIGHT] = random.uniform(-50.0, 5000.0)
    x[BG : BG + 3], x[BA : BA + 3] = random.normal(size=3) * 0.02, random.normal(size=3) * 0.2
    x[BARO] = random.normal()
    imu0 = np.concatenate([random.uniform(-1.7, 1.7, 3), random.uniform(-17.0, 17.0, 3)])
    imu1 = imu0 + np.concatenate([random.normal(size=3) * 0.05, random.normal(size=3) * 0.5])
    return x, imu0, imu1


def numeric(model: ModuleType, x: Array, imu0: Array, imu1: Array, dt: float) -> Array:
    """d(propagated dx) / d(dx), shape (N, N), by central differences."""
    retract, local = getattr(model, "retract", strapdown.retract), getattr(model, "local", strapdown.local)
    centre, average = x.copy(), np.empty(21)
    model.propagate(centre, imu0, imu1, dt, average)
    F = np.empty((N, N))
    for j in range(N):
        ends = []
        for sign in (1.0, -1.0):
            y, dx = x.copy(), np.zeros(N)
            dx[j] = sign * EPSILON[j]
            retract(y, dx)
            model.propagate(y, imu0, imu1, dt, average)
            local(centre, y, dx)
            ends.append(dx)
        F[:, j] = (ends[0] - ends[1]) / (2.0 * EPSILON[j])
    return F


def analytic(model: ModuleType, x: Array, imu0: Array, imu1: Array, dt: float) -> Array:
    """Phi of the code, shape (N, N)."""
    average, F = np.empty(21), np.eye(N)
    y = x.copy()
    model.propagate(y, imu0, imu1, dt, average)
    sums = np.zeros(SUMS)
    strapdown.gather(average, dt, sums)
    model.transition(y, sums, dt, F[:9, :TOP])
    return F


def tolerance(block: Array, row: str, column: str, dt: float) -> float:
    """What may be missing of a block of F - 1, by norm.

    The relative size of what a Phi of leading order leaves out is how far the body turns in dt, at up to 2.9 rad/s and weighted by a
    half or less, and how far the two samples differ, 0.5 of 17 m/s^2 and more. Beside it the frame's slow terms, which have their own
    test, and the resolution of finite differences.
    """
    resolution = 3.0 * ULP / EPSILON[BLOCKS[column]][0]
    # of the third order: the trapezoid of propagate moves the position by f dt^3 / 4, the integral in Phi by f dt^3 / 6
    relative = (0.4 if (row, column) == ("p", "dbg") else 0.1) + 1.5 * dt
    return float(relative * np.linalg.norm(block)) + 3e-5 * dt + resolution


@pytest.mark.parametrize("model", models(), ids=lambda module: module.__name__.rsplit(".", 1)[1])
def test_transition_is_the_derivative_of_propagate(model: ModuleType) -> None:
    for seed in range(60):
        case = random_case(np.random.default_rng(seed))
        for dt in (0.005, 0.02, 0.1, 0.25):
            expected = numeric(model, *case, dt)
            error = analytic(model, *case, dt) - expected
            for row in ("theta", "v", "p"):
                for column in BLOCKS:
                    block = expected[BLOCKS[row], BLOCKS[column]] - (np.eye(3) if row == column else 0.0)
                    size = np.linalg.norm(error[BLOCKS[row], BLOCKS[column]])
                    assert size < tolerance(block, row, column, dt), (seed, dt, row, column)
            # the rest is the identity
            np.testing.assert_allclose(expected[9:], np.eye(N)[9:], rtol=0, atol=1e-12)
            np.testing.assert_allclose(expected[:9, TOP:], 0.0, rtol=0, atol=ULP)


def test_the_case_is_hard_enough() -> None:
    """Each block is larger than what is tolerated, at every dt: leaving it out would be seen."""
    for dt in (0.005, 0.25):
        F = numeric(strapdown, *random_case(np.random.default_rng(0)), dt)
        for row, column in [("v", "theta"), ("p", "theta"), ("p", "v"), ("theta", "dbg"), ("v", "dbg"), ("p", "dbg")]:
            block = F[BLOCKS[row], BLOCKS[column]]
            assert np.linalg.norm(block) > 1.2 * tolerance(block, row, column, dt), (dt, row, column)
        for row in ("v", "p"):
            block = F[BLOCKS[row], BLOCKS["dba"]]
            assert np.linalg.norm(block) > 1.2 * tolerance(block, row, "dba", dt), (dt, row)


def test_slow_terms_of_strapdown() -> None:
    """At rest in n the terms of the earth's rotation, transport rate and gravity gradient stand alone, each to a few percent."""
    dt = 1.0
    for latitude in (-60.0, 0.0, 50.0):
        x, _, _ = random_case(np.random.default_rng(1))
        x[LATITUDE], x[BG : BG + 3], x[BA : BA + 3], x[V : V + 3] = radians(latitude), 0.0, 0.0, [0.3, -0.2, 0.1]
        C = np.empty((3, 3))
        rotation_matrix(x[Q : Q + 4], C)
        imu = np.concatenate([np.zeros(3), C.T @ [0.0, 0.0, -9.81]])
        y, average, Phi = x.copy(), np.empty(21), np.empty((9, TOP))
        strapdown.propagate(y, imu, imu, dt, average)
        sums = np.zeros(SUMS)
        strapdown.gather(average, dt, sums)
        strapdown.transition(y, sums, dt, Phi)
        F = numeric(strapdown, x, imu, imu, dt)
        # rad per rad, (m/s) per (m/s): 7.3e-5 and 1.5e-4 of the earth's rotation; second order g dt^2 / 2R = 8e-7
        np.testing.assert_allclose(Phi[0:3, 0:3], F[0:3, 0:3], rtol=0, atol=2e-6)
        np.testing.assert_allclose(Phi[3:6, 3:6], F[3:6, 3:6], rtol=0, atol=2e-6)
        # rad per (m/s): dt / R = 1.6e-7
        np.testing.assert_allclose(Phi[0:3, 3:6], F[0:3, 3:6], rtol=0, atol=2e-9)
        # (m/s) per m: 3.1e-6 of gravity
        np.testing.assert_allclose(Phi[3:6, 6:9], F[3:6, 6:9], rtol=0, atol=4e-8)
