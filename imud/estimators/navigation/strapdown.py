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

COSINE_FLOOR = 1e-4  # of latitude, some 600 m from a pole: east and north lose their meaning there
SAME_PLACE = 1e-7  # radii, some 0.6 m (times the cosine of the latitude): nothing here changes by more than that share
LATITUDE_LIMIT = 0.5 * math.pi - 1e-9


@kernel
def wrapped(angle: float) -> float:
    """The angle in [-pi, pi)."""
    if -math.pi <= angle < math.pi:
        return angle
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel
def cosine(lat: float) -> float:
    """cos(lat), kept away from zero."""
    return max(math.cos(lat), COSINE_FLOOR)


@kernel
def locate(c: Any) -> None:
    """Find what depends on the place, anew after some 0.6 m."""
    near = abs(c.lat - c.located[0]) < SAME_PLACE * c.cosine
    if near and abs(c.height - c.located[1]) < SAME_PLACE * SEMI_MAJOR_M:
        return
    c.located[0], c.located[1] = c.lat, c.height
    c.sine, c.cosine = math.sin(c.lat), cosine(c.lat)
    c.tangent = c.sine / c.cosine
    meridian, prime_vertical = radii_by_sine(c.sine)
    c.meridional, c.vertical = 1.0 / (meridian + c.height), 1.0 / (prime_vertical + c.height)
    c.longitudinal = c.vertical / c.cosine
    c.gravity = gravity_above(surface_gravity(c.sine), c.sine, c.height)


@kernel
def displace(c: Any, north: float, east: float, down: float) -> None:
    """Move the position by metres."""
    locate(c)
    c.lon = wrapped(c.lon + east * c.longitudinal)
    c.lat = min(max(c.lat + north * c.meridional, -LATITUDE_LIMIT), LATITUDE_LIMIT)
    c.height -= down


@kernel
def way(c: Any, lat0: float, lon0: float, lat: float, lon: float) -> tuple[float, float]:
    """Metres north and east from one place to another near the core's."""
    meridian, prime_vertical = radii(c.lat)
    return (lat - lat0) * (meridian + c.height), wrapped(lon - lon0) * (prime_vertical + c.height) * cosine(c.lat)


@kernel
def integrate(c: Any, w: Any, f: Any, dt: float) -> None:
    """Advance q, v and position by `dt` s while the sensor goes from (c.w, c.f) to (w, f), linearly; body axes."""
    locate(c)
    wx = 0.5 * (c.w[0] + w[0]) - c.bg[0]
    wy = 0.5 * (c.w[1] + w[1]) - c.bg[1]
    wz = 0.5 * (c.w[2] + w[2]) - c.bg[2]
    fx, fy, fz = 0.5 * (c.f[0] + f[0]) - c.ba[0], 0.5 * (c.f[1] + f[1]) - c.ba[1], 0.5 * (c.f[2] + f[2]) - c.ba[2]
    # half differences: rate and force are mean -+ slope at the two ends
    ux, uy, uz = 0.5 * (w[0] - c.w[0]), 0.5 * (w[1] - c.w[1]), 0.5 * (w[2] - c.w[2])
    gx, gy, gz = 0.5 * (f[0] - c.f[0]), 0.5 * (f[1] - c.f[1]), 0.5 * (f[2] - c.f[2])
    k = dt * dt / 6.0
    turn = quat_exp(
        wx * dt + k * (wy * uz - wz * uy), wy * dt + k * (wz * ux - wx * uz), wz * dt + k * (wx * uy - wy * ux)
    )
    h = 0.5 * dt * dt
    dv = quat_rotate(
        (c.q[0], c.q[1], c.q[2], c.q[3]),
        (
            fx * dt + h * (wy * fz - wz * fy) + k * (wy * gz - wz * gy - uy * fz + uz * fy),
            fy * dt + h * (wz * fx - wx * fz) + k * (wz * gx - wx * gz - uz * fx + ux * fz),
            fz * dt + h * (wx * fy - wy * fx) + k * (wx * gy - wy * gx - ux * fy + uy * fx),
        ),
    )
    north_rate, down_rate = EARTH_RATE_RADPS * c.cosine, -EARTH_RATE_RADPS * c.sine
    tn, te = c.v[1] * c.vertical, -c.v[0] * c.meridional
    td = -tn * c.tangent
    on, oe, od = 2.0 * north_rate + tn, te, 2.0 * down_rate + td  # Coriolis
    vn, ve, vd = c.v[0], c.v[1], c.v[2]
    c.v[0] = vn + dv[0] - (oe * vd - od * ve) * dt
    c.v[1] = ve + dv[1] - (od * vn - on * vd) * dt
    c.v[2] = vd + dv[2] - (on * ve - oe * vn) * dt + c.gravity * dt
    displace(c, 0.5 * (vn + c.v[0]) * dt, 0.5 * (ve + c.v[1]) * dt, 0.5 * (vd + c.v[2]) * dt)
    x, y, z = -0.5 * (north_rate + tn) * dt, -0.5 * te * dt, -0.5 * (down_rate + td) * dt
    q = quat_product((c.q[0], c.q[1], c.q[2], c.q[3]), turn)
    # of first order: at 300 m/s a sample turns the frame by 1e-7 rad
    c.q[0], c.q[1], c.q[2], c.q[3] = quat_renormalised(
        (
            q[0] - x * q[1] - y * q[2] - z * q[3],
            q[1] + x * q[0] + y * q[3] - z * q[2],
            q[2] - x * q[3] + y * q[0] + z * q[1],
            q[3] + x * q[2] - y * q[1] + z * q[0],
        )
    )
    c.turned[0] += wx * dt
    c.turned[1] += wy * dt
    c.turned[2] += wz * dt
    for i in range(3):
        c.dv[i] += dv[i]
        c.sum_n[i] += dv[i]
    c.gathered += dt
    c.elapsed += dt


@kernel
def rotate(c: Any, x: float, y: float, z: float) -> None:
    """q <- exp(x, y, z) q, normalised."""
    q = quat_product(quat_exp(x, y, z), (c.q[0], c.q[1], c.q[2], c.q[3]))
    c.q[0], c.q[1], c.q[2], c.q[3] = quat_normalised(q)
