"""Strapdown mechanization in the local-level frame: attitude, velocity and position over one interval.

Angular rate and specific force are taken as linear in time between two samples, so that the rotation vector and the
velocity increment have closed second-order (coning and sculling) terms; the navigation frame turns with earth and
transport rate, gravity is Somigliana's.

Source: Titterton and Weston, Strapdown Inertial Navigation Technology (2004), ch. 3 and 11; Savage (1998).
"""

import math
from typing import Any

from ...kernels.earth import EARTH_RATE_RADPS, gravity_above, radii, radii_by_sine, surface_gravity
from ...kernels.jit import kernel
from ...kernels.rotation import quat_exp, quat_normalised, quat_product, quat_rotate

COSINE_FLOOR = 1e-4  # of latitude, some 600 m from a pole: east and north lose their meaning there
SAME_LATITUDE = 1e-7  # rad, times the cosine: sine, cosine and the rest change by a ten-millionth at most
LATITUDE_LIMIT = 0.5 * math.pi - 1e-9


@kernel
def wrapped(angle: float) -> float:
    """The angle in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel
def cosine(lat: float) -> float:
    """cos(lat), kept away from zero."""
    return max(math.cos(lat), COSINE_FLOOR)


@kernel
def locate(c: Any) -> Any:
    """Sine and cosine of the latitude, radii of curvature and gravity on the ellipsoid: anew after some 0.6 m."""
    terms = c.terms
    if not abs(c.lat - terms[0]) < SAME_LATITUDE * terms[2]:
        sine = math.sin(c.lat)
        terms[0], terms[1], terms[2] = c.lat, sine, cosine(c.lat)
        terms[3], terms[4] = radii_by_sine(sine)
        terms[5] = surface_gravity(sine)
    return terms[1], terms[2], terms[3], terms[4], terms[5]


@kernel
def displace(c: Any, north: float, east: float, down: float) -> None:
    """Move the position by metres."""
    _, cl, meridian, prime_vertical, _ = locate(c)
    c.lon = wrapped(c.lon + east / ((prime_vertical + c.height) * cl))
    c.lat = min(max(c.lat + north / (meridian + c.height), -LATITUDE_LIMIT), LATITUDE_LIMIT)
    c.height -= down


@kernel
def way(c: Any, lat0: float, lon0: float, lat: float, lon: float) -> tuple[float, float]:
    """Metres north and east from one place to another near the core's."""
    meridian, prime_vertical = radii(c.lat)
    return (lat - lat0) * (meridian + c.height), wrapped(lon - lon0) * (prime_vertical + c.height) * cosine(c.lat)


@kernel
def integrate(c: Any, w: Any, f: Any, dt: float) -> None:
    """Advance q, v and position by `dt` s while the sensor goes from (c.w, c.f) to (w, f), linearly; body axes."""
    sl, cl, meridian, prime_vertical, surface = locate(c)
    wx = 0.5 * (c.w[0] + w[0]) - c.bg[0] - c.excess[0]
    wy = 0.5 * (c.w[1] + w[1]) - c.bg[1] - c.excess[1]
    wz = 0.5 * (c.w[2] + w[2]) - c.bg[2] - c.excess[2]
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
    north_rate = EARTH_RATE_RADPS * cl
    down_rate = -EARTH_RATE_RADPS * sl
    tn = c.v[1] / (prime_vertical + c.height)
    te = -c.v[0] / (meridian + c.height)
    td = -tn * sl / cl
    on, oe, od = 2.0 * north_rate + tn, te, 2.0 * down_rate + td  # Coriolis
    vn, ve, vd = c.v[0], c.v[1], c.v[2]
    c.v[0] = vn + dv[0] - (oe * vd - od * ve) * dt
    c.v[1] = ve + dv[1] - (od * vn - on * vd) * dt
    c.v[2] = vd + dv[2] - (on * ve - oe * vn) * dt + gravity_above(surface, sl, c.height) * dt
    displace(c, 0.5 * (vn + c.v[0]) * dt, 0.5 * (ve + c.v[1]) * dt, 0.5 * (vd + c.v[2]) * dt)
    rotate(c, turn, -(north_rate + tn) * dt, -te * dt, -(down_rate + td) * dt)
    for i in range(3):
        c.dv[i] += dv[i]
    c.gathered += dt


@kernel
def rotate(c: Any, turn: Any, x: float, y: float, z: float) -> None:
    """q <- exp(x, y, z) q turn, normalised."""
    q = quat_product(quat_exp(x, y, z), quat_product((c.q[0], c.q[1], c.q[2], c.q[3]), turn))
    c.q[0], c.q[1], c.q[2], c.q[3] = quat_normalised(q)
