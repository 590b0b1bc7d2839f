"""Do the wheels contradict the receiver? Only they show a receiver that drifts, and says so in its velocity, too.

Wheels measure the velocity along the direction of travel, independently of the receiver. Where the receiver's velocity
contradicts the estimate at several fixes, there are two explanations: the receiver drifts, by a constant velocity in
NED (2 unknowns); or the heading is wrong, which rotates the vehicle's velocity (1 unknown). Least squares decide for
the one with the smaller residual. On a straight road a drift across the direction of travel has equal residuals in
both: there `glr_tests.velocity_drift` decides by what is known of the heading. A receiver that drifts is rejected,
positions and velocities, until its velocities refute the drift; across the direction of travel of a vehicle whose
heading has become uncertain they may agree with both. If meanwhile a wrong heading explains them better than any drift,
the detection was wrong: it ends, and the heading is as uncertain as that. The position stays as uncertain as the drift
has made it. No drift is found by single velocities before fixes have agreed, since a new estimate may be what is wrong.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_variance, innovation_variance, set_jacobian
from ..glr_tests.compass_offset import is_unconfirmed
from ..glr_tests.gnss_drift import BY_WHEELS, clear_detection, declare_drift
from ..glr_tests.velocity_drift import (
    count_confirmation,
    remove_most_likely_drift,
    renew_contradicted_onset,
    reset_confirmations,
    reset_velocity_drift,
    store_drift,
)
from ..state import ATTITUDE, NAVIGATING, NEVER_NS, POSITION, TIME_OFFSET, VELOCITY, VELOCITY_TIME_OFFSET

if TYPE_CHECKING:
    from ..types import Core, Parameters

TUNABLES = (
    Tunable(
        "wheel_fresh_s", 10.0, "s", "Age of the last used reading up to which wheels support the velocity.", "Slips."
    ),
    Tunable(
        "wheel_check_speed", 2.0, "m/s", "Least speed at which the receiver is compared with the wheels.", "Choice."
    ),
    Tunable(
        "wheel_check_gate",
        9.0,
        "NIS",
        "Gate of a GNSS velocity beyond which it contradicts the wheels.",
        "Three sigma.",
    ),
    Tunable(
        "wheel_min_contradiction",
        0.3,
        "m/s",
        "Least difference of a GNSS velocity that contradicts the wheels.",
        "The scale factor's error at 60 km/h.",
    ),
    Tunable(
        "wheel_contradictions",
        3.5,
        "fixes",
        "Number of contradictions by which drift and wrong heading are distinguished; an agreement halves it.",
        "Choice.",
    ),
    Tunable(
        "wheel_open_count",
        0.5,
        "fixes",
        "Number of contradictions from which either may be wrong.",
        "One, and at most one agreement since.",
    ),
    Tunable(
        "wheel_evidence",
        25.0,
        "",
        "Difference of the squared residuals of wrong heading and drift, over the variance, that proves a drift.",
        "Five sigma.",
    ),
    Tunable(
        "wheel_reject_factor",
        3.0,
        "",
        "Factor of max_velocity_rejects where wheels support the velocity.",
        "A turn comes meanwhile.",
    ),
    Tunable("wheel_agreements", 10, "fixes", "So many fixes that refute a drift end it.", "Choice."),
    Tunable("wheel_max_reject_s", 600.0, "s", "Longest rejection of a receiver that drifts beside wheels.", "Choice."),
)


@kernel
def wheels_support(p: Parameters, c: Core) -> bool:
    """Whether a reading of the odometer was used lately."""
    last_ns = c.odometer.last_used_ns
    return bool(last_ns != NEVER_NS and 1e-9 * (c.nav.t_ns - last_ns) < p.tuning.wheel_fresh_s)


@kernel
def wheels_reject(p: Parameters, c: Core) -> bool:
    """Whether the receiver drifts by the wheels, so that its fixes are of no use."""
    if c.drift.detected != BY_WHEELS or c.alignment.mode != NAVIGATING:
        return False
    outage_s = 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns)
    return bool(wheels_support(p, c) and outage_s < p.tuning.wheel_max_reject_s)


@kernel
def wheels_contradict(p: Parameters, c: Core) -> bool:
    """Whether the receiver drifts by the wheels, or one of its last velocities contradicts them."""
    return bool(wheels_reject(p, c) or (wheels_support(p, c) and c.wheel_check.count >= p.tuning.wheel_open_count))


@kernel
def velocity_innovation_variance(c: Core, axis: int, accel: float, r: float) -> float:
    """Variance, (m/s)^2, of the innovation of a velocity along an axis; arguments: see `contradicts`."""
    length = set_jacobian(c, 0, VELOCITY + axis, 1.0)
    length = set_jacobian(c, length, TIME_OFFSET, -accel)
    length = set_jacobian(c, length, VELOCITY_TIME_OFFSET, -accel)
    return innovation_variance(c, length) + r


@kernel
def contradicts(p: Parameters, c: Core, axis: int, z: float, accel: float, r: float) -> bool:
    """Whether the velocity along an axis contradicts the estimate. z: innovation, m/s; accel: m/s^2; r: variance."""
    variance = velocity_innovation_variance(c, axis, accel, r)
    return bool(abs(z) > p.tuning.wheel_min_contradiction and z * z > p.tuning.wheel_check_gate * variance)


@kernel
def check_receiver(p: Parameters, c: Core, z_n: float, z_e: float, accel_n: float, accel_e: float, r: float) -> None:
    """Test the velocity of a fix before it is fused. z: its innovation, m/s; accel: m/s^2; r: variance."""
    if not wheels_support(p, c) or c.alignment.mode != NAVIGATING or not math.isfinite(z_n + z_e):
        return
    wrong = contradicts(p, c, 0, z_n, accel_n, r) or contradicts(p, c, 1, z_e, accel_e, r)
    separate_sums(c)
    if c.drift.detected == BY_WHEELS:
        d = c.velocity_drift.drift
        ratio = log_ratio(c, 0, z_n, d[0], accel_n, r) + log_ratio(c, 1, z_e, d[1], accel_e, r)
        count_agreement(c, wrong, 2.0 * ratio > p.tuning.wheel_check_gate)
        fade_contradictions(p, c)
        sum_contradictions(c, z_n, z_e, True)
        heading_error = heading_instead(p, c, 2.0 * r)
        if c.wheel_check.agreements >= p.tuning.wheel_agreements:
            clear_detection(c)
        elif heading_error > 0.0:
            add_variance(c, ATTITUDE + 2, heading_error * heading_error)
            clear_detection(c)
            reset_confirmations(c)
        return
    s_n, s_e = velocity_innovation_variance(c, 0, accel_n, r), velocity_innovation_variance(c, 1, accel_e, r)
    renew_contradicted_onset(p, c, (z_n, z_e), (s_n, s_e))
    turned = p.tuning.unconfirmed_heading_sigma
    would_show = contradicts(p, c, 0, turned * c.nav.v_n[1], accel_n, r)
    if would_show or contradicts(p, c, 1, turned * c.nav.v_n[0], accel_e, r):
        count_confirmation(p, c, not wrong)
    if elementary.hypot(c.nav.v_n[0], c.nav.v_n[1]) > p.tuning.wheel_check_speed:
        sum_contradictions(c, z_n, z_e, wrong)
        speed = drift_speed(p, c, 2.0 * r)
        confirmed = c.velocity_drift.confirmations >= p.tuning.heading_confirmations
        if speed > 0.0 and confirmed and not is_unconfirmed(c):
            since_s = 1e-9 * (c.nav.t_ns - c.wheel_check.onset_ns)
            for i in range(2):
                add_variance(c, POSITION + i, (speed * since_s) ** 2)
            remove_most_likely_drift(p, c)
            store_drift(c, c.wheel_check.z_n / c.wheel_check.count, c.wheel_check.z_e / c.wheel_check.count)
            reject_by_wheels(c)


@kernel
def reject_by_wheels(c: Core) -> None:
    """The receiver drifts, by the velocity in `velocity_drift`: from now on its fixes are rejected."""
    declare_drift(c, BY_WHEELS)
    reset_velocity_drift(c)
    clear_wheel_contradictions(c)


@kernel
def separate_sums(c: Core) -> None:
    """Begin the sums anew after a detection has ended, here or elsewhere: they are those of a receiver that drifted."""
    rejecting = 1 if c.drift.detected == BY_WHEELS else 0
    if rejecting < c.wheel_check.rejecting:
        clear_wheel_contradictions(c)
    c.wheel_check.rejecting = rejecting


@kernel
def count_agreement(c: Core, wrong: bool, refuted: bool) -> None:
    """Count fixes that refute the drift, since the last that contradicts the wheels; one may do neither."""
    if wrong:
        c.wheel_check.agreements = 0
    elif refuted:
        c.wheel_check.agreements += 1


@kernel
def log_ratio(c: Core, axis: int, z: float, drift: float, accel: float, r: float) -> float:
    """Log likelihood ratio of no drift to `drift`, m/s, along an axis; arguments: see `contradicts`."""
    return float(0.5 * ((z - drift) ** 2 - z * z) / velocity_innovation_variance(c, axis, accel, r))


@kernel
def clear_wheel_contradictions(c: Core) -> None:
    """Set the sums and counts to zero."""
    g = c.wheel_check
    g.count, g.z_n, g.z_e, g.z2, g.cross_sum, g.v2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    g.agreements = 0


@kernel
def sum_contradictions(c: Core, z_n: float, z_e: float, wrong: bool) -> None:
    """Add a contradiction to the sums of the two explanations; an agreement halves them."""
    g = c.wheel_check
    if not wrong:
        g.count, g.z_n, g.z_e, g.z2 = 0.5 * g.count, 0.5 * g.z_n, 0.5 * g.z_e, 0.5 * g.z2
        g.cross_sum, g.v2 = 0.5 * g.cross_sum, 0.5 * g.v2
        return
    v_n, v_e = c.nav.v_n[0], c.nav.v_n[1]
    if g.count < 0.5:
        g.onset_ns = c.nav.t_ns
    g.count += 1.0
    g.z_n += z_n
    g.z_e += z_e
    g.z2 += z_n * z_n + z_e * z_e
    g.cross_sum += z_e * v_n - z_n * v_e
    g.v2 += v_n * v_n + v_e * v_e


@kernel
def fade_contradictions(p: Parameters, c: Core) -> None:
    """The sums forget what is older than some `wheel_agreements` fixes."""
    g, keep = c.wheel_check, 1.0 - 1.0 / p.tuning.wheel_agreements
    g.count, g.z_n, g.z_e, g.z2 = keep * g.count, keep * g.z_n, keep * g.z_e, keep * g.z2
    g.cross_sum, g.v2 = keep * g.cross_sum, keep * g.v2


@kernel
def heading_instead(p: Parameters, c: Core, r: float) -> float:
    """Size of the heading error, rad, if that explains the contradictions and a drift does not; else 0; r: as below."""
    g = c.wheel_check
    if g.count < p.tuning.wheel_contradictions or not g.v2 > 0.0:
        return 0.0
    of_drift = g.z2 - (g.z_n**2 + g.z_e**2) / g.count
    of_heading = g.z2 - g.cross_sum**2 / g.v2
    return abs(g.cross_sum) / g.v2 if of_drift - of_heading > p.tuning.wheel_evidence * r else 0.0


@kernel
def drift_speed(p: Parameters, c: Core, r: float) -> float:
    """Speed of the drift, m/s, if the contradictions are those of one and not of a wrong heading; else 0.

    r: variance of an innovation, (m/s)^2.
    """
    g = c.wheel_check
    if g.count < p.tuning.wheel_contradictions:
        return 0.0
    of_drift = g.z2 - (g.z_n**2 + g.z_e**2) / g.count
    of_heading = g.z2 - g.cross_sum**2 / g.v2
    speed = elementary.hypot(g.z_n, g.z_e) / g.count
    return speed if of_heading - of_drift > p.tuning.wheel_evidence * r and speed < p.tuning.max_drift_speed else 0.0
