"""The axes of a land vehicle in the body: forward, lateral, vertical. The sensor may be mounted in any way."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Vector, cross

if TYPE_CHECKING:
    from .types import Core


@kernel
def forward_axis(c: Core) -> Vector:
    """Unit vector of the vehicle's motion in the body."""
    return c.nav.forward[0], c.nav.forward[1], c.nav.forward[2]


@kernel
def lateral_axis(c: Core) -> Vector:
    """Unit vector to the vehicle's right in the body."""
    return c.nav.lateral[0], c.nav.lateral[1], c.nav.lateral[2]


@kernel
def vertical_axis(c: Core) -> Vector:
    """Unit vector down from the vehicle in the body."""
    return cross(forward_axis(c), lateral_axis(c))


@kernel
def set_vehicle_axes(c: Core, forward: Vector, lateral: Vector) -> None:
    """Set forward and lateral axis (unit vectors, body) and a zero lever arm of the constraint."""
    for i in range(3):
        c.nav.forward[i], c.nav.lateral[i] = forward[i], lateral[i]
    c.nav.nhc_lever_arm = 0.0


@kernel
def rotate_vehicle_axes(c: Core, pitch: float, yaw: float) -> None:
    """Rotate forward and lateral axis by small angles, rad, about lateral and vertical axis."""
    fx, fy, fz = forward_axis(c)
    lx, ly, lz = lateral_axis(c)
    ux, uy, uz = vertical_axis(c)
    fx, fy, fz = fx + yaw * lx - pitch * ux, fy + yaw * ly - pitch * uy, fz + yaw * lz - pitch * uz
    n = math.sqrt(fx * fx + fy * fy + fz * fz)
    fx, fy, fz = fx / n, fy / n, fz / n
    s = lx * fx + ly * fy + lz * fz
    lx, ly, lz = lx - s * fx, ly - s * fy, lz - s * fz
    n = math.sqrt(lx * lx + ly * ly + lz * lz)
    c.nav.forward[0], c.nav.forward[1], c.nav.forward[2] = fx, fy, fz
    c.nav.lateral[0], c.nav.lateral[1], c.nav.lateral[2] = lx / n, ly / n, lz / n
