"""The decision about rest, from the windows of `stationarity` and from the speed.

A window of low motion is not yet rest. Rest requires also a mean rate equal to the gyro bias, no level force, and a
speed near zero, from a recent fix or from the filter. Where no speed is known, as after a start in motion, the smallest
gyro deviation measured may itself be one of motion: then a deviation of the force is required that no moving vehicle
has. In a GNSS outage the speed becomes uncertain: then the log likelihood ratio of the classes of motion decides.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.earth import STANDARD_GRAVITY
from ..tuning import Tunable
from .ekf import innovation_variance, set_jacobian, variance
from .mechanization import rotation_matrix
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, HORIZONTAL, NAVIGATING, VELOCITY
from .stationarity import interrupt_rest

if TYPE_CHECKING:
    from .types import Core, Parameters


TUNABLES = (
    Tunable(
        "long_rest_windows",
        10,
        "windows",
        "Low-motion windows in a row after which a body is at rest even if no speed is known.",
        "Five seconds.",
    ),
    Tunable(
        "long_rest_variance", 10.0, "m^2/s^2", "Largest variance of a velocity that allows a long rest.", "Choice."
    ),
    Tunable(
        "rest_variance",
        0.5,
        "m^2/s^2",
        "Largest variance of a velocity that allows a rest.",
        "A prototype on recorded drives.",
    ),
    Tunable(
        "known_rest_speed",
        1.0,
        "m/s",
        "Largest estimated speed of a body that a fix says is at rest, beyond limit_sigmas.",
        "Choice: the fix knows better.",
    ),
    Tunable(
        "unknown_bias_windows",
        6,
        "windows",
        "Low-motion windows in a row before a mean rate that only an unknown gyro bias explains is one of rest.",
        "Three seconds: a ship that rolls slowly turns steadily for one.",
        low=2,
    ),
    Tunable("rest_log_likelihood", 3.0, "", "Log likelihood ratio that proves rest.", "Odds of 20 to 1."),
)


@kernel
def withdraw_rest(c: Core) -> None:
    """End a rest: the sensor does not measure enough to detect it."""
    interrupt_rest(c)
    c.stationarity.at_rest = 0


@kernel
def fixes_contradict_rest(p: Parameters, c: Core) -> bool:
    """Whether positions go on to contradict a rest that no earlier ones have confirmed.

    Before the heading is known, even motion looks like rest: if the first fixes after a start, an outage or a reset
    move on, they are right. A receiver that drifts away has agreed with the rest before.
    """
    g, rejected = c.integrity, c.integrity.reject_count[HORIZONTAL]
    few = c.gnss.fix_count - rejected <= p.tuning.reset_count
    new = few or g.outage_at_reject_s > p.tuning.fresh_fix_s or g.reset_score > 0.0
    return bool(c.alignment.mode != NAVIGATING and rejected > p.tuning.reset_count and new)


@kernel
def speed_allows_rest(p: Parameters, c: Core) -> bool:
    """Whether the speed, as far as it is known, allows rest."""
    s = c.stationarity
    fresh = c.gnss.fix_count > 0 and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < p.tuning.fresh_fix_s
    known = (fresh or fixes_contradict_rest(p, c)) and c.gnss.speed >= 0.0
    if known and c.gnss.speed > p.tuning.rest_speed:
        return False
    speed2 = c.nav.v_n[0] ** 2 + c.nav.v_n[1] ** 2 + c.nav.v_n[2] ** 2
    s2 = max(variance(c, VELOCITY), variance(c, VELOCITY + 1))
    error2 = p.tuning.limit_sigmas**2 * s2
    if c.alignment.mode != NAVIGATING:
        unhurried = speed2 < p.tuning.rest_speed**2 + error2
        return bool(known or (s.stationary_count > p.tuning.long_rest_windows and unhurried))
    return bool(
        (known and speed2 < p.tuning.known_rest_speed**2 + error2)
        or (
            speed2 < p.tuning.rest_speed**2
            and s2
            < (
                p.tuning.long_rest_variance
                if s.low_motion_count > p.tuning.long_rest_windows
                else p.tuning.rest_variance
            )
        )
        or (
            fresh
            and not known
            and s.stationary_count > p.tuning.long_rest_windows
            and speed2 < p.tuning.rest_speed**2 + error2
        )
        or (
            s.log_likelihood_ratio > p.tuning.rest_log_likelihood
            and speed2 < p.tuning.rest_speed**2 + error2
            and s2 < p.tuning.long_rest_variance
        )
    )


@kernel
def gnss_confirms_rest(p: Parameters, c: Core) -> bool:
    """Whether the speed that the receiver reports is that of rest, and recent."""
    return bool(
        c.gnss.speed <= p.tuning.rest_speed and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < p.tuning.fresh_fix_s
    )


@kernel
def max_rest_rate(p: Parameters, c: Core, i: int) -> float:
    """Largest mean rate about body axis i at rest, beyond the estimated bias, rad/s."""
    return p.tuning.rest_rate + p.tuning.limit_sigmas * math.sqrt(variance(c, GYRO_BIAS + i))


@kernel
def level_force_variance(c: Core, axis: int) -> float:
    """Variance, m^2/s^4, of the level specific force at rest along north (axis 0) or east (1), by tilt and bias.

    The two errors are correlated after a rest: their sum is known better than each of them.
    """
    C_nb = rotation_matrix(c)
    length = set_jacobian(c, 0, ATTITUDE + 1 - axis, STANDARD_GRAVITY if axis == 1 else -STANDARD_GRAVITY)
    for j in range(3):
        length = set_jacobian(c, length, ACCEL_BIAS + j, -C_nb[3 * axis + j])
    return innovation_variance(c, length)


@kernel
def is_unaccelerated(p: Parameters, c: Core) -> bool:
    """Whether the mean level specific force of the window is zero, within the errors of tilt and bias."""
    s = c.stationarity
    error = math.sqrt(max(level_force_variance(c, 0), level_force_variance(c, 1)))
    most = p.tuning.rest_accel + p.tuning.limit_sigmas * error
    return bool(elementary.hypot(s.delta_v[0], s.delta_v[1]) < most * s.duration)


@kernel
def is_resting(p: Parameters, c: Core) -> bool:
    """Whether the last two windows, at least, were at rest."""
    s = c.stationarity
    if s.low_motion_count < 2 or not speed_allows_rest(p, c):
        return False
    if s.stationary_count > p.tuning.long_rest_windows and gnss_confirms_rest(p, c):
        return True  # regardless of tilt and biases: if they contradict, they are wrong
    if not is_unaccelerated(p, c):
        return False
    is_short = s.low_motion_count < p.tuning.unknown_bias_windows
    for i in range(3):
        if abs(s.mean_w[i] - c.nav.bg[i]) > (p.tuning.rest_rate if is_short else max_rest_rate(p, c, i)):
            return False
    return True


@kernel
def detect_rest(p: Parameters, c: Core) -> bool:
    """Decide whether the sensor is at rest, and store the decision."""
    at_rest = is_resting(p, c)
    c.stationarity.at_rest = 1 if at_rest else 0
    return at_rest
