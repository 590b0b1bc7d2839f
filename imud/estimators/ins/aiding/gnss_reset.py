"""What a GNSS position that was rejected, or that comes after an outage, does to the estimate once it is used.

Either P was too small, and is multiplied, or the position is set to the fix and loses its correlations. `gnss_gate`
decides when.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_variance, decorrelate, inflate, variance
from ..integrity.reset_inflation import inflate_position, inflate_velocity
from ..mechanization import displace
from ..state import (
    ATTITUDE,
    COARSE_ALIGNMENT,
    GNSS_VELOCITY_BIAS,
    HORIZONTAL,
    NAVIGATING,
    POSITION,
    TIME_OFFSET,
    VELOCITY,
)
from .gnss_noise import clear_gnss_bias

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "reset_sigmas",
        2.0,
        "sigma",
        "Sigma of the position after a reset, in sigmas of the fix.",
        "What was rejected for long may be wrong again.",
    ),
    Tunable(
        "outage_freedom",
        4.0,
        "",
        "Degrees of freedom of Student's t, the distribution of the errors that grow in an outage.",
        "Simulated outages with faults of the IMU.",
    ),
    Tunable("reset_position_sigma", 1.0, "m", "Sigma of the position after a reset, beside reset_sigmas.", "Choice."),
    Tunable(
        "reset_velocity_sigma",
        2.0,
        "m/s",
        "Sigma added to a velocity that nothing supports, at a reset.",
        "Choice.",
    ),
    Tunable(
        "max_diverging_tilt",
        math.radians(10.0),
        "rad",
        "Largest tilt sigma to which P is inflated where the estimate diverges.",
        "Linearization.",
    ),
    Tunable(
        "max_linear_tilt",
        math.radians(30.0),
        "rad",
        "Tilt sigma from which a fix finds the attitude anew.",
        "Linearization.",
    ),
    Tunable(
        "reset_heading_sigma",
        math.radians(10.0),
        "rad",
        "Sigma added to the heading when the filter is reset to rejected positions.",
        "Choice.",
    ),
    Tunable(
        "reset_time_sigma",
        0.2,
        "s",
        "Sigma added to the time offset when the filter is reset to rejected positions.",
        "Choice.",
    ),
)


@kernel
def bias_free_innovation(c: Core, axis: int) -> float:
    """Innovation of the position along an axis, m, without the estimated GNSS bias."""
    return float(c.scratch.position_innovation[axis] + c.nav.gnss_bias[axis])


@kernel
def allow_for_wrong_positions(p: Parameters, c: Core, axis: int, distance: float) -> None:
    """At a reset before the heading is known: what wrong positions before it may have done along an axis.

    They alone gave the velocity. distance: of the fix from the estimate, m. No more of it is stated as an error than
    the first rejected position was off and a receiver drifts; no more than a jump where but one position was used.
    """
    outage_s = max(1e-9 * (c.nav.t_ns - c.gnss.last_used_ns), 1e-3)
    speed = min(distance / outage_s, p.tuning.unknown_speed)
    add_variance(c, VELOCITY + axis, max(p.tuning.reset_velocity_sigma, speed) ** 2)
    most = p.tuning.jump_sigma
    if c.integrity.position_uses >= 1.0:
        most = abs(c.integrity.first_offset[axis]) + p.tuning.max_drift_speed * outage_s
    inflate_position(c, axis, min(distance, most) ** 2)


@kernel
def reset_to_gnss(p: Parameters, c: Core, first: int, last: int, supported: bool, drifted_for_s: float) -> None:
    """Set position axes first to last - 1 to the fix, and inflate their stated variance by the squared difference.

    Either the estimate or the receiver was wrong, so the difference is stated as an error. This inflation decays as the
    GNSS bias does; it is no state, because every further fix there would contradict a GNSS bias that large.
    Unless the velocity is supported, the variances of velocity and heading are increased, too, and the velocity with
    which the horizontal positions drifted away in `drifted_for_s` is stated as an error.
    """
    # along all axes at once: the metres east are those at the latitude before
    if first == 0:
        displace(c, bias_free_innovation(c, 0), bias_free_innovation(c, 1), 0.0)
    if last == 3:
        displace(c, 0.0, 0.0, bias_free_innovation(c, 2))
    for i in range(first, last):
        z, sigma = bias_free_innovation(c, i), c.gnss.reported_sigma[i // 2]
        decorrelate(c, POSITION + i, (p.tuning.reset_sigmas * sigma) ** 2 + p.tuning.reset_position_sigma**2)
        clear_gnss_bias(c, i, sigma * sigma)
        c.scratch.position_innovation[i] = 0.0
        if not supported and i < 2 and c.alignment.mode == COARSE_ALIGNMENT:
            allow_for_wrong_positions(p, c, i, abs(z))
            continue
        inflate_position(c, i, z * z)
        if not supported:
            add_variance(c, VELOCITY + i, p.tuning.reset_velocity_sigma**2)
            if i < 2 and drifted_for_s > 0.0:
                inflate_velocity(c, i, ((z - c.integrity.reject_offset[i]) / drifted_for_s) ** 2)
    if first == 0 and not supported:
        add_variance(c, ATTITUDE + 2, p.tuning.reset_heading_sigma**2)
    if first == 0:
        add_variance(c, TIME_OFFSET, p.tuning.reset_time_sigma**2)


@kernel
def inflate_after_outage(p: Parameters, c: Core, nis: float) -> None:
    """At the first position after an outage, of this NIS: P is multiplied by the mean of what it was too small by.

    The errors grew as those of the IMU, of which a sheet says little: they are of Student's t, given P.
    """
    freedom = p.tuning.outage_freedom
    inflate(c, max((freedom + nis) / (freedom + 2.0), 1.0))


@kernel
def inflate_to_fix(c: Core, nis: float) -> None:
    """Multiply P by the NIS of a position that was rejected after an outage, so that it is used.

    What has grown together (position, velocity, tilt, biases) is corrected together, which a reset of the position
    would undo. The receiver may be wrong instead, so the difference is stated as an error, as at a reset.
    """
    inflate(c, nis)
    for i in range(2):
        inflate_position(c, i, bias_free_innovation(c, i) ** 2)


@kernel
def diverging_inflation(p: Parameters, c: Core, nis: float) -> float:
    """By what P is multiplied where the estimate diverges from a position of this NIS; 1: the tilt is wide already."""
    tilt2 = max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    return float(max(1.0, min(nis, p.tuning.max_diverging_tilt**2 / tilt2)))


@kernel
def inflate_to_diverging(p: Parameters, c: Core, nis: float) -> None:
    """Multiply P by the NIS of a position from which the estimate diverges, so that it is used.

    A bias or the mounting has changed, say: tilt and velocity have gone wrong together, which a reset of the position
    would not correct. The heading, which turns slowly meanwhile, is as after a reset: the velocity shows nothing of it,
    as it comes of no force. The receiver may be wrong instead, unless it has centimetre accuracy: then the difference
    is stated as an error.
    """
    heading2 = variance(c, ATTITUDE + 2)
    inflate(c, diverging_inflation(p, c, nis))
    decorrelate(c, ATTITUDE + 2, heading2 + p.tuning.reset_heading_sigma**2)
    for i in range(2 if c.gnss.reported_sigma[HORIZONTAL] >= p.tuning.survey_sigma else 0):
        inflate_position(c, i, bias_free_innovation(c, i) ** 2)


@kernel
def lose_attitude(p: Parameters, c: Core) -> None:
    """Make the tilt as uncertain as one that is lost."""
    for i in range(2):
        decorrelate(c, ATTITUDE + i, 4.0 * p.tuning.max_linear_tilt**2)


@kernel
def attitude_is_lost(p: Parameters, c: Core) -> bool:
    """Whether the tilt is so uncertain, as after an outage in which a bias has stepped, that no update is linear."""
    tilt2 = max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    return c.alignment.mode == NAVIGATING and tilt2 > p.tuning.max_linear_tilt**2


@kernel
def allow_for_wrong_velocity(c: Core) -> None:
    """No drift of positions lasts so long: the velocity that supported the estimate was wrong, and it goes on."""
    for i in range(2):
        add_variance(c, VELOCITY + i, c.drift.velocity[i] ** 2)
        add_variance(c, GNSS_VELOCITY_BIAS + i, c.drift.velocity[i] ** 2)


@kernel
def allow_for_drift(c: Core) -> None:
    """State what positions that drifted, until they came back, have done to the estimate."""
    for i in range(2):
        add_variance(c, POSITION + i, c.scratch.drift[i] ** 2)
