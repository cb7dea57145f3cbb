"""A true flight on the WGS-84 earth: place, velocity, attitude, angular rate and specific force that fit each other.

The route gives velocity and acceleration in frame t, the north-east-down plane that touches the ellipsoid at the start
and turns with the earth. Everything else follows exactly: place by integration (horizontally Gauss-Legendre, whose
error is below a micrometre), specific force from

    f = a + 2 omega_ie x v - g        (Groves 2nd ed., eq. 5.18, in axes fixed to the earth; g is normal gravity)

attitude from the forces on the vehicle, angular rate as the derivative of that attitude plus the earth rate. Height is
above the ellipsoid, which stands for sea level here.
"""

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from mavkf.models.earth import (
    EARTH_RATE,
    ECCENTRICITY_SQUARED,
    FLATTENING,
    GRAVITY_EQUATOR,
    RATIO_M,
    SEMI_MAJOR_AXIS,
    SOMIGLIANA,
)
from mavkf.replay.simulation.route import TICK, Channel, Route

Floats = NDArray[np.float64]

DRAG = 0.15  # 1/s: deceleration of a copter per speed
ATTACK, ATTACK_SPEED = 0.06, 8.0  # rad, m/s: angle of attack of a fast plane, speed at which it has half of that
HALF_STEP = 5e-4  # s: of the central difference that gives the angular rate
CHUNK = 20_000  # times computed together: bounds the memory
NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True)
class Motion:
    """What a vehicle does at n times.

    time:        s since boot (n).
    latitude, longitude, height:  rad, rad, m above the ellipsoid (n).
    v_n:         velocity over the earth, m/s, frame n (n, 3).
    euler:       roll, pitch, yaw of the body to n, ZYX, rad (n, 3).
    f_b:         specific force, m/s^2, frame b (n, 3).
    omega_b:     angular rate against inertial space, rad/s, frame b (n, 3).
    """

    time: Floats
    latitude: Floats
    longitude: Floats
    height: Floats
    v_n: Floats
    euler: Floats
    f_b: Floats
    omega_b: Floats


