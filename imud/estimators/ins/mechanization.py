"""Strapdown mechanization in the local-level frame: attitude, velocity and position over one interval.

Angular rate and specific force are taken as linear in time between two samples, so that the rotation vector and the
velocity increment have closed second-order (coning and sculling) terms; the navigation frame turns with earth and
transport rate, gravity is Somigliana's.

Source: Titterton and Weston, Strapdown Inertial Navigation Technology (2004), ch. 3 and 11; Savage (1998).
"""

import math
from typing import Any

from ...kernels.earth import EARTH_RATE_RADPS, SEMI_MAJOR_M, gravity_above, radii, radii_by_sine, surface_gravity
from ...kernels.jit import kernel
from ...kernels.rotation import quat_exp, quat_normalised, quat_product, quat_renormalised, quat_rotate

MIN_COS_LAT = 1e-4  # of latitude, some 600 m from a pole: east and north lose their meaning there
EARTH_TOLERANCE = (
    1e-7  # radii, some 0.6 m (times the cosine of the latitude): nothing here changes by more than that share
)
MAX_LATITUDE = 0.5 * math.pi - 1e-9


@kernel
def wrap_angle(angle: float) -> float:
    """The angle in [-pi, pi)."""
    if -math.pi <= angle < math.pi:
        return angle
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel
def bounded_cosine(lat: float) -> float:
    """cos(lat), kept away from zero."""
    return max(math.cos(lat), MIN_COS_LAT)


@kernel
def update_earth(c: Any) -> None:
    """Find what depends on the place, anew after some 0.6 m."""
    near = abs(c.nav.lat - c.earth.position[0]) < EARTH_TOLERANCE * c.earth.cos_lat
    if near and abs(c.nav.height - c.earth.position[1]) < EARTH_TOLERANCE * SEMI_MAJOR_M:
        return
    c.earth.position[0], c.earth.position[1] = c.nav.lat, c.nav.height
    c.earth.sin_lat, c.earth.cos_lat = math.sin(c.nav.lat), bounded_cosine(c.nav.lat)
    c.earth.tan_lat = c.earth.sin_lat / c.earth.cos_lat
    meridian, prime_vertical = radii_by_sine(c.earth.sin_lat)
    c.earth.lat_per_m, c.earth.transverse_per_m = 1.0 / (meridian + c.nav.height), 1.0 / (prime_vertical + c.nav.height)
    c.earth.lon_per_m = c.earth.transverse_per_m / c.earth.cos_lat
    c.earth.gravity = gravity_above(surface_gravity(c.earth.sin_lat), c.earth.sin_lat, c.nav.height)


@kernel
def displace(c: Any, north: float, east: float, down: float) -> None:
    """Move the position by metres."""
    update_earth(c)
    c.nav.lon = wrap_angle(c.nav.lon + east * c.earth.lon_per_m)
    c.nav.lat = min(max(c.nav.lat + north * c.earth.lat_per_m, -MAX_LATITUDE), MAX_LATITUDE)
    c.nav.height -= down


@kernel
def ned_difference(c: Any, lat0: float, lon0: float, lat: float, lon: float) -> tuple[float, float]:
    """Metres north and east from one place to another near the core's."""
    meridian, prime_vertical = radii(c.nav.lat)
    return (lat - lat0) * (meridian + c.nav.height), wrap_angle(lon - lon0) * (
        prime_vertical + c.nav.height
    ) * bounded_cosine(c.nav.lat)


@kernel
def integrate_strapdown(c: Any, w: Any, f: Any, dt: float) -> None:
    """Advance q, v and position by `dt` s while the sensor goes from the last sample to (w, f), linearly; body axes."""
    update_earth(c)
    wx = 0.5 * (c.imu.w[0] + w[0]) - c.nav.bg[0]
    wy = 0.5 * (c.imu.w[1] + w[1]) - c.nav.bg[1]
    wz = 0.5 * (c.imu.w[2] + w[2]) - c.nav.bg[2]
    fx, fy, fz = (
        0.5 * (c.imu.f[0] + f[0]) - c.nav.ba[0],
        0.5 * (c.imu.f[1] + f[1]) - c.nav.ba[1],
        0.5 * (c.imu.f[2] + f[2]) - c.nav.ba[2],
    )
    # half differences: rate and force are mean -+ slope at the two ends
    ux, uy, uz = 0.5 * (w[0] - c.imu.w[0]), 0.5 * (w[1] - c.imu.w[1]), 0.5 * (w[2] - c.imu.w[2])
    gx, gy, gz = 0.5 * (f[0] - c.imu.f[0]), 0.5 * (f[1] - c.imu.f[1]), 0.5 * (f[2] - c.imu.f[2])
    k = dt * dt / 6.0
    turn = quat_exp(
        wx * dt + k * (wy * uz - wz * uy), wy * dt + k * (wz * ux - wx * uz), wz * dt + k * (wx * uy - wy * ux)
    )
    h = 0.5 * dt * dt
    dv = quat_rotate(
        (c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]),
        (
            fx * dt + h * (wy * fz - wz * fy) + k * (wy * gz - wz * gy - uy * fz + uz * fy),
            fy * dt + h * (wz * fx - wx * fz) + k * (wz * gx - wx * gz - uz * fx + ux * fz),
            fz * dt + h * (wx * fy - wy * fx) + k * (wx * gy - wy * gx - ux * fy + uy * fx),
        ),
    )
    north_rate, down_rate = EARTH_RATE_RADPS * c.earth.cos_lat, -EARTH_RATE_RADPS * c.earth.sin_lat
    tn, te = c.nav.v_n[1] * c.earth.transverse_per_m, -c.nav.v_n[0] * c.earth.lat_per_m
    td = -tn * c.earth.tan_lat
    on, oe, od = 2.0 * north_rate + tn, te, 2.0 * down_rate + td  # Coriolis
    vn, ve, vd = c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2]
    c.nav.v_n[0] = vn + dv[0] - (oe * vd - od * ve) * dt
    c.nav.v_n[1] = ve + dv[1] - (od * vn - on * vd) * dt
    c.nav.v_n[2] = vd + dv[2] - (on * ve - oe * vn) * dt + c.earth.gravity * dt
    displace(c, 0.5 * (vn + c.nav.v_n[0]) * dt, 0.5 * (ve + c.nav.v_n[1]) * dt, 0.5 * (vd + c.nav.v_n[2]) * dt)
    x, y, z = -0.5 * (north_rate + tn) * dt, -0.5 * te * dt, -0.5 * (down_rate + td) * dt
    q = quat_product((c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]), turn)
    # of first order: at 300 m/s a sample turns the frame by 1e-7 rad
    c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3] = quat_renormalised(
        (
            q[0] - x * q[1] - y * q[2] - z * q[3],
            q[1] + x * q[0] + y * q[3] - z * q[2],
            q[2] - x * q[3] + y * q[0] + z * q[1],
            q[3] + x * q[2] - y * q[1] + z * q[0],
        )
    )
    c.imu.delta_theta[0] += wx * dt
    c.imu.delta_theta[1] += wy * dt
    c.imu.delta_theta[2] += wz * dt
    for i in range(3):
        c.imu.delta_v[i] += dv[i]
        c.stationarity.delta_v[i] += dv[i]
    c.imu.integration_time += dt
    c.stationarity.duration += dt


@kernel
def rotate_attitude(c: Any, x: float, y: float, z: float) -> None:
    """q <- exp(x, y, z) q, normalised."""
    q = quat_product(quat_exp(x, y, z), (c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]))
    c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3] = quat_normalised(q)
