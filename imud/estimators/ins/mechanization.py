"""Strapdown mechanization in the local-level frame: attitude, velocity and position over one interval.

Angular rate and specific force are taken as linear in time between two samples, so that the rotation vector and the
velocity increment have closed second-order (coning and sculling) terms. The navigation frame turns with earth rate and
transport rate; gravity is Somigliana's.

Source: Titterton and Weston, Strapdown Inertial Navigation Technology (2004), ch. 3 and 11; Savage (1998); Groves
(2013), sec. 5.4.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.earth import EARTH_RATE_RADPS, SEMI_MAJOR_M, gravity_above, radii, radii_by_sine, surface_gravity
from ...math.rotation import (
    Vector,
    dcm_of_quat,
    quat_exp,
    quat_normalised,
    quat_product,
    quat_renormalised,
    quat_rotate,
    quat_rotate_back,
    wrap_angle,
)

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from ...math.rotation import Matrix, Quaternion
    from .types import Core

MIN_COS_LAT = 1e-4  # some 600 m from a pole, where east and north are not defined
EARTH_TOLERANCE = 1e-7  # of an earth radius, some 0.6 m: what depends on the position changes by no larger share
MAX_LATITUDE = 0.5 * math.pi - 1e-9


@kernel
def bounded_cosine(lat: float) -> float:
    """cos(lat), kept away from zero."""
    return max(elementary.cos(lat), MIN_COS_LAT)


@kernel
def quaternion(c: Core) -> tuple[float, float, float, float]:
    """The attitude q_nb as a tuple."""
    q = c.nav.q_nb
    return q[0], q[1], q[2], q[3]


@kernel
def rotation_matrix(c: Core) -> Matrix:
    """C_nb, body to navigation axes: nine numbers, row by row."""
    return dcm_of_quat(quaternion(c))


@kernel
def body_to_ned(c: Core, x: Vector) -> Vector:
    """A body vector in navigation axes."""
    return quat_rotate(quaternion(c), x)


@kernel
def ned_to_body(c: Core, x: Vector) -> Vector:
    """A vector of navigation axes in body axes."""
    return quat_rotate_back(quaternion(c), x)


@kernel
def update_earth(c: Core) -> None:
    """Evaluate radii and gravity at the position, again after a change of some 0.6 m."""
    n, e = c.nav, c.earth
    near = abs(n.lat - e.lat) < EARTH_TOLERANCE * e.cos_lat
    if near and abs(n.height - e.height) < EARTH_TOLERANCE * SEMI_MAJOR_M:
        return
    e.lat, e.height = n.lat, n.height
    e.sin_lat, e.cos_lat = elementary.sin(n.lat), bounded_cosine(n.lat)
    e.tan_lat = e.sin_lat / e.cos_lat
    meridian, prime_vertical = radii_by_sine(e.sin_lat)
    e.lat_per_m, e.transverse_per_m = 1.0 / (meridian + n.height), 1.0 / (prime_vertical + n.height)
    e.lon_per_m = e.transverse_per_m / e.cos_lat
    e.gravity = gravity_above(surface_gravity(e.sin_lat), e.sin_lat, n.height)


@kernel
def move_position(c: Core, north: float, east: float, down: float) -> None:
    """Move the nominal position by metres north, east and down, by the radii of the last `update_earth`."""
    c.nav.lon = wrap_angle(c.nav.lon + east * c.earth.lon_per_m)
    c.nav.lat = min(max(c.nav.lat + north * c.earth.lat_per_m, -MAX_LATITUDE), MAX_LATITUDE)
    c.nav.height -= down


@kernel
def displace(c: Core, north: float, east: float, down: float) -> None:
    """Move the nominal position by metres north, east and down."""
    update_earth(c)
    move_position(c, north, east, down)


@kernel
def ned_difference(c: Core, lat0: float, lon0: float, lat: float, lon: float) -> tuple[float, float]:
    """Metres north and east from one position to another near the core's."""
    meridian, prime_vertical = radii(c.nav.lat)
    north = (lat - lat0) * (meridian + c.nav.height)
    return north, wrap_angle(lon - lon0) * (prime_vertical + c.nav.height) * bounded_cosine(c.nav.lat)


