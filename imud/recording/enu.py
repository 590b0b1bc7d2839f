"""Our frames and those of robotics (REP-103, REP-105): NED to ENU, body FRD to FLU, WGS-84 to metres.

Quaternions are Hamilton, scalar first.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..math.arrays import Floats

MAP, ODOM, BODY, IMU, ANTENNA = "map", "odom", "base_link", "imu_link", "gnss_link"  # frames
A, E2 = 6378137.0, 6.69437999014e-3  # WGS-84: semi-major axis, m; first eccentricity squared
_HALF = math.sqrt(0.5)
_NED_TO_ENU = (0.0, _HALF, _HALF, 0.0)  # half a turn about the axis midway between north and east
_FLU_TO_FRD = (0.0, 1.0, 0.0, 0.0)  # half a turn about x

Vector = Sequence[float]


def product(p: Any, q: Any) -> tuple[Any, Any, Any, Any]:
    """Hamilton's. Like `attitude`, `world` and `body` also of arrays, one for each component."""
    a, b, c, d = p
    e, f, g, h = q
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def attitude(q_nb: Any) -> tuple[Any, Any, Any, Any]:
    """From FRD in NED to FLU in ENU."""
    return product(product(_NED_TO_ENU, q_nb), _FLU_TO_FRD)


def world(v: Any) -> tuple[Any, Any, Any]:
    """A vector (NED) in ENU."""
    return v[1], v[0], -v[2]


def body(v: Any) -> tuple[Any, Any, Any]:
    """A vector (FRD) in FLU."""
    return v[0], -v[1], -v[2]


def diagonal(sigmas: Vector) -> list[float]:
    """Row-major 3 x 3 covariance of independent components."""
    x, y, z = sigmas
    return [x * x, 0.0, 0.0, 0.0, y * y, 0.0, 0.0, 0.0, z * z]


def each(function: Callable[..., float], *columns: Any) -> Any:
    """A function of `math` for each element: its digits are the same on every processor, unlike numpy's."""
    return np.fromiter(map(function, *(column.tolist() for column in columns)), float, len(columns[0]))


def _ecef(lat: Any, lon: Any, height: Any) -> tuple[Any, Any, Any]:
    """Of arrays."""
    s = each(math.sin, lat)
    n = A / np.sqrt(1.0 - E2 * (s * s))
    across = (n + height) * each(math.cos, lat)
    return across * each(math.cos, lon), across * each(math.sin, lon), (n * (1.0 - E2) + height) * s


class LocalMap:
    """East, north, up in m on the plane that touches the ellipsoid below the first position."""

    def __init__(self) -> None:
        self._origin: tuple[Floats, Floats, Floats] | None = None

    def place(self, lat: float, lon: float, height: float) -> tuple[float, float, float]:
        """Of a position (rad, m)."""
        east, north, up = self.places(*(np.array([value], float) for value in (lat, lon, height)))[0].tolist()
        return east, north, up

    def places(self, lat: Floats, lon: Floats, height: Floats) -> Floats:
        """Of n positions: n x 3."""
        if self._origin is None:
            self._origin = lat[:1].copy(), lon[:1].copy(), height[:1].copy()
        lat0, lon0 = float(self._origin[0][0]), float(self._origin[1][0])
        x, y, z = (a - b for a, b in zip(_ecef(lat, lon, height), _ecef(*self._origin), strict=True))
        s, c, sl, cl = math.sin(lat0), math.cos(lat0), math.sin(lon0), math.cos(lon0)
        out = x * cl + y * sl  # away from the axis
        return np.stack([y * cl - x * sl, z * c - out * s, z * s + out * c], axis=1)
