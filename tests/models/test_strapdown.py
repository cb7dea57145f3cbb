"""Strapdown mechanisation against an independent integration: attitude matrix, velocity and position in the earth-fixed frame, by RK4."""

from itertools import pairwise
from math import cos, pi, radians, sin

import numpy as np
import pymap3d
import pytest

from mavkf.models.earth import gravity
from mavkf.models.rotation import quaternion_from_euler, rotation_matrix
from mavkf.models.strapdown import BA, BG, HEIGHT, LATITUDE, LONGITUDE, X_SIZE, N, Q, V, local, propagate, retract

Array = np.ndarray
RATE = 7.292115e-5  # rad/s, WGS-84
GM, J2, A, E2 = 3.986004418e14, 1.0826298e-3, 6378137.0, 6.69437999014e-3


def skew(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def axes_of_n(latitude: float, longitude: float) -> Array:
    """Columns: north, east, down in the earth-fixed frame."""
    sp, cp, sl, cl = sin(latitude), cos(latitude), sin(longitude), cos(longitude)
    return np.array([[-sp * cl, -sl, -cp * cl], [-sp * sl, cl, -cp * sl], [cp, 0.0, -sp]])


def gravity_e(r: Array) -> Array:
    """Gravitation to J2, plus the centrifugal acceleration: normal gravity to about 2e-5 m/s^2, with its direction."""
    d = np.linalg.norm(r)
    k, s = 1.5 * J2 * (A / d) ** 2, 5.0 * (r[2] / d) ** 2
    return -GM / d**3 * r * (1.0 + k * np.array([1.0 - s, 1.0 - s, 3.0 - s])) + RATE**2 * np.array([r[0], r[1], 0.0])


class Truth:
    """A state in the earth-fixed frame moved by given omega_b(t), f_b(t)."""

    def __init__(self, x: Array) -> None:
        C_nb = np.empty((3, 3))
        rotation_matrix(x[Q : Q + 4], C_nb)
        C = axes_of_n(x[LATITUDE], x[LONGITUDE])
        r = pymap3d.geodetic2ecef(x[LATITUDE], x[LONGITUDE], x[HEIGHT], deg=False)
        self.y = np.concatenate([(C @ C_nb).ravel(), C @ x[V : V + 3], r])

    @staticmethod
    def derivative(t: float, y: Array, omega, force) -> Array:
        C, v, r = y[:9].reshape(3, 3), y[9:12], y[12:]
        earth = skew(np.array([0.0, 0.0, RATE]))
        C_dot = C @ skew(omega(t)) - earth @ C
        v_dot = C @ force(t) + gravity_e(r) - 2.0 * earth @ v
        return np.concatenate([C_dot.ravel(), v_dot, v])

    def run(self, omega, force, duration: float, steps: int) -> "Truth":
        h = duration / steps
        for i in range(steps):
            t, y = i * h, self.y
            k1 = self.derivative(t, y, omega, force)
            k2 = self.derivative(t + h / 2, y + h / 2 * k1, omega, force)
            k3 = self.derivative(t + h / 2, y + h / 2 * k2, omega, force)
            k4 = self.derivative(t + h, y + h * k3, omega, force)
            self.y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return self

    def errors(self, x: Array) -> tuple[float, float, float]:
        """Angle (rad), velocity (m/s) and position (m) between x and this."""
        C_nb = np.empty((3, 3))
        rotation_matrix(x[Q : Q + 4], C_nb)
        C = axes_of_n(x[LATITUDE], x[LONGITUDE])
        D = C @ C_nb @ self.y[:9].reshape(3, 3).T
        angle = 0.5 * np.linalg.norm([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
        r = np.array(pymap3d.geodetic2ecef(x[LATITUDE], x[LONGITUDE], x[HEIGHT], deg=False))
        return (
            float(angle),
            float(np.linalg.norm(C @ x[V : V + 3] - self.y[9:12])),
            float(np.linalg.norm(r - self.y[12:])),
        )


def start(latitude: float = 47.0, velocity: tuple[float, ...] = (12.0, -7.0, 1.0), height: float = 500.0) -> Array:
    x = np.zeros(X_SIZE)
    quaternion_from_euler(0.2, -0.1, 2.0, x[Q : Q + 4])
    x[V : V + 3] = velocity
    x[LATITUDE], x[LONGITUDE], x[HEIGHT] = radians(latitude), radians(8.5), height
    return x


def coning(t: float) -> Array:
    return np.array([0.9 * cos(6.0 * t), 0.9 * sin(6.0 * t), 0.3])


def surging(t: float) -> Array:
    return np.array([2.0 * sin(1.7 * t), 0.8 * cos(2.3 * t), -9.81 + 1.5 * sin(1.1 * t)])


def integrate(x: Array, omega, force, duration: float, dt: float) -> Array:
    average, steps = np.empty(21), round(duration / dt)
    samples = np.array([[*omega(i * dt), *force(i * dt)] for i in range(steps + 1)])
    samples += np.concatenate([x[BG : BG + 3], x[BA : BA + 3]])  # what biased sensors show
    for i in range(steps):
        propagate(x, samples[i], samples[i + 1], dt, average)
    return x


@pytest.mark.parametrize("latitude", [-60.0, 0.0, 47.0])
def test_order_of_convergence(latitude: float) -> None:
    duration = 4.0
    truth = Truth(start(latitude)).run(coning, surging, duration, 4000)
    steps = [0.04, 0.02, 0.01]
    x0 = start(latitude)
    x0[BG : BG + 3], x0[BA : BA + 3] = [0.01, -0.02, 0.005], [0.1, 0.05, -0.2]
    errors = np.array([truth.errors(integrate(x0.copy(), coning, surging, duration, dt)) for dt in steps])
    # J2 gravity against Somigliana's is 2e-5 m/s^2 at most: what is left of velocity and position when dt is nothing
    floor = np.array([1e-8, 2.5e-5 * duration, 2.5e-5 * duration**2 / 2.0])
    assert np.all(errors[-1] < [2e-4, 2e-3, 4e-3])
    for coarse, fine in pairwise(errors):
        # a halved step leaves a quarter of the error
        assert np.all(fine < coarse / 3.6 + floor)
    assert errors[0][0] < 3e-3  # without the coning term another 0.9^2 * 6 * dt^2 / 12 * 4 s = 2.6e-3


@pytest.mark.parametrize("latitude", [-60.0, 10.0])
def test_the_frame_turns_with_the_earth_and_the_velocity(latitude: float) -> None:
    duration = 100.0
    x = start(latitude, velocity=(180.0, 150.0, 0.0))
    C_nb = np.empty((3, 3))
    rotation_matrix(x[Q : Q + 4], C_nb)
    up = C_nb.T @ [0.0, 0.0, -9.81]
    truth = Truth(x).run(lambda t: np.zeros(3), lambda t: up, duration, 1000)
    integrate(x, lambda t: np.zeros(3), lambda t: up, duration, 0.05)
    angle, velocity, position = truth.errors(x)
    # transport rate 234 / 6.4e6 * 100 = 3.7e-3 rad, the earth's 7e-3 rad, of which a thousandth is 5e-6
    assert angle < 5e-6
    # Coriolis 2 * 7e-5 * 234 * 100 = 3.4 m/s; J2 gravity is wrong by 2e-5 m/s^2
    assert velocity < 1e-2
    assert position < 0.5


def test_at_rest_on_the_turning_earth() -> None:
    for latitude in (-70.0, 0.0, 35.0):
        x = start(latitude, velocity=(0.0, 0.0, 0.0))
        C_nb = np.empty((3, 3))
        rotation_matrix(x[Q : Q + 4], C_nb)
        C_eb = axes_of_n(x[LATITUDE], x[LONGITUDE]) @ C_nb
        omega = C_eb.T @ np.array([0.0, 0.0, RATE])
        force = C_nb.T @ np.array([0.0, 0.0, -gravity(x[LATITUDE], x[HEIGHT])])
        before = x.copy()
        integrate(x, lambda t, w=omega: w, lambda t, f=force: f, 600.0, 0.05)
        dx = np.empty(N)
        local(before, x, dx)
        assert np.abs(dx[0:3]).max() < 1e-9
        assert np.abs(dx[3:6]).max() < 1e-7
        assert np.abs(dx[6:9]).max() < 1e-4


def test_a_free_fall_on_the_turning_earth_drifts_east() -> None:
    # Reich's experiment: omega cos(latitude) g t^3 / 3 to the east
    x = start(45.0, velocity=(0.0, 0.0, 0.0), height=2000.0)
    y0 = x[LONGITUDE]
    integrate(x, lambda t: np.zeros(3), lambda t: np.zeros(3), 10.0, 0.01)
    east = (x[LONGITUDE] - y0) * pymap3d.rcurve.transverse(45.0) * cos(pi / 4)
    assert east == pytest.approx(RATE * cos(pi / 4) * 9.8 * 1000.0 / 3.0, rel=0.01)
    assert 2000.0 - x[HEIGHT] == pytest.approx(0.5 * 9.800 * 100.0, rel=2e-4)


@pytest.mark.parametrize(
    "longitude",
    [
        0.15,
        -pi,
        pi - 1e-6,
    ],
)
def test_local_is_the_inverse_of_retract(longitude: float) -> None:
    random = np.random.default_rng(11)
    for _ in range(500):
        x = start(random.uniform(-80.0, 80.0), height=random.uniform(-100.0, 9000.0))
        x[LONGITUDE] = longitude + random.uniform(0.0, 1e-6)
        quaternion_from_euler(*random.uniform(-pi, pi, 3), x[Q : Q + 4])
        dx = random.normal(size=N) * ([1.0] * 3 + [5.0] * 3 + [50.0] * 3 + [0.1] * 6 + [3.0] * (N - 15))
        dx[0:3] *= min(1.0, 3.1 / np.linalg.norm(dx[0:3]))
        y, back = x.copy(), np.empty(N)
        retract(y, dx)
        local(x, y, back)
        # an ulp of longitude is 3e-9 m
        np.testing.assert_allclose(back, dx, rtol=1e-9, atol=1e-8)


def test_retract_moves_in_n() -> None:
    x = start()
    y, dx = x.copy(), np.zeros(N)
    dx[0:3], dx[3:6], dx[6:9] = [0.0, 0.0, 0.1], [1.0, 2.0, 3.0], [100.0, -50.0, 8.0]
    retract(y, dx)
    ned = pymap3d.geodetic2ned(*y[LATITUDE : HEIGHT + 1], *x[LATITUDE : HEIGHT + 1], deg=False)
    np.testing.assert_allclose(ned, dx[6:9], rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(y[V : V + 3] - x[V : V + 3], dx[3:6], atol=1e-12)
    C0, C1 = np.empty((3, 3)), np.empty((3, 3))
    rotation_matrix(x[Q : Q + 4], C0)
    rotation_matrix(y[Q : Q + 4], C1)
    c, s = cos(0.1), sin(0.1)
    np.testing.assert_allclose(C1, np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ C0, atol=1e-15)
