"""The search for a land vehicle's forward axis in the body: the principal direction of its velocity there.

The velocity in the body is accumulated, normalised by its uncertainty, as a scatter matrix. The principal axis is the
forward axis when the velocity across it is explained by the uncertainty, while the velocity over ground has turned.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.rotation import quat_exp, quat_rotate, quat_rotate_back
from ...tuning import Tunable
from ..ekf import variance
from ..mechanization import ned_to_body, quaternion
from ..state import ATTITUDE, AUTO, FREE, LAND, NAVIGATING, VELOCITY
from .land_evidence import add_evidence, clear_evidence, judge_evidence, shows_land_vehicle

if TYPE_CHECKING:
    from ....math.rotation import Vector
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("typical_lever_arm", 1.2, "m", "Lever arm assumed while the forward axis is sought.", "Cars."),
    Tunable(
        "direction_sigmas", 2.0, "sigma", "Least speed, in sigmas, of a velocity whose direction is used.", "Two sigma."
    ),
    Tunable(
        "scatter_decay",
        0.98,
        "per window",
        "Decay of the scatter matrix of the velocity in the body.",
        "25 s.",
        high=0.9999,
    ),
    Tunable(
        "axis_windows",
        8.0,
        "windows",
        "Windows with a direction before the constraint is enabled; vehicle = auto.",
        "Recorded flights and drives.",
    ),
    Tunable(
        "axis_across",
        0.5,
        "",
        "Largest normalised square of the velocity across the forward axis, per window; vehicle = auto.",
        "Recorded flights and drives.",
    ),
    Tunable(
        "axis_across_growth",
        0.01,
        "",
        "Growth of axis_across per window: a flight looks like a drive for some seconds.",
        "Recorded flights.",
    ),
    Tunable(
        "axis_ground",
        12.0,
        "",
        "Normalised square of the velocity across any line over ground that proves a turn.",
        "Recorded flights and drives.",
    ),
    Tunable(
        "max_lean",
        0.26,
        "",
        "Largest sine of the angle by which a land vehicle leans sideways; vehicle = auto.",
        "15 deg: banked roads and soft springs have less, aircraft in turns more.",
        high=1.0,
    ),
    Tunable(
        "axis_windows_land",
        6.0,
        "windows",
        "Windows with a direction before the constraint is enabled; vehicle = land.",
        "Choice.",
    ),
    Tunable(
        "axis_across_land",
        4.0,
        "",
        "Largest normalised square of the velocity across the forward axis, per window; vehicle = land.",
        "Choice.",
    ),
    Tunable(
        "power_iterations",
        4,
        "",
        "Power iterations of the principal axis; each begins where the last ended.",
        "Numerics.",
    ),
)


@kernel
def clear_scatter(c: Core) -> None:
    """Forget in which direction the vehicle moved and which way was down."""
    h = c.nhc
    h.scatter_weight = 0.0
    clear_evidence(c)
    for i in range(6):
        h.velocity_scatter[i] = 0.0
    for i in range(3):
        h.ground_scatter[i] = 0.0
        h.down_sum[i] = 0.0


@kernel
def find_forward_axis(p: Parameters, c: Core) -> bool:
    """Once per window: accumulate the velocity in the body; True if it has one principal axis, nhc.principal_axis.

    The axis is found when the velocity across it is explained by the uncertainty, while the velocity across every line
    over ground is not: then the velocity has turned with the body. In a GNSS outage nothing is accumulated.
    """
    h = c.nhc
    if 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) > p.tuning.fresh_fix_s:
        return False
    level2 = max(variance(c, VELOCITY), variance(c, VELOCITY + 1))
    down = c.nav.v_n[2] * math.sqrt(min(level2 / variance(c, VELOCITY + 2), 1.0))  # as uncertain as the level ones
    if not accumulate_scatter(p, c, (c.nav.v_n[0], c.nav.v_n[1], down), level2, variance(c, ATTITUDE + 2)):
        return False
    across = h.velocity_scatter[0] + h.velocity_scatter[3] + h.velocity_scatter[5] - principal_direction(p, c)
    n, land, t = h.scatter_weight, p.vehicle == LAND, p.tuning
    disabled_s = 1e-9 * (c.nav.t_ns - h.disabled_ns)
    if h.disable_count > 0 and disabled_s < p.tuning.nhc_retry_s * (1 << min(h.disable_count, 62)):
        return False
    if land:
        found = n >= t.axis_windows_land and across < t.axis_across_land * n
    else:
        turned = scatter_across_ground_line(c) - across > t.axis_ground
        found = n >= t.axis_windows and across < (t.axis_across + t.axis_across_growth * n) * n and turned
        found = found and is_upright(p, c) and shows_land_vehicle(p, c)
    return bool(found)


@kernel
def is_upright(p: Parameters, c: Core) -> bool:
    """Whether the vertical has kept its direction in the body, on average within half of max_lean."""
    h = c.nhc
    length2 = h.down_sum[0] ** 2 + h.down_sum[1] ** 2 + h.down_sum[2] ** 2
    return bool(length2 > (1.0 - 0.25 * p.tuning.max_lean**2) * h.scatter_weight**2)


@kernel
def accumulate_scatter(p: Parameters, c: Core, v: Vector, level2: float, heading2: float) -> bool:
    """Add velocity v (m/s, NED) in body axes to the scatter matrices; False if it is too small to have a direction.

    level2: variance of a level component, m^2/s^2; heading2: of the heading, rad^2. The weight is the inverse variance
    by these, by sideslip, suspension and lever arm.
    """
    h = c.nhc
    if p.vehicle == FREE or (h.enabled and p.vehicle == LAND):
        return False
    q = quaternion(c)
    u = quat_rotate_back(q, v)
    speed2 = u[0] ** 2 + u[1] ** 2 + u[2] ** 2
    rate2 = c.imu.rate_b[0] ** 2 + c.imu.rate_b[1] ** 2 + c.imu.rate_b[2] ** 2
    s2 = (
        level2
        + p.tuning.nhc_sigma**2
        + p.tuning.typical_lever_arm**2 * rate2
        + (p.tuning.suspension_pitch**2 + heading2) * speed2
    )
    down = quat_rotate_back(q, (0.0, 0.0, 1.0))
    fast = speed2 > p.tuning.direction_sigmas**2 * (level2 + p.tuning.nhc_sigma**2)
    if fast and p.vehicle == AUTO and c.alignment.mode == NAVIGATING and h.scatter_weight > 0.0:
        add_evidence(p, c, v, level2 + heading2 * speed2, down)
        if not h.enabled:
            judge_evidence(p, c)
    if speed2 < p.tuning.direction_sigmas**2 * s2:
        return False
    if h.enabled:
        return False
    for i in range(3):
        h.down_sum[i] = p.tuning.scatter_decay * h.down_sum[i] + down[i]
    k = 0
    for i in range(3):
        for j in range(i, 3):
            h.velocity_scatter[k] = p.tuning.scatter_decay * h.velocity_scatter[k] + u[i] * u[j] / s2
            k += 1
    h.ground_scatter[0] = p.tuning.scatter_decay * h.ground_scatter[0] + v[0] * v[0] / s2
    h.ground_scatter[1] = p.tuning.scatter_decay * h.ground_scatter[1] + v[0] * v[1] / s2
    h.ground_scatter[2] = p.tuning.scatter_decay * h.ground_scatter[2] + v[1] * v[1] / s2
    h.scatter_weight = p.tuning.scatter_decay * h.scatter_weight + 1.0
    if h.scatter_weight <= 1.0:
        h.principal_axis[0], h.principal_axis[1], h.principal_axis[2] = u[0], u[1], u[2]
    return True


@kernel
def rotate_scatter(c: Core, psi: float) -> None:
    """Rotate the scatter matrix and the principal axis before the level frame is rotated by psi (rad, about down)."""
    h = c.nhc
    down = ned_to_body(c, (0.0, 0.0, 1.0))
    q_turn = quat_exp(-psi * down[0], -psi * down[1], -psi * down[2])
    x, y, z = (
        quat_rotate(q_turn, (1.0, 0.0, 0.0)),
        quat_rotate(q_turn, (0.0, 1.0, 0.0)),
        quat_rotate(q_turn, (0.0, 0.0, 1.0)),
    )
    a = quat_rotate(q_turn, (h.principal_axis[0], h.principal_axis[1], h.principal_axis[2]))
    xx, xy, xz, yy, yz, zz = (
        h.velocity_scatter[0],
        h.velocity_scatter[1],
        h.velocity_scatter[2],
        h.velocity_scatter[3],
        h.velocity_scatter[4],
        h.velocity_scatter[5],
    )
    k = 0
    for i in range(3):
        h.principal_axis[i] = a[i]
        for j in range(i, 3):
            diagonal = xx * x[i] * x[j] + yy * y[i] * y[j] + zz * z[i] * z[j]
            mixed = xy * (x[i] * y[j] + y[i] * x[j]) + xz * (x[i] * z[j] + z[i] * x[j])
            h.velocity_scatter[k] = diagonal + mixed + yz * (y[i] * z[j] + z[i] * y[j])
            k += 1


@kernel
def scatter_across_ground_line(c: Core) -> float:
    """Smaller eigenvalue of the scatter over ground: sum of squares across its principal line."""
    h = c.nhc
    half = 0.5 * (h.ground_scatter[0] + h.ground_scatter[2])
    return float(half - elementary.hypot(0.5 * (h.ground_scatter[0] - h.ground_scatter[2]), h.ground_scatter[1]))


@kernel
def principal_direction(p: Parameters, c: Core) -> float:
    """Update the principal axis of the scatter matrix by power iteration; returns its eigenvalue."""
    a, s, n = c.nhc.principal_axis, c.nhc.velocity_scatter, 0.0
    for _ in range(p.tuning.power_iterations):
        x = s[0] * a[0] + s[1] * a[1] + s[2] * a[2]
        y = s[1] * a[0] + s[3] * a[1] + s[4] * a[2]
        z = s[2] * a[0] + s[4] * a[1] + s[5] * a[2]
        n = math.sqrt(x * x + y * y + z * z)
        a[0], a[1], a[2] = x / n, y / n, z / n
    return n
