"""GLR test for a compass that shows a wrong heading, and whether motion has confirmed a heading that was given.

A compass may be mounted wrong, near iron or in other units, and a user may be mistaken: headings then differ by an
offset d from the true ones, a fault of `fault_sensitivity`. Least squares over the innovations of the fixes of the last
`compass_offset_memory_s`, used or not, gives d. Its chi-square is divided by the mean square of the residuals where
that is above 1. A heading is confirmed once d is known to be small, or, of a compass, its sigma and what d does to it,
and the residuals as expected. Until then a contradiction is the heading's, not the receiver's: no drift or step of its
time tags is looked for, and few rejected velocities (`unconfirmed_velocity_rejects`), large residuals
(`contradicted_residual`) or biases that no accelerometer has end the heading.

When an offset is detected, the fault is removed. The effect of a large one is not linear, and that of an offset that
varies, as near iron, is another: the heading then has to be found anew.

Source: as `fault_sensitivity`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..boresights import heading_boresight_variance, set_opened_variance, widen_boresight_prior
from ..ekf import variance
from ..state import ATTITUDE, BORESIGHTS, COMPASS_FAULT, HEADING_BORESIGHT, NEVER_NS, POSITION_AXIS, STATES
from .fault_sensitivity import chi2_beyond, open_column, remove_fault, set_boresight_sensitivity, set_sensitivity

if TYPE_CHECKING:
    from ..types import Core, Parameters

TUNABLES = (
    Tunable("compass_offset_chi2", 30.0, "", "Chi-square (1 degree of freedom) that proves an offset.", "5.5 sigma."),
    Tunable(
        "likely_compass_offset_chi2",
        6.0,
        "",
        "Chi-square from which what such an offset does is part of the stated sigma of the heading.",
        "2.5 sigma.",
    ),
    Tunable(
        "wide_boresight_chi2",
        9.0,
        "",
        "Chi-square from which nothing is known of a boresight that was stated.",
        "3 sigma: it is then estimated as one that was not stated.",
    ),
    Tunable("compass_offset_memory_s", 100.0, "s", "Time over which innovations are summed.", "Choice: some turns."),
    Tunable(
        "compass_offset_correlation_s", 1.0, "s", "Fixes of so long share their error.", "Receivers of 1 Hz are white."
    ),
    Tunable("compass_offset_prior", 1.0, "rad", "Sigma of an offset before anything is known.", "Mounted anyhow."),
    Tunable(
        "min_compass_offset", math.radians(3.0), "rad", "Least offset that is a fault.", "Choice: mounting by eye."
    ),
    Tunable(
        "max_compass_offset",
        math.radians(15.0),
        "rad",
        "Largest offset whose effect is corrected; for a larger one the heading is found anew.",
        "Linearization.",
    ),
    Tunable("compass_offset_share", 0.3, "", "Sigma of an offset that was detected, as a share of it.", "Choice."),
    Tunable(
        "confirmed_offset",
        math.radians(5.0),
        "rad",
        "A heading is confirmed when a larger offset, or what it does to the heading, is excluded by two sigmas.",
        "Choice.",
    ),
    Tunable("confirmed_residual", 3.0, "", "Largest mean NIS of the fixes that confirm a heading.", "Choice."),
    Tunable(
        "compass_offset_residual",
        2.0,
        "",
        "Largest mean NIS that a detected offset leaves where it is constant.",
        "Choice.",
    ),
    Tunable(
        "contradicted_residual",
        8.0,
        "",
        "Mean NIS of the fixes from which a heading that a compass gave and motion has not confirmed is wrong.",
        "Choice.",
    ),
    Tunable("confirming_fixes", 3.0, "fixes", "Least number of innovations that confirm a heading.", "Choice."),
)


@kernel
def open_compass_offset(c: Core, given: bool) -> None:
    """The heading is `given`, by the compass or the user; or the compass is used first beside a known one."""
    g = c.compass_offset
    g.onset_ns = g.last_ns = c.nav.t_ns
    g.unconfirmed = 1 if given else 0
    g.information = g.vector = g.energy = g.count = g.heading_variance = g.turn_variance = 0.0
    open_column(c, COMPASS_FAULT)
    set_sensitivity(c, ATTITUDE + 2, COMPASS_FAULT, 1.0 if given else 0.0)
    if given:
        set_opened_variance(c, 0.0)


@kernel
def close_compass_offset(c: Core) -> None:
    """The heading is not a given one any more."""
    c.compass_offset.onset_ns, c.compass_offset.unconfirmed = NEVER_NS, 0
    c.compass_offset.heading_variance = 0.0


@kernel
def sensitivity_to_compass(c: Core, i: int) -> float:
    """What an offset of the heading that was given, or of the compass, has done to error state i, per rad."""
    return float(c.faults.sensitivity[i, COMPASS_FAULT])


@kernel
def state_turn(c: Core, variance: float) -> None:
    """The sensor may have been turned by this variance, rad^2: part of the heading's until that is confirmed."""
    if is_unconfirmed(c):
        c.compass_offset.turn_variance = variance


