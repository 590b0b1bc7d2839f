"""Do the wheels contradict the receiver? Only they show a receiver that drifts, and says so in its velocity, too.

Wheels measure the velocity along the direction of travel, independently of the receiver. Where the receiver's velocity
contradicts the estimate at several fixes, there are two explanations: the receiver drifts, by a constant velocity in
NED (2 unknowns); or the heading is wrong, which rotates the vehicle's velocity (1 unknown). Least squares decide for
the one with the smaller residual. On a straight road a drift across the direction of travel has equal residuals in
both, and after some more fixes the rules without wheels apply. A receiver that drifts is rejected, positions and
velocities, until its velocity agrees with the wheels and refutes the drift; across the direction of travel of a vehicle
whose heading has become uncertain it may agree with both. The position stays as uncertain as the drift has made it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_variance, innovation_variance, set_jacobian
from ..integrity.gnss_drift import BY_WHEELS, clear_detection, declare_drift
from ..state import NAVIGATING, NEVER_NS, POSITION, TIME_OFFSET, VELOCITY, VELOCITY_TIME_OFFSET

if TYPE_CHECKING:
    from ..types import Core, Parameters

RECENT_CONTRADICTION = 0.5  # of the count: one contradiction, and at most one agreement since
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
        "Number of contradictions by which drift and wrong heading are told apart; an agreement halves it.",
        "Choice.",
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
    Tunable(
        "wheel_max_reject_s", 600.0, "s", "Longest rejection of fixes while wheels support the velocity.", "Choice."
    ),
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
    return bool(wheels_reject(p, c) or (wheels_support(p, c) and c.wheel_check.count >= RECENT_CONTRADICTION))


@kernel
def contradicts(p: Parameters, c: Core, axis: int, z: float, accel: float, r: float) -> bool:
    """Whether the velocity along an axis contradicts the estimate. z: innovation, m/s; accel: m/s^2; r: variance."""
    length = set_jacobian(c, 0, VELOCITY + axis, 1.0)
    length = set_jacobian(c, length, TIME_OFFSET, -accel)
    length = set_jacobian(c, length, VELOCITY_TIME_OFFSET, -accel)
    return bool(
        abs(z) > p.tuning.wheel_min_contradiction
        and z * z > p.tuning.wheel_check_gate * (innovation_variance(c, length) + r)
    )


@kernel
def check_receiver(p: Parameters, c: Core, z_n: float, z_e: float, accel_n: float, accel_e: float, r: float) -> None:
    """Test the velocity of a fix before it is fused. z: its innovation, m/s; accel: m/s^2; r: variance."""
    if not wheels_support(p, c) or c.alignment.mode != NAVIGATING or not math.isfinite(z_n + z_e):
        return
    wrong = contradicts(p, c, 0, z_n, accel_n, r) or contradicts(p, c, 1, z_e, accel_e, r)
    if c.drift.detected == BY_WHEELS:
        g = c.wheel_check
        refuted = contradicts(p, c, 0, z_n - g.drift[0], accel_n, r) or contradicts(
            p, c, 1, z_e - g.drift[1], accel_e, r
        )
        count_agreement(c, wrong, refuted)
        if c.wheel_check.agreements >= p.tuning.wheel_agreements:
            clear_detection(c)
    elif elementary.hypot(c.nav.v_n[0], c.nav.v_n[1]) > p.tuning.wheel_check_speed:
        sum_contradictions(c, z_n, z_e, wrong)
        speed = drift_speed(p, c, 2.0 * r)
        if speed > 0.0:
            since_s = 1e-9 * (c.nav.t_ns - c.wheel_check.onset_ns)
            for i in range(2):
                add_variance(c, POSITION + i, (speed * since_s) ** 2)
            c.wheel_check.drift[0] = c.wheel_check.z_n / c.wheel_check.count
            c.wheel_check.drift[1] = c.wheel_check.z_e / c.wheel_check.count
            declare_drift(c, BY_WHEELS)
            clear_wheel_contradictions(c)


@kernel
def count_agreement(c: Core, wrong: bool, refuted: bool) -> None:
    """Count fixes that refute the drift, since the last that contradicts the wheels; one may do neither."""
    if wrong:
        c.wheel_check.agreements = 0
    elif refuted:
        c.wheel_check.agreements += 1


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
def drift_speed(p: Parameters, c: Core, r: float) -> float:
    """Speed of the drift, m/s, if the contradictions are those of one and not of a wrong heading; else 0.

    r: variance of an innovation, (m/s)^2.
    """
    g = c.wheel_check
    if g.count < p.tuning.wheel_contradictions:
        return 0.0
    of_drift = g.z2 - (g.z_n**2 + g.z_e**2) / g.count
    of_heading = g.z2 - g.cross_sum**2 / g.v2
    if of_heading - of_drift < p.tuning.wheel_evidence * r:
        return 0.0
    return elementary.hypot(g.z_n, g.z_e) / g.count
