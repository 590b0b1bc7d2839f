"""GLR test for a step of the gyro bias about the vertical, which turns the heading away.

The test does not run (`gnss_fix`) while the heading is uncertain, wheels contradict the receiver, or there is a
compass, and neither a step of the time offset nor, with wheels, a drift of the receiver must explain more: the
innovations look the same then.

A knock, a change of temperature, or a wrong scale factor in a long turn changes a bias whose variance is small. No
fix measures the heading directly, so the heading is wrong for many seconds before the velocities contradict it by
much. A step d of the bias since an onset is a fault of `fault_sensitivity`, whose chi-square, over the mean square of
the residuals, decides. Horizontal velocities count; those of one second share the receiver's part of their variance.
Positions may drift: only those of centimetres count, or those of a receiver without velocities, if they are accepted,
with the variance that `gnss_drift` has learned, and a drift must not explain more. The prior of d is that of the bias
at switch-on. A slow vehicle shows a step within many seconds, an agile one sooner: of the four onsets each is up to
twice as old as the one before. An onset that is too old becomes the one before it, with what was summed since, and the
first is opened anew. So there is always one of half the greatest age.

When a step is detected, the fault is removed with sigma = `gyro_bias_step_share` d. The vertical part of a step shows,
not the axis of the gyro that has it, so sigma^2 is added to the variances of all three biases. While a step is likely
but not detected, the solution adds the square of what it does to the heading to the stated variance.

Source: as `fault_sensitivity`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_variance
from ..mechanization import rotation_matrix
from ..state import (
    ATTITUDE,
    GYRO_BIAS,
    GYRO_BIAS_ONSETS,
    GYRO_STEP_FAULT,
    HORIZONTAL,
    NEVER_NS,
    POSITION_AXIS,
    VELOCITY_AXIS,
)
from .fault_sensitivity import chi2_beyond, copy_column, open_column, remove_fault, set_sensitivity

if TYPE_CHECKING:
    from ..types import Core, Parameters

TUNABLES = (
    Tunable(
        "gyro_bias_step_chi2",
        16.0,
        "",
        "Chi-square (1 degree of freedom) that proves a step.",
        "Four sigma: simulated, with 3.5 there are twice as many false alarms, and no fewer wrong headings.",
    ),
    Tunable(
        "likely_gyro_bias_step_chi2",
        2.0,
        "",
        "Chi-square from which the heading error of a step is part of the stated sigma.",
        "1.4 sigma: not to state a step that is there costs more than to state one that is not.",
    ),
    Tunable("gyro_bias_step_share", 0.5, "", "Sigma of a step that was detected, as a share of it.", "Choice."),
    Tunable(
        "gyro_bias_onset_s",
        12.0,
        "s",
        "Longest age of the first onset; that of each further one is twice as long.",
        "In it 0.5 deg/s turn by 6 deg.",
    ),
    Tunable("gyro_bias_correlation_s", 1.0, "s", "Fixes of so long share their error.", "Receivers of 1 Hz are white."),
)


@kernel
def interrupt_gyro_bias_step(c: Core) -> None:
    """Forget the onsets, but not what a likely step has done to the heading."""
    for j in range(GYRO_BIAS_ONSETS):
        c.gyro_bias_step.onset_ns[j] = NEVER_NS


@kernel
def reset_gyro_bias_step(c: Core) -> None:
    """Forget the onsets: the estimate is new."""
    c.gyro_bias_step.heading_variance = 0.0
    interrupt_gyro_bias_step(c)


@kernel
def open_gyro_bias_step(c: Core, j: int) -> None:
    """Onset j is now."""
    g, C_nb = c.gyro_bias_step, rotation_matrix(c)
    g.onset_ns[j] = c.nav.t_ns
    g.information[j] = g.vector[j] = g.energy[j] = g.count[j] = 0.0
    open_column(c, GYRO_STEP_FAULT + j)
    for i in range(3):
        set_sensitivity(c, GYRO_BIAS + i, GYRO_STEP_FAULT + j, -C_nb[6 + i])


@kernel
def reports_no_velocity(p: Parameters, c: Core) -> bool:
    """Whether the receiver reports positions alone."""
    return bool(1e-9 * (c.nav.t_ns - c.gyro_bias_step.velocity_ns) > p.tuning.gyro_bias_onset_s)


@kernel
def counts_positions(p: Parameters, c: Core) -> bool:
    """Whether positions count: they are of centimetres, or the receiver reports no velocities."""
    exact = 0.0 < c.gnss.reported_sigma[HORIZONTAL] < p.tuning.survey_sigma
    return bool(exact or reports_no_velocity(p, c))


@kernel
def note_fix(c: Core) -> None:
    """After each fix: `weight_of` needs the time since the last one."""
    c.gyro_bias_step.last_ns = c.nav.t_ns


@kernel
def share_of_new(p: Parameters, c: Core, s: float, r: float) -> float:
    """Share of an innovation of variance s that is new: fixes within `gyro_bias_correlation_s` share their part r."""
    interval_s = 1e-9 * (c.nav.t_ns - c.gyro_bias_step.last_ns)
    sharing = max(p.tuning.gyro_bias_correlation_s / max(interval_s, 1e-3), 1.0)
    return float(s / (s + (sharing - 1.0) * r))


@kernel
def weight_of(p: Parameters, c: Core, s: float, r: float, axis: int) -> float:
    """Weight of an innovation of variance s of a fix, 0 unless it counts; notes that there was a velocity.

    r: the receiver's part of s, which successive velocities share; axis: see `fuse`.
    """
    if VELOCITY_AXIS <= axis < VELOCITY_AXIS + 2:
        c.gyro_bias_step.velocity_ns = c.nav.t_ns
        return share_of_new(p, c, s, r)
    if POSITION_AXIS <= axis < VELOCITY_AXIS and counts_positions(p, c):
        return float(1.0 / c.drift.noise_scale)
    return 0.0


@kernel
def add_to_gyro_bias_step(p: Parameters, c: Core, z: float, s: float, r: float, axis: int) -> None:
    """Add an innovation z of variance s of a fix to the sums; call before its update. The rest: see `weight_of`."""
    g, weight = c.gyro_bias_step, weight_of(p, c, s, r, axis)
    if weight == 0.0:
        return
    for j in range(GYRO_BIAS_ONSETS):
        hw = c.scratch.fault_innovation[GYRO_STEP_FAULT + j]
        g.information[j] += weight * hw * hw / s
        g.vector[j] += weight * hw * z / s
        g.energy[j] += weight * z * z / s
        g.count[j] += weight


@kernel
def apply_gyro_bias_step(p: Parameters, c: Core, j: int, d: float) -> None:
    """Gather a step of d rad/s since onset j in scratch.x, and add its variance to P; see the file's head."""
    sigma = abs(d) * p.tuning.gyro_bias_step_share
    remove_fault(c, GYRO_STEP_FAULT + j, d, sigma)
    for i in range(3):
        add_variance(c, GYRO_BIAS + i, sigma * sigma)