@kernel
def is_unconfirmed(c: Core) -> bool:
    """Whether a compass or the user gave the heading, and motion has not confirmed it yet."""
    return bool(c.compass_offset.unconfirmed)


@kernel
def is_measured(c: Core) -> bool:
    """Whether a compass or a pose gave the heading, and motion has not confirmed it yet."""
    by_pose = c.pose.yaw_ns != NEVER_NS
    return bool(is_unconfirmed(c) and (heading_boresight_variance(c) > 0.0 or by_pose))


@kernel
def add_to_compass_offset(p: Parameters, c: Core, z: float, s: float, axis: int) -> None:
    """Add a horizontal innovation z of variance s of a fix, used or not; call before its update; axis: see `fuse`."""
    g = c.compass_offset
    if g.onset_ns == NEVER_NS or axis < POSITION_AXIS:
        return
    hw = c.scratch.fault_innovation[COMPASS_FAULT]
    weight = min(1e-9 * (c.nav.t_ns - g.last_ns) / p.tuning.compass_offset_correlation_s, 1.0)
    g.information += weight * hw * hw / s
    g.vector += weight * hw * z / s
    g.energy += weight * z * z / s
    g.count += weight


@kernel
def explained_by_compass_offset(c: Core) -> float:
    """Sum of the normalised innovations squared that an offset explains."""
    g = c.compass_offset
    return g.vector * g.vector / g.information if g.onset_ns != NEVER_NS and g.information > 0.0 else 0.0


@kernel
def fixes_contradict_heading(p: Parameters, c: Core) -> bool:
    """Whether the innovations of fixes are far too large for a measured heading that motion has not confirmed.

    A heading that is the wrong way round is no offset whose effect is linear: velocities differ along their changes.
    """
    g = c.compass_offset
    return bool(is_measured(c) and g.energy > p.tuning.contradicted_residual * max(g.count, p.tuning.confirming_fixes))


@kernel
def biases_contradict_heading(p: Parameters, c: Core) -> bool:
    """Whether a heading that motion has not confirmed has made biases of the accelerometers that no sensor has.

    Velocities that a wrong heading does not explain are those of biases, to the filter: the innovations stay small. It
    has made none of a vehicle that stands.
    """
    ba = c.nav.ba
    largest = max(abs(ba[0]), abs(ba[1]), abs(ba[2]))
    moves = c.gnss.speed > p.tuning.rest_speed
    return bool(moves and is_unconfirmed(c) and largest > p.tuning.limit_sigmas * p.accel_bias_sigma)


