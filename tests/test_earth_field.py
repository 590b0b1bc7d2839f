"""The earth's magnetic field against the test values that NOAA publishes with the World Magnetic Model."""

import math
import sys

import pytest

from imud.configuration.settings import Aiding, Settings
from imud.errors import UsageError
from imud.estimators import earth_field
from imud.setup import choices

# year, height km, latitude, longitude, deg: declination, dip, deg, horizontal, north, east, down, nT.
# Source: NOAA NCEI, WMM2025_TestValues.txt (WMM2025COF.zip), 19 of its 100 rows
NOAA = (
    (2025.0, 28, 89, -121, -99.77, 88.47, 1504.2981, -255.3887, -1482.4606, 56194.2888),
    (2025.0, 48, 80, -96, -29.91, 87.77, 2164.2855, 1875.9823, -1079.2694, 55623.0441),
    (2025.0, 54, 82, 87, 54.89, 87.68, 2302.4273, 1324.3369, 1883.4286, 56740.7721),
    (2025.0, 65, 43, 93, 0.50, 64.10, 24300.7647, 24299.8528, 210.5171, 50037.9240),
    (2025.0, 51, -33, 109, -5.49, -67.50, 21838.0465, 21737.7788, -2090.2741, -52710.0039),
    (2025.0, 39, -59, -8, -15.75, -58.55, 14918.1158, 14358.0955, -4049.1075, -24389.0864),
    (2025.0, 3, -50, -103, 27.96, -54.89, 22106.0414, 19526.5328, 10362.9910, -31437.5628),
    (2025.0, 94, -29, -110, 15.74, -38.25, 24181.9901, 23275.4711, 6559.0465, -19063.6053),
    (2025.5, 6, -36, -137, 20.28, -52.11, 25353.2307, 23781.9307, 8786.6989, -32577.5186),
    (2025.5, 63, 26, 81, 0.51, 41.07, 34803.9801, 34802.6134, 308.4319, 30332.0570),
    (2025.5, 69, 38, -144, 12.93, 56.97, 23096.3370, 22510.8045, 5167.6362, 35525.9903),
    (2025.5, 50, -70, -133, 57.21, -71.94, 16656.7094, 9021.8478, 14001.8652, -51084.8383),
    (2026.0, 74, -57, 3, -22.51, -58.65, 14362.2066, 13268.1196, -5498.1796, -23576.0629),
    (2026.0, 46, -24, -122, 14.01, -34.17, 26638.5001, 25846.1187, 6448.8633, -18080.3994),
    (2026.0, 69, 23, 63, 1.17, 35.92, 34565.8585, 34558.6053, 708.0788, 25043.4059),
    (2026.0, 33, -3, -147, 9.71, -2.12, 30957.6661, 30514.0864, 5221.8407, -1146.9790),
    (2027.0, 37, -66, -5, -17.22, -59.04, 17159.8365, 16390.7713, -5079.6266, -28608.2436),
    (2028.0, 49, 20, 167, 5.10, 26.82, 30251.2625, 30131.4361, 2689.8767, 15295.6118),
    (2029.0, 95, -60, -59, 8.58, -55.17, 18095.5989, 17893.0189, 2700.1059, -26011.8458),
)


@pytest.mark.parametrize("row", NOAA)
def test_the_model_gives_noaas_values(row):
    """To 0.05 uT: ours is that of the middle of a cell of 0.1 deg."""
    year, km, lat, lon, declination, dip, level, *field = row
    found = earth_field.earth_field(math.radians(lat), math.radians(lon), 1e3 * km, year)
    assert [1e9 * each for each in found] == pytest.approx(field, abs=80.0)
    assert 1e9 * math.hypot(*found[:2]) == pytest.approx(level, abs=80.0)
    if level > 6000.0:  # elsewhere no compass is of use
        assert math.degrees(math.atan2(found[1], found[0])) == pytest.approx(declination, abs=0.15)
        assert math.degrees(math.atan2(found[2], math.hypot(*found[:2]))) == pytest.approx(dip, abs=0.15)


def test_longitudes_of_a_turn_more_are_the_same_and_the_end_of_the_coefficients_is_no_error():
    there = (math.radians(48.0), math.radians(11.03), 500.0)
    around = (there[0], there[1] + 2.0 * math.pi, 500.0)
    assert earth_field.earth_field(*there, 2030.0) == earth_field.earth_field(*around, 2030.0)


def test_without_the_package_the_settings_are_refused_and_say_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygeomag", None)
    earth_field._model.cache_clear()
    with pytest.raises(UsageError, match=r"pip install 'imud\[magnetometer\]'"):
        choices.estimators(Settings(aiding=Aiding(magnetometer=True)))
    choices.estimators(Settings())
