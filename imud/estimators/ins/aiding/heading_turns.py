"""Whether the headings of a source turn with the gyros: not where they are in wrong units, or do not change at all.

Turns of the gyros and of the headings are compared over intervals of `heading_turn_s`. The change from one interval to
the next has no gyro bias in it: x of the gyros, y of the headings. Least squares of y = k x over a minute or so gives
k with its sigma; a deviation by iron makes k vary by half, wrong units make it 57 times too small or too large.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.rotation import wrap_angle
from ...tuning import Tunable
from ..state import NEVER_NS

if TYPE_CHECKING:
    from ..types import Core, Parameters

TUNABLES = (
    Tunable("heading_turn_s", 3.0, "s", "Interval of the turns that are compared.", "Longer than a heading is late."),
    Tunable("heading_turn_step_s", 0.35, "s", "Longest time between headings that are compared.", "4 Hz and more."),
    Tunable(
        "heading_turn_memory",
        20.0,
        "intervals",
        "Intervals of turns over which the comparison is summed.",
        "Choice: a minute.",
    ),
    Tunable(
        "min_heading_turn",
        0.2,
        "rad",
        "Least root of the sum of squared changes of the turns with which they are compared.",
        "Choice.",
    ),
    Tunable("min_turn_count", 3, "intervals", "Least number of intervals.", "Choice: one may have a jump."),
    Tunable("min_turn_ratio", 0.4, "", "Headings that turn by less are wrong.", "Iron: half."),
)


@kernel
def restart_turns(c: Core, t_ns: int, heading: float) -> None:
    """Begin the first interval, with this heading, rad."""
    g = c.heading_aid
    g.turn_ns, g.turn_heading, g.turn, g.turn_shown, g.turn_count = t_ns, heading, 0.0, 0.0, 0


@kernel
def add_heading_turn(p: Parameters, c: Core, t_ns: int, heading: float, rate: float, r: float) -> None:
    """Add a heading, rad, of variance r; rate: of the yaw, rad/s, then."""
    g = c.heading_aid
    dt = 1e-9 * (t_ns - g.last_ns) if g.last_ns != NEVER_NS else math.inf
    if not 0.0 < dt < p.tuning.heading_turn_step_s:
        restart_turns(c, t_ns, heading)
        g.turn_rate = rate
        return
    g.turn += 0.5 * (rate + g.turn_rate) * dt
    g.turn_shown += wrap_angle(heading - g.turn_heading)
    g.turn_rate, g.turn_heading = rate, heading
    if 1e-9 * (t_ns - g.turn_ns) < p.tuning.heading_turn_s:
        return
    if g.turn_count > 0:
        x = g.turn - g.last_turn
        y = max(-abs(x), min(g.turn_shown - g.last_turn_shown, abs(x)))  # a jump tells no more than a turn
        keep = 1.0 - 1.0 / p.tuning.heading_turn_memory
        g.turn_xx = keep * g.turn_xx + x * x
        g.turn_xy = keep * g.turn_xy + x * y
        g.turn_noise = keep * g.turn_noise + 6.0 * r * x * x
    g.last_turn, g.last_turn_shown = g.turn, g.turn_shown
    g.turn_count += 1
    g.turn_ns, g.turn, g.turn_shown = t_ns, 0.0, 0.0


@kernel
def turns_differently(p: Parameters, c: Core) -> bool:
    """Whether the headings turn much less than the gyros, or against them."""
    g = c.heading_aid
    xx, xy, noise = g.turn_xx, g.turn_xy, g.turn_noise
    if g.turn_count < p.tuning.min_turn_count or xx < p.tuning.min_heading_turn**2:
        return False
    return bool(xy / xx + p.tuning.limit_sigmas * math.sqrt(noise) / xx < p.tuning.min_turn_ratio)


@kernel
def forget_turns(c: Core) -> None:
    """Sums and interval begin anew."""
    g = c.heading_aid
    g.turn_count = 0
    g.turn_xx = g.turn_xy = g.turn_noise = 0.0
