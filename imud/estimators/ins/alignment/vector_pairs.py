"""Pairs of vectors: the receiver's velocity changes and the integrals of specific force, in a frame fixed by the gyros.

Between two fixes the receiver measures the integral of specific force in navigation axes. The IMU measures it in a
frame that was the body's at the first fix and that the gyros carry on:

    dV - g dt = C (df + S db),   S = integral of [f x] G,   G = integral of the body's axes in that frame

C, the attitude of that frame, and db, the error of the gyro bias, are the same for all pairs. `vector_levelling` solves
for them.

Source: Wu and Pan, Velocity/position integration formula, part I (2013).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.earth import gravity
from ....math.rotation import (
    cross,
    dcm_of_quat,
    quat_exp,
    quat_normalised,
    quat_product,
    quat_rotate,
)
from ...tuning import Tunable
from ..ekf import variance
from ..lever_arm import antenna_velocity
from ..mechanization import ned_to_body
from ..state import NEVER_NS, TIME_OFFSET, VECTORS

if TYPE_CHECKING:
    from ....math.rotation import Quaternion, Vector
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable("vector_pair_s", 0.9, "s", "Shortest time between two fixes of a pair of vectors.", "1 Hz receivers."),
    Tunable("vector_pair_max_s", 3.0, "s", "Longest time between two fixes of a pair of vectors.", "Choice."),
    Tunable(
        "vector_accel_sigma",
        0.3,
        "m/s^2",
        "Acceleration that a receiver's velocity does not show, and the accelerometer's own error.",
        "As level_gnss_sigma.",
    ),
    Tunable(
        "vector_vertical_sigma",
        2.0,
        "m/s",
        "Sigma of a change of the vertical velocity that the fix does not give.",
        "Choice.",
    ),
)


@kernel
def vector_quaternion(c: Core) -> Quaternion:
    """The body's attitude in the vectors' frame."""
    q = c.alignment.vector_q
    return (q[0], q[1], q[2], q[3])


@kernel
def accumulate_vectors(c: Core, dt: float) -> None:
    """Add the covariance interval's integrals of rate and force, over `dt` s, to those of the present pair."""
    a = c.alignment
    if a.vector_start_ns == NEVER_NS:
        return
    w, bg, b0 = c.imu.delta_theta, c.nav.bg, a.vector_bias
    change = quat_exp(w[0] + (bg[0] - b0[0]) * dt, w[1] + (bg[1] - b0[1]) * dt, w[2] + (bg[2] - b0[2]) * dt)
    q = quat_normalised(quat_product(vector_quaternion(c), change))
    for i in range(4):
        a.vector_q[i] = q[i]
    C = dcm_of_quat(q)
    f = quat_rotate(q, ned_to_body(c, (c.imu.delta_v[0], c.imu.delta_v[1], c.imu.delta_v[2])))
    for j in range(3):
        column = cross(f, (a.vector_rotation[0, j], a.vector_rotation[1, j], a.vector_rotation[2, j]))
        for i in range(3):
            a.vector_sensitivity[i, j] += column[i]
    for i in range(3):
        a.vector_force[i] += f[i]
        for j in range(3):
            a.vector_rotation[i, j] += C[3 * i + j] * dt


@kernel
def restart_vectors(c: Core) -> None:
    """The next fix is the first of new pairs of vectors."""
    c.alignment.vector_start_ns = NEVER_NS


@kernel
def start_vector(c: Core, v: Vector, arm: Vector) -> None:
    """Begin the next pair: velocity of the fix, m/s, NED; that of the antenna to the IMU, in the vectors' frame."""
    a = c.alignment
    a.vector_start_ns = c.nav.t_ns
    a.vector_force[:] = 0.0
    a.vector_sensitivity[:] = 0.0
    for i in range(3):
        a.vector_velocity[i], a.vector_arm_velocity[i] = v[i], arm[i]


@kernel
def start_vectors(c: Core, b: HypothesisBank) -> None:
    """The vectors' frame is the body's now."""
    a = c.alignment
    b.vector_count = 0
    a.vector_rotation[:] = 0.0
    for i in range(4):
        a.vector_q[i] = 1.0 if i == 0 else 0.0
    for i in range(3):
        a.vector_bias[i] = c.nav.bg[i]


@kernel
def match_vectors(p: Parameters, c: Core, b: HypothesisBank, v: Vector, noise2: float) -> bool:
    """Store the pair of vectors that ends with a fix of velocity v (m/s, NED; NaN where unknown); True if it did.

    noise2: variance of a level component of the velocity, m^2/s^2.
    """
    a = c.alignment
    if not (math.isfinite(v[0]) and math.isfinite(v[1])):
        return False
    dt = 1e-9 * (c.nav.t_ns - a.vector_start_ns)
    if a.vector_start_ns == NEVER_NS or dt > p.tuning.vector_pair_max_s:
        start_vectors(c, b)
        start_vector(c, v, quat_rotate(vector_quaternion(c), ned_to_body(c, antenna_velocity(c))))
        return False
    if dt < p.tuning.vector_pair_s:
        return False
    arm = quat_rotate(vector_quaternion(c), ned_to_body(c, antenna_velocity(c)))
    if b.vector_count == VECTORS:
        drop_oldest(b)
    pair, first = b.vectors[b.vector_count], a.vector_velocity
    vertical = math.isfinite(v[2]) and math.isfinite(first[2])
    pair.gnss[0], pair.gnss[1] = v[0] - first[0], v[1] - first[1]
    pair.gnss[2] = (v[2] - first[2] if vertical else 0.0) - gravity(c.nav.lat, c.nav.height) * dt
    for i in range(3):
        pair.force[i] = a.vector_force[i] + arm[i] - a.vector_arm_velocity[i]
        for j in range(3):
            pair.sensitivity[i, j] = a.vector_sensitivity[i, j]
    timing2 = 0.0
    if b.vector_count > 0:
        before = b.vectors[b.vector_count - 1]
        for i in range(3):
            timing2 += variance(c, TIME_OFFSET) * ((pair.gnss[i] - before.gnss[i]) / dt) ** 2
    pair.level_variance = 2.0 * noise2 + (p.tuning.vector_accel_sigma * dt) ** 2 + timing2
    pair.down_variance = pair.level_variance + (0.0 if vertical else p.tuning.vector_vertical_sigma**2)
    b.vector_count += 1
    start_vector(c, v, arm)
    return True


@kernel
def drop_oldest(b: HypothesisBank) -> None:
    """Forget the oldest pair of vectors."""
    for k in range(VECTORS - 1):
        b.vectors[k] = b.vectors[k + 1]
    b.vector_count -= 1
