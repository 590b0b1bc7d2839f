"""GLR test for a step of the receiver's time tags: the time offset then differs from its estimate.

The variance of the old offset is small, so the filter would reject the fixes or distort the trajectory. A step d of the
offset since an onset is a fault of `fault_sensitivity`. Least squares over the innovations of positions and velocities
since the onset, also of those that were rejected, gives d. Its chi-square is divided by the mean square of the
residuals, so that errors of the receiver in any direction are no evidence of a step, and a constant jump of the
position is eliminated first: only changes of the velocity distinguish the two. But the step has to explain most of the
innovations without a jump, too, which it does not if some of them are outliers; where nearly all of them is of one fix,
that is an outlier. The onset is the last fix whose innovations were as expected, or after which a step could be
excluded.

When a step is detected, the fault is removed, and P += sigma^2 u u', with 1 at TIME_OFFSET and the velocity at
POSITION in u. An offset and a displacement along the track cancel in every position (h u = 0); later fixes separate
them.

Source: as `fault_sensitivity`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_covariance
from ..state import NEVER_NS, POSITION, POSITION_AXIS, TIME_OFFSET, TIME_STEP_FAULT, VELOCITY_AXIS
from .fault_sensitivity import (
    chi2_beyond,
    clear_energy,
    explains_most,
    is_outlier,
    note_energy,
    open_column,
    remove_fault,
    set_sensitivity,
)

if TYPE_CHECKING:
    from ..types import Core, Parameters

TUNABLES = (
    Tunable("time_offset_step_chi2", 30.0, "", "Chi-square (1 degree of freedom) that proves a step.", "5.5 sigma."),
    Tunable("time_offset_step_onset_chi2", 4.0, "", "Chi-square from which the onset is kept.", "Two sigma."),
    Tunable(
        "excluded_step_sigmas",
        3.0,
        "sigma",
        "The onset is renewed when a step since then, of the least size, is excluded with so many sigmas.",
        "What an old onset knows hides a new step.",
    ),
    Tunable("time_offset_step_sigma", 0.3, "", "Sigma of a step that was detected, as a share of it.", "Choice."),
    Tunable(
        "max_step_heading_sigma",
        math.radians(5.0),
        "rad",
        "Heading sigma up to which steps of time offset and gyro bias are looked for: a wrong heading looks like both.",
        "Simulated wrong headings.",
    ),
    Tunable(
        "min_time_offset_step_s",
        0.3,
        "s",
        "Least step; the offset's own sigma covers smaller ones.",
        "Recorded drives.",
    ),
    Tunable(
        "departure_s",
        3.0,
        "s",
        "Time since a rest up to which no step is looked for: a gentle departure passes for rest, then seems late.",
        "Simulated trams.",
    ),
    Tunable("max_time_offset_step_s", 2.5, "s", "Largest step.", "Leap seconds are corrected by one or two."),
)


@kernel
def reset_time_offset_step(c: Core) -> None:
    """Forget the onset: the estimate is new."""
    c.time_offset_step.onset_ns = NEVER_NS


@kernel
def open_time_offset_step(c: Core) -> None:
    """The onset is now."""
    g = c.time_offset_step
    g.onset_ns = c.nav.t_ns
    g.information = g.vector = 0.0
    g.count = 0
    clear_energy(g)
    open_column(c, TIME_STEP_FAULT)
    set_sensitivity(c, TIME_OFFSET, TIME_STEP_FAULT, -1.0)
    g.jump[:] = 0.0


@kernel
def add_to_time_offset_step(c: Core, z: float, s: float, axis: int) -> None:
    """Add an innovation z of variance s of a fix, used or not; call before its update; axis: see `fuse`."""
    g, hw = c.time_offset_step, c.scratch.fault_innovation[TIME_STEP_FAULT]
    g.information += hw * hw / s
    g.vector += hw * z / s
    g.energy += z * z / s
    note_energy(g, c.nav.t_ns, z * z / s)
    g.count += 1
    if not POSITION_AXIS <= axis < VELOCITY_AXIS:
        return
    g.jump[axis, 0] += 1.0 / s
    g.jump[axis, 1] += hw / s
    g.jump[axis, 2] += z / s


@kernel
def find_time_offset_step(c: Core) -> tuple[float, float, float]:
    """The step, s, its sigma, s, and its chi-square, beyond what a jump of the position explains."""
    g = c.time_offset_step
    information, vector, energy = g.information, g.vector, g.energy
    for axis in range(2):
        r = g.jump[axis]
        if r[0] > 0.0:
            information -= r[1] * r[1] / r[0]
            vector -= r[1] * r[2] / r[0]
            energy -= r[2] * r[2] / r[0]
    information = max(information, 1e-9 * g.information)  # not 0 by rounding
    chi2 = chi2_beyond(information, vector, energy, g.count - 3.0)
    return vector / information, 1.0 / math.sqrt(information), chi2


@kernel
def explained_by_time_offset_step(c: Core) -> float:
    """Sum of the normalised innovations squared that a step since the onset explains."""
    g = c.time_offset_step
    return g.vector * g.vector / g.information if g.onset_ns != NEVER_NS and g.information > 0.0 else 0.0


@kernel
def residual_of_time_offset_step(c: Core) -> float:
    """Mean square that a step since the onset leaves unexplained; 0: no onset is open."""
    g = c.time_offset_step
    if g.onset_ns == NEVER_NS:
        return 0.0
    return float((g.energy - explained_by_time_offset_step(c)) / max(g.count - 1.0, 1.0))


@kernel
def apply_time_offset_step(c: Core, d: float, sigma: float) -> None:
    """Gather the step d, s, in scratch.x, and add its variance, of sigma s, to P; see the file's head."""
    v, s2 = c.nav.v_n, sigma * sigma
    remove_fault(c, TIME_STEP_FAULT, d, sigma)
    for i in range(3):
        for k in range(i, 3):
            add_covariance(c, POSITION + i, POSITION + k, s2 * v[i] * v[k])
        add_covariance(c, POSITION + i, TIME_OFFSET, s2 * v[i])
    add_covariance(c, TIME_OFFSET, TIME_OFFSET, s2)


@kernel
def detect_time_offset_step(p: Parameters, c: Core, explained_otherwise: float) -> bool:
    """After a fix, while navigating: True if a step is detected; then its correction is in scratch.x, not injected.

    explained_otherwise: sum of the normalised innovations squared that another cause explains; a step has to explain
    more.
    """
    g = c.time_offset_step
    if (
        g.onset_ns == NEVER_NS
        or chi2_beyond(g.information, g.vector, g.energy, g.count) < p.tuning.time_offset_step_onset_chi2
    ):
        open_time_offset_step(c)
        return False
    d, sigma, chi2 = find_time_offset_step(c)
    if abs(d) + p.tuning.excluded_step_sigmas * sigma < p.tuning.min_time_offset_step_s:
        open_time_offset_step(c)
        return False
    if (
        chi2 > p.tuning.time_offset_step_chi2
        and p.tuning.min_time_offset_step_s < abs(d) < p.tuning.max_time_offset_step_s
        and explained_by_time_offset_step(c) > explained_otherwise
        and explains_most(explained_by_time_offset_step(c), g.energy, g.count)
        and not is_outlier(g)
    ):
        apply_time_offset_step(c, d, p.tuning.time_offset_step_sigma * abs(d))
        open_time_offset_step(c)
        return True
    return False
