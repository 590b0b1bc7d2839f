"""A gyro bias that is larger than usual ones, before any rest: gravity stays where it is in the body.

A body whose mean rate and mean force do not change, and whose force is as large as gravity, does not turn by much
across it: what a gyro shows there is its bias, if it is more than what motions have that do keep the force fixed. These
are a turn in which the body leans, or which pushes the force aside: it is about an axis near the force, and only a part
of it is seen across; and swell, whose slope a boat follows: its rates are slow. No speed is needed, and the tilt, which
such a bias makes wrong within a second, is put right with it.

What the gyro shows along the force may be a turn about the vertical. But if it is more than usual biases, or if those
across the force are (the three gyros of a sensor are alike), the bias along it may be as large as those of the worst
parts: its variance grows, and `rest` and the alignment find it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.earth import STANDARD_GRAVITY
from ...tuning import Tunable
from ..ekf import add_covariance, innovation_variance, set_jacobian3
from ..fusion import NO_GATE, correct_state, gated_update
from ..state import COARSE_ALIGNMENT, GYRO_BIAS

if TYPE_CHECKING:
    from ....math.rotation import Vector
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "fixed_gravity_windows",
        2,
        "windows",
        "Low-motion windows in a row before gravity counts as fixed in the body.",
        "A second and a half with the one before.",
        low=1,
    ),
    Tunable(
        "fixed_gravity_magnitude",
        0.1,
        "",
        "Largest difference of the force from gravity, as a share of it.",
        "In a turn whose rate is half across the force the force is larger by 15 %.",
    ),
    Tunable(
        "fixed_gravity_sigma",
        math.radians(0.2),
        "rad/s",
        "Sigma of a bias that no motion explains.",
        "Slow oscillations.",
    ),
    Tunable("swell_rate", math.radians(1.5), "rad/s", "RMS rate of a boat in swell.", "3 deg of slope, 10 s."),
    Tunable(
        "leaning_ratio",
        0.6,
        "",
        "Rate across the force, over that along it, up to which a turn in which the body leans explains it.",
        "Twice that of 0.3 g across the vertical.",
    ),
    Tunable(
        "fixed_gravity_excess",
        4.0,
        "",
        "Least rate across the force that is a bias, over the rate at which the force turned in the body.",
        "Noise of the two means; a rotation without a bias has 1.",
    ),
)


@kernel
def fuse_across(p: Parameters, c: Core, down: Vector, across: Vector, rate: Vector) -> None:
    """Fuse `rate` (rad/s, body), less the part along `down`, as the gyro bias; across: the axis of the rest of it."""
    other = (
        down[1] * across[2] - down[2] * across[1],
        down[2] * across[0] - down[0] * across[2],
        down[0] * across[1] - down[1] * across[0],
    )
    for axis in (across, other):
        z = axis[0] * rate[0] + axis[1] * rate[1] + axis[2] * rate[2]
        gated_update(c, set_jacobian3(c, 0, GYRO_BIAS, axis), z, p.tuning.fixed_gravity_sigma**2, NO_GATE)
    correct_state(p, c)


@kernel
def widen_along(p: Parameters, c: Core, down: Vector) -> None:
    """Let the gyro bias along `down` be one of the worst parts'."""
    missing = p.gyro_bias_wide**2 - innovation_variance(c, set_jacobian3(c, 0, GYRO_BIAS, down))
    if missing > 0.0:
        for i in range(3):
            for j in range(i, 3):
                add_covariance(c, GYRO_BIAS + i, GYRO_BIAS + j, missing * down[i] * down[j])


@kernel
def measure_fixed_gravity(p: Parameters, c: Core) -> None:
    """Call at the end of a window, once it is classified."""
    s, t = c.stationarity, p.tuning
    if c.alignment.mode != COARSE_ALIGNMENT or s.low_motion_count < t.fixed_gravity_windows:
        return
    w = (s.mean_w[0] - c.nav.bg[0], s.mean_w[1] - c.nav.bg[1], s.mean_w[2] - c.nav.bg[2])
    f, along, change2 = s.mean_f, 0.0, 0.0
    force = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    if abs(force - STANDARD_GRAVITY) > t.fixed_gravity_magnitude * STANDARD_GRAVITY:
        return
    down = (-f[0] / force, -f[1] / force, -f[2] / force)
    for i in range(3):
        along += w[i] * down[i]
        change2 += (f[i] - s.steady_f[i]) ** 2
    x, y, z = w[0] - along * down[0], w[1] - along * down[1], w[2] - along * down[2]
    across = math.sqrt(x * x + y * y + z * z)
    changed = math.sqrt(change2) / (force * s.low_motion_count * s.duration)  # rad/s, that the force turned by
    usual2 = t.limit_sigmas**2 * (p.gyro_bias_sigma**2 + t.swell_rate**2)
    is_bias = across > t.fixed_gravity_excess * changed and across > t.leaning_ratio * abs(along)
    is_unknown = innovation_variance(c, set_jacobian3(c, 0, GYRO_BIAS, down)) > 0.5 * p.gyro_bias_sigma**2
    if is_bias and across * across > usual2:
        widen_along(p, c, down)
        fuse_across(p, c, down, (x / across, y / across, z / across), w)
    elif along * along > usual2 and is_unknown:
        widen_along(p, c, down)
