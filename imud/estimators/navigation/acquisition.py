"""Before the heading is known: position and velocity are the receiver's, and every fix helps to find the heading."""

import math
from typing import Any

from ...kernels.earth import STANDARD_GRAVITY
from ...kernels.jit import kernel
from ...kernels.kalman import reset
from .alignment import HORIZON_S, engage, find_heading
from .correction import predicted
from .covariance import WANDER_S, deviation, variance
from .fix_matching import levelled, pair, vertical_bias
from .gnss import slowness2, velocity_of
from .hypotheses import likely, turned
from .matching import TIME, ZETA, times, unit
from .motion import REST_SPEED, WINDOW_S
from .non_holonomic import witness
from .state import ATTITUDE, POSITION, STATES, VELOCITY
from .strapdown import way
from .whitening import SPEED, velocity

UNKNOWN_POSITION, UNKNOWN_HEIGHT = 100.0, 1000.0  # m
UNKNOWN_SPEED = 5.0  # m/s
UNKNOWN_CLIMB = 1.0
RECEIVED_SPEED = 0.3
SURE = 3.0  # times its sigma, a speed seen in positions is no noise


@kernel
def noise2(c: Any, dt: float) -> float:
    """Variance, m^2/s^2, of a velocity component seen in two positions `dt` s apart."""
    wander2 = c.reported[0] ** 2 * (1.0 - math.exp(-dt / WANDER_S))
    return float(2.0 * (c.white[0] + wander2) / dt**2)


@kernel
def calm_speed(c: Any, lat: float, lon: float) -> float:
    """Mean speed in the positions since the sensor has been quiet, m/s; NaN where that is not known well enough."""
    dt = 1e-9 * (c.t_ns - c.calm_ns)
    if dt > c.quiet * WINDOW_S:
        c.calm[0], c.calm[1], c.calm_ns = lat, lon, c.t_ns
        return math.nan
    if dt <= 0.0 or SURE**2 * noise2(c, dt) > REST_SPEED**2:
        return math.nan
    north, east = way(c, c.calm[0], c.calm[1], lat, lon)
    return float(math.hypot(north, east) / dt)


@kernel
def seen_speed(c: Any, lat: float, lon: float) -> float:
    """Speed seen in positions, m/s: over the last pair, or since the sensor is quiet; NaN where it may be noise."""
    calm = calm_speed(c, lat, lon)
    if c.slope[2] > 0.0:
        speed = math.hypot(c.slope[0], c.slope[1])
        sigma = math.sqrt(2.0 * c.white[0]) / c.slope[2]  # the wander hardly changes meanwhile
        if speed > SURE * sigma or SURE * sigma < REST_SPEED:
            return speed
    return calm


@kernel
def bear_witness(p: Any, c: Any, known: bool) -> None:
    """Let the fix's velocity tell of the axis, in the level frame; from positions it is that of a moment ago."""
    drift2 = predicted(c, vertical_bias(c)) * HORIZON_S**2
    noise = c.white_speed
    if not known:
        dt = c.slope[2]
        turned = 0.5 * dt * (abs(c.rate[0]) + abs(c.rate[1]) + abs(c.rate[2]))
        noise = 2.0 * c.white[0] / dt**2 + turned**2 * (c.v[0] ** 2 + c.v[1] ** 2)
    witness(p, c, noise, drift2, 0.0)


@kernel
def take_velocity(c: Any, b: Any) -> None:
    """With the heading found: the velocity that positions showed, and what was felt since."""
    k = likely(c)
    felt = times(unit(-c.frame - turned(c, k, 0.0)), (velocity(b, k, 0, ZETA), velocity(b, k, 1, ZETA)))
    tilt2 = STANDARD_GRAVITY**2 * max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    r = (
        b.whitener[SPEED, SPEED]
        + c.heading_sigma**2 * (felt[0] ** 2 + felt[1] ** 2)
        + tilt2 * velocity(b, k, 0, TIME) ** 2
    )
    for i in range(2):
        c.v[i] = b.followed[k, SPEED, 0, i] + felt[i]
        reset(c.P, STATES, VELOCITY + i, min(r, UNKNOWN_SPEED**2))


@kernel
def place(p: Any, c: Any, b: Any, fix: Any) -> None:
    """Put the core on the fix; begin to navigate when roll, pitch and heading are known."""
    c.lat, c.lon = fix.lat, fix.lon
    guess = 0.0  # sigma of a height that the fix does not tell: of the last one, if there was one
    if math.isfinite(fix.height):
        c.height = fix.height
    else:
        guess = min(max(deviation(c, POSITION + 2), c.reported[1]), UNKNOWN_HEIGHT)
    vn, ve = velocity_of(fix, 0), velocity_of(fix, 1)
    pair(c, b, fix.lat, fix.lon, vn, ve, slowness2(fix))
    known = math.isfinite(vn) and math.isfinite(ve)
    if not math.isfinite(c.fix_speed):
        c.fix_speed = seen_speed(c, fix.lat, fix.lon)
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
    if levelled(c) and (c.heading_sigma > 0.0 or find_heading(c, b)):
        for i in range(3):
            reset(c.P, STATES, POSITION + i, max(UNKNOWN_POSITION, guess if i == 2 else 0.0) ** 2)
            reset(c.P, STATES, VELOCITY + i, UNKNOWN_SPEED**2 if i < 2 else UNKNOWN_CLIMB**2)
        if not known and c.matched_ns == c.t_ns:
            take_velocity(c, b)
        engage(p, c)
