"""What each fault that a GLR test looks for does to the estimate and to the innovations.

A fault of size d since an onset makes an error V d of the estimate, and adds (b - h V) d to the mean of an innovation.
The filter's own steps give the sensitivity V:

    V <- T V (T: the transition matrix),    V <- V + K (b - h V) at an update.

V has a column for each hypothetical fault. A test opens it at an onset, adds up innovations, which give the size by
least squares, and decides by a chi-square (generalized likelihood ratio, GLR).

| columns              | of an onset | size d                                          | V at the onset       | b                                   |
|----------------------|-------------|-------------------------------------------------|----------------------|-------------------------------------|
| DRIFT_FAULT          | 2           | drift of positions north, east, m/s             | 0                    | time since the onset for a position |
| TIME_STEP_FAULT      | 1           | step of the receiver's time tags, s             | -1: time offset      | 0                                   |
| GYRO_STEP_FAULT      | 1           | step of the gyro bias about the vertical, rad/s | -1: vertical bias    | 0                                   |
| IMU_STEP_FAULT       | 3           | step of the gyros' (rad/s) or accelerometers' biases (m/s^2), body axes | -1: bias     | 0                                   |
| COMPASS_FAULT        | 1           | offset of a heading, rad                        | 1: heading, if given | 1 for a heading                     |
| CURRENT_FAULT        | 2           | current north, east, m/s                        | 0                    | minus the axis, for the constraint  |
| LEVER_ARM_FAULT      | 2           | error of the lever arm ahead, to the right, m   | C_nb: position; -1: lever arm | 0                          |
| VELOCITY_DRIFT_FAULT | 3           | the same with the velocity; heading step, rad   | 0, 0, -1: heading    | as above, 1 for a velocity; 0       |

V has rows for the boresights (`boresights`), too. Once a fault is found, x -= V d removes what it has done, and
P += sigma^2 V V' states how well d is known.

Source: Friedland, Treatment of bias in recursive filtering (1969); Willsky and Jones, A generalized likelihood ratio
approach to the detection and estimation of jumps in linear systems (1976).
"""  # noqa: E501 a table's row is one line

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ....compile.jit import kernel, unrolled
from ..boresights import any_boresight, has_boresight, remove_drift_from_boresights
from ..ekf import add_correction, add_covariance
from ..error_model import apply_transition
from ..state import (
    BORESIGHTS,
    COMPASS_AXIS,
    COMPASS_FAULT,
    CONSTRAINT_AXIS,
    CURRENT_FAULT,
    DRIFT_FAULT,
    FAULTS,
    HEADING_AXIS,
    LEVER_ARM_FAULT,
    NAVIGATING,
    NEVER_NS,
    ONSETS,
    POSITION_AXIS,
    STATES,
    VELOCITY,
    VELOCITY_AXIS,
    VELOCITY_DRIFT_FAULT,
)

if TYPE_CHECKING:
    from ..types import Core, Transition

OUTLIER_SHARE = 0.95  # of the energy, in one fix: a fault that lasts spreads it over several


@kernel
def open_column(c: Core, column: int) -> None:
    """A fault may begin now: it has not done anything yet."""
    for i in range(STATES):
        c.faults.sensitivity[i, column] = 0.0
    for j in range(BORESIGHTS):
        c.faults.boresight_sensitivity[j, column] = 0.0


@kernel
def copy_column(c: Core, source: int, target: int) -> None:
    """Column `target` becomes column `source`."""
    for i in range(STATES):
        c.faults.sensitivity[i, target] = c.faults.sensitivity[i, source]
    for j in range(BORESIGHTS):
        c.faults.boresight_sensitivity[j, target] = c.faults.boresight_sensitivity[j, source]


@kernel
def set_sensitivity(c: Core, i: int, column: int, value: float) -> None:
    """V of error state i, of a fault that begins now."""
    c.faults.sensitivity[i, column] = value


@kernel
def clear_velocity_sensitivity(c: Core) -> None:
    """The velocity was set without use of what a fault changes: V of it is zero."""
    for i in range(3):
        for j in range(FAULTS):
            c.faults.sensitivity[VELOCITY + i, j] = 0.0


