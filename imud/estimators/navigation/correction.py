"""Scalar measurements of the error state: gate, take, and carry the correction over into the nominal state."""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import measure, packed_index, shear, update
from .creep import follow_pull
from .matching import shift
from .state import (
    ACCEL_BIAS,
    ARM,
    ATTITUDE,
    GYRO_BIAS,
    LAG,
    LATENCY,
    MOUNT_PITCH,
    MOUNT_YAW,
    POSITION,
    STATES,
    TURN_SCALE,
    VELOCITY,
    WANDER,
)
from .strapdown import displace, rotate

NOTABLE_TURN = 1e-3  # rad


@kernel
def row(c: Any, k: int, column: int, value: float) -> int:
    """Put one element into the measurement row that has `k` already; returns k + 1."""
    c.columns[k] = column
    c.values[k] = value
    return k + 1


@kernel
def predicted(c: Any, m: int) -> float:
    """h P h' of the row in hand; leaves P h in c.d."""
    return measure(c.P, STATES, c.columns, c.values, m, c.d)


@kernel
def residual(c: Any, m: int, z: float) -> float:
    """What is left of residual z (against the nominal state) after the corrections gathered so far."""
    for k in range(m):
        z -= c.values[k] * c.x[c.columns[k]]
    return z


@kernel
def absorb(c: Any, m: int, z: float, s: float, axis: int) -> None:
    """Fuse the row in hand, whose P h is in c.d, with innovation z of variance s: of position `axis`, or -1."""
    follow_pull(c, m, s, z, axis)
    update(c.P, STATES, c.x, c.d, s, z, STATES)


@kernel
def take(c: Any, m: int, z: float, r: float, gate: float) -> float:
    """Fuse the row in hand with residual z (against the nominal state) and variance r, unless z^2/s > gate > 0.

    Returns the normalised innovation squared, negative when rejected.
    """
    s = predicted(c, m) + r
    z = residual(c, m, z)
    nis = z * z / s
    if 0.0 < gate < nis or not nis < math.inf:
        return -nis
    absorb(c, m, z, s, -1)
    return nis


@kernel
def assume(c: Any, kind: int, m: int, z: float, r: float, gate: float) -> tuple[float, float, float]:
    """Take what is assumed, not measured, and tell of it as of a fix: innovation, its variance, and as `take`."""
    left = residual(c, m, z)
    variance = predicted(c, m) + r
    nis = take(c, m, z, r, gate)
    if c.telling < len(c.told):
        o = c.told[c.telling]
        o.t_ns, o.kind, o.value, o.variance, o.used = c.t_ns, kind, left, variance, 1 if nis >= 0.0 else 0
        c.telling += 1
    return left, variance, nis


@kernel
def turn_axis(c: Any, pitch: float, yaw: float) -> None:
    """Turn the vehicle's forward and lateral axes by small angles about lateral and vertical."""
    fx, fy, fz = c.forward[0], c.forward[1], c.forward[2]
    lx, ly, lz = c.lateral[0], c.lateral[1], c.lateral[2]
    ux, uy, uz = fy * lz - fz * ly, fz * lx - fx * lz, fx * ly - fy * lx
    fx, fy, fz = fx + yaw * lx - pitch * ux, fy + yaw * ly - pitch * uy, fz + yaw * lz - pitch * uz
    n = math.sqrt(fx * fx + fy * fy + fz * fz)
    fx, fy, fz = fx / n, fy / n, fz / n
    s = lx * fx + ly * fy + lz * fz
    lx, ly, lz = lx - s * fx, ly - s * fy, lz - s * fz
    n = math.sqrt(lx * lx + ly * ly + lz * lz)
    c.forward[0], c.forward[1], c.forward[2] = fx, fy, fz
    c.lateral[0], c.lateral[1], c.lateral[2] = lx / n, ly / n, lz / n


@kernel
def turn_tilt(c: Any, psi: float) -> None:
    """Turn the roll and pitch errors, given in NED, with a heading corrected by `psi` (as three shears, twice).

    What ties them to the accelerometer bias is fixed in the body, and was linearized about the old heading.
    """
    for _ in range(2):
        shear(c.P, STATES, ATTITUDE, ATTITUDE + 1, -math.tan(0.25 * psi))
        shear(c.P, STATES, ATTITUDE + 1, ATTITUDE, math.sin(0.5 * psi))
        shear(c.P, STATES, ATTITUDE, ATTITUDE + 1, -math.tan(0.25 * psi))


@kernel
def correct(c: Any) -> None:
    """Add the gathered error estimate to the nominal state and clear it."""
    x = c.x
    shift(c)
    if abs(x[ATTITUDE + 2]) > NOTABLE_TURN:
        turn_tilt(c, x[ATTITUDE + 2])
    tilt2 = x[ATTITUDE] ** 2 + x[ATTITUDE + 1] ** 2
    bent2 = 0.25 * tilt2 * (tilt2 + x[ATTITUDE + 2] ** 2)  # a linear filter leaves out the square of a correction
    for i in range(2):
        c.P[packed_index(STATES, ATTITUDE + i, ATTITUDE + i)] += bent2
    displace(c, x[POSITION], x[POSITION + 1], x[POSITION + 2])
    for i in range(3):
        c.v[i] += x[VELOCITY + i]
        c.bg[i] += x[GYRO_BIAS + i]
        c.ba[i] += x[ACCEL_BIAS + i]
        c.wander[i] += x[WANDER + i]
        c.turn_scale[i] += x[TURN_SCALE + i]
    rotate(c, x[ATTITUDE], x[ATTITUDE + 1], 0.0)  # in the axes of the old heading, which may be far off
    rotate(c, 0.0, 0.0, x[ATTITUDE + 2])
    if c.constrained:
        turn_axis(c, x[MOUNT_PITCH], x[MOUNT_YAW])
        c.arm += x[ARM]
    c.latency += x[LATENCY]
    c.lag += x[LAG]
    for i in range(STATES):
        x[i] = 0.0
