"""Scalar measurements of the error state: gate, take, and carry the correction over into the nominal state."""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import measure, packed_index, shear, update
from .alignment.integrals import retain_integrals
from .integrity.gnss_drift import update_sensitivity
from .mechanization import displace, rotate_attitude
from .state import (
    ACCEL_BIAS,
    ATTITUDE,
    GNSS_BIAS,
    GYRO_BIAS,
    MOUNT_PITCH,
    MOUNT_YAW,
    NHC_LEVER_ARM,
    POSITION,
    STATES,
    TIME_OFFSET,
    TURN_SCALE,
    VELOCITY,
    VELOCITY_TIME_OFFSET,
)

MIN_TURN_RAD = 1e-3  # rad


@kernel
def set_jacobian(c: Any, k: int, column: int, value: float) -> int:
    """Put one element into the measurement row that has `k` already; returns k + 1."""
    c.scratch.columns[k] = column
    c.scratch.values[k] = value
    return k + 1


@kernel
def innovation_variance(c: Any, m: int) -> float:
    """h P h' of the row in hand; leaves P h in c.scratch.d."""
    return measure(c.cov.P, STATES, c.scratch.columns, c.scratch.values, m, c.scratch.d)


@kernel
def innovation(c: Any, m: int, z: float) -> float:
    """What is left of residual z (against the nominal state) after the corrections gathered so far."""
    for k in range(m):
        z -= c.scratch.values[k] * c.scratch.x[c.scratch.columns[k]]
    return z


@kernel
def kalman_update(c: Any, m: int, z: float, s: float, axis: int) -> None:
    """Fuse the row in hand, whose P h is in c.scratch.d, with innovation z of variance s: of position `axis`, or -1."""
    update_sensitivity(c, m, s, z, axis)
    update(c.cov.P, STATES, c.scratch.x, c.scratch.d, s, z, STATES)


@kernel
def gated_update(c: Any, m: int, z: float, r: float, gate: float) -> float:
    """Fuse the row in hand with residual z (against the nominal state) and variance r, unless z^2/s > gate > 0.

    Returns the normalised innovation squared, negative when rejected.
    """
    s = innovation_variance(c, m) + r
    z = innovation(c, m, z)
    nis = z * z / s
    if 0.0 < gate < nis or not nis < math.inf:
        return -nis
    kalman_update(c, m, z, s, -1)
    return nis


@kernel
def pseudo_measurement(c: Any, kind: int, m: int, z: float, r: float, gate: float) -> tuple[float, float, float]:
    """Take what is assumed, not measured, and tell of it as of a fix: innovation, its variance, and as `take`."""
    left = innovation(c, m, z)
    variance = innovation_variance(c, m) + r
    nis = gated_update(c, m, z, r, gate)
    if c.scratch.innovation_count < len(c.scratch.innovations):
        o = c.scratch.innovations[c.scratch.innovation_count]
        o.t_ns, o.kind, o.value, o.variance, o.used = c.nav.t_ns, kind, left, variance, 1 if nis >= 0.0 else 0
        c.scratch.innovation_count += 1
    return left, variance, nis


@kernel
def rotate_forward_axis(c: Any, pitch: float, yaw: float) -> None:
    """Turn the vehicle's forward and lateral axes by small angles about lateral and vertical."""
    fx, fy, fz = c.nhc.forward[0], c.nhc.forward[1], c.nhc.forward[2]
    lx, ly, lz = c.nhc.lateral[0], c.nhc.lateral[1], c.nhc.lateral[2]
    ux, uy, uz = fy * lz - fz * ly, fz * lx - fx * lz, fx * ly - fy * lx
    fx, fy, fz = fx + yaw * lx - pitch * ux, fy + yaw * ly - pitch * uy, fz + yaw * lz - pitch * uz
    n = math.sqrt(fx * fx + fy * fy + fz * fz)
    fx, fy, fz = fx / n, fy / n, fz / n
    s = lx * fx + ly * fy + lz * fz
    lx, ly, lz = lx - s * fx, ly - s * fy, lz - s * fz
    n = math.sqrt(lx * lx + ly * ly + lz * lz)
    c.nhc.forward[0], c.nhc.forward[1], c.nhc.forward[2] = fx, fy, fz
    c.nhc.lateral[0], c.nhc.lateral[1], c.nhc.lateral[2] = lx / n, ly / n, lz / n


@kernel
def rotate_tilt_covariance(c: Any, psi: float) -> None:
    """Turn the roll and pitch errors, given in NED, with a heading corrected by `psi` (as three shears, twice).

    What ties them to the accelerometer bias is fixed in the body, and was linearized about the old heading.
    """
    for _ in range(2):
        shear(c.cov.P, STATES, ATTITUDE, ATTITUDE + 1, -math.tan(0.25 * psi))
        shear(c.cov.P, STATES, ATTITUDE + 1, ATTITUDE, math.sin(0.5 * psi))
        shear(c.cov.P, STATES, ATTITUDE, ATTITUDE + 1, -math.tan(0.25 * psi))


@kernel
def inject_error(c: Any) -> None:
    """Add the gathered error estimate to the nominal state and clear it."""
    x = c.scratch.x
    retain_integrals(c)
    if abs(x[ATTITUDE + 2]) > MIN_TURN_RAD:
        rotate_tilt_covariance(c, x[ATTITUDE + 2])
    tilt2 = x[ATTITUDE] ** 2 + x[ATTITUDE + 1] ** 2
    bent2 = 0.25 * tilt2 * (tilt2 + x[ATTITUDE + 2] ** 2)  # a linear filter leaves out the square of a correction
    for i in range(2):
        c.cov.P[packed_index(STATES, ATTITUDE + i, ATTITUDE + i)] += bent2
    displace(c, x[POSITION], x[POSITION + 1], x[POSITION + 2])
    for i in range(3):
        c.nav.v_n[i] += x[VELOCITY + i]
        c.nav.bg[i] += x[GYRO_BIAS + i]
        c.nav.ba[i] += x[ACCEL_BIAS + i]
        c.gnss.bias[i] += x[GNSS_BIAS + i]
        c.nav.turn_scale[i] += x[TURN_SCALE + i]
    rotate_attitude(c, x[ATTITUDE], x[ATTITUDE + 1], 0.0)  # in the axes of the old heading, which may be far off
    rotate_attitude(c, 0.0, 0.0, x[ATTITUDE + 2])
    if c.nhc.enabled:
        rotate_forward_axis(c, x[MOUNT_PITCH], x[MOUNT_YAW])
        c.nhc.lever_arm += x[NHC_LEVER_ARM]
    c.gnss.time_offset += x[TIME_OFFSET]
    c.gnss.velocity_time_offset += x[VELOCITY_TIME_OFFSET]
    for i in range(STATES):
        x[i] = 0.0
