"""The gate of GNSS positions: which are rejected, for how long, and when the filter is reset to them (`gnss_reset`).

After a jump the rejected positions are consistent with the estimated velocity; in a drift they contradict it more and
more. So the filter is reset to rejected positions once they have been consistent with the velocity for some seconds, or
where nothing but the IMU supports the velocity; after `max_reject_s` (`wheel_max_reject_s` where a drift is detected,
and wheels support the velocity) in any case. A velocity of the receiver that agrees supports the velocity however far
off the positions are, wheels and a detected drift only as far as receivers drift. Where the estimate diverges from the
positions (`position_divergence`) those with centimetre accuracy are used at once, others after `reset_s`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_covariance, add_variance, variance
from ..glr_tests.gnss_drift import (
    BY_POSITIONS,
    BY_WHEELS,
    all_onsets_open,
    clear_detection,
    reset_drift,
    state_detected_drift,
)
from ..glr_tests.reset import reset_glr_tests
from ..glr_tests.time_offset_step import reset_time_offset_step
from ..integrity.alternating_receiver import count_height, reject_share, share_of_few
from ..integrity.reset_inflation import inflate_position_to
from ..state import COARSE_ALIGNMENT, HORIZONTAL, NAVIGATING, POSITION, TIME_OFFSET, VELOCITY, VERTICAL
from .gnss_reset import (
    allow_for_wrong_velocity,
    bias_free_innovation,
    diverging_inflation,
    inflate_after_outage,
    inflate_to_diverging,
    inflate_to_fix,
    lose_attitude,
    reset_to_gnss,
)
from .heading_contradiction import count_reset
from .position_divergence import estimate_diverges, measure_divergence
from .wheel_check import wheels_reject, wheels_support

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("gnss_position_gate", 25.0, "NIS", "Gate of the horizontal position, and of the height.", "Five sigma."),
    Tunable(
        "gnss_return_gate",
        9.0,
        "NIS",
        "Gate of the position while a drift is detected: within it the drift has ended.",
        "Three sigma.",
    ),
    Tunable(
        "burst_psd",
        0.5,
        "m^2/s^3",
        "Largest velocity noise since the last used fix that a position beyond its gate may be explained by.",
        "0.7 m/s in a second: a pothole, a gust.",
    ),
    Tunable(
        "burst_s",
        3.0,
        "s",
        "Longest time since the last used fix for which a position beyond its gate may be explained by velocity noise.",
        "Choice.",
    ),
    Tunable(
        "outlier_count",
        2,
        "fixes",
        "Positions in a row, far from those that were rejected before, that may be outliers.",
        "Choice.",
    ),
    Tunable(
        "lost_position_count",
        3,
        "fixes",
        "Positions in a row after an outage, further off than a receiver drifts, after which the estimate is wrong.",
        "Choice: one or two may be outliers.",
    ),
    Tunable("reset_count", 5, "fixes", "Number of rejected fixes before the filter is reset to them.", "Choice."),
    Tunable(
        "reset_s",
        8.0,
        "s",
        "Time for which rejected positions must be consistent with the velocity before the filter is reset to them.",
        "Recorded multipath.",
    ),
    Tunable(
        "max_inflation",
        100.0,
        "",
        "Largest factor by which a rejected position after an outage inflates P, instead of a reset to it.",
        "Errors ten times as large as stated; with larger ones the correction of the tilt is not small.",
    ),
    Tunable("consistency_gate", 9.0, "NIS", "Gate of a rejected position against the velocity.", "Three sigma."),
    Tunable("drift_reset_s", 20.0, "s", "As reset_s, where the receiver has been found to drift.", "Simulated drifts."),
    Tunable("max_reject_s", 60.0, "s", "Longest rejection of fixes that drift away.", "Choice."),
    Tunable("max_drift_speed", 5.0, "m/s", "Fastest drift of a receiver.", "Choice."),
    Tunable("inertial_velocity_error", 0.25, "m/s", "Error of an inertial velocity beyond its sigma.", "Choice."),
    Tunable("inertial_heading_error", 0.05, "rad", "Error of an inertial heading beyond its sigma.", "Choice."),
)


@kernel
def reports_velocity(p: Parameters, fix: Fix) -> bool:
    """Whether the receiver reports a velocity, or a speed with a direction or too low for one."""
    directed = math.isfinite(fix.course) or fix.speed < p.tuning.min_course_speed
    return bool(math.isfinite(fix.v[0]) or (math.isfinite(fix.speed) and directed))


@kernel
def velocity_is_supported(p: Parameters, c: Core, fix: Fix) -> bool:
    """Whether rest, wheels, the receiver's velocity, or a detected drift supports the estimated velocity.

    A detected drift and wheels, which do not show the direction, support it only as far as receivers drift: beyond, the
    estimate is off.
    """
    agrees = c.integrity.velocity_reject_count == 0 and c.drift.detected != BY_WHEELS
    drifts = (c.drift.detected != 0 or wheels_support(p, c)) and is_as_far_as_a_drift(p, c, p.tuning.reset_s)
    return bool(drifts or c.stationarity.at_rest != 0 or (reports_velocity(p, fix) and agrees))


@kernel
def is_as_far_as_a_drift(p: Parameters, c: Core, before_s: float) -> bool:
    """Whether a drift of the receiver that began `before_s` before the last fix used can explain the position."""
    distance = elementary.hypot(bias_free_innovation(c, 0), bias_free_innovation(c, 1))
    outage_s = 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns)
    return bool(distance < p.tuning.max_drift_speed * (outage_s + before_s))


@kernel
def estimate_may_be_wrong(p: Parameters, c: Core) -> bool:
    """Whether neither rest nor wheels support the velocity: if positions contradict it, either may be wrong."""
    return c.stationarity.at_rest == 0 and not wheels_support(p, c)


@kernel
def split_excess(p: Parameters, c: Core, excess: float) -> float:
    """Inflate P for horizontal positions that are too far off, by half of the `excess` variance, m^2.

    The estimate or the receiver is wrong; each gets half of it, so that the next fix decides. The estimate may be wrong
    by a burst of velocity noise since the last fix used, which correlates velocity and position. Returns the
    other half, m^2, which is the fix's; 0: a burst does not explain that much.
    """
    dt = 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns)
    half = 0.5 * excess
    if c.alignment.mode != NAVIGATING or c.drift.detected or dt > p.tuning.burst_s:
        return 0.0
    if half > p.tuning.burst_psd * dt**3 / 3.0:
        return 0.0
    for i in range(2):
        add_variance(c, POSITION + i, half)
        add_covariance(c, POSITION + i, VELOCITY + i, 1.5 * half / dt)
        add_variance(c, VELOCITY + i, 3.0 * half / dt**2)
    return half


@kernel
def drift_is_plausible(p: Parameters, c: Core, fix: Fix) -> bool:
    """Whether the rejected positions may be those of a drifting receiver, where only the IMU supports the velocity.

    Not where the estimate is new, or was without fixes before: then the estimate is as likely to be wrong.
    """
    recent = c.integrity.outage_at_reject_s < p.tuning.fresh_fix_s
    return bool(not reports_velocity(p, fix) and all_onsets_open(c) and recent and is_as_far_as_a_drift(p, c, 0.0))


@kernel
def inertial_velocity_variance(p: Parameters, c: Core) -> float:
    """Variance, m^2/s^2, of an inertial velocity beyond that in P."""
    v2 = c.nav.v_n[0] ** 2 + c.nav.v_n[1] ** 2
    return float(p.tuning.inertial_velocity_error**2 + p.tuning.inertial_heading_error**2 * v2)


@kernel
def was_coasting(p: Parameters, c: Core, outage_s: float) -> bool:
    """Whether the filter navigated without fixes for long: the errors may have grown faster than stated."""
    return bool(c.alignment.mode == NAVIGATING and outage_s > p.tuning.coasting_s)


@kernel
def ends_outage(p: Parameters, c: Core) -> bool:
    """Whether the fix is the first one after an outage.

    Its velocity is fused first then: signals that are back show it at once, while the position may be off for seconds.
    """
    return bool(
        c.integrity.reject_count[HORIZONTAL] == 0 and was_coasting(p, c, 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns))
    )


@kernel
def state_rejection(p: Parameters, c: Core, supported: bool, outage_s: float, nis: float) -> None:
    """Store what the rejected position, of this NIS, says if the estimate is wrong instead of the receiver.

    That is the velocity error that explains it, and how far off it is: if rejected positions agree, one of the two
    places is wrong, the estimate's with a probability that grows with their share, or as they accelerate away. The
    first one counts, too, if few have been used before. After an outage the estimate is as likely to be wrong, with all
    errors that have grown since: the stated P is as much larger.
    """
    g = c.integrity
    most = 0.0 if supported else math.sqrt(inertial_velocity_variance(p, c))
    for i in range(2):
        g.rejected_velocity[i] = min(abs(bias_free_innovation(c, i)) / max(outage_s, 1e-3), most)
    if was_coasting(p, c, g.outage_at_reject_s):
        g.rejected_inflation = nis - 1.0
    agree = g.reject_count[HORIZONTAL] > 1 and g.inconsistent_count == 0
    share = reject_share(c) if agree else share_of_few(p, c)
    if g.divergence_count > 1 and not supported and not wheels_support(p, c):  # the first may be a jump
        part = min(g.divergence_count / p.tuning.min_divergence_count, 1.0)
        share = max(share, part)
        g.rejected_inflation = max(g.rejected_inflation, part * (diverging_inflation(p, c, nis) - 1.0))
    for i in range(2):
        g.rejected_position2[i] = share * bias_free_innovation(c, i) ** 2
    height = bias_free_innovation(c, 2)  # it is not tested with this position, so what was stated of it stays
    if math.isfinite(height) and share > 0.0:
        g.rejected_position2[2] = share * height * height


@kernel
def count_rejection(c: Core, outage_s: float) -> None:
    """Count a rejected position; the first one in a row begins what `consistent_for` and `is_lost` compare.

    outage_s: s, since the last position that was used.
    """
    g = c.integrity
    g.reject_count[HORIZONTAL] += 1
    if g.reject_count[HORIZONTAL] == 1:
        g.outage_at_reject_s = outage_s
        for i in range(2):
            g.first_offset[i] = bias_free_innovation(c, i)
        compare_from_now(c)


@kernel
def compare_from_now(c: Core) -> None:
    """From this rejected position on the following ones are compared with the velocity."""
    g = c.integrity
    g.inconsistent_count = 0
    g.reject_start_ns[HORIZONTAL] = c.nav.t_ns
    for i in range(2):
        g.reject_offset[i] = bias_free_innovation(c, i)
        g.reject_velocity[i] = c.nav.v_n[i]


@kernel
def clear_rejection(c: Core) -> None:
    """A position is used: no rejected one contradicts the estimate."""
    c.integrity.reject_count[HORIZONTAL] = 0
    c.integrity.rejected_inflation = 0.0
    for i in range(2):
        c.integrity.rejected_velocity[i] = 0.0
        c.integrity.rejected_position2[i] = 0.0


@kernel
def consistent_for(p: Parameters, c: Core, supported: bool) -> float:
    """Time, s, for which the rejected positions have been consistent with the velocity, within the errors of both.

    Call for each rejected fix. Of inconsistent positions in a row, further off than a receiver drifts, the first
    `outlier_count` may be outliers: 0 s at these; a further one restarts the time, as one that drifts does. supported:
    see `velocity_is_supported`.
    """
    g = c.integrity
    dt = 1e-9 * (c.nav.t_ns - g.reject_start_ns[HORIZONTAL])
    inertial2 = 0.0 if supported else inertial_velocity_variance(p, c)
    inconsistent, far2 = False, 0.0
    for i in range(2):
        bias2 = c.gnss.reported_sigma[HORIZONTAL] ** 2 * (1.0 - elementary.exp(-dt / p.tuning.gnss_bias_time_s))
        allowed = 2.0 * (bias2 + c.gnss.noise_var[HORIZONTAL]) + (variance(c, VELOCITY + i) + inertial2) * dt * dt
        allowed += variance(c, TIME_OFFSET) * (c.nav.v_n[i] - g.reject_velocity[i]) ** 2
        away2 = (bias_free_innovation(c, i) - g.reject_offset[i]) ** 2
        inconsistent, far2 = inconsistent or away2 > p.tuning.consistency_gate * allowed, far2 + away2
    far = inconsistent and far2 > (p.tuning.max_drift_speed * max(dt, p.tuning.chord_step_s)) ** 2
    g.inconsistent_count = g.inconsistent_count + 1 if far else 0
    if g.reject_count[HORIZONTAL] > 1 and 0 < g.inconsistent_count <= p.tuning.outlier_count:
        return 0.0
    if inconsistent:
        compare_from_now(c)
        return 0.0
    return float(dt)


@kernel
def is_lost(p: Parameters, c: Core) -> bool:
    """Whether rejected positions after an outage are further off, and move away faster, than a receiver can drift.

    One that has jumped, or is another one, moves as the estimate does; one that comes back from a jump approaches it.
    """
    g = c.integrity
    if not was_coasting(p, c, g.outage_at_reject_s) or is_as_far_as_a_drift(p, c, p.tuning.reset_s):
        return False
    since_first_s = 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) - g.outage_at_reject_s
    north, east = bias_free_innovation(c, 0) - g.first_offset[0], bias_free_innovation(c, 1) - g.first_offset[1]
    away = north * g.first_offset[0] + east * g.first_offset[1] > 0.0
    fast = elementary.hypot(north, east) > p.tuning.max_drift_speed * since_first_s
    return bool(since_first_s >= p.tuning.chord_step_s and away and fast)


@kernel
def must_reject(p: Parameters, c: Core, diverges: bool, outage_s: float) -> bool:
    """Whether it is too early to use a rejected position.

    A receiver with centimetre accuracy measures the phase of the carriers: it does not extrapolate. Before the heading
    is known the estimate is no more than the positions used: when more have been rejected since, these are likelier.
    """
    outnumbered = c.integrity.reject_count[HORIZONTAL] > c.integrity.position_uses + 1.0
    if c.alignment.mode == COARSE_ALIGNMENT and outnumbered and outage_s > 0.0:
        return False
    if diverges and c.gnss.reported_sigma[HORIZONTAL] < p.tuning.survey_sigma:
        return False
    if is_lost(p, c):
        return c.integrity.reject_count[HORIZONTAL] < p.tuning.lost_position_count
    few = c.integrity.reject_count[HORIZONTAL] <= p.tuning.reset_count and not diverges
    return bool(few or outage_s <= p.tuning.reset_s or c.integrity.inconsistent_count == 1)


@kernel
def gate_position(p: Parameters, c: Core, fix: Fix, nis: float) -> bool:
    """Whether the horizontal position, of this NIS, is accepted; after long rejection the filter is reset to it."""
    g = c.integrity
    outage_s = 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns)
    if wheels_reject(p, c) and is_as_far_as_a_drift(p, c, p.tuning.reset_s):
        count_rejection(c, outage_s)
        return False
    if nis < (p.tuning.gnss_return_gate if c.drift.detected else p.tuning.gnss_position_gate):
        if g.reject_count[HORIZONTAL] > p.tuning.reset_count and outage_s > p.tuning.fresh_fix_s:
            reset_time_offset_step(c)  # positions that agree again by themselves had right stamps
        clear_detection(c)
        clear_rejection(c)
        if was_coasting(p, c, outage_s):
            reset_drift(c)
            inflate_after_outage(p, c, nis)
        return True
    count_rejection(c, outage_s)
    supported = velocity_is_supported(p, c, fix)
    consistent_s = consistent_for(p, c, supported)
    measure_divergence(p, c)
    diverges = estimate_diverges(p, c) and not supported
    state_rejection(p, c, supported, outage_s, nis)
    either = c.drift.detected == BY_POSITIONS and estimate_may_be_wrong(p, c)
    if either:
        state_detected_drift(c)
    if must_reject(p, c, diverges, outage_s):
        return False
    consistent = consistent_s > (p.tuning.drift_reset_s if c.drift.detected else p.tuning.reset_s)
    drifts = c.drift.detected != 0 and wheels_support(p, c)
    longest_s = p.tuning.wheel_max_reject_s if drifts else p.tuning.max_reject_s
    if (supported or (drift_is_plausible(p, c, fix) and not diverges)) and not consistent and outage_s < longest_s:
        return False
    if diverges and diverging_inflation(p, c, nis) > 1.0:
        inflate_to_diverging(p, c, nis)
    elif not supported and was_coasting(p, c, g.outage_at_reject_s) and nis < p.tuning.max_inflation:
        inflate_to_fix(c, nis)
    elif not supported and is_lost(p, c):
        lose_attitude(p, c)
    else:
        reset_to_gnss(p, c, 0, 2, supported, consistent_s)
        count_reset(c, supported)
    if either:
        allow_for_wrong_velocity(c)
    reset_glr_tests(c)
    clear_rejection(c)
    return True


@kernel
def state_rejected_height(p: Parameters, c: Core, share: float) -> None:
    """Store how far off the rejected height is; share: of the last heights that were rejected.

    The first of those in a row may be an outlier, but not one of few.
    """
    g, z = c.integrity, c.scratch.position_innovation[2]
    is_outlier = g.reject_count[VERTICAL] == 1 and p.tuning.max_reject_share * (g.height_uses + 1.0) >= 1.0
    if not is_outlier:
        g.rejected_position2[2] = share * z * z


@kernel
def accept_height(c: Core, share: float) -> None:
    """A height is used. After rejected ones, it or they may be wrong."""
    g, z = c.integrity, c.scratch.position_innovation[2]
    if g.reject_count[VERTICAL] > 0:
        inflate_position_to(c, 2, share * z * z)
    g.reject_count[VERTICAL] = 0
    g.rejected_position2[2] = 0.0


@kernel
def gate_height(p: Parameters, c: Core, nis: float) -> bool:
    """Whether the fix has a height and it is accepted; after long rejection the filter is reset to it."""
    g = c.integrity
    if not math.isfinite(c.scratch.position_innovation[2]):
        g.reject_count[VERTICAL] = 0
        g.rejected_position2[2] = 0.0
        return False
    accepted = nis < p.tuning.gnss_position_gate
    share = count_height(p, c, accepted)
    if accepted:
        accept_height(c, share)
        return True
    g.reject_count[VERTICAL] += 1
    state_rejected_height(p, c, share)
    if g.reject_count[VERTICAL] == 1:
        g.reject_start_ns[VERTICAL] = c.nav.t_ns
    if (
        g.reject_count[VERTICAL] <= p.tuning.reset_count
        or 1e-9 * (c.nav.t_ns - g.reject_start_ns[VERTICAL]) <= p.tuning.reset_s
    ):
        return False
    reset_to_gnss(p, c, 2, 3, c.stationarity.at_rest != 0, 0.0)
    accept_height(c, share)
    return True


@kernel
def set_rejecting(c: Core) -> None:
    """Store whether the last fix was rejected, in its horizontal position or its height."""
    c.integrity.rejecting = (
        1 if c.integrity.reject_count[HORIZONTAL] > 0 or c.integrity.reject_count[VERTICAL] > 0 else 0
    )


@kernel
def reject_frozen(c: Core) -> None:
    """Mark the fix of a frozen receiver as rejected."""
    c.integrity.rejecting = 1