@kernel
def integrate_strapdown(c: Core, w: Reals, f: Reals, dt: float) -> Vector:
    """Advance attitude, velocity and position by `dt` s while the sensor goes from its last sample to (w, f), linearly.

    w: rad/s, f: m/s^2, body axes. Returns the integral of the specific force in navigation axes, m/s.
    """
    update_earth(c)
    n, u, e = c.nav, c.imu, c.earth
    wx, wy, wz = 0.5 * (u.w[0] + w[0]) - n.bg[0], 0.5 * (u.w[1] + w[1]) - n.bg[1], 0.5 * (u.w[2] + w[2]) - n.bg[2]
    fx, fy, fz = 0.5 * (u.f[0] + f[0]) - n.ba[0], 0.5 * (u.f[1] + f[1]) - n.ba[1], 0.5 * (u.f[2] + f[2]) - n.ba[2]
    # half differences: rate and force are mean -+ slope at the two ends
    ux, uy, uz = 0.5 * (w[0] - u.w[0]), 0.5 * (w[1] - u.w[1]), 0.5 * (w[2] - u.w[2])
    gx, gy, gz = 0.5 * (f[0] - u.f[0]), 0.5 * (f[1] - u.f[1]), 0.5 * (f[2] - u.f[2])
    k = dt * dt / 6.0
    q_change = quat_exp(
        wx * dt + k * (wy * uz - wz * uy), wy * dt + k * (wz * ux - wx * uz), wz * dt + k * (wx * uy - wy * ux)
    )
    h = 0.5 * dt * dt
    dv = body_to_ned(
        c,
        (
            fx * dt + h * (wy * fz - wz * fy) + k * (wy * gz - wz * gy - uy * fz + uz * fy),
            fy * dt + h * (wz * fx - wx * fz) + k * (wz * gx - wx * gz - uz * fx + ux * fz),
            fz * dt + h * (wx * fy - wy * fx) + k * (wx * gy - wy * gx - ux * fy + uy * fx),
        ),
    )
    north_rate, down_rate = EARTH_RATE_RADPS * e.cos_lat, -EARTH_RATE_RADPS * e.sin_lat
    tn, te = n.v_n[1] * e.transverse_per_m, -n.v_n[0] * e.lat_per_m  # transport rate
    td = -tn * e.tan_lat
    on, oe, od = 2.0 * north_rate + tn, te, 2.0 * down_rate + td  # Coriolis
    vn, ve, vd = n.v_n[0], n.v_n[1], n.v_n[2]
    n.v_n[0] = vn + dv[0] - (oe * vd - od * ve) * dt
    n.v_n[1] = ve + dv[1] - (od * vn - on * vd) * dt
    n.v_n[2] = vd + dv[2] - (on * ve - oe * vn) * dt + e.gravity * dt
    move_position(c, 0.5 * (vn + n.v_n[0]) * dt, 0.5 * (ve + n.v_n[1]) * dt, 0.5 * (vd + n.v_n[2]) * dt)
    x, y, z = -0.5 * (north_rate + tn) * dt, -0.5 * te * dt, -0.5 * (down_rate + td) * dt
    q = quat_product(quaternion(c), q_change)
    # of first order: at 300 m/s a sample turns the frame by 1e-7 rad
    n.q_nb[0], n.q_nb[1], n.q_nb[2], n.q_nb[3] = quat_renormalised(
        (
            q[0] - x * q[1] - y * q[2] - z * q[3],
            q[1] + x * q[0] + y * q[3] - z * q[2],
            q[2] - x * q[3] + y * q[0] + z * q[1],
            q[3] + x * q[2] - y * q[1] + z * q[0],
        )
    )
    u.delta_theta[0] += wx * dt
    u.delta_theta[1] += wy * dt
    u.delta_theta[2] += wz * dt
    for i in range(3):
        u.delta_v[i] += dv[i]
    u.integration_time += dt
    return dv


@kernel
def start_integration(c: Core) -> None:
    """Start a new covariance interval."""
    for i in range(3):
        c.imu.delta_v[i] = c.imu.delta_theta[i] = 0.0
    c.imu.integration_time = 0.0


@kernel
def rotate_attitude(c: Core, x: float, y: float, z: float) -> None:
    """q_nb <- exp(x, y, z) q_nb, normalised; a small rotation in navigation axes, rad."""
    set_attitude(c, quat_normalised(quat_product(quat_exp(x, y, z), quaternion(c))))


@kernel
def set_attitude(c: Core, q: Quaternion) -> None:
    """q_nb <- q."""
    c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3] = q


@kernel
def set_position(c: Core, lat: float, lon: float, height: float) -> None:
    """Latitude and longitude rad, height m; a height of NaN leaves the present one."""
    c.nav.lat, c.nav.lon = lat, lon
    if math.isfinite(height):
        c.nav.height = height


@kernel
def set_velocity(c: Core, axis: int, v: float) -> None:
    """One component of the velocity, m/s, NED."""
    c.nav.v_n[axis] = v


@kernel
def clear_biases(c: Core) -> None:
    """Set both nominal biases to zero."""
    for i in range(3):
        c.nav.bg[i] = c.nav.ba[i] = 0.0


@kernel
def clear_gyro_bias(c: Core, i: int) -> None:
    """Set the nominal gyro bias of body axis i to zero."""
    c.nav.bg[i] = 0.0


@kernel
def clear_sensor_errors(c: Core) -> None:
    """Set nominal accelerometer biases and gyro_scale to zero."""
    for i in range(3):
        c.nav.ba[i] = 0.0
    for k in range(9):
        c.nav.gyro_scale[k] = 0.0
