"""Is the first order enough? Second-order terms of the product's own models along a flight, at states that it put out.

Hessians are finite differences of the compiled Jacobians on the manifold: along a turn by theta the second derivative of h is theta' h''
theta, so the symmetric part of what is found is h''. Every product of errors in these models has a turn or the delay as a factor, so
those four are enough to differentiate by. P is that of the pose (attitude with position, and velocity), and what the session ended with
for the slow errors; correlations between these parts are not in a pose row and are left out. S is that of the newest innovation; a
prediction's is what becomes of P without the noise of the IMU, so a slow IMU, whose noise is most of it, has no finding.
"""

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from mavkf.diagnostics import Finding
from mavkf.diagnostics.linearisation import judge, outside
from mavkf.models import gnss, magnetometer
from mavkf.models.rotation import rotation_matrix
from mavkf.models.strapdown import (
    BA,
    BG,
    DDELAY,
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    POS,
    SUMS,
    THETA,
    TOP,
    VEL,
    Q,
    V,
    gather,
    propagate,
    rates_of_frame,
    retract,
    transition,
)
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.replay.results import SessionResult
from mavkf.replay.stretches import Stretches, sensor_of

Array = NDArray[np.float64]
TURNS = tuple(range(THETA, THETA + 3))
STEP = {**dict.fromkeys(TURNS, 1e-4), DDELAY: 1e-3}  # rad, s
LONGEST = 1.0  # s that a prediction is taken over


def judge_linearity(session: SessionResult) -> dict[str, Finding]:
    """A finding for each sensor whose model is not linear, by its name, and one for the prediction."""
    shares: dict[str, list[float]] = {}
    for name, share in _shares(session):
        shares.setdefault(name, []).append(share)
    return {
        name: judge(np.array(found), "prediction" if name == "prediction" else "measurement")
        for name, found in shares.items()
    }


def hessians(jacobian: Callable[[Array], Array], x: Array, by: tuple[int, ...]) -> Array:
    """Symmetric Hessians (k, n, n) at x of what has the Jacobian (k, n), which is differentiated by some errors."""
    k, n = jacobian(x).shape
    found = np.zeros((k, n, n))
    for j in by:
        dx = np.zeros(n)
        dx[j] = STEP[j]
        ahead, behind = x.copy(), x.copy()
        retract(ahead, dx)
        retract(behind, -dx)
        found[:, j, :] = (jacobian(ahead) - jacobian(behind)) / (2.0 * STEP[j])
    done = np.zeros(n, dtype=bool)
    done[list(by)] = True
    both = done[:, None] & done[None, :]
    turned = found.transpose(0, 2, 1)
    return np.where(both, 0.5 * (found + turned), found + turned)


def _shares(session: SessionResult) -> Iterator[tuple[str, float]]:
    dt = _between_fixes(session.tally.innovations)
    is_fast = session.state[L.PERIOD] <= L.SLOW
    for state in session.tally.states.found.values():
        x, P = _state(session, state.row)
        rate = state.row[L.R_RATE : L.R_RATE + 3]
        is_integrated = is_fast and state.row[L.R_MODEL] == L.STRAPDOWN
        yield from shares_at(x, P, state.acceleration, rate, state.innovations, dt if is_integrated else None)


def shares_at(
    x: Array, P: Array, a: Array, rate: Array, innovations: Mapping[Sensor, Array], dt: float | None
) -> Iterator[tuple[str, float]]:
    """The shares of `diagnostics.linearisation.outside` at one state, by name.

    x: nominal state; P: (n, n); a: acceleration (3,), m/s^2 in n; rate: (3,), rad/s in b; innovations: newest innovation row of each
    sensor; dt: time (s) that the prediction is taken over, None: it is not judged.
    """
    for sensor, jacobian in _measurements(a, rate, len(P)).items():
        mine = innovations.get(sensor)
        if mine is not None:
            m = int(mine[L.I_SIZE])
            S = mine[L.I_S : L.I_S + m * m].reshape(m, m)
            if _is_definite(S):
                yield sensor.name.lower(), outside(hessians(jacobian, x, (*TURNS, DDELAY))[:m], P, S)
    if dt is not None:
        move = _prediction(x, a, rate, dt)
        F, known_P = move(x), P[:TOP, :TOP]
        S = F @ known_P @ F.T
        if _is_definite(S):
            yield "prediction", outside(hessians(move, x, TURNS), known_P, S)


