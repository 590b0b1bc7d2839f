"""The solution: one row of outputs from the core."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import euler_variances
from ..records import (
    AT_REST,
    ATTITUDE_VALID,
    COASTING,
    HEADING_VALID,
    HEIGHT_VALID,
    POSITION_VALID,
    REJECTING,
    SATURATED,
)
from ..tuning import Tunable
from .ekf import covariance, variance
from .integrity.alternating_receiver import is_alternating
from .state import (
    ACCEL_BIAS,
    ATTITUDE,
    GNSS_LEVER_ARM,
    GYRO_BIAS,
    NAVIGATING,
    NEVER_NS,
    POSITION,
    STATED,
    TIME_OFFSET,
    VELOCITY,
)

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from ..types import Solution
    from .types import Core, Parameters


TUNABLES = (
    Tunable(
        "coasting_s",
        5.0,
        "s",
        "Time without a fix after which COASTING is set.",
        "A slow line brings 1 Hz fixes 2 s apart.",
    ),
    Tunable(
        "max_valid_tilt_sigma", math.radians(10.0), "rad", "Tilt sigma up to which ATTITUDE_VALID is set.", "Choice."
    ),
    Tunable(
        "contradicted_heading_pairs",
        2,
        "pairs",
        "So many pairs of fixes in a row that contradict the heading withdraw HEADING_VALID.",
        "One may be chance.",
    ),
    Tunable(
        "max_valid_heading_sigma",
        math.radians(30.0),
        "rad",
        "Heading sigma up to which HEADING_VALID is set.",
        "Choice.",
    ),
)


@kernel
def status_bits(p: Parameters, c: Core, sigma_rpy: Reals, sigma_down: float) -> int:
    """The status bits of the solution.

    The first height that is measured brings its sigma far below half of that of an unknown height. Nothing is valid
    whose variances are negative or not numbers.
    """
    bits, estimated = 0, True
    for i in range(3):
        estimated = estimated and variance(c, POSITION + i) >= 0.0 and variance(c, ATTITUDE + i) >= 0.0
    if c.stationarity.at_rest:
        bits |= AT_REST
    if c.integrity.rejecting:
        bits |= REJECTING
    if c.imu.saturated:
        bits |= SATURATED
    if estimated and max(sigma_rpy[0], sigma_rpy[1]) < p.tuning.max_valid_tilt_sigma:
        bits |= ATTITUDE_VALID
    known = estimated and (c.alignment.mode == NAVIGATING or c.alignment.heading_sigma > 0.0)
    contradicted = c.alignment.heading_fault_count >= p.tuning.contradicted_heading_pairs
    contradicted |= c.integrity.velocity_reject_count > 1
    if known and not contradicted and sigma_rpy[2] < p.tuning.max_valid_heading_sigma:
        bits |= HEADING_VALID
    if c.gnss.fix_count > 0:
        position_known = estimated and not is_alternating(p, c)
        if position_known:
            bits |= POSITION_VALID
        if position_known and sigma_down < 0.5 * p.tuning.unknown_height:
            bits |= HEIGHT_VALID
        if c.nav.t_ns - max(c.gnss.last_used_ns, c.pose.last_used_ns) > 1e9 * p.tuning.coasting_s:
            bits |= COASTING
    return bits


@kernel
def likely_drift(c: Core, axis: int) -> tuple[float, float]:
    """What likely drifts of the receiver add to the stated variances of an axis, m^2 and m^2/s^2."""
    if axis == 2:
        return 0.0, 0.0
    d, w = c.drift, c.velocity_drift
    of_velocity = w.velocity_variance[axis] + d.velocity_variance[axis] + c.integrity.velocity_inflation[axis]
    return float(w.position_variance[axis] + d.position_variance[axis]), float(of_velocity)


@kernel
def unknown_time_offset(c: Core, axis: int) -> float:
    """What an unknown time offset adds to the stated variance of a position, m^2, during coarse alignment.

    Then the position is that of the epoch of the fixes; while navigating P has this part.
    """
    if c.alignment.mode == NAVIGATING or c.gnss.last_used_ns == NEVER_NS:
        return 0.0
    return float(max(variance(c, TIME_OFFSET), c.scratch.fix_age_error2) * c.nav.v_n[axis] ** 2)


@kernel
def rejected_position(c: Core, axis: int) -> tuple[float, float]:
    """What rejected positions add to the stated variances of an axis, m^2 and m^2/s^2: the estimate may be wrong."""
    if axis == 2:
        return float(c.integrity.rejected_position2[2]), 0.0
    v, t = c.integrity.rejected_velocity[axis], 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns)
    return float((v * t) ** 2 + c.integrity.rejected_position2[axis]), float(v * v)


@kernel
def open_discrepancy(p: Parameters, c: Core, axis: int) -> tuple[float, float]:
    """What a receiver whose velocity and positions contradict each other adds to the stated variances of an axis.

    Either of them may be wrong: m^2 and m^2/s^2.
    """
    if axis == 2 or c.scratch.discrepancy2[axis] == 0.0:
        return 0.0, 0.0
    since_s = min(1e-9 * (c.nav.t_ns - c.scratch.discrepancy_onset_ns), p.tuning.max_reject_s)
    return float(c.scratch.discrepancy2[axis] * since_s**2), float(c.scratch.discrepancy2[axis])


@kernel
def added_by_lever_arm(c: Core, i: int) -> float:
    """What a lever arm that may be wrong adds to the stated variance of an error state."""
    added = 0.0
    for k in range(3):
        inflation = c.gnss.lever_arm_inflation[k]
        if inflation > 0.0:
            added += inflation * (covariance(c, i, GNSS_LEVER_ARM + k) / variance(c, GNSS_LEVER_ARM + k)) ** 2
    return added


@kernel
def added_by_time_offset(c: Core, i: int) -> float:
    """What a time offset that is less known than P says adds to the stated variance of an error state."""
    missing = c.time_evidence.missing_variance
    return float(missing * (covariance(c, i, TIME_OFFSET) / variance(c, TIME_OFFSET)) ** 2) if missing > 0.0 else 0.0


@kernel
def state_variances(p: Parameters, c: Core) -> None:
    """scratch.stated_variances <- those of P and what is beyond it, of position, velocity, attitude and biases.

    scratch.stated_sigmas <- their square roots, where any but the attitude's has changed: P does not with each sample.
    Those of roll, pitch and yaw are `write_solution`'s.
    """
    stated, inflation = c.scratch.stated_variances, 1.0 + c.integrity.rejected_inflation
    changed = False
    for i in range(3):
        added_p, added_v = likely_drift(c, i)
        rejected_p, rejected_v = rejected_position(c, i)
        added_v += rejected_v
        open_p, open_v = open_discrepancy(p, c, i)  # the same error as of a likely drift
        added_v = max(added_v, open_v)
        added_p = max(added_p, open_p)
        added_p += rejected_p + c.integrity.position_inflation[i] + unknown_time_offset(c, i)
        added_p += c.time_evidence.missing_variance * c.nav.v_n[i] ** 2
        added_v += c.time_evidence.missing_variance * c.imu.accel_n[i] ** 2
        added_p += added_by_lever_arm(c, POSITION + i)
        added_v += added_by_lever_arm(c, VELOCITY + i)
        p2 = inflation * max(variance(c, POSITION + i), 0.0) + added_p
        v2 = inflation * max(variance(c, VELOCITY + i), 0.0) + added_v
        bg, ba = max(variance(c, GYRO_BIAS + i), 0.0), max(variance(c, ACCEL_BIAS + i), 0.0)
        changed |= (p2 != stated[POSITION + i]) | (v2 != stated[VELOCITY + i])
        changed |= (bg != stated[GYRO_BIAS + i]) | (ba != stated[ACCEL_BIAS + i])
        stated[POSITION + i], stated[VELOCITY + i], stated[GYRO_BIAS + i], stated[ACCEL_BIAS + i] = p2, v2, bg, ba
        stated[ATTITUDE + i] = inflation * variance(c, ATTITUDE + i) + added_by_time_offset(c, ATTITUDE + i)
        stated[ATTITUDE + i] += c.imu_bias_step.attitude_variance[i]
    stated[ATTITUDE + 2] += (
        c.gyro_bias_step.heading_variance
        + c.velocity_drift.heading_variance
        + c.compass_offset.heading_variance
        + c.current.heading_variance
        + c.rest_gap.turn2
        + c.stationarity.contradicting_turn2
        + added_by_lever_arm(c, ATTITUDE + 2)
    )
    if changed:
        for i in range(STATED):
            c.scratch.stated_sigmas[i] = math.sqrt(max(stated[i], 0.0))


@kernel
def write_solution(p: Parameters, c: Core, o: Solution) -> None:
    """Write the solution to row o; values that are not known are NaN."""
    o.t_ns = c.nav.t_ns
    known = c.gnss.fix_count > 0
    o.lat = c.nav.lat if known else math.nan
    o.lon = c.nav.lon if known else math.nan
    o.height = c.nav.height if known else math.nan
    for i in range(4):
        o.q_nb[i] = c.nav.q_nb[i]
    for i in range(3):
        o.v[i] = c.nav.v_n[i] if known else math.nan
        o.w[i] = c.imu.w[i] - c.nav.bg[i] - c.imu.scale_error_rate[i]
        o.f[i] = c.imu.f[i] - c.nav.ba[i]
        o.bg[i] = c.nav.bg[i]
        o.ba[i] = c.nav.ba[i]
    state_variances(p, c)
    sigmas, stated = c.scratch.stated_sigmas, c.scratch.stated_variances
    for i in range(3):
        o.sigma_p[i] = sigmas[POSITION + i] if known else math.nan
        o.sigma_v[i] = sigmas[VELOCITY + i] if known else math.nan
        o.sigma_bg[i], o.sigma_ba[i] = sigmas[GYRO_BIAS + i], sigmas[ACCEL_BIAS + i]
    a, inflation = ATTITUDE, 1.0 + c.integrity.rejected_inflation
    rpy = euler_variances(
        (c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]),
        stated[a],
        inflation * covariance(c, a, a + 1),
        inflation * covariance(c, a, a + 2),
        stated[a + 1],
        inflation * covariance(c, a + 1, a + 2),
        stated[a + 2],
    )
    for i in range(3):
        o.sigma_rpy[i] = math.sqrt(max(rpy[i], 0.0))
    o.status = status_bits(p, c, o.sigma_rpy, o.sigma_p[2])
