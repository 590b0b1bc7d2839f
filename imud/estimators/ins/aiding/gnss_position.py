"""The GNSS position: innovation, Jacobian and gate, axis by axis; the height has a gate of its own.

z = p_fix - p - C_nb lever_arm - gnss_bias + v_antenna age, in m, NED; `age`: by which the position was true before the
core's time, s, whose error is that of the time offset; v_antenna = v + C_nb (w x lever_arm).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.earth import radii
from ....math.rotation import Vector, wrap_angle
from ...records import POSITION_N
from ...tuning import Tunable
from ..ekf import innovation_variance, set_jacobian, set_jacobian3, variance
from ..fusion import NO_GATE, REJECT, correct_state, fix_update, write_innovation
from ..glr_tests.gnss_drift import detect_drift
from ..integrity.alternating_receiver import count_position, reject_share
from ..integrity.position_jump import state_likely_jump
from ..lever_arm import antenna_position, arm_position_row, attitude_row, velocity_of_point
from ..mechanization import bounded_cosine
from ..state import (
    ATTITUDE,
    GNSS_BIAS,
    GNSS_LEVER_ARM,
    HORIZONTAL,
    NAVIGATING,
    OTHER_AXIS,
    POSITION,
    POSITION_AXIS,
    TIME_OFFSET,
    VELOCITY,
)
from .gnss_gate import estimate_may_be_wrong, gate_height, gate_position, set_rejecting, split_excess
from .gnss_noise import (
    learn_position_noise,
    limit_position_confidence,
    mark_used,
    second_order_error,
)
from .gnss_reset import allow_for_drift
from .gnss_time import confirm_survey_epochs

if TYPE_CHECKING:
    from ....math.arrays import Reals
    from ...types import Fix, Innovation
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "bias_free_gate",
        20.0,
        "NIS",
        "Gate of a position innovation without the estimated GNSS bias.",
        "A bias drifts, it does not jump.",
    ),
    Tunable(
        "offset_velocity_gate",
        9.0,
        "",
        "Square of a change of velocity over its variance from which it shows the time offset.",
        "Three sigma.",
    ),
    Tunable(
        "ended_drift_share",
        0.5,
        "",
        "Error of a drift of the positions that has ended, as a share of it.",
        "Its rate and its onset are found late.",
        high=1.0,
    ),
    Tunable("late_fix_accel", 1.0, "m/s^2", "Acceleration assumed from a fix to its fusion.", "Choice."),
)


@kernel
def position_offset(c: Core, fix: Fix, out: Reals) -> None:
    """out (3) <- position of the fix minus the estimate, m, NED; down is NaN without a height."""
    meridian, prime_vertical = radii(c.nav.lat)
    out[0] = (fix.lat - c.nav.lat) * (meridian + c.nav.height)
    out[1] = wrap_angle(fix.lon - c.nav.lon) * (prime_vertical + c.nav.height) * bounded_cosine(c.nav.lat)
    out[2] = -(fix.height - c.nav.height)


@kernel
def position_jacobian(c: Core, lever: Vector, i: int) -> int:
    """Jacobian of the position along axis i: position, attitude, GNSS bias, time offset; returns its length.

    lever: lever arm, m, NED.
    """
    length = set_jacobian(c, 0, POSITION + i, 1.0)
    length = set_jacobian3(c, length, ATTITUDE, attitude_row(lever, i))
    length = set_jacobian(c, length, GNSS_BIAS + i, 1.0)
    if c.alignment.mode != NAVIGATING:
        return length
    length = set_jacobian3(c, length, GNSS_LEVER_ARM, arm_position_row(c, i))
    return set_jacobian(c, length, TIME_OFFSET, -c.gnss.offset_velocity[i])


@kernel
def hold_offset_velocity(p: Parameters, c: Core, velocity: Vector) -> float:
    """Hold the velocity by which the time offset shifts a position until it has changed; returns what that may cost.

    The velocity's error belongs to that of the position. If it were in the Jacobian, the position's innovations would
    be correlated with its Jacobian, and give a wrong time offset that is certain (errors in variables). So only changes
    beyond the sigma count: an acceleration shows a time offset. velocity: the antenna's, m/s, NED. Returns m^2.
    """
    held, missed = c.gnss.offset_velocity, 0.0
    for i in range(3):
        change = velocity[i] - held[i]
        if change * change > p.tuning.offset_velocity_gate * variance(c, VELOCITY + i):
            held[i] = velocity[i]
        else:
            missed += change * change
    return missed * variance(c, TIME_OFFSET)


@kernel
def max_nis(p: Parameters, c: Core, lever: Vector, extra: float, first: int, last: int) -> float:
    """Largest NIS of axes first to last - 1, with and without the GNSS bias, on the scale of gnss_position_gate.

    extra: m^2, variance of each axis beyond the receiver's white noise. The NIS without the bias rejects positions that
    only a diverged bias state explains.
    """
    largest, z = 0.0, c.scratch.position_innovation
    for i in range(first, last):
        r = c.gnss.noise_var[i // 2] + extra
        s = innovation_variance(c, position_jacobian(c, lever, i)) + r
        without_bias = variance(c, POSITION + i) + c.gnss.reported_sigma[i // 2] ** 2 + r
        nis = (z[i] + c.nav.gnss_bias[i]) ** 2 / without_bias
        largest = max(largest, z[i] ** 2 / s, nis * (p.tuning.gnss_position_gate / p.tuning.bias_free_gate))
    return largest


@kernel
def position_variances(c: Core, lever: Vector, extra: float) -> tuple[float, float]:
    """Variances, m^2, of the innovations north and east; arguments: see `max_nis`."""
    r = c.gnss.noise_var[HORIZONTAL] + extra
    north = innovation_variance(c, position_jacobian(c, lever, 0)) + r
    return float(north), float(innovation_variance(c, position_jacobian(c, lever, 1)) + r)


@kernel
def excess_variance(c: Core, lever: Vector, extra: float) -> float:
    """Most by which the square of a horizontal innovation exceeds its variance, m^2; arguments: see `max_nis`."""
    z, s = c.scratch.position_innovation, position_variances(c, lever, extra)
    return float(max(z[0] ** 2 - s[0], z[1] ** 2 - s[1], 0.0))


@kernel
def drift_has_ended(p: Parameters, c: Core) -> bool:
    """Whether a horizontal position that would be rejected is where positions would be without a drift of those used.

    The receiver's velocity has contradicted them since then, so that one of the two was wrong. How far they have
    drifted is known to a share of it only.
    """
    if c.integrity.reject_count[HORIZONTAL] > 0:
        return False
    z, drift = c.scratch.position_innovation, c.scratch.drift
    far2, left2 = drift[0] ** 2 + drift[1] ** 2, (z[0] + drift[0]) ** 2 + (z[1] + drift[1]) ** 2
    return bool(left2 < p.tuning.ended_drift_share**2 * far2)


@kernel
def fuse_gnss_position(p: Parameters, c: Core, fix: Fix, age: float, innovations: list[Innovation], n: int) -> int:
    """Gate and fuse the position, which was true `age` s before the core's time; returns the rows of innovations.

    A rejected height does not reject the horizontal position. n: rows of `innovations` written before.
    """
    z = c.scratch.position_innovation
    position_offset(c, fix, z)
    lever, velocity = (0.0, 0.0, 0.0), (c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2])
    if c.alignment.mode == NAVIGATING:  # in coarse alignment position and velocity are the antenna's
        lever, velocity = antenna_position(c), velocity_of_point(c.nav, c.imu, c.nav.gnss_lever_arm)
    extra = second_order_error(p, c) ** 2 + (0.5 * p.tuning.late_fix_accel * age * age) ** 2
    for i in range(3):
        z[i] += age * velocity[i] - lever[i] - c.nav.gnss_bias[i]
    if c.alignment.mode == NAVIGATING:
        extra += hold_offset_velocity(p, c, velocity)
    nis = max_nis(p, c, lever, extra, 0, 2)
    receiver_share = 0.0
    if nis > p.tuning.gnss_position_gate and drift_has_ended(p, c):
        allow_for_drift(c)
        nis = max_nis(p, c, lever, extra, 0, 2)
    if nis > p.tuning.gnss_position_gate:
        receiver_share = split_excess(p, c, excess_variance(c, lever, extra))
    after_rejects = c.integrity.reject_count[HORIZONTAL] > 0
    horizontal = gate_position(p, c, fix, 1.0 if receiver_share > 0.0 else nis)
    count_position(p, c, horizontal, after_rejects)
    if horizontal:
        least = reject_share(c) if after_rejects else 0.0
        state_likely_jump(p, c, position_variances(c, lever, extra + receiver_share), least)
    height = horizontal and gate_height(p, c, max_nis(p, c, lever, extra, 2, 3))
    for i in range(3):
        if not math.isfinite(z[i]):
            continue
        accepted = horizontal if i < 2 else height
        r = c.gnss.noise_var[i // 2] + extra + (receiver_share if i < 2 else 0.0)
        length, gate = position_jacobian(c, lever, i), NO_GATE if accepted else REJECT
        value, s, nis = fix_update(p, c, length, z[i], r, gate, POSITION_AXIS + i if i < 2 else OTHER_AXIS)
        n = write_innovation(innovations, n, fix.t_ns, POSITION_N + i, value, s, accepted)
        if accepted and (c.alignment.mode == NAVIGATING or c.stationarity.at_rest):  # else it contains accelerations
            learn_position_noise(p, c, i, nis, s)
    if horizontal:
        correct_state(p, c)
        mark_used(c)
        confirm_survey_epochs(p, c)
        if c.alignment.mode == NAVIGATING and detect_drift(p, c, estimate_may_be_wrong(p, c)):
            correct_state(p, c)
        limit_position_confidence(p, c)
    set_rejecting(c)
    return n
