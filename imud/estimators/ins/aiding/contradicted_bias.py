"""A vehicle stands, and its mean rate contradicts the gyro bias: the bias has stepped, or the sensor turns slowly.

A bias stays the same, the rate of a body that turns does not for long. While it does, both are possible: the heading is
right, or off by all that the rate has turned it. That is stated, and becomes part of P, together with the bias, if
motion ends it. What stays the same for longer is a step: it corrects bias and heading. A rate that changes while the
body stands, or that is too large for a step, is a turn.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import EARTH_RATE_RADPS
from ...tuning import Tunable
from ..ekf import add_covariance, add_variance, decorrelate, variance
from ..mechanization import body_to_ned, ned_to_body
from ..rest import gnss_confirms_rest, max_rest_rate
from ..state import ATTITUDE, GYRO_BIAS, NAVIGATING

if TYPE_CHECKING:
    from ....math.arrays import Reals
    from ....math.rotation import Vector
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("zaru_sigma", 1e-4, "rad/s", "Sigma of the rate of a vehicle that stands.", "Choice."),
    Tunable(
        "bias_contradiction_windows",
        10,
        "windows",
        "Windows at rest in a row that contradict the gyro bias, all by the same rate, before it is replaced.",
        "Five seconds: of a body that turns on the spot the rate seldom is the same for so long.",
        low=1,
    ),
    Tunable(
        "known_heading_contradiction_windows",
        40,
        "windows",
        "As bias_contradiction_windows, where the heading is known: a body that turns would lose it.",
        "Choice: 20 s; until then the heading's sigma has what a step would have done to it.",
        low=1,
    ),
    Tunable(
        "changed_rate_windows",
        4,
        "windows",
        "Windows of standing with another rate after which it was a turn that contradicted the gyro bias.",
        "Two seconds: a departure may begin with a turn.",
    ),
    Tunable(
        "turned_share",
        0.5,
        "",
        "Sigma of the heading after a likely step, over its error if the sensor had turned instead.",
        "Choice: two sigma.",
    ),
)


@kernel
def rates_beyond_bias(c: Core, w: Reals) -> Vector:
    """Mean rates w of a window beyond the bias and the Earth's rotation, rad/s, body axes."""
    north, down = EARTH_RATE_RADPS * elementary.cos(c.nav.lat), -EARTH_RATE_RADPS * elementary.sin(c.nav.lat)
    x, y, z = ned_to_body(c, (north, 0.0, down))
    return w[0] - x - c.nav.bg[0], w[1] - y - c.nav.bg[1], w[2] - z - c.nav.bg[2]


@kernel
def excess_rate(c: Core, i: int) -> float:
    """Mean rate of the window about body axis i beyond the bias and the Earth's rotation, rad/s."""
    return float(rates_beyond_bias(c, c.stationarity.mean_w)[i])


@kernel
def rate_variance(p: Parameters, c: Core) -> float:
    """Variance of the mean rate of a window at rest, rad^2/s^2."""
    s = c.stationarity
    noise = p.gyro_psd / s.duration + s.gyro_noise_floor**2 / s.sample_count
    return float(noise + p.tuning.zaru_sigma**2 + s.turn_rate_var)


@kernel
def contradicts_bias(p: Parameters, c: Core, i: int) -> bool:
    """Whether the window's mean rate about body axis i, as one at rest, contradicts the bias beyond its own noise."""
    noise = p.tuning.limit_sigmas * math.sqrt(variance(c, GYRO_BIAS + i) + rate_variance(p, c))
    return bool(abs(excess_rate(c, i)) > max(max_rest_rate(p, c, i), noise))


@kernel
def step_of_bias(c: Core) -> Vector:
    """The step of the bias, rad/s, body axes, that explains the rate which contradicts it."""
    return rates_beyond_bias(c, c.stationarity.contradicting_w)


@kernel
def is_likely(p: Parameters, c: Core) -> bool:
    """Whether a bias may step so far: as from one switch-on to the next."""
    x, y, z = step_of_bias(c)
    return max(abs(x), abs(y), abs(z)) < p.tuning.limit_sigmas * p.gyro_bias_sigma


@kernel
def turn_by_step(c: Core) -> Vector:
    """What that step has turned the estimate by, rad, NED, since the first window that contradicted."""
    north, east, down = body_to_ned(c, step_of_bias(c))
    seconds = c.stationarity.contradiction_count * c.stationarity.duration
    return north * seconds, east * seconds, down * seconds


