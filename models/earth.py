"""The earth: WGS-84 radii, normal gravity, earth rate and transport rate. Metres, radians, seconds; frame n.

References: NIMA TR8350.2 (WGS-84 constants, normal gravity formula of Somigliana, eq. 4-1, height by eq. 4-3); Groves,
"Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems", 2nd ed., eqs. 2.105, 2.106 (radii), 5.44 (transport rate).
"""

import math

from mavkf.compiled import kernel

SEMI_MAJOR_AXIS = 6378137.0  # m
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
EARTH_RATE = 7.292115e-5  # rad/s
GRAVITY_EQUATOR = 9.7803253359  # m/s^2
GRAVITY_POLE = 9.8321849378  # m/s^2
GRAVITATIONAL_CONSTANT = 3.986004418e14  # m^3/s^2
SOMIGLIANA = (1.0 - FLATTENING) * GRAVITY_POLE / GRAVITY_EQUATOR - 1.0
RATIO_M = EARTH_RATE**2 * SEMI_MAJOR_AXIS**3 * (1.0 - FLATTENING) / GRAVITATIONAL_CONSTANT
STANDARD_GRAVITY = 9.80665  # m/s^2, by definition


@kernel
def radii(latitude):
    """Meridian and transverse radii of curvature (m) at a latitude (rad)."""
    sine = math.sin(latitude)
    w2 = 1.0 - ECCENTRICITY_SQUARED * sine * sine
    w = math.sqrt(w2)
    return SEMI_MAJOR_AXIS * (1.0 - ECCENTRICITY_SQUARED) / (w * w2), SEMI_MAJOR_AXIS / w


@kernel
def gravity(latitude, height):
    """Normal gravity (m/s^2, positive down) at a latitude (rad) and a height above the ellipsoid (m)."""
    sine2 = math.sin(latitude) ** 2
    surface = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA * sine2) / math.sqrt(1.0 - ECCENTRICITY_SQUARED * sine2)
    k = height / SEMI_MAJOR_AXIS
    return surface * (1.0 - 2.0 * k * (1.0 + FLATTENING + RATIO_M - 2.0 * FLATTENING * sine2) + 3.0 * k * k)
