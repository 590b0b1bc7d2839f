"""Refused positions: for how long, and when the filter gives in to them after all, and with how much doubt.

A receiver that jumps stays where it went; one that creeps contradicts the velocity ever more. So refused positions are
believed once they have kept to the velocity for a while, or where nothing else vouches for the velocity.
"""

import math
from typing import Any

from ....kernels.jit import kernel
from ....kernels.kalman import reset
from ...records import AT_REST
from ..error_model import GNSS_BIAS_TIME_S, add_variance, variance
from ..mechanization import displace
from ..state import ATTITUDE, GNSS_BIAS, NAVIGATING, POSITION, STATES, VELOCITY
from ..stationarity import FRESH_S
from .gnss_drift import all_onsets_open, reset_drift

POSITION_GATE = 25.0
RETURN_GATE = 9.0  # gate of a receiver that has crept: within that it is back
RESET_COUNT, RESET_S = 5, 8.0
CONSISTENCY_GATE = 9.0
DRIFT_RESET_S = 20.0  # steady for so long, where the receiver has been found to creep slowly
MAX_REJECT_S, MAX_DRIFT_SPEED = 60.0, 5.0  # s, m/s: of fixes that creep away from the velocity
FROZEN_MIN_SPEED, FROZEN_MIN_S = 2.0, 0.5  # m/s, s: what shows in the last digit of any receiver
INERTIAL_VELOCITY_ERROR, INERTIAL_HEADING_ERROR = (
    0.25,
    0.05,
)  # m/s, rad: what an inertial velocity may be wrong by without knowing it


@kernel
def is_frozen(c: Any, fix: Any) -> bool:
    """Does the receiver go on repeating a position, to the last digit, that the vehicle has certainly left?

    At rest many hold it, and let go of it late.
    """
    if fix.lat != c.gnss.frozen_position[0] or fix.lon != c.gnss.frozen_position[1]:
        c.gnss.frozen_position[0], c.gnss.frozen_position[1] = fix.lat, fix.lon
        c.gnss.frozen_since_ns = c.nav.t_ns
        return False
    held_s = 1e-9 * (c.nav.t_ns - c.gnss.frozen_since_ns)
    least = math.hypot(c.nav.v_n[0], c.nav.v_n[1]) - 3.0 * math.sqrt(
        max(variance(c, VELOCITY), variance(c, VELOCITY + 1))
    )
    return bool(c.alignment.mode == NAVIGATING and least > FROZEN_MIN_SPEED and FROZEN_MIN_S < held_s < MAX_REJECT_S)


@kernel
def reports_velocity(fix: Any) -> bool:
    """Does the receiver tell of its velocity?"""
    return math.isfinite(fix.speed) or math.isfinite(fix.v[0])


@kernel
def velocity_is_supported(c: Any, fix: Any) -> bool:
    """Does something but positions vouch for the velocity: rest, the receiver's own, which agrees, or its creeping?"""
    return (
        c.drift.detected != 0
        or c.nav.flags & AT_REST != 0
        or (reports_velocity(fix) and c.integrity.velocity_reject_count == 0)
    )


@kernel
def drift_is_plausible(c: Any, fix: Any, alone_s: float) -> bool:
    """Where only what is felt vouches for the velocity: may refused positions be such that creep?

    Not where the estimate is new, or was alone before: then it is as likely to be wrong.
    """
    way = math.hypot(
        c.scratch.position_innovation[0] + c.gnss.bias[0], c.scratch.position_innovation[1] + c.gnss.bias[1]
    )
    return bool(
        not reports_velocity(fix)
        and all_onsets_open(c)
        and c.integrity.outage_at_reject_s < FRESH_S
        and way < MAX_DRIFT_SPEED * alone_s
    )


