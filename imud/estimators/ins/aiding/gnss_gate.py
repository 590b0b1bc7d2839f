"""The gate of GNSS positions: which are rejected, for how long, and when the filter is reset to them after all.

A receiver that jumps stays where it went; one that drifts contradicts the velocity ever more. So rejected positions are
believed once they have been consistent with the velocity for a while, or where nothing else supports the velocity.
"""

import math
from typing import Any

from ....compile.jit import kernel
from ..ekf import add_variance, clear_gnss_bias, decorrelate, variance
from ..error_model import GNSS_BIAS_TIME_S
from ..mechanization import displace
from ..observers.gnss_drift import all_onsets_open, clear_detection, reset_drift
from ..observers.reset_inflation import inflate_position
from ..state import ATTITUDE, NAVIGATING, POSITION, VELOCITY
from ..stationarity import FRESH_S

POSITION_GATE = 25.0
RETURN_GATE = 9.0  # gate of a receiver that has drifted: within that it is back
RESET_COUNT, RESET_S = 5, 8.0
CONSISTENCY_GATE = 9.0
DRIFT_RESET_S = 20.0  # consistent for so long, where the receiver has been found to drift slowly
MAX_REJECT_S, MAX_DRIFT_SPEED = 60.0, 5.0  # s, m/s: of fixes that drift away from the velocity
FROZEN_MIN_SPEED, FROZEN_MIN_S = 2.0, 0.5  # m/s, s: what shows in the last digit of any receiver
# m/s, rad: what an inertial velocity may be wrong by without knowing it
INERTIAL_VELOCITY_ERROR, INERTIAL_HEADING_ERROR = 0.25, 0.05
MAX_VELOCITY_REJECTS = 8  # fixes in a row with a velocity that contradicts: the heading is wrong
MAX_RESET_SCORE, RESET_SCORE_DECAY = 1.5, 0.98


@kernel
def is_frozen(c: Any, fix: Any) -> bool:
    """Does the receiver go on repeating a position, to the last digit, that the vehicle has certainly left?

    At rest many hold it, and let go of it late.
    """
    g = c.integrity
    if fix.lat != g.frozen_position[0] or fix.lon != g.frozen_position[1]:
        g.frozen_position[0], g.frozen_position[1] = fix.lat, fix.lon
        g.frozen_since_ns = c.nav.t_ns
        return False
    frozen_s = 1e-9 * (c.nav.t_ns - g.frozen_since_ns)
    sigma = math.sqrt(max(variance(c, VELOCITY), variance(c, VELOCITY + 1)))
    least = math.hypot(c.nav.v_n[0], c.nav.v_n[1]) - 3.0 * sigma
    return bool(c.alignment.mode == NAVIGATING and least > FROZEN_MIN_SPEED and FROZEN_MIN_S < frozen_s < MAX_REJECT_S)


@kernel
def reports_velocity(fix: Any) -> bool:
    """Does the receiver report a velocity?"""
    return math.isfinite(fix.speed) or math.isfinite(fix.v[0])


@kernel
def velocity_is_supported(c: Any, fix: Any) -> bool:
    """Does something other than positions support the velocity: rest, the receiver's own velocity, or its drift?"""
    own = reports_velocity(fix) and c.integrity.velocity_reject_count == 0
    return c.drift.detected != 0 or c.stationarity.at_rest != 0 or own


@kernel
def position_residual(c: Any, axis: int) -> float:
    """How far the fix is from the estimate, m, with no bias allowed for."""
    return float(c.scratch.position_innovation[axis] + c.nav.gnss_bias[axis])


@kernel
def drift_is_plausible(c: Any, fix: Any, outage_s: float) -> bool:
    """Where only the IMU supports the velocity: may the rejected positions be those of a receiver that drifts?

    Not where the estimate is new, or had no fixes before: then it is as likely to be wrong.
    """
    way = math.hypot(position_residual(c, 0), position_residual(c, 1))
    recent = c.integrity.outage_at_reject_s < FRESH_S
    return bool(not reports_velocity(fix) and all_onsets_open(c) and recent and way < MAX_DRIFT_SPEED * outage_s)


@kernel
def consistent_for(c: Any, known: bool) -> float:
    """For how long, s, the rejected positions have been consistent with the velocity, as far as errors of both allow.

    Call for each rejected fix; a position that is not consistent begins anew.
    """
    g = c.integrity
    dt = 1e-9 * (c.nav.t_ns - g.reject_start_ns[0])
    v2 = c.nav.v_n[0] ** 2 + c.nav.v_n[1] ** 2
    unknown = 0.0 if known else INERTIAL_VELOCITY_ERROR**2 + INERTIAL_HEADING_ERROR**2 * v2
    leaves = False
    for i in range(2):
        bias2 = c.gnss.reported_sigma[0] ** 2 * (1.0 - math.exp(-dt / GNSS_BIAS_TIME_S))
        allowed = 2.0 * (bias2 + c.gnss.noise_var[0]) + (variance(c, VELOCITY + i) + unknown) * dt * dt
        leaves = leaves or (position_residual(c, i) - g.reject_offset[i]) ** 2 > CONSISTENCY_GATE * allowed
    if g.reject_count[0] == 1 or leaves:
        g.reject_start_ns[0] = c.nav.t_ns
        for i in range(2):
            g.reject_offset[i] = position_residual(c, i)
        return 0.0
    return float(dt)


