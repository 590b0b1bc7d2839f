"""Is the heading that is navigated with the right one? The matching that found it goes on, and can say no.

A filter whose heading is wrong by much more than its sigma does not come back by itself: it explains the velocity
changes that it sees by tilt and biases. Here they are matched as in `alignment`, whatever the filter's covariance says.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from .alignment import LEAST_HEADING, adopt, engage, turn_north
from .correction import predicted
from .covariance import doubt_turn_scale, grow, variance
from .fix_matching import pair, vertical_bias
from .gnss import slowness2, velocity_of
from .non_holonomic import stop
from .posterior import disbelieve, solve
from .state import ACCEL_BIAS, ASTRAY, ATTITUDE, GYRO_BIAS, STATES

WRONG = math.radians(10.0)
GATE = 16.0
MISLED_TILT = math.radians(1.0)
VAGUE = math.radians(14.0)  # a heading no better known than that is better found anew


@kernel
def supervise(p: Any, c: Any, b: Any, fix: Any) -> bool:
    """Take a fix at the core's time; False when the heading was wrong and no better one is known."""
    if c.astray >= ASTRAY:
        return False
    before = b.weight
    pair(c, b, fix.lat, fix.lon, velocity_of(fix, 0), velocity_of(fix, 1), slowness2(fix))
    if b.weight == before:
        return True
    bias = predicted(c, vertical_bias(c))
    disbelieve(c, b, p.accel_initial)
    found = solve(c, b, bias)
    psi, sigma = found[0], found[1]
    known = variance(c, ATTITUDE + 2)
    wrong = abs(psi) > WRONG and psi * psi > GATE * (sigma * sigma + known)
    c.astray = c.astray + 1 if wrong else 0
    if c.astray >= ASTRAY:
        c.heading_sigma = max(sigma, LEAST_HEADING)
        turn_north(c, psi)
        realign(p, c)
    elif known > VAGUE**2 and adopt(c, found):
        realign(p, c)
    return True


@kernel
def realign(p: Any, c: Any) -> None:
    """Doubt what was learned with the wrong heading, and go on with the new one."""
    stop(c)
    for i in range(2):
        grow(c, ATTITUDE + i, MISLED_TILT**2)
    for i in range(3):
        reset(c.P, STATES, ACCEL_BIAS + i, p.accel_initial**2)
        if c.heading_age == 0.0:
            reset(c.P, STATES, GYRO_BIAS + i, p.gyro_initial**2)
    doubt_turn_scale(p, c)
    engage(p, c)