@kernel
def consistent_for(c: Any, known: bool) -> float:
    """For how long, s, the refused positions have kept to the velocity, as far as errors of both explain.

    Call for each refused fix; a position that does not keep to it begins anew.
    """
    dt = 1e-9 * (c.nav.t_ns - c.integrity.reject_start_ns[0])
    unknown = (
        0.0
        if known
        else INERTIAL_VELOCITY_ERROR**2 + INERTIAL_HEADING_ERROR**2 * (c.nav.v_n[0] ** 2 + c.nav.v_n[1] ** 2)
    )
    drifts = False
    for i in range(2):
        wander = c.gnss.reported_sigma[0] ** 2 * (1.0 - math.exp(-dt / GNSS_BIAS_TIME_S))
        allowed = 2.0 * (wander + c.gnss.noise_var[0]) + (variance(c, VELOCITY + i) + unknown) * dt * dt
        drifts = (
            drifts
            or (c.scratch.position_innovation[i] + c.gnss.bias[i] - c.integrity.reject_offset[i]) ** 2
            > CONSISTENCY_GATE * allowed
        )
    if c.integrity.reject_count[0] == 1 or drifts:
        c.integrity.reject_start_ns[0] = c.nav.t_ns
        for i in range(2):
            c.integrity.reject_offset[i] = c.scratch.position_innovation[i] + c.gnss.bias[i]
        return 0.0
    return float(dt)


@kernel
def reset_to_gnss(c: Any, first: int, last: int, known: bool) -> None:
    """The fixes have contradicted the estimate for long enough: go to them, unsure by as much as they disagreed.

    Whether the estimate or the receiver was wrong nothing tells: that is `doubt`, which fades as the receiver's errors
    do. No state can hold it, as a wander state that large would be contradicted by every fix that stays where it is.
    Velocity and heading are doubted where nothing vouches for the velocity.
    """
    for i in range(first, last):
        way, sigma = c.scratch.position_innovation[i] + c.gnss.bias[i], c.gnss.reported_sigma[i // 2]
        displace(c, way if i == 0 else 0.0, way if i == 1 else 0.0, way if i == 2 else 0.0)
        reset(c.cov.P, STATES, POSITION + i, 4.0 * sigma * sigma + 1.0)
        reset(c.cov.P, STATES, GNSS_BIAS + i, sigma * sigma)
        c.integrity.position_inflation[i] += way * way
        c.gnss.bias[i] = c.scratch.position_innovation[i] = 0.0
        if not known:
            add_variance(c, VELOCITY + i, 4.0)
    if first == 0 and not known:
        add_variance(c, ATTITUDE + 2, math.radians(10.0) ** 2)
        c.integrity.reset_score += 1


@kernel
def gate_position(c: Any, fix: Any, worst: float) -> bool:
    """May the horizontal position correct the estimate? In the end it may, whatever it says."""
    if worst < (RETURN_GATE if c.drift.detected else POSITION_GATE):
        c.drift.detected = 0
        c.integrity.reject_count[0] = 0
        return True
    c.integrity.reject_count[0] += 1
    known, alone_s = velocity_is_supported(c, fix), 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns)
    steady_s = consistent_for(c, known)
    if c.integrity.reject_count[0] == 1:
        c.integrity.outage_at_reject_s = alone_s
    if c.integrity.reject_count[0] <= RESET_COUNT or alone_s <= RESET_S:
        return False
    steady = steady_s > (DRIFT_RESET_S if c.drift.detected else RESET_S)
    if (known or drift_is_plausible(c, fix, alone_s)) and not steady and alone_s < MAX_REJECT_S:
        return False
    reset_to_gnss(c, 0, 2, known)
    reset_drift(c)
    c.integrity.reject_count[0] = 0
    return True


@kernel
def gate_height(c: Any, worst: float) -> bool:
    """May the height, where there is one, correct the estimate?"""
    if not math.isfinite(c.scratch.position_innovation[2]) or worst < POSITION_GATE:
        c.integrity.reject_count[1] = 0
        return math.isfinite(c.scratch.position_innovation[2])
    c.integrity.reject_count[1] += 1
    if c.integrity.reject_count[1] == 1:
        c.integrity.reject_start_ns[1] = c.nav.t_ns
    if c.integrity.reject_count[1] <= RESET_COUNT or 1e-9 * (c.nav.t_ns - c.integrity.reject_start_ns[1]) <= RESET_S:
        return False
    reset_to_gnss(c, 2, 3, c.nav.flags & AT_REST != 0)
    c.integrity.reject_count[1] = 0
    return True
