"""The WGS-84 ellipsoid: radii of curvature, normal gravity, earth rate.

Source: NIMA TR8350.2 (2000), Somigliana's formula (eq. 4-1) and its second-order height term (eq. 4-3).
"""

import math

from imud.drivers import elementary

from ..compile.jit import kernel
from .rotation import wrap_angle

SEMI_MAJOR_M = 6378137.0
MEAN_RADIUS_M = 6.371e6  # of differences of latitude and longitude that need not be exact
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)
EARTH_RATE_RADPS = 7.292115e-5
GRAVITY_EQUATOR = 9.7803253359  # m/s^2
SOMIGLIANA_K = 0.00193185265241
GRAVITY_RATIO = 0.00344978650684  # m = omega^2 a^2 b / GM
STANDARD_GRAVITY = 9.80665  # m/s^2, the unit "g"
MIN_COS = 1e-9  # of a latitude: at the poles east is not defined


@kernel
def radii(lat: float) -> tuple[float, float]:
    """Meridian and prime-vertical radii of curvature in m at latitude `lat` (rad)."""
    return radii_by_sine(elementary.sin(lat))


@kernel
def radii_by_sine(sine: float) -> tuple[float, float]:
    """`radii`, given the sine of the latitude."""
    d = 1.0 - ECCENTRICITY2 * sine**2
    prime_vertical = SEMI_MAJOR_M / math.sqrt(d)
    return prime_vertical * (1.0 - ECCENTRICITY2) / d, prime_vertical


@kernel
def gravity(lat: float, height: float) -> float:
    """Normal gravity in m/s^2 at latitude (rad) and ellipsoidal height (m), positive down."""
    sine = elementary.sin(lat)
    return gravity_above(surface_gravity(sine), sine, height)


@kernel
def surface_gravity(sine: float) -> float:
    """Normal gravity on the ellipsoid in m/s^2, given the sine of the latitude."""
    return GRAVITY_EQUATOR * (1.0 + SOMIGLIANA_K * sine**2) / math.sqrt(1.0 - ECCENTRICITY2 * sine**2)


@kernel
def gravity_above(surface: float, sine: float, height: float) -> float:
    """Normal gravity in m/s^2 at `height` m, given that on the ellipsoid and the sine of the latitude."""
    h = height / SEMI_MAJOR_M
    return surface * (1.0 - 2.0 * h * (1.0 + FLATTENING + GRAVITY_RATIO - 2.0 * FLATTENING * sine**2) + 3.0 * h * h)


@kernel
def displaced(lat: float, lon: float, height: float, north: float, east: float) -> tuple[float, float]:
    """Latitude within +-pi/2 and longitude in [-pi, pi) of the point `north` and `east` m from (lat, lon), both small
    against the earth."""
    meridian, prime_vertical = radii(lat)
    lon = wrap_angle(lon + east / ((prime_vertical + height) * max(elementary.cos(lat), MIN_COS)))
    return min(max(lat + north / (meridian + height), -0.5 * math.pi), 0.5 * math.pi), lon
