"""imud.math.earth against pymap3d and closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imud.math.earth import EARTH_RATE_RADPS, FLATTENING, SEMI_MAJOR_M, gravity, radii

pymap3d = pytest.importorskip("pymap3d")
LATITUDES = st.floats(-0.5 * math.pi, 0.5 * math.pi)


@given(LATITUDES)
def test_radii_are_those_of_pymap3d(lat):
    meridian, prime_vertical = radii(lat)
    assert meridian == pytest.approx(float(pymap3d.rcurve.meridian(lat, deg=False)), rel=1e-12)
    assert prime_vertical == pytest.approx(float(pymap3d.rcurve.transverse(lat, deg=False)), rel=1e-12)


@given(st.floats(-1.4, 1.4), st.floats(-3.0, 3.0), st.floats(0.0, 5000.0))
def test_radii_turn_small_angles_into_the_metres_of_the_ellipsoid(lat, lon, height):
    step = 1e-6
    meridian, prime_vertical = radii(lat)
    n, e, _ = pymap3d.geodetic2ned(lat + step, lon + step, height, lat, lon, height, deg=False)
    assert n == pytest.approx(step * (meridian + height), rel=1e-4)
    assert e == pytest.approx(step * (prime_vertical + height) * math.cos(lat), rel=1e-4)


def test_gravity_has_the_values_of_its_source_at_equator_and_pole():
    assert gravity(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)  # TR8350.2 table 3.4
    assert gravity(0.5 * math.pi, 0.0) == pytest.approx(9.8321849378, abs=1e-8)
    lat = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 4001)
    area = np.array([math.prod(radii(x)) * math.cos(x) for x in lat])
    mean = np.sum(area * [gravity(x, 0.0) for x in lat]) / np.sum(area)
    assert mean == pytest.approx(9.7976432222, abs=1e-7)  # its theoretical mean over the ellipsoid


@pytest.mark.parametrize("lat", [0.0, 0.4, 0.9, 1.5])
def test_gravity_falls_with_height_like_the_attraction_of_the_ellipsoid(lat):
    """Independent: gradient of the normal potential by the free-air formula 2 g / R (1 + f + m - 2 f sin^2)."""
    m = EARTH_RATE_RADPS**2 * SEMI_MAJOR_M**3 * (1.0 - FLATTENING) / 3.986004418e14
    slope = (gravity(lat, 100.0) - gravity(lat, 0.0)) / 100.0
    free_air = 2.0 * gravity(lat, 0.0) / SEMI_MAJOR_M * (1.0 + FLATTENING + m - 2.0 * FLATTENING * math.sin(lat) ** 2)
    assert slope == pytest.approx(-free_air, rel=1e-4)
    assert np.diff([gravity(lat, h) for h in range(0, 10_000, 500)]).max() < 0.0
