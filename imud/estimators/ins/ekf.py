"""The error-state Kalman filter itself: Jacobian, innovation, scalar update, injection.

A measurement is one scalar. `set_jacobian` sets the elements of its Jacobian h, a sparse row; `cross_covariance`
returns h P h' and stores P h; `math.kalman.update_by_gain` corrects P and adds K z to the error estimate x in scratch,
which `inject_error` adds to the nominal state. Where x is not injected after each scalar, `innovation` subtracts h x.

Source: Groves (2013), sec. 3.2 and 14.2; Sola, Quaternion kinematics for the error-state Kalman filter (2017).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.kalman import measure, packed_index, predicted_variance, reset, shear, shear3, update_by_gain
from ...math.rotation import Vector
from ..tuning import Tunable
from .mechanization import displace, rotate_attitude
from .state import (
    ACCEL_BIAS,
    ATTITUDE,
    BARO_OFFSET,
    BORESIGHTS,
    GNSS_BIAS,
    GNSS_LEVER_ARM,
    GNSS_VELOCITY_BIAS,
    GYRO_BIAS,
    GYRO_SCALE,
    MOUNT_PITCH,
    MOUNT_YAW,
    NHC_LEVER_ARM,
    ODOMETER_SCALE,
    POSITION,
    STATES,
    TIME_OFFSET,
    VELOCITY,
    VELOCITY_TIME_OFFSET,
)
from .vehicle_axes import rotate_vehicle_axes

if TYPE_CHECKING:
    from .types import Core, Parameters


TUNABLES = (
    Tunable(
        "min_rotated_tilt",
        1e-3,
        "rad",
        "Least correction of the heading for which the covariance of the tilt is rotated.",
        "Numerics.",
    ),
)


@kernel
def exponential(c: Core, slot: int, x: float) -> float:
    """exp(x), remembered in a slot of scratch: the intervals of P are nearly all the same."""
    scratch = c.scratch
    if x != scratch.exp_arguments[slot] or scratch.exponentials[slot] == 0.0:
        scratch.exp_arguments[slot], scratch.exponentials[slot] = x, elementary.exp(x)
    return float(scratch.exponentials[slot])


@kernel
def covariance(c: Core, i: int, k: int) -> float:
    """P[i, k]."""
    return float(c.cov.P[packed_index(STATES, i, k)])


@kernel
def variance(c: Core, i: int) -> float:
    """P[i, i]."""
    return float(c.cov.P[packed_index(STATES, i, i)])


@kernel
def standard_deviation(c: Core, i: int) -> float:
    """Square root of P[i, i]."""
    return math.sqrt(max(variance(c, i), 0.0))


@kernel
def add_variance(c: Core, i: int, q: float) -> None:
    """P[i, i] += q."""
    c.cov.P[packed_index(STATES, i, i)] += q


@kernel
def inflate(c: Core, factor: float) -> None:
    """P *= factor >= 1: the errors are larger than stated, in the same proportion, and the correlations stay.

    The variances of the lever arm, the last three states, stay: it is constant, and its prior is taken back from them
    (`aiding.lever_arm_prior`).
    """
    P, root = c.cov.P, math.sqrt(factor)
    for i in range(GNSS_LEVER_ARM):
        begin = packed_index(STATES, i, i) - i
        for j in range(i, GNSS_LEVER_ARM):
            P[begin + j] *= factor
        for j in range(GNSS_LEVER_ARM, STATES):
            P[begin + j] *= root


@kernel
def add_covariance(c: Core, i: int, k: int, q: float) -> None:
    """P[i, k] += q."""
    c.cov.P[packed_index(STATES, i, k)] += q


@kernel
def decorrelate(c: Core, i: int, variance: float) -> None:
    """Make error state i independent of the others, with `variance`."""
    reset(c.cov.P, STATES, i, variance)
    for j in range(BORESIGHTS):
        c.cov.boresight[i, j] = 0.0


@kernel
def combine(c: Core, i: int, k: int, a: float) -> None:
    """Error state i gains `a` times error state k."""
    shear(c.cov.P, STATES, i, k, a)
    u = c.cov.boresight
    for j in range(BORESIGHTS):
        u[i, j] += a * u[k, j]


@kernel
def combine3(c: Core, i: int, k: int, a: float, b: float, d: float) -> None:
    """Error state i gains a, b, d times the error states k, k + 1, k + 2."""
    shear3(c.cov.P, STATES, i, k, a, b, d)
    u = c.cov.boresight
    for j in range(BORESIGHTS):
        u[i, j] += a * u[k, j] + b * u[k + 1, j] + d * u[k + 2, j]


@kernel
def set_jacobian(c: Core, length: int, column: int, value: float) -> int:
    """Append one element to the Jacobian, which has `length` elements; returns length + 1."""
    c.scratch.columns[length] = column
    c.scratch.values[length] = value
    return length + 1


@kernel
def set_jacobian3(c: Core, length: int, column: int, row: Vector) -> int:
    """Append the elements of three error states from `column` on to the Jacobian, unless all are 0, as those of a lever
    arm of 0; returns its length."""
    if row[0] == 0.0 and row[1] == 0.0 and row[2] == 0.0:
        return length
    length = set_jacobian(c, length, column, row[0])
    length = set_jacobian(c, length, column + 1, row[1])
    return set_jacobian(c, length, column + 2, row[2])


@kernel
def innovation_variance(c: Core, length: int) -> float:
    """h P h' for the Jacobian's `length` elements."""
    return predicted_variance(c.cov.P, STATES, c.scratch.columns, c.scratch.values, length)


@kernel
def cross_covariance(c: Core, length: int) -> float:
    """`innovation_variance`; stores P h in scratch.d, which an update needs."""
    return measure(c.cov.P, STATES, c.scratch.columns, c.scratch.values, length, c.scratch.d)


@kernel
def compute_gain(c: Core, s: float) -> None:
    """scratch.gain <- P h / s for an innovation of variance s; P h is in scratch.d."""
    for i in range(STATES):
        c.scratch.gain[i] = c.scratch.d[i] / s


@kernel
def apply_gain(c: Core, z: float) -> None:
    """Correct P and the error estimate by an innovation z; P h is in scratch.d, the gain in scratch.gain."""
    update_by_gain(c.cov.P, STATES, c.scratch.x, c.scratch.d, c.scratch.gain, z)


@kernel
def innovation(c: Core, length: int, z: float) -> float:
    """Innovation: z, that against the nominal state, less h x of the error estimate that is not injected yet."""
    for k in range(length):
        z -= c.scratch.values[k] * c.scratch.x[c.scratch.columns[k]]
    return z


@kernel
def add_correction(c: Core, i: int, x: float) -> None:
    """Add x to the estimate of error state i, without a measurement."""
    c.scratch.x[i] += x


@kernel
def cancel_correction(c: Core, i: int) -> None:
    """Set the estimate of error state i to zero."""
    c.scratch.x[i] = 0.0


@kernel
def rotate_tilt_covariance(c: Core, psi: float) -> None:
    """Rotate the covariance of the tilt errors (NED) by a heading correction `psi`, rad (as three shears, twice).

    The correlation of tilt and accelerometer bias is fixed in the body, and was linearized about the old heading.
    """
    for _ in range(2):
        combine(c, ATTITUDE, ATTITUDE + 1, -elementary.tan(0.25 * psi))
        combine(c, ATTITUDE + 1, ATTITUDE, elementary.sin(0.5 * psi))
        combine(c, ATTITUDE, ATTITUDE + 1, -elementary.tan(0.25 * psi))


@kernel
def inject_error(p: Parameters, c: Core) -> None:
    """Add the error estimate in scratch.x to the nominal state and clear it."""
    x, n = c.scratch.x, c.nav
    if abs(x[ATTITUDE + 2]) > p.tuning.min_rotated_tilt:
        rotate_tilt_covariance(c, x[ATTITUDE + 2])
    tilt2 = x[ATTITUDE] ** 2 + x[ATTITUDE + 1] ** 2
    second_order2 = 0.25 * tilt2 * (tilt2 + x[ATTITUDE + 2] ** 2)  # rad^2, square of the second-order part
    for i in range(2):
        add_variance(c, ATTITUDE + i, second_order2)
    displace(c, x[POSITION], x[POSITION + 1], x[POSITION + 2])
    for i in range(3):
        n.gnss_velocity_bias[i] += x[GNSS_VELOCITY_BIAS + i]
        n.v_n[i] += x[VELOCITY + i]
        n.bg[i] += x[GYRO_BIAS + i]
        n.ba[i] += x[ACCEL_BIAS + i]
        n.gnss_bias[i] += x[GNSS_BIAS + i]
        n.gnss_lever_arm[i] += x[GNSS_LEVER_ARM + i]
    for k in range(9):
        n.gyro_scale[k] += x[GYRO_SCALE + k]
    rotate_attitude(c, x[ATTITUDE], x[ATTITUDE + 1], 0.0)  # in the axes of the old heading, which may be far off
    rotate_attitude(c, 0.0, 0.0, x[ATTITUDE + 2])
    rotate_vehicle_axes(c, x[MOUNT_PITCH], x[MOUNT_YAW])
    if c.nhc.enabled:
        n.nhc_lever_arm += x[NHC_LEVER_ARM]
    n.time_offset += x[TIME_OFFSET]
    n.velocity_time_offset += x[VELOCITY_TIME_OFFSET]
    n.odometer_scale += x[ODOMETER_SCALE]
    n.baro_offset += x[BARO_OFFSET]
    for i in range(STATES):
        x[i] = 0.0