@kernel
def add_step(c: Core) -> None:
    """P += e e', e the errors of biases and heading if the bias has stepped and the sensor has not turned.

    Gravity has corrected the tilt meanwhile by what is not known: its variance grows without a correlation.
    """
    step, turn = step_of_bias(c), turn_by_step(c)
    for i in range(3):
        add_variance(c, ATTITUDE + i, turn[i] * turn[i])
        add_covariance(c, ATTITUDE + 2, GYRO_BIAS + i, -turn[2] * step[i])
        for k in range(i, 3):
            add_covariance(c, GYRO_BIAS + i, GYRO_BIAS + k, step[i] * step[k])


@kernel
def stands(p: Parameters, c: Core) -> bool:
    """Whether the receiver says that a body stands which hardly moves.

    Where the receiver falls silent meanwhile, the body goes on to stand as long as it hardly moves.
    """
    s = c.stationarity
    silent = s.contradiction_count > 0 and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) >= p.tuning.fresh_fix_s
    return bool(s.low_motion_count > 0 and (gnss_confirms_rest(p, c) or silent))


@kernel
def is_same_rate(p: Parameters, c: Core) -> bool:
    """Whether the window's mean rate is that of the first window that contradicted, within its noise."""
    s, limit = c.stationarity, p.tuning.limit_sigmas * math.sqrt(2.0 * rate_variance(p, c))
    same = True
    for i in range(3):
        same &= abs(s.mean_w[i] - s.contradicting_w[i]) < limit
    return same


@kernel
def forget_contradiction(c: Core) -> None:
    """The biases are others than before: what has contradicted them says nothing of these."""
    c.stationarity.contradiction_count = c.stationarity.changed_rate_count = 0
    c.stationarity.contradicting_turn2 = 0.0


@kernel
def stays_contradicted(p: Parameters, c: Core) -> bool:
    """Whether the rate has contradicted the bias for so long that it is one of rest; never if a heading is known and
    the rate is too large for a step.
    """
    count = c.stationarity.contradiction_count
    if c.alignment.mode != NAVIGATING:
        return count >= p.tuning.bias_contradiction_windows
    return is_likely(p, c) and count >= p.tuning.known_heading_contradiction_windows


@kernel
def replace_bias(p: Parameters, c: Core) -> None:
    """Open the bias for the rate that has stayed, which the update at rest then fuses.

    A known heading is corrected with it, and that the sensor has turned so evenly stays possible. Before, gravity shows
    the tilt.
    """
    step, turn = step_of_bias(c), turn_by_step(c)
    if c.alignment.mode == NAVIGATING:
        add_step(c)
        add_variance(c, ATTITUDE + 2, (p.tuning.turned_share * turn[2]) ** 2)
        return
    for i in range(3):
        decorrelate(c, GYRO_BIAS + i, step[i] * step[i])
        add_variance(c, ATTITUDE + i, turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)


@kernel
def watch_bias(p: Parameters, c: Core, at_rest: bool) -> bool:
    """At the end of a window: count those that contradict the bias, and state what a step of it would have done.

    Returns whether a known heading, and its bias, may be other than before.
    """
    s, standing, changed = c.stationarity, stands(p, c), False
    navigating, enough = c.alignment.mode == NAVIGATING, p.tuning.unknown_bias_windows
    contradicted = standing and (contradicts_bias(p, c, 0) or contradicts_bias(p, c, 1) or contradicts_bias(p, c, 2))
    if s.contradiction_count > 0 and not (contradicted and is_same_rate(p, c)):
        s.changed_rate_count += 1
        if standing and s.changed_rate_count <= p.tuning.changed_rate_windows:
            return False  # a turn that ends, or a departure
        if not standing and navigating and s.contradiction_count >= enough and is_likely(p, c):
            add_step(c)
            changed = True
        s.contradiction_count = 0
    s.changed_rate_count = 0
    if s.contradiction_count == 0:
        for i in range(3):
            s.contradicting_w[i] = s.mean_w[i]
    s.contradiction_count = s.contradiction_count + 1 if contradicted else 0
    if at_rest and stays_contradicted(p, c):
        replace_bias(p, c)
        s.contradiction_count = 0
        changed = navigating
    s.contradicting_turn2 = turn_by_step(c)[2] ** 2 if s.contradiction_count >= enough and is_likely(p, c) else 0.0
    return changed
