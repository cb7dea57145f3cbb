"""The earth against pymap3d (radii, offsets) and published values (normal gravity of WGS-84)."""

from math import cos, pi, radians

import numpy as np
import pymap3d
import pytest
from pymap3d import rcurve

from mavkf.models.earth import gravity, radii
from mavkf.models.strapdown import LATITUDE, LONGITUDE, X_SIZE, move, offset

LATITUDES = [-85.0, -47.0, -1e-3, 0.0, 12.0, 45.0, 60.0, 85.0]


@pytest.mark.parametrize("latitude", LATITUDES)
def test_radii(latitude: float) -> None:
    meridian, transverse = radii(radians(latitude))
    assert meridian == pytest.approx(rcurve.meridian(latitude), rel=1e-12)
    assert transverse == pytest.approx(rcurve.transverse(latitude), rel=1e-12)


@pytest.mark.parametrize(
    ("latitude", "expected", "tolerance"),
    [(0.0, 9.7803253359, 1e-10), (90.0, 9.8321849378, 1e-10), (-90.0, 9.8321849378, 1e-10), (45.0, 9.806199, 1e-5)],
)
def test_gravity_on_the_ellipsoid(latitude: float, expected: float, tolerance: float) -> None:
    assert gravity(radians(latitude), 0.0) == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize("latitude", [0.0, 45.0, 90.0])
def test_gravity_falls_with_height(latitude: float) -> None:
    phi = radians(latitude)
    gradient = (gravity(phi, 100.0) - gravity(phi, -100.0)) / 200.0
    assert gradient == pytest.approx(-3.086e-6, abs=0.004e-6)  # 3.0877e-6 at the equator, 3.0834e-6 at the pole
    # the quadratic term, 7e-5 at 10 km, against an inverse square law of the same gradient
    g, k = gravity(phi, 0.0), -gradient / (2.0 * gravity(phi, 0.0))
    assert gravity(phi, 1e4) == pytest.approx(g / (1.0 + k * 1e4) ** 2, abs=2e-6)


def state(latitude: float, longitude: float, height: float) -> np.ndarray:
    x = np.zeros(X_SIZE)
    x[0] = 1.0
    x[LATITUDE : LATITUDE + 3] = radians(latitude), radians(longitude), height
    return x


def ned(x: np.ndarray, origin: np.ndarray) -> np.ndarray:
    def geodetic(s: np.ndarray) -> tuple[float, float, float]:
        return (s[LATITUDE], s[LONGITUDE], s[LATITUDE + 2])

    return np.array(pymap3d.geodetic2ned(*geodetic(x), *geodetic(origin), deg=False))


@pytest.mark.parametrize("latitude", LATITUDES)
@pytest.mark.parametrize("longitude", [-180.0, -179.9999, 0.0, 8.5, 179.9999])
def test_move_by_metres(latitude: float, longitude: float) -> None:
    for step in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [20.0, -30.0, 5.0]):
        origin = state(latitude, longitude, 300.0)
        x = origin.copy()
        move(x, *step)
        # the tangent plane leaves the ellipsoid by d^2 / 2R, and its meridians converge by d^2 tan(latitude) / R
        tolerance = 1e-9 * 6.4e6 * 1e-3 + sum(v * v for v in step[:2]) / 6.3e6 / cos(radians(latitude))
        np.testing.assert_allclose(ned(x, origin), step, rtol=1e-5, atol=tolerance)
        assert abs(x[LONGITUDE]) <= pi


@pytest.mark.parametrize("latitude", LATITUDES)
@pytest.mark.parametrize("distance", [1.0, 100.0, 5000.0])
def test_offset_in_metres(latitude: float, distance: float) -> None:
    for bearing in np.linspace(0.0, 2.0 * pi, 9):
        origin = state(latitude, 179.99, 250.0)
        x = origin.copy()
        move(x, distance * np.cos(bearing), distance * np.sin(bearing), -40.0)
        out = np.empty(3)
        offset(*x[LATITUDE : LATITUDE + 3], *origin[LATITUDE : LATITUDE + 3], out)
        expected = ned(x, origin)
        # distances along the curved earth against the tangent plane
        bend = distance**2 / 6.3e6 / cos(radians(latitude))
        np.testing.assert_allclose(out[:2], expected[:2], rtol=1e-5, atol=1e-6 + bend)
        assert abs(np.hypot(*out[:2]) - np.hypot(*expected[:2])) < 1e-6 + 1.5e-5 * distance
        assert out[2] == pytest.approx(-40.0, abs=1e-9)


def test_offset_is_antisymmetric_and_crosses_the_date_line() -> None:
    a, b = (radians(-17.0), radians(179.999), 10.0), (radians(-17.001), radians(-179.999), 35.0)
    there, back = np.empty(3), np.empty(3)
    offset(*b, *a, there)
    offset(*a, *b, back)
    np.testing.assert_allclose(there, -back, rtol=1e-12)
    np.testing.assert_allclose(there, [-110.7, 213.0, -25.0], atol=0.2)