class Trajectory:
    """A flight of a route (`manoeuvres.copter`, `manoeuvres.plane`) that starts at a place with a heading (rad, rad, m, rad).

    winged:  its body follows the air flow and banks so that nothing slides sideways; else its thrust points where the
             acceleration and the drag need it, and it turns its nose as the route says.
    """

    def __init__(
        self, route: Route, latitude: float, longitude: float, height: float, heading: float, *, winged: bool = False
    ) -> None:
        self._winged, self._heading = winged, heading
        self._channels = {name: Channel(steps) for name, steps in route.steps.items()}
        place = np.array([latitude]), np.array([longitude])
        self._origin = ecef(*place, np.array([height]))[0]
        self._C_et: Floats = axes(*place)[0]
        self._omega_t: Floats = self._C_et.T @ np.array([0.0, 0.0, EARTH_RATE])
        edges = TICK * np.arange(math.ceil(route.time / TICK) + 2, dtype=np.float64)
        self._knots = np.concatenate([np.zeros((1, 2)), np.cumsum(self._travel(edges[:-1], TICK), axis=0)])

    def at(self, t: Floats) -> Motion:
        """Compute the motion at times t (n), s since boot."""
        parts = [self._at(t[i : i + CHUNK]) for i in range(0, max(len(t), 1), CHUNK)]
        return Motion(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Motion)))

    def _at(self, t: Floats) -> Motion:
        latitude, longitude, height, v_t, f_t, C_tb = self._state(t)
        before, after = self._state(t - HALF_STEP)[-1], self._state(t + HALF_STEP)[-1]
        turned = np.swapaxes(before, 1, 2) @ after
        sine = 0.5 * np.stack([turned[:, i, j] - turned[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
        square = np.sum(sine**2, axis=1, keepdims=True)
        # arcsin(s)/s = 1 + s^2/6 + ...: the angle is some milliradians
        omega_b = sine * (1.0 + square / 6.0) / (2.0 * HALF_STEP) + self._omega_t @ C_tb
        C_nt = np.swapaxes(axes(latitude, longitude), 1, 2) @ self._C_et
        C_nb = C_nt @ C_tb
        euler = np.stack(
            [
                np.arctan2(C_nb[:, 2, 1], C_nb[:, 2, 2]),
                -np.arcsin(np.clip(C_nb[:, 2, 0], -1.0, 1.0)),
                np.arctan2(C_nb[:, 1, 0], C_nb[:, 0, 0]),
            ],
            axis=1,
        )
        v_n = np.einsum("nij,nj->ni", C_nt, v_t)
        return Motion(t, latitude, longitude, height, v_n, euler, np.einsum("nji,nj->ni", C_tb, f_t), omega_b)

    def _travel(self, t: Floats, length: Floats | float) -> Floats:
        """Integrate the horizontal velocity from t (n) over `length` s: metres north, east in frame t (n, 2)."""
        half = 0.5 * np.broadcast_to(np.asarray(length, dtype=np.float64), t.shape)
        times = t[:, None] + half[:, None] * (1.0 + NODES)
        speed = self._channels["speed"].at(times)[1]
        course = self._heading + self._channels["course_rate"].at(times)[0]
        travel: Floats = half[:, None] * np.stack(
            [(speed * np.cos(course)) @ WEIGHTS, (speed * np.sin(course)) @ WEIGHTS], axis=1
        )
        return travel

    def _state(self, t: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
        """Latitude, longitude, height (n); velocity, specific force in t (n, 3); C_tb (n, 3, 3)."""
        _, speed, speed_rate = self._channels["speed"].at(t)
        turned, course_rate, _ = self._channels["course_rate"].at(t)
        up, climb, climb_rate = self._channels["climb"].at(t)
        cosine, sine = np.cos(self._heading + turned), np.sin(self._heading + turned)
        knot = np.clip(np.floor(t / TICK).astype(np.int64), 0, len(self._knots) - 1)
        begin = np.asarray(knot * TICK, np.float64)
        horizontal = self._knots[knot] + self._travel(begin, t - begin)
        v_t = np.stack([speed * cosine, speed * sine, -climb], axis=1)
        across = speed * course_rate
        a_t = np.stack([speed_rate * cosine - across * sine, speed_rate * sine + across * cosine, -climb_rate], axis=1)
        place = np.column_stack([horizontal, -up])
        latitude, longitude, height = geodetic(self._origin + place @ self._C_et.T)
        down = axes(latitude, longitude)[:, :, 2] @ self._C_et
        f_t = a_t + 2.0 * np.cross(self._omega_t, v_t) - gravity(latitude, height)[:, None] * down
        if self._winged:
            attack = ATTACK * speed**2 / (speed**2 + ATTACK_SPEED**2)
            # the 1 m/s keeps the direction of motion smooth while the plane stands
            pitch = np.arctan2(climb, np.sqrt(speed**2 + 1.0)) + attack
            x = np.stack([np.cos(pitch) * cosine, np.cos(pitch) * sine, -np.sin(pitch)], axis=1)
            z = _unit(np.sum(f_t * x, axis=1, keepdims=True) * x - f_t)
        else:
            yaw = self._heading + self._channels["yaw_rate"].at(t)[0]
            z = _unit(-(f_t + DRAG * v_t))
            x = _unit(np.cross(np.stack([-np.sin(yaw), np.cos(yaw), np.zeros_like(yaw)], axis=1), z))
        return latitude, longitude, height, v_t, f_t, np.stack([x, np.cross(z, x), z], axis=2)


def _unit(vectors: Floats) -> Floats:
    result: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return result


def gravity(latitude: Floats, height: Floats) -> Floats:
    """Compute normal gravity (n), m/s^2 down: `mavkf.models.earth.gravity` for arrays."""
    sine2 = np.sin(latitude) ** 2
    surface = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA * sine2) / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sine2)
    k = height / SEMI_MAJOR_AXIS
    result: Floats = surface * (1.0 - 2.0 * k * (1.0 + FLATTENING + RATIO_M - 2.0 * FLATTENING * sine2) + 3.0 * k * k)
    return result


def axes(latitude: Floats, longitude: Floats) -> Floats:
    """C_en (n, 3, 3): the columns are north, east, down in earth-fixed axes (Groves eq. 2.150, transposed)."""
    sl, cl, so, co = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    zero = np.zeros_like(sl)
    return np.stack(
        [
            np.stack([-sl * co, -so, -cl * co], axis=1),
            np.stack([-sl * so, co, -cl * so], axis=1),
            np.stack([cl, zero, -sl], axis=1),
        ],
        axis=1,
    )


def ecef(latitude: Floats, longitude: Floats, height: Floats) -> Floats:
    """Earth-fixed Cartesian coordinates (n, 3), m (Groves eq. 2.112)."""
    radius = SEMI_MAJOR_AXIS / np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    across = (radius + height) * np.cos(latitude)
    up = (radius * (1.0 - ECCENTRICITY_SQUARED) + height) * np.sin(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), up], axis=1)


def geodetic(p_e: Floats) -> tuple[Floats, Floats, Floats]:
    """Latitude, longitude (rad), height (m) of earth-fixed coordinates (n, 3), by Bowring's (1976) formula.

    Within some kilometres of the surface it is exact to the rounding of double precision.
    """
    across = np.hypot(p_e[:, 0], p_e[:, 1])
    b = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)
    reduced = np.arctan2(p_e[:, 2], (1.0 - FLATTENING) * across)
    latitude = np.arctan2(
        p_e[:, 2] + ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED) * b * np.sin(reduced) ** 3,
        across - ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS * np.cos(reduced) ** 3,
    )
    sine, cosine = np.sin(latitude), np.cos(latitude)
    height = across * cosine + p_e[:, 2] * sine - SEMI_MAJOR_AXIS * np.sqrt(1.0 - ECCENTRICITY_SQUARED * sine**2)
    return latitude, np.arctan2(p_e[:, 1], p_e[:, 0]), height
