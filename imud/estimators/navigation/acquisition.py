"""Before the heading is known: position and velocity are followed as the receiver shows them, its antenna's at the
fixes' own time (see `alignment.refer`), by the filter that navigates later, and every fix helps to find the heading."""

import math
from typing import Any

from ...kernels.earth import STANDARD_GRAVITY
from ...kernels.jit import kernel
from ...kernels.kalman import reset, shear
from .alignment import HORIZON_S, engage, find_heading
from .correction import predicted
from .covariance import WANDER_S, deviation, variance
from .fix_matching import levelled, pair, vertical_bias
from .gnss import doubt_place, slowness2, velocity_of
from .hypotheses import likely, turned
from .matching import TIME, ZETA, times, unit
from .motion import REST_SPEED, WINDOW_S
from .non_holonomic import witness
from .state import ATTITUDE, POSITION, STATES, VELOCITY, WANDER
from .strapdown import way
from .whitening import SPEED, velocity

UNKNOWN_HEIGHT = 1000.0  # m
UNKNOWN_SPEED, UNKNOWN_CLIMB = 30.0, 1.0  # m/s
RECEIVED_SPEED = 0.3  # m/s
FELT_SPEED = 5.0  # m/s, at most, of a velocity that positions and what was felt since have told
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
def bear_witness(p: Any, c: Any, vn: float, ve: float) -> None:
    """Let the velocity of a fix (NaN: it told none) tell of the vehicle's axis, in the level frame.

    One that is seen in positions is exact, but that of a moment ago.
    """
    noise = c.white_speed
    if not (math.isfinite(vn) and math.isfinite(ve)):
        vn, ve, dt = c.slope[0], c.slope[1], c.slope[2]
        if not dt > 0.0 or c.mark_ns != c.t_ns:
            return
        turned = 0.5 * dt * (abs(c.rate[0]) + abs(c.rate[1]) + abs(c.rate[2]))
        noise = 2.0 * c.white[0] / dt**2 + turned**2 * (vn**2 + ve**2)
    drift2 = predicted(c, vertical_bias(c)) * HORIZON_S**2
    witness(p, c, (vn, ve, 0.0), noise, drift2)


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
        reset(c.P, STATES, VELOCITY + i, min(r, FELT_SPEED**2))


@kernel
def place(p: Any, c: Any, fix: Any) -> None:
    """Put the core on the fix: all that is known of the place is what it says, and how far receivers wander."""
    c.lat, c.lon = fix.lat, fix.lon
    guess = 0.0  # sigma of a height that the fix does not tell: of the last one, if there was one
    if math.isfinite(fix.height):
        c.height = fix.height
    else:
        guess = min(max(deviation(c, POSITION + 2), c.reported[1]), UNKNOWN_HEIGHT)
    for i in range(3):
        v = velocity_of(fix, i)
        known = math.isfinite(v)
        c.v[i] = v if known else 0.0
        speed = RECEIVED_SPEED if known else UNKNOWN_CLIMB if i == 2 else UNKNOWN_SPEED
        reset(c.P, STATES, VELOCITY + i, speed**2)
        reset(c.P, STATES, POSITION + i, c.white[i // 2] if i < 2 or guess == 0.0 else guess**2)
        reset(c.P, STATES, WANDER + i, c.reported[i // 2] ** 2)
        c.wander[i] = 0.0
        if i < 2 or guess == 0.0:
            shear(c.P, STATES, POSITION + i, WANDER + i, -1.0)
    doubt_place(p, c)
    c.fix_ns = c.t_ns


@kernel
def acquire(p: Any, c: Any, b: Any, fix: Any) -> None:
    """Learn from a fix, before it is fused, what the heading is; begin to navigate when that is known."""
    vn, ve = velocity_of(fix, 0), velocity_of(fix, 1)
    pair(c, b, fix.lat, fix.lon, vn, ve, slowness2(fix))
    if not math.isfinite(c.fix_speed):
        c.fix_speed = seen_speed(c, fix.lat, fix.lon)
    bear_witness(p, c, vn, ve)
    if levelled(c) and (c.heading_sigma > 0.0 or find_heading(c, b)):
        if math.isfinite(vn) and math.isfinite(ve):  # told in a moment, for a sensor whose heading is known
            for i in range(2):
                reset(c.P, STATES, VELOCITY + i, FELT_SPEED**2)
        elif c.matched_ns == c.t_ns:
            take_velocity(c, b)
        engage(p, c)