def _is_definite(S: Array) -> bool:
    return bool(np.isfinite(S).all() and np.linalg.eigvalsh(S)[0] > 0.0)


def _between_fixes(innovations: Stretches) -> float:
    """Time between two fixes, s, LONGEST at most."""
    fixes = [kept.rows for kind, kept in innovations.kept.items() if sensor_of(kind) == Sensor.GNSS_POSITION.value]
    steps = [np.diff(rows[:, L.I_TIME]) for rows in fixes if len(rows) > 1]
    return min(float(np.median(np.concatenate(steps))), LONGEST) if steps else LONGEST


def _state(session: SessionResult, row: Array) -> tuple[Array, Array]:
    """The nominal state and the covariance of a pose row, its slow errors as at the end of the session."""
    end = session.state
    x, P = end[L.X : L.P].copy(), L.covariance(end).copy()
    x[Q : Q + 4] = row[L.R_Q : L.R_Q + 4]
    x[V : V + 3] = row[L.R_V : L.R_V + 3]
    x[LATITUDE], x[LONGITUDE], x[HEIGHT] = row[L.R_LATITUDE], row[L.R_LONGITUDE], row[L.R_HEIGHT]
    x[BG : BG + 3], x[BA : BA + 3] = row[L.R_BG : L.R_BG + 3], row[L.R_BA : L.R_BA + 3]
    P[:9, :], P[:, :9] = 0.0, 0.0
    order = np.array([POS, POS + 1, POS + 2, *TURNS])
    P[np.ix_(order, order)] = row[L.R_POSE_COVARIANCE : L.R_POSE_COVARIANCE + 36].reshape(6, 6)
    P[VEL : VEL + 3, VEL : VEL + 3] = row[L.R_VELOCITY_COVARIANCE : L.R_VELOCITY_COVARIANCE + 9].reshape(3, 3)
    return x, P


def _measurements(a: Array, rate: Array, n: int) -> dict[Sensor, Callable[[Array], Array]]:
    """The Jacobians (3, n) of the sensors that are not linear, as functions of the state. a: (3,) m/s^2 in n; rate: (3,) rad/s in b."""

    def taken(x: Array) -> tuple[Array, Array]:
        C, H = np.empty((3, 3)), np.zeros((3, n))
        rotation_matrix(x[Q : Q + 4], C)
        return C, H

    def position(x: Array) -> Array:
        C, H = taken(x)
        gnss.position_jacobian(x, a, C, rate, H)
        return H

    def velocity(x: Array) -> Array:
        C, H = taken(x)
        gnss.velocity_jacobian(x, a, C, rate, H)
        return H

    def field(x: Array) -> Array:
        C, H = taken(x)
        magnetometer.jacobian(x, C, H)
        return H

    return {Sensor.GNSS_POSITION: position, Sensor.GNSS_VELOCITY: velocity, Sensor.MAGNETOMETER: field}


def _prediction(x: Array, a: Array, rate: Array, dt: float) -> Callable[[Array], Array]:
    """The rows (9, TOP) of the transition over dt (s) with the IMU sample that the motion makes at x, as a function of the state."""
    C, frame = np.empty((3, 3)), np.empty(9)
    rotation_matrix(x[Q : Q + 4], C)
    imu = np.empty(6)
    imu[:3] = rate + x[BG : BG + 3]
    imu[3:] = C.T @ (a - np.array([0.0, 0.0, rates_of_frame(x, frame)])) + x[BA : BA + 3]

    def move(start: Array) -> Array:
        moved, average, Phi = start.copy(), np.empty(21), np.zeros((9, TOP))
        propagate(moved, imu, imu, dt, average)
        sums = np.zeros(SUMS)
        gather(average, dt, sums)
        transition(moved, sums, dt, Phi)
        return Phi

    return move
