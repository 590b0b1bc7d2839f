"""How far the headings of a compass deviate, as near iron: learned from their changes and those of the gyros.

Iron of the vehicle deviates a compass by an angle that depends on the heading, iron of the surroundings by one that
depends on the place: neither noise nor a constant boresight. But over `deviation_time_s` the gyros know how far the yaw
has changed. With d the heading less the yaw by the gyros alone,

    u <- (1 - dt / T) u + change of d,

and what of u^2 noise and the gyros' biases, scale factors and noise do not explain is a deviation's. Its mean over
`deviation_memory_s`, times `deviation_scale`, is the variance of an error that all headings share (`fuse_heading`).
What headings have done to the estimate when less of that was known is opened again: yaw, boresight, and the gyro bias
about the vertical, which a deviation that changes with the yaw makes wrong.

A heading that repeats the last one to the last digit waits for the next. One that jumps by more than noise and the turn
since the last one explain is a reflection's: it counts nothing.

Source: Mehra, On the identification of variances and adaptive Kalman filtering (1970), for a shared error.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.rotation import wrap_angle
from ...tuning import Tunable
from ..boresights import add_boresight_variance, set_opened_variance
from ..ekf import add_covariance, add_variance, innovation_variance, set_jacobian3
from ..mechanization import ned_to_body
from ..noise_density import attitude_psd
from ..state import ATTITUDE, GYRO_BIAS, GYRO_SCALE, NEVER_NS

if TYPE_CHECKING:
    from ...types import Measurement
    from ..types import Core, Parameters

TUNABLES = (
    Tunable("deviation_time_s", 20.0, "s", "Time over which headings and gyros are compared.", "Choice: a turn."),
    Tunable(
        "deviation_memory_s", 20.0, "s", "Time over which the square of what differs is averaged.", "Choice: a turn."
    ),
    Tunable("deviation_step_s", 2.0, "s", "Longest time between headings that are compared.", "1 Hz and more."),
    Tunable("deviation_jump", 25.0, "", "NIS of a jump from one heading to the next.", "As heading_gate."),
    Tunable(
        "deviation_clip",
        9.0,
        "",
        "Largest square that counts, over what is expected with the deviation known so far.",
        "Three sigma: one difference proves little.",
    ),
    Tunable(
        "deviation_scale",
        2.0,
        "",
        "Variance of a deviation, over that of its changes within deviation_time_s.",
        "Of a random one whose correlation time is that.",
    ),
    Tunable(
        "deviation_min_excess",
        0.5,
        "",
        "Mean square beyond what is explained, over it, that is no deviation.",
        "Scatter of the mean of a right compass.",
    ),
)


@kernel
def explained_variance(p: Parameters, c: Core, rate: float) -> float:
    """Variance, rad^2, of what the gyros' errors make of the yaw's change lately; rate: of the yaw now, rad/s."""
    x, y, z = ned_to_body(c, (0.0, 0.0, 1.0))
    memory, turned = p.tuning.deviation_time_s, c.heading_aid.gyros_turned
    length = set_jacobian3(c, 0, GYRO_BIAS, (memory * x, memory * y, memory * z))
    length = set_jacobian3(c, length, GYRO_SCALE, (turned * x * x, turned * x * y, turned * x * z))
    length = set_jacobian3(c, length, GYRO_SCALE + 3, (turned * y * x, turned * y * y, turned * y * z))
    length = set_jacobian3(c, length, GYRO_SCALE + 6, (turned * z * x, turned * z * y, turned * z * z))
    return float(innovation_variance(c, length) + 0.5 * memory * attitude_psd(p, c, rate))


@kernel
def learn_deviation(p: Parameters, c: Core, m: Measurement, off: float, r: float, rate: float, timing: float) -> None:
    """Learn from a heading that is off the yaw by this, rad, of variance r, and more with the yaw's rate, rad/s."""
    g = c.heading_aid
    if m.value[0] == g.turn_heading:
        return  # it repeats the last one: the compass is coarse, or has stopped
    off += g.yaw_corrections  # of the yaw by the gyros alone
    dt = 1e-9 * (m.t_ns - g.off_ns) if g.off_ns != NEVER_NS else math.inf
    change = wrap_angle(off - g.last_off)
    g.off_ns, g.last_off = m.t_ns, off
    if not 0.0 < dt < p.tuning.deviation_step_s:
        g.off_changed = g.gyros_turned = 0.0
        return
    keep = 1.0 - dt / p.tuning.deviation_time_s
    if abs(change) > math.sqrt(p.tuning.deviation_jump * 2.0 * (r + timing)) + abs(rate) * dt:
        change = 0.0
    g.off_changed = keep * g.off_changed + change
    g.gyros_turned = keep * g.gyros_turned + rate * dt
    g.expected_variance = r + timing + explained_variance(p, c, rate)
    square = min(g.off_changed**2, p.tuning.deviation_clip * (g.mean_excess + g.expected_variance))
    gain = dt / p.tuning.deviation_memory_s
    g.mean_excess = max(g.mean_excess + gain * (square - g.expected_variance - g.mean_excess), 0.0)
    beyond = g.mean_excess - p.tuning.deviation_min_excess * g.expected_variance
    g.deviation_variance = max(p.tuning.deviation_scale * beyond, 0.0)
    open_deviation(p, c)


@kernel
def open_deviation(p: Parameters, c: Core) -> None:
    """A larger deviation has shown: what was learned from the headings without it is known no better than it allows."""
    g = c.heading_aid
    added = g.deviation_variance - g.opened_variance
    if added <= 0.0:
        return
    set_opened_variance(c, g.deviation_variance)
    if g.distrusted:
        return  # its headings are not used
    add_variance(c, ATTITUDE + 2, added)
    add_boresight_variance(c, added)
    down, of_rate = ned_to_body(c, (0.0, 0.0, 1.0)), added / p.tuning.deviation_time_s**2
    for i in range(3):
        for k in range(i, 3):
            add_covariance(c, GYRO_BIAS + i, GYRO_BIAS + k, of_rate * down[i] * down[k])
