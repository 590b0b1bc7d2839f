"""Is the heading that is navigated with the right one? The matching that found it goes on, and can say no.

A filter whose heading is wrong by much more than its sigma does not come back by itself: it explains the velocity
changes that it sees by tilt and biases. Here they are matched as in `alignment`, whatever the filter's covariance says.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from .alignment import (
    COHERENCE,
    CORRELATED,
    FITTED,
    LEAST_HEADING,
    MOVED,
    NOISE,
    PAIRS,
    correlation,
    engage,
    pair,
    turn_north,
)
from .covariance import variance
from .non_holonomic import stop
from .state import ACCEL_BIAS, ASTRAY, ATTITUDE, GYRO_BIAS, RATES, STATES, TURN_SCALE

STEADY = RATES // 2  # the hypothesis without drift
WRONG = math.radians(10.0)
GATE = 16.0


@kernel
def follow_turn(c: Any) -> None:
    """Turn what was felt as the filter has turned its heading since."""
    co, si = math.cos(c.turned), math.sin(c.turned)
    re, im = c.match[STEADY, 0], c.match[STEADY, 1]
    c.match[STEADY, 0], c.match[STEADY, 1] = co * re + si * im, co * im - si * re
    re, im = c.felt[0], c.felt[1]
    c.felt[0], c.felt[1] = co * re - si * im, co * im + si * re
    c.turned = 0.0


@kernel
def heading_error(c: Any) -> tuple[float, float]:
    """True minus estimated heading from the pairs, and its variance; (0, pi^2) when they do not tell."""
    unknown = (0.0, math.pi**2)
    if c.pairs < PAIRS * 0.9:
        return unknown
    re, im, v2 = correlation(c, STEADY)
    z2 = c.energy[0] - (c.felt[0] ** 2 + c.felt[1] ** 2) / c.pairs
    size = math.hypot(re, im)
    if z2 < PAIRS * MOVED**2 or size * size < COHERENCE * z2 * v2:
        return unknown
    r = CORRELATED * max((z2 + v2 - 2.0 * size) / (2.0 * c.pairs - FITTED), NOISE**2)
    return math.atan2(im, re), r / z2


@kernel
def supervise(p: Any, c: Any, lat: float, lon: float, vn: float, ve: float) -> bool:
    """Take a fix at the core's time; False when the heading was wrong and no better one is known."""
    if c.astray >= ASTRAY:
        return False
    before = c.pairs
    follow_turn(c)
    pair(c, lat, lon, vn, ve)
    if c.pairs == before:
        return True
    psi, var = heading_error(c)
    wrong = abs(psi) > WRONG and psi * psi > GATE * (var + variance(c, ATTITUDE + 2))
    c.astray = c.astray + 1 if wrong else 0
    if c.astray >= ASTRAY:
        realign(p, c, psi, var)
    return True


@kernel
def realign(p: Any, c: Any, psi: float, var: float) -> None:
    """Turn the heading by psi, and doubt what was learned with the wrong one."""
    stop(c)
    turn_north(c, psi)
    for i in range(3):
        reset(c.P, STATES, GYRO_BIAS + i, p.gyro_initial**2)
        reset(c.P, STATES, ACCEL_BIAS + i, p.accel_initial**2)
        reset(c.P, STATES, TURN_SCALE + i, p.gyro_scale**2)
    c.heading_sigma = math.sqrt(max(var, LEAST_HEADING**2))
    engage(p, c)