@kernel
def information_of(p: Parameters, c: Core, j: int) -> float:
    """Information, s^2/rad^2, about the step since onset j, with that of its prior."""
    return float(c.gyro_bias_step.information[j] + 1.0 / p.gyro_bias_sigma**2)


@kernel
def step_since(p: Parameters, c: Core, j: int) -> float:
    """The step since onset j, rad/s."""
    return float(c.gyro_bias_step.vector[j] / information_of(p, c, j))


@kernel
def chi2_of(p: Parameters, c: Core, j: int) -> float:
    """Chi-square of a step since onset j."""
    g = c.gyro_bias_step
    return chi2_beyond(information_of(p, c, j), g.vector[j], g.energy[j], g.count[j])


@kernel
def most_likely_onset(p: Parameters, c: Core) -> int:
    """The onset whose step has the largest chi-square; stores what the likely steps add to the heading's variance.

    While the vehicle stands nothing shows its heading: what a likely step has done to it before stays.
    """
    g, best, most = c.gyro_bias_step, 0, 0.0
    slow = elementary.hypot(c.nav.v_n[0], c.nav.v_n[1]) < p.tuning.rest_speed
    stands = slow and c.stationarity.low_motion_count > 0
    g.heading_variance = g.heading_variance if stands else 0.0
    for j in range(GYRO_BIAS_ONSETS):
        chi2 = chi2_of(p, c, j)
        if chi2 > p.tuning.likely_gyro_bias_step_chi2:
            turned = c.faults.sensitivity[ATTITUDE + 2, GYRO_STEP_FAULT + j] * step_since(p, c, j)
            g.heading_variance = max(g.heading_variance, turned * turned)
        if chi2 > most:
            best, most = j, chi2
    return best


@kernel
def explained_by_gyro_bias_step(p: Parameters, c: Core) -> float:
    """Most of the sum of the normalised innovations squared that a step since an onset explains."""
    most = 0.0
    for j in range(GYRO_BIAS_ONSETS):
        if c.gyro_bias_step.onset_ns[j] != NEVER_NS:
            most = max(most, step_since(p, c, j) * c.gyro_bias_step.vector[j])
    return most


@kernel
def take_younger_onset(c: Core, j: int) -> None:
    """Onset j becomes onset j - 1, with what was summed since."""
    g = c.gyro_bias_step
    g.onset_ns[j], g.count[j], g.energy[j] = g.onset_ns[j - 1], g.count[j - 1], g.energy[j - 1]
    g.information[j], g.vector[j] = g.information[j - 1], g.vector[j - 1]
    copy_column(c, GYRO_STEP_FAULT + j - 1, GYRO_STEP_FAULT + j)


@kernel
def renew_onsets(p: Parameters, c: Core) -> None:
    """Each onset that is too old becomes the one before it; the first one is opened anew."""
    g, longest_s = c.gyro_bias_step, p.tuning.gyro_bias_onset_s * 2.0 ** (GYRO_BIAS_ONSETS - 1)
    for j in range(GYRO_BIAS_ONSETS - 1, -1, -1):
        if g.onset_ns[j] == NEVER_NS:
            open_gyro_bias_step(c, j)
        elif 1e-9 * (c.nav.t_ns - g.onset_ns[j]) >= longest_s:
            if j > 0:
                take_younger_onset(c, j)
            else:
                open_gyro_bias_step(c, j)
        longest_s *= 0.5


@kernel
def detect_gyro_bias_step(p: Parameters, c: Core, explained_otherwise: float) -> bool:
    """After a fix, while navigating: True if a step is detected; then its correction is in scratch.x, not
    injected.

    explained_otherwise: sum of the normalised innovations squared that another cause explains; a step has to explain
    more.
    """
    g = c.gyro_bias_step
    renew_onsets(p, c)
    best = most_likely_onset(p, c)
    step = step_since(p, c, best)
    if step * g.vector[best] <= explained_otherwise or chi2_of(p, c, best) <= p.tuning.gyro_bias_step_chi2:
        return False
    apply_gyro_bias_step(p, c, best, step)
    g.heading_variance = 0.0
    for j in range(GYRO_BIAS_ONSETS):
        open_gyro_bias_step(c, j)
    return True
