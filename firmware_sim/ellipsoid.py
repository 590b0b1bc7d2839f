"""The WGS-84 earth as the emulator sees it: radii of curvature with their derivatives, earth rate, normal gravity.

Source: NIMA TR8350.2 (2000): Somigliana's formula (4-1), gravity above the ellipsoid (4-3). Written apart from the
estimator's own earth on purpose: the two check each other.
"""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

SEMI_MAJOR = 6378137.0  # m
SEMI_MINOR = 6356752.3142
FLATTENING = (SEMI_MAJOR - SEMI_MINOR) / SEMI_MAJOR
ECCENTRICITY_SQUARED = 6.69437999014e-3
EARTH_RATE = 7292115e-11  # rad/s
GM = 3986004.418e8  # m^3/s^2
EQUATOR_GRAVITY = 9.7803253359  # m/s^2
POLE_GRAVITY = 9.8321849378


def meridian(lat: Array) -> tuple[Array, Array]:
    """Meridian radius of curvature at latitude `lat` (rad) in m, and its derivative by latitude in m/rad."""
    s = np.sin(lat)
    w2 = 1.0 - ECCENTRICITY_SQUARED * s * s
    radius = SEMI_MAJOR * (1.0 - ECCENTRICITY_SQUARED) * w2**-1.5
    return radius, 3.0 * radius * ECCENTRICITY_SQUARED * s * np.cos(lat) / w2


def prime_vertical(lat: Array) -> tuple[Array, Array]:
    """Prime-vertical radius of curvature at latitude `lat` (rad) in m, and its derivative by latitude in m/rad."""
    s = np.sin(lat)
    w2 = 1.0 - ECCENTRICITY_SQUARED * s * s
    radius = SEMI_MAJOR * w2**-0.5
    return radius, radius * ECCENTRICITY_SQUARED * s * np.cos(lat) / w2


def gravity(lat: Array, height: Array) -> Array:
    """Normal gravity (attraction and centrifugal) in m/s^2, positive down, at latitude (rad) and height (m)."""
    s2 = np.sin(lat) ** 2
    k = SEMI_MINOR * POLE_GRAVITY / (SEMI_MAJOR * EQUATOR_GRAVITY) - 1.0
    surface = EQUATOR_GRAVITY * (1.0 + k * s2) / np.sqrt(1.0 - ECCENTRICITY_SQUARED * s2)
    m = EARTH_RATE**2 * SEMI_MAJOR**2 * SEMI_MINOR / GM
    linear = 2.0 / SEMI_MAJOR * (1.0 + FLATTENING + m - 2.0 * FLATTENING * s2)
    result: Array = surface * (1.0 - linear * height + 3.0 * (height / SEMI_MAJOR) ** 2)
    return result
