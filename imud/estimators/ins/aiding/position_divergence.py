"""Do rejected positions show that the estimate diverges from them, since a bias or the mounting has changed?

A receiver that jumps stays where it is, and one that drifts does so evenly; what accelerates for long is the double
integral of a wrong force: of a tilt, which makes no more of it than gravity, and may turn with the vehicle. So the
velocities of the positions against the estimate are compared, over as short a time as their noise allows. `gnss_gate`
acts on it.

Source: the test is of this project; a change of velocity against its own sigma.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import STANDARD_GRAVITY
from ...tuning import Tunable
from ..state import HORIZONTAL, NAVIGATING, NEVER_NS
from .gnss_reset import bias_free_innovation
from .wheel_check import wheels_support

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("divergence_step_s", 0.5, "s", "Least time between rejected positions that are compared.", "Choice."),
    Tunable(
        "divergence_accel",
        0.2,
        "m/s^2",
        "Least acceleration of rejected positions away from the estimate.",
        "A tilt that is wrong by 1 deg.",
    ),
    Tunable("divergence_sigmas", 3.0, "sigma", "Least change of the velocity of rejected positions.", "Three sigma."),
    Tunable(
        "divergence_window_s",
        5.0,
        "s",
        "Time without a change of their velocity away from the estimate after which rejected positions do not diverge.",
        "A tilt of 1 deg makes 1 m/s of it.",
    ),
    Tunable(
        "divergence_speed_share",
        0.5,
        "",
        "Least share of the velocity away from the estimate that goes on while it changes.",
        "After a jump nothing does.",
        high=1.0,
    ),
    Tunable(
        "min_divergence_count",
        3,
        "times",
        "How often rejected positions have to accelerate away before the estimate counts as wrong.",
        "Outliers.",
    ),
)


@kernel
def measure_divergence(p: Parameters, c: Core) -> None:
    """After a position was rejected: count, if it accelerates away from the estimate, or begin anew."""
    g = c.integrity
    if c.alignment.mode != NAVIGATING:
        g.divergence_count, g.divergence_ns = 0, NEVER_NS
        return
    if g.divergence_ns < c.gnss.last_used_ns:
        moved = c.drift.detected != 0  # the estimate, after the last position that was used
        g.divergence_count = 0
        g.divergence_ns = c.nav.t_ns if moved else c.gnss.last_used_ns
        for i in range(2):
            g.diverging_offset[i] = bias_free_innovation(c, i) if moved else 0.0
            g.diverging_velocity[i] = 0.0
    dt = 1e-9 * (c.nav.t_ns - g.divergence_ns)
    if dt < p.tuning.divergence_step_s:
        return
    walk = 2.0 * c.gnss.reported_sigma[HORIZONTAL] ** 2 / p.tuning.gnss_bias_time_s
    noise = math.sqrt(6.0 * c.gnss.noise_var[HORIZONTAL] + 2.0 * walk * dt) / dt  # of a difference of two velocities
    north = (bias_free_innovation(c, 0) - g.diverging_offset[0]) / dt
    east = (bias_free_innovation(c, 1) - g.diverging_offset[1]) / dt
    along = north * g.diverging_velocity[0] + east * g.diverging_velocity[1]
    before2 = g.diverging_velocity[0] ** 2 + g.diverging_velocity[1] ** 2
    change = elementary.hypot(north - g.diverging_velocity[0], east - g.diverging_velocity[1])
    goes_on = before2 == 0.0 or along > p.tuning.divergence_speed_share * before2
    accelerates = change > p.tuning.divergence_accel * dt + p.tuning.divergence_sigmas * noise
    if goes_on and accelerates and change < STANDARD_GRAVITY * dt:
        g.divergence_count += 1
    elif dt < p.tuning.divergence_window_s:
        return
    else:
        g.divergence_count = 0
    g.divergence_ns = c.nav.t_ns
    g.diverging_velocity[0], g.diverging_velocity[1] = north, east
    for i in range(2):
        g.diverging_offset[i] = bias_free_innovation(c, i)


@kernel
def estimate_diverges(p: Parameters, c: Core) -> bool:
    """Whether the rejected positions show that the estimate diverges; not where wheels support the velocity."""
    return bool(c.integrity.divergence_count >= p.tuning.min_divergence_count and not wheels_support(p, c))
