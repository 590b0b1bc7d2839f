"""Our frames and those of robotics (REP-103, REP-105): NED to ENU, body FRD to FLU, WGS-84 to metres.

Quaternions are Hamilton, scalar first.
"""

import math
from collections.abc import Sequence

MAP, ODOM, BODY, IMU, ANTENNA = "map", "odom", "base_link", "imu_link", "gnss_link"  # frames
A, E2 = 6378137.0, 6.69437999014e-3  # WGS-84: semi-major axis, m; first eccentricity squared
_HALF = math.sqrt(0.5)
_NED_TO_ENU = (0.0, _HALF, _HALF, 0.0)  # half a turn about the axis midway between north and east
_FLU_TO_FRD = (0.0, 1.0, 0.0, 0.0)  # half a turn about x

Vector = Sequence[float]


def product(p: Vector, q: Vector) -> tuple[float, float, float, float]:
    """Hamilton's."""
    a, b, c, d = p
    e, f, g, h = q
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def attitude(q_nb: Vector) -> tuple[float, float, float, float]:
    """From FRD in NED to FLU in ENU."""
    return product(product(_NED_TO_ENU, q_nb), _FLU_TO_FRD)


def world(v: Vector) -> tuple[float, float, float]:
    """A vector (NED) in ENU."""
    return v[1], v[0], -v[2]


def body(v: Vector) -> tuple[float, float, float]:
    """A vector (FRD) in FLU."""
    return v[0], -v[1], -v[2]


def diagonal(sigmas: Vector) -> list[float]:
    """Row-major 3 x 3 covariance of independent components."""
    x, y, z = sigmas
    return [x * x, 0.0, 0.0, 0.0, y * y, 0.0, 0.0, 0.0, z * z]


def _ecef(lat: float, lon: float, height: float) -> tuple[float, float, float]:
    n = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    across = (n + height) * math.cos(lat)
    return across * math.cos(lon), across * math.sin(lon), (n * (1.0 - E2) + height) * math.sin(lat)


class LocalMap:
    """East, north, up in m on the plane that touches the ellipsoid below the first position."""

    def __init__(self) -> None:
        self._origin: tuple[float, float, float] | None = None

    def place(self, lat: float, lon: float, height: float) -> tuple[float, float, float]:
        """Of a position (rad, m)."""
        if self._origin is None:
            self._origin = lat, lon, height
        lat0, lon0, _ = self._origin
        x, y, z = (a - b for a, b in zip(_ecef(lat, lon, height), _ecef(*self._origin), strict=True))
        s, c, sl, cl = math.sin(lat0), math.cos(lat0), math.sin(lon0), math.cos(lon0)
        out = x * cl + y * sl  # away from the axis
        return y * cl - x * sl, z * c - out * s, z * s + out * c
