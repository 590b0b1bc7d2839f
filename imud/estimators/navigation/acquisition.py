"""Before the heading is known: position and velocity are the receiver's, and every fix helps to find the heading."""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from .alignment import HORIZON_S, engage, find_heading, levelled, pair, vertical_bias
from .correction import predicted
from .covariance import deviation
from .gnss import velocity_of
from .motion import REST_SPEED
from .non_holonomic import witness
from .state import POSITION, STATES, VELOCITY

UNKNOWN_POSITION, UNKNOWN_HEIGHT = 100.0, 1000.0  # m
UNKNOWN_SPEED = 5.0  # m/s
UNKNOWN_CLIMB = 1.0
RECEIVED_SPEED = 0.3
SURE = 3.0  # times its sigma, a speed seen in positions is no noise


@kernel
def seen_speed(c: Any) -> float:
    """Speed over the last pair of positions, m/s; NaN where it may be noise or there is none."""
    if not c.slope[2] > 0.0:
        return math.nan
    sigma = math.sqrt(2.0 * c.white[0]) / c.slope[2]  # the wander hardly changes meanwhile
    speed = math.hypot(c.slope[0], c.slope[1])
    return speed if SURE * sigma < REST_SPEED or speed > SURE * sigma else math.nan


@kernel
def bear_witness(p: Any, c: Any, known: bool) -> None:
    """Let the fix's velocity tell of the axis, in the level frame; from positions it is that of a moment ago."""
    drift2 = predicted(c, vertical_bias(c)) * HORIZON_S**2
    noise2 = c.white_speed
    if not known:
        dt = c.slope[2]
        turned = 0.5 * dt * (abs(c.rate[0]) + abs(c.rate[1]) + abs(c.rate[2]))
        noise2 = 2.0 * c.white[0] / dt**2 + turned**2 * (c.v[0] ** 2 + c.v[1] ** 2)
    witness(p, c, noise2, drift2, 0.0)


@kernel
def place(p: Any, c: Any, fix: Any) -> None:
    """Put the core on the fix; begin to navigate when roll, pitch and heading are known."""
    c.lat, c.lon = fix.lat, fix.lon
    guess = 0.0  # sigma of a height that the fix does not tell: of the last one, if there was one
    if math.isfinite(fix.height):
        c.height = fix.height
    else:
        guess = min(max(deviation(c, POSITION + 2), c.reported[1]), UNKNOWN_HEIGHT)
    vn, ve = velocity_of(fix, 0), velocity_of(fix, 1)
    pair(c, fix.lat, fix.lon, vn, ve)
    known = math.isfinite(vn) and math.isfinite(ve)
    if not math.isfinite(c.fix_speed):
        c.fix_speed = seen_speed(c)
    if not known and c.slope[2] > 0.0:
        vn, ve = c.slope[0], c.slope[1]
    moving = known or c.slope[2] > 0.0
    c.v[0] = vn if moving else 0.0
    c.v[1] = ve if moving else 0.0
    c.v[2] = 0.0
    if known or (moving and c.mark_ns == c.t_ns):
        bear_witness(p, c, known)
    arm2 = p.lever[0] ** 2 + p.lever[1] ** 2 + p.lever[2] ** 2
    for i in range(3):
        sigma = c.reported[0] if i < 2 else max(guess, c.reported[1])
        reset(c.P, STATES, POSITION + i, sigma * sigma + arm2)
        reset(c.P, STATES, VELOCITY + i, (RECEIVED_SPEED if known else UNKNOWN_SPEED) ** 2)
    c.fix_ns = c.t_ns
    if levelled(c) and (c.heading_sigma > 0.0 or find_heading(c)):
        for i in range(3):
            reset(c.P, STATES, POSITION + i, max(UNKNOWN_POSITION, guess if i == 2 else 0.0) ** 2)
            reset(c.P, STATES, VELOCITY + i, UNKNOWN_SPEED**2 if i < 2 else UNKNOWN_CLIMB**2)
        engage(p, c)