@kernel
def reset_to_gnss(c: Any, first: int, last: int, known: bool) -> None:
    """The fixes have contradicted the estimate for long enough: go to them, as uncertain as they disagreed.

    Nothing shows whether the estimate or the receiver was wrong: the position's sigma is inflated by the difference,
    which fades as the receiver's errors do. No state can hold it, as a GNSS bias that large would be contradicted by
    every fix that stays where it is. Velocity and heading get more variance where nothing supports the velocity.
    """
    for i in range(first, last):
        way, sigma = position_residual(c, i), c.gnss.reported_sigma[i // 2]
        displace(c, way if i == 0 else 0.0, way if i == 1 else 0.0, way if i == 2 else 0.0)
        decorrelate(c, POSITION + i, 4.0 * sigma * sigma + 1.0)
        clear_gnss_bias(c, i, sigma * sigma)
        inflate_position(c, i, way * way)
        c.scratch.position_innovation[i] = 0.0
        if not known:
            add_variance(c, VELOCITY + i, 4.0)
    if first == 0 and not known:
        add_variance(c, ATTITUDE + 2, math.radians(10.0) ** 2)
        c.integrity.reset_score += 1


@kernel
def gate_position(c: Any, fix: Any, nis: float) -> bool:
    """May the horizontal position, of this normalised innovation squared, correct the estimate? In the end it may."""
    g = c.integrity
    if nis < (RETURN_GATE if c.drift.detected else POSITION_GATE):
        clear_detection(c)
        g.reject_count[0] = 0
        return True
    g.reject_count[0] += 1
    known, outage_s = velocity_is_supported(c, fix), 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns)
    consistent_s = consistent_for(c, known)
    if g.reject_count[0] == 1:
        g.outage_at_reject_s = outage_s
    if g.reject_count[0] <= RESET_COUNT or outage_s <= RESET_S:
        return False
    consistent = consistent_s > (DRIFT_RESET_S if c.drift.detected else RESET_S)
    if (known or drift_is_plausible(c, fix, outage_s)) and not consistent and outage_s < MAX_REJECT_S:
        return False
    reset_to_gnss(c, 0, 2, known)
    reset_drift(c)
    g.reject_count[0] = 0
    return True


@kernel
def gate_height(c: Any, nis: float) -> bool:
    """May the height, where there is one, correct the estimate?"""
    g, known = c.integrity, math.isfinite(c.scratch.position_innovation[2])
    if not known or nis < POSITION_GATE:
        g.reject_count[1] = 0
        return known
    g.reject_count[1] += 1
    if g.reject_count[1] == 1:
        g.reject_start_ns[1] = c.nav.t_ns
    if g.reject_count[1] <= RESET_COUNT or 1e-9 * (c.nav.t_ns - g.reject_start_ns[1]) <= RESET_S:
        return False
    reset_to_gnss(c, 2, 3, c.stationarity.at_rest != 0)
    g.reject_count[1] = 0
    return True


@kernel
def set_rejecting(c: Any) -> None:
    """Whether the last fix was rejected, in its position or its height."""
    c.integrity.rejecting = 1 if c.integrity.reject_count[0] > 0 or c.integrity.reject_count[1] > 0 else 0


@kernel
def reject_frozen(c: Any) -> None:
    """The receiver is frozen: its fix is rejected."""
    c.integrity.rejecting = 1


@kernel
def count_velocity_rejects(c: Any, rejected: int) -> None:
    """After the velocity of a fix, of which `rejected` components were: how many fixes in a row were so."""
    c.integrity.velocity_reject_count = c.integrity.velocity_reject_count + 1 if rejected else 0


@kernel
def contradicts_heading(c: Any) -> bool:
    """After a fix: do so many rejected velocities, or resets, say that the heading is wrong?"""
    g = c.integrity
    return bool(g.velocity_reject_count > MAX_VELOCITY_REJECTS or g.reset_score > MAX_RESET_SCORE)


@kernel
def fade_reset_score(c: Any) -> None:
    """Resets count less with every fix."""
    c.integrity.reset_score *= RESET_SCORE_DECAY


@kernel
def clear_contradictions(c: Any) -> None:
    """Count rejected velocities and resets anew."""
    c.integrity.velocity_reject_count = 0
    c.integrity.reset_score = 0.0
