"""True motion on the rotating ellipsoid, and the measurements of an ideal inertial sensor.

A path gives displacement and attitude with exact derivatives; position, velocity, angular rate and specific force
follow in closed form, so that they agree with each other to rounding. Axes: body FRD, navigation NED, Euler angles ZYX.
Source of the equations: Groves, Principles of GNSS, Inertial and Multisensor Integrated Navigation Systems (2013), 5.4.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from . import ellipsoid
from .ellipsoid import Array


@dataclass(frozen=True)
class Kinematics:
    """Of a path at n times. displacement: north, east, down in m from the origin, with two derivatives; rpy in rad."""

    displacement: Array  # (n, 3)
    velocity: Array  # (n, 3), its first derivative
    acceleration: Array  # (n, 3), its second derivative
    rpy: Array  # (n, 3) roll, pitch, yaw
    rpy_rate: Array  # (n, 3)


class Path(Protocol):
    """The shape of a motion in time, on a flat earth."""

    def at(self, t: Array) -> Kinematics:
        """Displacement and attitude at times `t` (n,) in s; at rest before 0."""
        ...


@dataclass(frozen=True)
class Truth:
    """True state of the sensor at n times, SI."""

    lat: Array  # (n,) rad
    lon: Array  # (n,) rad
    height: Array  # (n,) m above the ellipsoid
    v_n: Array  # (n, 3) m/s, NED
    rpy: Array  # (n, 3) rad
    w_ib_b: Array  # (n, 3) rad/s
    f_b: Array  # (n, 3) m/s^2, specific force


def rotation(rpy: Array) -> Array:
    """Matrices C_bn (n, 3, 3), which turn body vectors into n, of Euler angles `rpy` (n, 3) in rad."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy).T, np.cos(rpy).T
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def body_rate(rpy: Array, rpy_rate: Array) -> Array:
    """w_nb_b (n, 3) of Euler angles and their derivatives (Groves 2.58)."""
    (sr, sp, _), (cr, cp, _) = np.sin(rpy).T, np.cos(rpy).T
    dr, dp, dy = rpy_rate.T
    return np.stack([dr - dy * sp, dp * cr + dy * sr * cp, dy * cr * cp - dp * sr], axis=1)


class Trajectory:
    """A path laid on the ellipsoid: metres north and east become angles by the radii at the origin."""

    end = math.inf  # s; a scenario never ends

    def __init__(self, path: Path, lat_deg: float, lon_deg: float, height_m: float, delay_s: float = 0.0) -> None:
        self._path, self._delay = path, delay_s
        self._lat, self._lon, self._height = math.radians(lat_deg), math.radians(lon_deg), height_m
        lat = np.array([self._lat])
        self._north = float(ellipsoid.meridian(lat)[0][0]) + height_m
        self._east = (float(ellipsoid.prime_vertical(lat)[0][0]) + height_m) * math.cos(self._lat)

    def at(self, t: Array) -> Truth:
        """True state at times `t` (n,), s since the start."""
        k = self._path.at(t - self._delay)
        lat = self._lat + k.displacement[:, 0] / self._north
        lon = self._lon + k.displacement[:, 1] / self._east
        height = self._height - k.displacement[:, 2]
        dlat, ddlat = k.velocity[:, 0] / self._north, k.acceleration[:, 0] / self._north
        dlon, ddlon = k.velocity[:, 1] / self._east, k.acceleration[:, 1] / self._east
        climb = -k.velocity[:, 2]
        m, dm = ellipsoid.meridian(lat)
        n, dn = ellipsoid.prime_vertical(lat)
        s, c = np.sin(lat), np.cos(lat)
        m, n = m + height, n + height
        v_n = np.stack([m * dlat, n * c * dlon, -climb], axis=1)
        dv_north = m * ddlat + (dm * dlat + climb) * dlat
        dv_east = n * c * ddlon + ((dn * dlat + climb) * c - n * s * dlat) * dlon
        dv_n = np.stack([dv_north, dv_east, k.acceleration[:, 2]], axis=1)
        zero = np.zeros_like(lat)
        w_ie_n = ellipsoid.EARTH_RATE * np.stack([c, zero, -s], axis=1)
        w_en_n = np.stack([dlon * c, -dlat, -dlon * s], axis=1)
        g_n = np.stack([zero, zero, ellipsoid.gravity(lat, height)], axis=1)
        c_bn = rotation(k.rpy)
        w_ib_b = body_rate(k.rpy, k.rpy_rate) + np.einsum("nji,nj->ni", c_bn, w_ie_n + w_en_n)
        f_b = np.einsum("nji,nj->ni", c_bn, dv_n + np.cross(2.0 * w_ie_n + w_en_n, v_n) - g_n)
        return Truth(lat, lon, height, v_n, k.rpy, w_ib_b, f_b)

    def imu(self, t: Array) -> Array:
        """What an ideal sensor measures: w_ib_b in rad/s, then f_b in m/s^2, (n, 6) at times `t` (n,)."""
        truth = self.at(t)
        return np.hstack([truth.w_ib_b, truth.f_b])


@dataclass(frozen=True)
class Mounted:
    """The motion in the axes of a mounted sensor; matrix (3, 3) turns its vectors into the vehicle's."""

    vehicle: Trajectory
    matrix: Array

    @property
    def end(self) -> float:
        """As the vehicle's."""
        return self.vehicle.end

    def imu(self, t: Array) -> Array:
        """See `Trajectory.imu`, in the sensor's axes."""
        rates, forces = np.hsplit(self.vehicle.imu(t), 2)
        return np.hstack([rates @ self.matrix, forces @ self.matrix])
