"""What a mounting that is not exactly known adds to the covariance of an attitude.

The error is a small rotation about each axis, and a rotation by an angle that may be large about the one axis that is
known worst: gravity does not show how a sensor is turned about the vertical. Such a turn by psi, normally distributed,
moves the direction of gravity by sin(psi) across and 1 - cos(psi) along the way from that axis, whose mean squares are
exact for any standard deviation; for a small one they are those of a small rotation.
"""

import math
from typing import Any

import numpy as np

from ..compile.jit import kernel
from ..math.arrays import Floats, Records
from ..math.rotation import Matrix, Vector, cross, dot

MOUNTING_ERROR = np.dtype(
    [
        ("covariance", "<f8", (9,)),  # rad^2, row-major, body axes, without the axis that is known worst
        ("axis", "<f8", (3,)),  # that axis, of unit length
        ("angle_sigma", "<f8"),  # rad, about it; 0: the mounting is exact
        ("sine_sigma", "<f8"),  # root mean square of sin(angle)
        ("versine_sigma", "<f8"),  # and of 1 - cos(angle)
    ],
    align=True,
)


def set_covariance(error: Records, covariance: Floats) -> None:
    """Fill an array of one MOUNTING_ERROR from the covariance [3, 3], rad^2, of a rotation in body axes."""
    values, vectors = np.linalg.eigh(covariance)
    axis, variance = vectors[:, 2], float(values[2])
    error["covariance"] = (covariance - variance * np.outer(axis, axis)).ravel()
    error["axis"], error["angle_sigma"] = axis, math.sqrt(variance)
    error["sine_sigma"] = math.sqrt(-0.5 * math.expm1(-2.0 * variance))
    versine2 = -2.0 * math.expm1(-0.5 * variance) + 0.5 * math.expm1(-2.0 * variance)
    error["versine_sigma"] = math.sqrt(max(versine2, 0.0))


@kernel
def bilinear(x: Vector, C: Any, y: Vector) -> float:
    """x^T C y of a matrix C (9,), row-major."""
    product: float = (
        x[0] * (C[0] * y[0] + C[1] * y[1] + C[2] * y[2])
        + x[1] * (C[3] * y[0] + C[4] * y[1] + C[5] * y[2])
        + x[2] * (C[6] * y[0] + C[7] * y[1] + C[8] * y[2])
    )
    return product


@kernel
def added_covariance(error: Any, R: Matrix) -> tuple[float, float, float, float, float, float]:
    """Of a rotation in navigation axes (NED), rad^2: elements 00, 01, 02, 11, 12, 22. R: from body axes to those."""
    north, east, down = (R[0], R[1], R[2]), (R[3], R[4], R[5]), (R[6], R[7], R[8])
    u = (error.axis[0], error.axis[1], error.axis[2])
    along = dot(u, down)
    turned, moved = error.angle_sigma * along, error.sine_sigma
    # about the axis: its part about the vertical, and what of it moves the direction of gravity; and across both
    v0, v1, v2 = moved * dot(north, u), moved * dot(east, u), turned
    side = cross(down, u)
    w0, w1 = error.versine_sigma * along * dot(north, side), error.versine_sigma * along * dot(east, side)
    C = error.covariance
    return (
        bilinear(north, C, north) + v0 * v0 + w0 * w0,
        bilinear(north, C, east) + v0 * v1 + w0 * w1,
        bilinear(north, C, down) + v0 * v2,
        bilinear(east, C, east) + v1 * v1 + w1 * w1,
        bilinear(east, C, down) + v1 * v2,
        bilinear(down, C, down) + v2 * v2,
    )
