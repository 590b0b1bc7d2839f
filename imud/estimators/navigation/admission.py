"""Refused positions: for how long, and when the filter gives in to them after all, and with how much doubt.

A receiver that jumps stays where it went; one that creeps contradicts the velocity ever more. So refused positions are
believed once they have kept to the velocity for a while, or where nothing else vouches for the velocity.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from ..records import AT_REST
from .covariance import WANDER_S, grow, variance
from .creep import forget_creep, proven
from .motion import FRESH_S
from .state import ATTITUDE, NAVIGATING, POSITION, STATES, VELOCITY, WANDER
from .strapdown import displace

GATE = 25.0
RETURNED = 9.0  # gate of a receiver that has crept: within that it is back
GIVE_IN_COUNT, GIVE_IN_S = 5, 8.0
DRIFT_GATE = 9.0
CREPT_STEADY_S = 20.0  # steady for so long, where the receiver has been found to creep slowly
LONGEST_REFUSAL_S, FASTEST_CREEP = 60.0, 5.0  # s, m/s: of fixes that creep away from the velocity
UNDER_WAY, UNSEEN_S = 2.0, 0.5  # m/s, s: what shows in the last digit of any receiver
FELT, FELT_HEADING = 0.25, 0.05  # m/s, rad: what an inertial velocity may be wrong by without knowing it


@kernel
def stuck(c: Any, fix: Any) -> bool:
    """Does the receiver go on repeating a position, to the last digit, that the vehicle has certainly left?

    At rest many hold it, and let go of it late.
    """
    if fix.lat != c.held[0] or fix.lon != c.held[1]:
        c.held[0], c.held[1] = fix.lat, fix.lon
        c.held_ns = c.t_ns
        return False
    held_s = 1e-9 * (c.t_ns - c.held_ns)
    least = math.hypot(c.v[0], c.v[1]) - 3.0 * math.sqrt(max(variance(c, VELOCITY), variance(c, VELOCITY + 1)))
    return bool(c.phase == NAVIGATING and least > UNDER_WAY and UNSEEN_S < held_s < LONGEST_REFUSAL_S)


@kernel
def told(fix: Any) -> bool:
    """Does the receiver tell of its velocity?"""
    return math.isfinite(fix.speed) or math.isfinite(fix.v[0])


@kernel
def known_velocity(c: Any, fix: Any) -> bool:
    """Does something but positions vouch for the velocity: rest, the receiver's own, which agrees, or its creeping?"""
    return c.creeping != 0 or c.flags & AT_REST != 0 or (told(fix) and c.contrary == 0)


@kernel
def creeps(c: Any, fix: Any, alone_s: float) -> bool:
    """Where only what is felt vouches for the velocity: may refused positions be such that creep?

    Not where the estimate is new, or was alone before: then it is as likely to be wrong.
    """
    way = math.hypot(c.z[0] + c.wander[0], c.z[1] + c.wander[1])
    return bool(not told(fix) and proven(c) and c.refused_after_s < FRESH_S and way < FASTEST_CREEP * alone_s)


@kernel
def settled(c: Any, known: bool) -> float:
    """For how long, s, the refused positions have kept to the velocity, as far as errors of both explain.

    Call for each refused fix; a position that does not keep to it begins anew.
    """
    dt = 1e-9 * (c.t_ns - c.refused_ns[0])
    unknown = 0.0 if known else FELT**2 + FELT_HEADING**2 * (c.v[0] ** 2 + c.v[1] ** 2)
    drifts = False
    for i in range(2):
        wander = c.reported[0] ** 2 * (1.0 - math.exp(-dt / WANDER_S))
        allowed = 2.0 * (wander + c.white[0]) + (variance(c, VELOCITY + i) + unknown) * dt * dt
        drifts = drifts or (c.z[i] + c.wander[i] - c.refused[i]) ** 2 > DRIFT_GATE * allowed
    if c.rejected[0] == 1 or drifts:
        c.refused_ns[0] = c.t_ns
        for i in range(2):
            c.refused[i] = c.z[i] + c.wander[i]
        return 0.0
    return float(dt)


@kernel
def give_in(c: Any, first: int, last: int, known: bool) -> None:
    """The fixes have contradicted the estimate for long enough: go to them, unsure by as much as they disagreed.

    Whether the estimate or the receiver was wrong nothing tells: that is `doubt`, which fades as the receiver's errors
    do. No state can hold it, as a wander state that large would be contradicted by every fix that stays where it is.
    Velocity and heading are doubted where nothing vouches for the velocity.
    """
    for i in range(first, last):
        way, sigma = c.z[i] + c.wander[i], c.reported[i // 2]
        displace(c, way if i == 0 else 0.0, way if i == 1 else 0.0, way if i == 2 else 0.0)
        reset(c.P, STATES, POSITION + i, 4.0 * sigma * sigma + 1.0)
        reset(c.P, STATES, WANDER + i, sigma * sigma)
        c.doubt[i] += way * way
        c.wander[i] = c.z[i] = 0.0
        if not known:
            grow(c, VELOCITY + i, 4.0)
    if first == 0 and not known:
        grow(c, ATTITUDE + 2, math.radians(10.0) ** 2)
        c.lost += 1


@kernel
def admit(c: Any, fix: Any, worst: float) -> bool:
    """May the horizontal position correct the estimate? In the end it may, whatever it says."""
    if worst < (RETURNED if c.creeping else GATE):
        c.creeping = 0
        c.rejected[0] = 0
        return True
    c.rejected[0] += 1
    known, alone_s = known_velocity(c, fix), 1e-9 * (c.t_ns - c.fix_ns)
    steady_s = settled(c, known)
    if c.rejected[0] == 1:
        c.refused_after_s = alone_s
    if c.rejected[0] <= GIVE_IN_COUNT or alone_s <= GIVE_IN_S:
        return False
    steady = steady_s > (CREPT_STEADY_S if c.creeping else GIVE_IN_S)
    if (known or creeps(c, fix, alone_s)) and not steady and alone_s < LONGEST_REFUSAL_S:
        return False
    give_in(c, 0, 2, known)
    forget_creep(c)
    c.rejected[0] = 0
    return True


@kernel
def admit_height(c: Any, worst: float) -> bool:
    """May the height, where there is one, correct the estimate?"""
    if not math.isfinite(c.z[2]) or worst < GATE:
        c.rejected[1] = 0
        return math.isfinite(c.z[2])
    c.rejected[1] += 1
    if c.rejected[1] == 1:
        c.refused_ns[1] = c.t_ns
    if c.rejected[1] <= GIVE_IN_COUNT or 1e-9 * (c.t_ns - c.refused_ns[1]) <= GIVE_IN_S:
        return False
    give_in(c, 2, 3, c.flags & AT_REST != 0)
    c.rejected[1] = 0
    return True