@kernel
def find_compass_offset(p: Parameters, c: Core) -> float:
    """After a fix, while navigating: the offset, rad, if it is detected, else 0.

    Also: whether the heading is confirmed, and what a likely offset adds to the stated variance of the heading.
    """
    g = c.compass_offset
    if g.onset_ns == NEVER_NS:
        return 0.0
    information = g.information + 1.0 / p.tuning.compass_offset_prior**2
    d, sigma = g.vector / information, 1.0 / math.sqrt(information)
    chi2 = chi2_beyond(information, g.vector, g.energy, g.count)
    turned = c.faults.sensitivity[ATTITUDE + 2, COMPASS_FAULT] * d
    g.heading_variance = turned * turned if chi2 > p.tuning.likely_compass_offset_chi2 else 0.0
    if g.unconfirmed:
        g.heading_variance = max(g.heading_variance, g.turn_variance - variance(c, ATTITUDE + 2))
    if chi2 > p.tuning.compass_offset_chi2 and abs(d) > p.tuning.min_compass_offset:
        return d
    settled = g.count >= p.tuning.confirming_fixes and g.energy < p.tuning.confirmed_residual * g.count
    shown = settled and variance(c, ATTITUDE + 2) < (0.5 * p.tuning.confirmed_offset) ** 2
    if shown:
        g.turn_variance = 0.0  # the fixes have shown the heading itself
    possible = abs(d) + 2.0 * sigma
    if heading_boresight_variance(c) > 0.0:  # which takes most of an offset
        possible *= abs(c.faults.sensitivity[ATTITUDE + 2, COMPASS_FAULT]) if shown else math.inf
    if settled and possible < p.tuning.confirmed_offset:
        g.unconfirmed = 0
        by_user = c.heading_aid.last_ns == NEVER_NS and c.pose.yaw_ns == NEVER_NS
        if by_user:  # nothing brings an offset in later
            close_compass_offset(c)
            return 0.0
    keep = 1.0 - min(1e-9 * (c.nav.t_ns - g.last_ns) / p.tuning.compass_offset_memory_s, 1.0)
    g.information, g.vector, g.energy, g.count = (
        keep * g.information,
        keep * g.vector,
        keep * g.energy,
        keep * g.count,
    )
    g.last_ns = c.nav.t_ns
    return 0.0


@kernel
def estimate_wide_boresight(p: Parameters, c: Core) -> bool:
    """After a fix: gather in scratch.x what an unknown boresight would have made of its innovations, if they show it.

    A boresight that was stated, and is contradicted, is an offset d of known sigma, by which b is too small. Its
    estimate by the innovations is taken out of the states, and what is left of d is part of P, C and M, as if it had
    been unknown from the start.
    """
    g = c.compass_offset
    chi2 = chi2_beyond(g.information, g.vector, g.energy, g.count)
    if g.onset_ns == NEVER_NS or heading_boresight_variance(c) == 0.0 or chi2 < p.tuning.wide_boresight_chi2:
        return False
    added = widen_boresight_prior(p, c)
    if added == 0.0:
        return False
    information = g.information + 1.0 / added
    d = g.vector / information
    v = c.faults.boresight_sensitivity
    set_boresight_sensitivity(c, HEADING_BORESIGHT, COMPASS_FAULT, v[HEADING_BORESIGHT, COMPASS_FAULT] - 1.0)
    remove_fault(c, COMPASS_FAULT, d, 1.0 / math.sqrt(information))
    rest = 1.0 / (added * information)  # of an offset, what is not taken out
    for i in range(STATES):
        set_sensitivity(c, i, COMPASS_FAULT, rest * c.faults.sensitivity[i, COMPASS_FAULT])
    for j in range(BORESIGHTS):
        set_boresight_sensitivity(c, j, COMPASS_FAULT, rest * v[j, COMPASS_FAULT])
    set_boresight_sensitivity(c, HEADING_BORESIGHT, COMPASS_FAULT, v[HEADING_BORESIGHT, COMPASS_FAULT] + 1.0)
    g.information = g.vector = g.energy = g.count = g.heading_variance = 0.0
    return True


@kernel
def correct_compass_offset(p: Parameters, c: Core, d: float) -> bool:
    """Gather what an offset d, rad, has done to the estimate in scratch.x, and add its variance to P.

    False: it is too large for that, or not constant.
    """
    g = c.compass_offset
    residual = g.energy - explained_by_compass_offset(c)
    if abs(d) > p.tuning.max_compass_offset or residual > p.tuning.compass_offset_residual * g.count:
        return False
    remove_fault(c, COMPASS_FAULT, d, d * p.tuning.compass_offset_share)
    return True