@kernel
def set_boresight_sensitivity(c: Core, j: int, column: int, value: float) -> None:
    """V of boresight j, of a fault that begins now."""
    c.faults.boresight_sensitivity[j, column] = value


@kernel
def all_in_use(c: Core) -> bool:
    """Whether all columns are: most vehicles have no wheels, which those of VELOCITY_DRIFT_FAULT need."""
    return bool(c.velocity_drift.onset_ns[0] != NEVER_NS)


@kernel
def columns_in_use(c: Core) -> int:
    """How many columns of V are followed at an update."""
    if all_in_use(c):
        return FAULTS
    if c.lever_arm_error.onset_ns != NEVER_NS:
        return LEVER_ARM_FAULT + 2
    return VELOCITY_DRIFT_FAULT if c.nhc.enabled else CURRENT_FAULT


@kernel
def propagate_sensitivities(c: Core, transition: Transition) -> None:
    """V <- T V.

    During coarse alignment only of the columns before COMPASS_FAULT: the heading has an arbitrary origin then, which a
    compass does not change, and there are no wheels to contradict.
    """
    if c.alignment.mode != NAVIGATING:
        apply_transition(c.faults.sensitivity, COMPASS_FAULT, transition)
    elif all_in_use(c):
        apply_transition(c.faults.sensitivity, FAULTS, transition)
    elif c.lever_arm_error.onset_ns != NEVER_NS:
        apply_transition(c.faults.sensitivity, LEVER_ARM_FAULT + 2, transition)
    elif c.nhc.enabled:
        apply_transition(c.faults.sensitivity, VELOCITY_DRIFT_FAULT, transition)
    else:
        apply_transition(c.faults.sensitivity, CURRENT_FAULT, transition)


@kernel
def predict_innovations(c: Core, length: int, axis: int) -> None:
    """Mean of the next innovation per unit of each fault, b - h V, to scratch; axis: see `fusion.fuse`.

    The Jacobian h has `length` elements.
    """
    if all_in_use(c):
        predict_from_errors(c, length, FAULTS)
    elif c.lever_arm_error.onset_ns != NEVER_NS:
        predict_from_errors(c, length, LEVER_ARM_FAULT + 2)
    elif c.nhc.enabled:
        predict_from_errors(c, length, VELOCITY_DRIFT_FAULT)
    else:
        predict_from_errors(c, length, CURRENT_FAULT)
    if axis >= POSITION_AXIS:
        for j in range(ONSETS):
            add_drift(c, axis, c.drift.onset_ns[j], DRIFT_FAULT + 2 * j, 0.0)
            add_drift(c, axis, c.velocity_drift.onset_ns[j], VELOCITY_DRIFT_FAULT + 3 * j, 1.0)
    elif axis == CONSTRAINT_AXIS:
        for i in range(2):  # the Jacobian begins with the velocity's
            c.scratch.fault_innovation[CURRENT_FAULT + i] -= c.scratch.values[i]
    elif axis in (HEADING_AXIS, COMPASS_AXIS) and c.compass_offset.onset_ns != NEVER_NS:
        c.scratch.fault_innovation[COMPASS_FAULT] += 1.0
    if has_boresight(axis):
        predict_from_boresights(c)


@unrolled
def predict_from_errors(c: Core, length: int, columns: int) -> None:
    """-h V, what the errors of the estimate do to an innovation, for the first `columns` of V."""
    for j in range(columns):
        c.scratch.fault_innovation[j] = 0.0
    for k in range(length):
        for j in range(columns):
            change = c.scratch.values[k] * c.faults.sensitivity[c.scratch.columns[k], j]
            c.scratch.fault_innovation[j] -= change


@kernel
def predict_from_boresights(c: Core) -> None:
    """-B V, what the errors of the boresights do to an innovation."""
    if not any_boresight(c):
        return
    for j in range(BORESIGHTS):
        for k in range(columns_in_use(c)):
            change = c.scratch.boresight_row[j] * c.faults.boresight_sensitivity[j, k]
            c.scratch.fault_innovation[k] -= change


