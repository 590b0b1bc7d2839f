"""GLR test for a lever arm of a survey that is given wrong: positions of centimetres then turn about another point.

It runs while the lever arm counts as exact, because its sigma is not given and the epochs are a survey's
(`aiding.lever_arm_prior`), and there is no odometer, whose test has the same columns.

On a straight way the antenna's place in the vehicle does not matter; in turns a wrong one bends heading
and velocity, until positions are rejected.
An error d of the lever arm, ahead and to the right, is a fault of `fault_sensitivity` since an onset: V is -1 at
GNSS_LEVER_ARM and C_nb at POSITION, which has the error already. All innovations of positions and velocities since,
also rejected ones, give its size, with the prior of a lever arm that is not set. Errors of less than
`min_lever_arm_error` are left: those of time look the same. Where one fix has nearly all of the normalised innovations
squared, it is an outlier.

When one is found, what it has done is removed, and the lever arm is estimated from there on; its sigma is a share of
the error, as it was given by somebody who was wrong.

Source: as `fault_sensitivity`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_variance, variance
from ..mechanization import rotation_matrix
from ..state import (
    EE,
    GNSS_LEVER_ARM,
    HORIZONTAL,
    LEVER_ARM_FAULT,
    NAVIGATING,
    NE,
    NEVER_NS,
    NN,
    POSITION,
)
from .current import add_to_sums
from .fault_sensitivity import clear_energy, is_outlier, note_energy, open_column, remove_drift, set_sensitivity
from .gyro_bias_step import weight_of

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("lever_arm_error_chi2", 30.0, "", "Chi-square (2 degrees of freedom) that proves an error.", "5 sigma."),
    Tunable("min_lever_arm_error", 0.5, "m", "Least error that is looked for.", "Errors of time: 0.1 to 0.4 m."),
    Tunable("lever_arm_error_share", 0.3, "", "Sigma of an error that was found, as a share of it.", "Choice."),
)


@kernel
def reset_lever_arm_error(c: Core) -> None:
    """Forget the onset: the estimate is new."""
    c.lever_arm_error.onset_ns = NEVER_NS


@kernel
def open_lever_arm_error(c: Core) -> None:
    """The onset is now: the position has the error already."""
    g, C_nb = c.lever_arm_error, rotation_matrix(c)
    g.onset_ns = c.nav.t_ns
    g.vector[:] = 0.0
    g.information[:] = 0.0
    g.count = 0.0
    clear_energy(g)
    for j in range(2):
        open_column(c, LEVER_ARM_FAULT + j)
        for i in range(3):
            set_sensitivity(c, POSITION + i, LEVER_ARM_FAULT + j, C_nb[3 * i + j])
        set_sensitivity(c, GNSS_LEVER_ARM + j, LEVER_ARM_FAULT + j, -1.0)


@kernel
def add_to_lever_arm_error(p: Parameters, c: Core, z: float, s: float, r: float, axis: int) -> None:
    """Add an innovation z of variance s of a fix, used or not; call before its update; r, axis: see `weight_of`."""
    if c.lever_arm_error.onset_ns == NEVER_NS:
        return
    mean, weight = c.scratch.fault_innovation, weight_of(p, c, s, r, axis)
    note_energy(c.lever_arm_error, c.nav.t_ns, weight * z * z / s)
    add_to_sums(c.lever_arm_error, mean[LEVER_ARM_FAULT], mean[LEVER_ARM_FAULT + 1], z, s, weight)


@kernel
def find_lever_arm_error(p: Parameters, c: Core) -> tuple[float, float, float, float, float, float]:
    """The error ahead and to the right, m, its covariance xx, xy, yy, and its chi-square over that of the residuals."""
    g, k = c.lever_arm_error, 1.0 / p.tuning.unset_lever_arm_sigma**2
    a, b, ab = g.information[NN] + k, g.information[EE] + k, g.information[NE]
    det = a * b - ab * ab
    x, y = (b * g.vector[0] - ab * g.vector[1]) / det, (a * g.vector[1] - ab * g.vector[0]) / det
    explained = x * g.vector[0] + y * g.vector[1]
    rest = max((g.energy - explained) / max(g.count, 1.0), 1.0)
    return x, y, rest * b / det, -rest * ab / det, rest * a / det, explained / rest


@kernel
def explained_by_lever_arm_error(p: Parameters, c: Core) -> float:
    """Sum of the normalised innovations squared that an error of the lever arm explains."""
    if c.lever_arm_error.onset_ns == NEVER_NS:
        return 0.0
    x, y, _, _, _, _ = find_lever_arm_error(p, c)
    return float(x * c.lever_arm_error.vector[0] + y * c.lever_arm_error.vector[1])


@kernel
def apply_lever_arm_error(p: Parameters, c: Core, d: tuple[float, float], xx: float, xy: float, yy: float) -> None:
    """Gather in scratch.x the error d, m, of the lever arm and what it has done, and add its covariance to P."""
    share2 = p.tuning.lever_arm_error_share**2 * (d[0] * d[0] + d[1] * d[1])
    remove_drift(c, LEVER_ARM_FAULT, d, xx + share2, xy, yy + share2)
    add_variance(c, GNSS_LEVER_ARM + 2, share2)


@kernel
def detect_lever_arm_error(p: Parameters, c: Core, explained_otherwise: float) -> bool:
    """After a fix: True if an error is found; then its correction is in scratch.x, not injected.

    explained_otherwise: sum of the normalised innovations squared that another cause explains; an error has to explain
    more.
    """
    by_default = p.lever_arm_sigma < 0.0 and variance(c, GNSS_LEVER_ARM) == 0.0
    precise = c.gnss.reported_sigma[HORIZONTAL] < p.tuning.survey_sigma
    if not (by_default and precise and c.alignment.mode == NAVIGATING and c.velocity_drift.onset_ns[0] == NEVER_NS):
        reset_lever_arm_error(c)
        return False
    if c.lever_arm_error.onset_ns == NEVER_NS:
        open_lever_arm_error(c)
        return False
    x, y, xx, xy, yy, chi2 = find_lever_arm_error(p, c)
    large = x * x + y * y > p.tuning.min_lever_arm_error**2 and not is_outlier(c.lever_arm_error)
    if not large or chi2 <= p.tuning.lever_arm_error_chi2 or explained_by_lever_arm_error(p, c) <= explained_otherwise:
        return False
    apply_lever_arm_error(p, c, (x, y), xx, xy, yy)
    reset_lever_arm_error(c)
    return True
