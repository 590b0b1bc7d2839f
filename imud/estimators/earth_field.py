"""The earth's magnetic field at a place, by the World Magnetic Model (package pygeomag, extra `imud[magnetometer]`)."""

import functools
import math
from typing import Any

import numpy as np

from ..errors import UsageError
from ..math.arrays import Records
from .records import MAGNETOMETER_SOURCE

CELL_DEG = 0.1  # the model is evaluated at the middle of a cell: it changes by less than 0.1 deg within
_LAST_YEAR = 2029.999  # that the newest coefficients are for


@functools.cache
def _model(year: float) -> Any:
    try:
        import pygeomag
    except ImportError as error:
        raise UsageError("the magnetometer needs the package pygeomag: pip install 'imud[magnetometer]'") from error
    return pygeomag.GeoMag(base_year=int(year))


def check() -> None:
    """Raises UsageError if the model's package is missing."""
    _model(_LAST_YEAR)


@functools.lru_cache(maxsize=64)
def _in_cell(lat: int, lon: int, km: int, year: float) -> tuple[float, float, float]:
    half = 0.5 * CELL_DEG
    found = _model(year).calculate(CELL_DEG * lat + half, CELL_DEG * lon + half, float(km), year)
    return 1e-9 * found.x, 1e-9 * found.y, 1e-9 * found.z


def earth_field(lat: float, lon: float, height: float, year: float) -> tuple[float, float, float]:
    """Field, T, in north, east, down, at latitude and longitude, rad, and height, m, in a decimal year from 2010 on.

    Source: NOAA NCEI and BGS, The US/UK World Magnetic Model. Raises UsageError if its package is missing.
    """
    cells = (math.floor(math.degrees(angle) / CELL_DEG) for angle in (lat, math.remainder(lon, math.tau)))
    return _in_cell(*cells, min(max(round(1e-3 * height), -1), 100), min(year, _LAST_YEAR))


def set_earth_field(measurements: Records, place: tuple[float, float, float], year: float) -> None:
    """Write the field at the place (rad, rad, m) to readings of a magnetometer (MEASUREMENT) that have none yet."""
    wanted = (measurements["kind"] == MAGNETOMETER_SOURCE) & np.isnan(measurements["value"][:, 3:]).any(axis=1)
    if wanted.any():
        measurements["value"][wanted, 3:] = earth_field(*place, year)