@kernel
def add_drift(c: Core, axis: int, onset_ns: int, column: int, of_velocity: float) -> None:
    """b of a drift since an onset: the time since then for a position, of_velocity for a velocity."""
    if onset_ns == NEVER_NS:
        return
    b = 1e-9 * (c.nav.t_ns - onset_ns) if axis < VELOCITY_AXIS else of_velocity
    c.scratch.fault_innovation[column + axis % VELOCITY_AXIS] += b


@kernel
def update_sensitivities(c: Core) -> None:
    """V <- V + K (b - h V) before the scalar update that follows, whose gains are in scratch."""
    if all_in_use(c):
        follow_update(c, FAULTS)
    elif c.lever_arm_error.onset_ns != NEVER_NS:
        follow_update(c, LEVER_ARM_FAULT + 2)
    elif c.nhc.enabled:
        follow_update(c, VELOCITY_DRIFT_FAULT)
    else:
        follow_update(c, CURRENT_FAULT)


@unrolled
def follow_update(c: Core, columns: int) -> None:
    """V <- V + K (b - h V) for the first `columns` of V."""
    for i in range(STATES):
        for j in range(columns):
            c.faults.sensitivity[i, j] += c.scratch.gain[i] * c.scratch.fault_innovation[j]
    if any_boresight(c):
        for i in range(BORESIGHTS):
            for j in range(columns):
                c.faults.boresight_sensitivity[i, j] += c.scratch.boresight_gain[i] * c.scratch.fault_innovation[j]


@kernel
def remove_fault(c: Core, column: int, d: float, sigma: float) -> None:
    """Gather in scratch.x the correction for a fault of size d, and add its variance, of this sigma, to P."""
    remove_drift(c, column, (d, 0.0), sigma * sigma, 0.0, 0.0)


@kernel
def remove_drift(c: Core, column: int, d: tuple[float, float], nn: float, ne: float, ee: float) -> None:
    """`remove_fault` of a drift d, north and east, m/s, with its covariance, in this column and the next one."""
    v = c.faults.sensitivity
    for i in range(STATES):
        add_correction(c, i, -(v[i, column] * d[0] + v[i, column + 1] * d[1]))
        a = nn * v[i, column] + ne * v[i, column + 1]
        b = ne * v[i, column] + ee * v[i, column + 1]
        for k in range(i, STATES):
            add_covariance(c, i, k, a * v[k, column] + b * v[k, column + 1])
    remove_drift_from_boresights(c, column, d, nn, ne, ee)


@kernel
def chi2_beyond(information: float, vector: float, energy: float, count: float) -> float:
    """Chi-square of a fault, over the mean square of what it leaves unexplained where that is above 1.

    Of `count` innovations z of variance s and mean a d: the sums of a^2 / s, a z / s and z^2 / s.
    """
    if not (information > 0.0 and count > 0.0):
        return 0.0
    explained = vector * vector / information
    return float(explained / max((energy - explained) / count, 1.0))


@kernel
def note_energy(g: Any, t_ns: int, energy: float) -> None:
    """Note what a normalised innovation squared of the fix at this time, ns, adds to the energy of the test g."""
    if t_ns != g.epoch_ns:
        g.epoch_ns, g.epoch_energy = t_ns, 0.0
    g.epoch_energy += energy
    g.largest_energy = max(g.largest_energy, g.epoch_energy)


@kernel
def clear_energy(g: Any) -> None:
    """At the onset: there is none."""
    g.energy = g.epoch_energy = g.largest_energy = 0.0


@kernel
def is_outlier(g: Any) -> bool:
    """Whether nearly all of the energy is that of one fix: what lasts shows in several."""
    return bool(g.largest_energy > OUTLIER_SHARE * g.energy)


@kernel
def explains_most(explained: float, energy: float, count: float) -> bool:
    """Whether a fault explains most of what the innovations have beyond noise: one outlier among others is no fault.

    Of `count` innovations z of variance s: energy, the sum of z^2 / s, and what of it the fault explains.
    """
    return bool(explained > 0.5 * (energy - count))
