"""The axes of the sensor, in which its readings are cut off, rounded and frozen, beside those of the body."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Vector

if TYPE_CHECKING:
    from .types import Parameters


@kernel
def to_sensor_axes(p: Parameters, v: Vector) -> Vector:
    """A vector in body axes, in those of the sensor."""
    R = p.sensor_axes
    return (
        R[0] * v[0] + R[3] * v[1] + R[6] * v[2],
        R[1] * v[0] + R[4] * v[1] + R[7] * v[2],
        R[2] * v[0] + R[5] * v[1] + R[8] * v[2],
    )


@kernel
def to_body_axes(p: Parameters, v: Vector) -> Vector:
    """A vector in the sensor's axes, in those of the body."""
    R = p.sensor_axes
    return (
        R[0] * v[0] + R[1] * v[1] + R[2] * v[2],
        R[3] * v[0] + R[4] * v[1] + R[5] * v[2],
        R[6] * v[0] + R[7] * v[1] + R[8] * v[2],
    )
