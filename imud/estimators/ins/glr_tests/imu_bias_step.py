"""GLR test for a step of the biases of the accelerometers, or of those of the gyros, on all three axes.

A blow, a change of temperature, or vibration that a sensor rectifies changes biases whose variances are small. The
receiver's velocities then tilt the estimate instead, and after a turn the tilt is wrong. A step d since an onset is a
fault of `fault_sensitivity`, whose chi-square, over the mean square of the residuals, decides. All three components of
a velocity count; positions only of metres, and where the receiver reports no velocity: in more accurate ones a wrong
lever arm looks alike. The test of `gyro_bias_step`, about the vertical alone, sees smaller steps. The prior of d is
that of the biases at switch-on.

A hypothesis is an onset and a sensor: 2 j + RATES and 2 j + FORCES for onset j. The first onset follows the newest fix
as long as nothing shows since it: it is there when a large step begins. The other two see slow ones: the second is up
to `imu_bias_onset_s` old, the third up to four times that; where it is too old, it becomes the second one. In positions
a step shows only seconds later: with them alone the first onset stays until it is `positions_show_step_s` old, and the
second one then takes its place.

A step has to explain more by `imu_bias_step_excess` than one of the other sensor or another cause, at
`imu_bias_step_proofs` fixes in a row. It is then removed, with sigma = `imu_bias_step_share` |d| on each axis. One of
the other sensor, with another onset, may explain nearly as much: P += e e', e being the difference of the two
corrections, so that the next fixes decide; with positions alone the size of that step is as uncertain as its time, and
its variance adds to P, too. While a step is likely but not detected, the solution adds the squares of what it does to
the attitude to the stated variances.

Source: as `fault_sensitivity`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_covariance
from ..state import (
    ACCEL_BIAS,
    ATTITUDE,
    DOWN_VELOCITY_AXIS,
    FORCES,
    GYRO_BIAS,
    HORIZONTAL,
    IMU_BIAS_HYPOTHESES,
    IMU_BIAS_ONSETS,
    IMU_STEP_FAULT,
    NEVER_NS,
    POSITION_AXIS,
    RATES,
    STATES,
    VELOCITY_AXIS,
)
from .fault_sensitivity import copy_column, open_column, remove_fault, set_sensitivity
from .gyro_bias_step import reports_no_velocity, share_of_new, weight_of

if TYPE_CHECKING:
    from ..types import Core, Parameters

TUNABLES = (
    Tunable("imu_bias_step_chi2", 25.0, "", "Chi-square (3 degrees of freedom) that proves a step.", "Once in 65000."),
    Tunable(
        "coarse_position_sigma",
        0.5,
        "m",
        "Least sigma of positions that count: in more accurate ones a wrong lever arm looks like a step.",
        "Choice.",
    ),
    Tunable(
        "positions_step_chi2",
        42.0,
        "",
        "Chi-square that proves a step with positions alone, whose errors last.",
        "Simulated cars that stop and go: with 25 six of twenty had a step that was none, with 42 one of 120.",
    ),
    Tunable(
        "likely_imu_bias_step_chi2",
        8.0,
        "",
        "Chi-square from which what a step does to the attitude is part of the stated sigma.",
        "Once in twenty.",
    ),
    Tunable(
        "imu_bias_step_excess",
        4.0,
        "",
        "By how much more of the sum of squares a step has to explain than another cause.",
        "Akaike: two for each of the two unknowns more than the other causes have.",
    ),
    Tunable(
        "imu_bias_step_residual",
        3.0,
        "",
        "Largest mean square of what a step leaves unexplained, in variances: more comes of another step.",
        "Choice.",
    ),
    Tunable(
        "imu_bias_step_misfit",
        0.03,
        "",
        "Largest share of the sum of squares that a large step may leave instead: it begins between two fixes.",
        "Simulated cars.",
        high=1.0,
    ),
    Tunable(
        "imu_bias_step_proofs",
        2,
        "fixes",
        "So many fixes in a row after which a step is proven, until it is removed.",
        "One may be an outlier, or a departure with a wrong heading.",
    ),
    Tunable("imu_bias_step_share", 0.5, "", "Sigma of a step that was detected, as a share of it.", "Choice."),
    Tunable(
        "imu_bias_step_alternative",
        0.5,
        "",
        "Least share of the sum of squares which another cause explains that a step has to explain to be possible.",
        "Choice: when a step began is known to some seconds.",
        high=1.0,
    ),
    Tunable(
        "imu_bias_onset_s",
        12.0,
        "s",
        "Longest age of the first two onsets; that of the third is four times as long.",
        "As of the gyro bias about the vertical.",
    ),
    Tunable(
        "positions_show_step_s",
        4.0,
        "s",
        "Time that positions need to show a step: so old is the first onset when it becomes the second one.",
        "1 deg/s turns to 2 m in 4 s.",
    ),
    Tunable("imu_bias_quiet_chi2", 3.0, "", "Chi-square below which nothing shows since the first onset.", "Its mean."),
)


@kernel
def interrupt_imu_bias_step(c: Core) -> None:
    """Forget the onsets, and what a likely step does."""
    for j in range(IMU_BIAS_ONSETS):
        c.imu_bias_step.onset_ns[j] = NEVER_NS
    clear_conclusions(c)


@kernel
def clear_conclusions(c: Core) -> None:
    """No step is likely or proven."""
    c.imu_bias_step.proofs = 0
    for i in range(3):
        c.imu_bias_step.attitude_variance[i] = 0.0


@kernel
def open_imu_bias_step(c: Core, j: int) -> None:
    """Onset j is now."""
    g = c.imu_bias_step
    g.onset_ns[j] = c.nav.t_ns
    g.energy[j] = g.count[j] = 0.0
    for h in range(2 * j, 2 * j + 2):
        bias = GYRO_BIAS if h % 2 == RATES else ACCEL_BIAS
        for i in range(6):
            g.information[h, i] = 0.0
        for i in range(3):
            g.vector[h, i] = 0.0
            open_column(c, IMU_STEP_FAULT + 3 * h + i)
            set_sensitivity(c, bias + i, IMU_STEP_FAULT + 3 * h + i, -1.0)


@kernel
def has_positions_alone(p: Parameters, c: Core) -> bool:
    """Whether the receiver reports no velocities, and positions too coarse to show a lever arm."""
    return bool(reports_no_velocity(p, c) and c.gnss.reported_sigma[HORIZONTAL] >= p.tuning.coarse_position_sigma)


@kernel
def weight_in_imu_bias_step(p: Parameters, c: Core, s: float, r: float, axis: int) -> float:
    """`weight_of`, of all three components of a velocity, and of a position where there are positions alone.

    Positions of a second share their error, too, so that a drift is not taken for a step.
    """
    if axis >= VELOCITY_AXIS or axis == DOWN_VELOCITY_AXIS:
        return weight_of(p, c, s, r, VELOCITY_AXIS)
    if axis >= POSITION_AXIS and has_positions_alone(p, c):
        return weight_of(p, c, s, r, axis) * share_of_new(p, c, s, r)
    return 0.0


@kernel
def add_to_imu_bias_step(p: Parameters, c: Core, z: float, s: float, r: float, axis: int) -> None:
    """Add an innovation z of variance s of a fix to the sums; call before its update. The rest: see `weight_of`."""
    g, mean, weight = c.imu_bias_step, c.scratch.fault_innovation, weight_in_imu_bias_step(p, c, s, r, axis)
    if weight == 0.0:
        return
    for h in range(IMU_BIAS_HYPOTHESES):
        first, k = IMU_STEP_FAULT + 3 * h, 0
        for i in range(3):
            scaled = weight * mean[first + i] / s
            g.vector[h, i] += scaled * z
            for n in range(i, 3):
                g.information[h, k] += scaled * mean[first + n]
                k += 1
    for j in range(IMU_BIAS_ONSETS):
        g.energy[j] += weight * z * z / s
        g.count[j] += weight


@kernel
def estimate_imu_bias_step(p: Parameters, c: Core, h: int) -> tuple[float, float, float, float, float]:
    """The step of hypothesis h (body axes; rad/s or m/s^2), the sum of squares that it explains, the mean square of the
    rest.
    """
    g, prior = c.imu_bias_step, 1.0 / (p.gyro_bias_sigma if h % 2 == RATES else p.accel_bias_sigma) ** 2
    energy, count = g.energy[h // 2], g.count[h // 2]
    if not count > 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    m, v = g.information[h], g.vector[h]
    xx, xy, xz, yy, yz, zz = m[0] + prior, m[1], m[2], m[3] + prior, m[4], m[5] + prior
    cxx, cxy, cxz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy  # cofactors
    cyy, cyz, czz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    scale = 1.0 / (xx * cxx + xy * cxy + xz * cxz)
    x = scale * (cxx * v[0] + cxy * v[1] + cxz * v[2])
    y = scale * (cxy * v[0] + cyy * v[1] + cyz * v[2])
    z = scale * (cxz * v[0] + cyz * v[1] + czz * v[2])
    explained = x * v[0] + y * v[1] + z * v[2]
    return x, y, z, explained, (energy - explained) / max(count - 3.0, 1.0)


@kernel
def explained_by_step_of(p: Parameters, c: Core, sensor: int) -> float:
    """Most of the sum of the normalised innovations squared that a step of this sensor (RATES, FORCES) explains."""
    most = 0.0
    for j in range(IMU_BIAS_ONSETS):
        if c.imu_bias_step.onset_ns[j] != NEVER_NS:
            most = max(most, estimate_imu_bias_step(p, c, 2 * j + sensor)[3])
    return most


@kernel
def explained_by_imu_bias_step(p: Parameters, c: Core) -> float:
    """Most of that sum that a step of either sensor explains."""
    return max(explained_by_step_of(p, c, RATES), explained_by_step_of(p, c, FORCES))


@kernel
def fits(p: Parameters, c: Core, h: int, explained: float, residual: float) -> bool:
    """Whether what a step of hypothesis h leaves unexplained may come of noise, and of its onset between two fixes."""
    energy = c.imu_bias_step.energy[h // 2]
    return residual < p.tuning.imu_bias_step_residual or energy - explained < p.tuning.imu_bias_step_misfit * energy


@kernel
def least_residual(p: Parameters, c: Core) -> float:
    """Least mean square that a step leaves unexplained which may be proven; infinite: there is none."""
    least = math.inf
    for h in range(IMU_BIAS_HYPOTHESES):
        _, _, _, explained, residual = estimate_imu_bias_step(p, c, h)
        if explained > max(residual, 1.0) * p.tuning.imu_bias_step_chi2 and fits(p, c, h, explained, residual):
            least = min(least, residual)
    return least


@kernel
def copy_onset(c: Core, j: int) -> None:
    """Onset j + 1 becomes what onset j is, with what was summed since."""
    g = c.imu_bias_step
    g.onset_ns[j + 1], g.energy[j + 1], g.count[j + 1] = g.onset_ns[j], g.energy[j], g.count[j]
    for h in range(2 * j, 2 * j + 2):
        for i in range(6):
            g.information[h + 2, i] = g.information[h, i]
        for i in range(3):
            g.vector[h + 2, i] = g.vector[h, i]
            copy_column(c, IMU_STEP_FAULT + 3 * h + i, IMU_STEP_FAULT + 3 * (h + 2) + i)


@kernel
def nothing_shows(p: Parameters, c: Core) -> bool:
    """Whether no step shows since the first onset; with positions alone, and the sum of squares is that of noise."""
    g = c.imu_bias_step
    shown = max(estimate_imu_bias_step(p, c, 0)[3], estimate_imu_bias_step(p, c, 1)[3])
    if has_positions_alone(p, c):
        shown = max(shown, g.energy[0] - g.count[0])
    return bool(shown < p.tuning.imu_bias_quiet_chi2)


@kernel
def renew_imu_bias_onsets(p: Parameters, c: Core) -> None:
    """Open the onsets that are too old anew, all of them after an outage, and the first also while nothing shows."""
    g, longest_ns = c.imu_bias_step, int(1e9 * p.tuning.imu_bias_onset_s)
    if g.onset_ns[0] == NEVER_NS or c.nav.t_ns - g.onset_ns[1] >= 4 * longest_ns:
        for j in range(IMU_BIAS_ONSETS):
            open_imu_bias_step(c, j)
    if c.nav.t_ns - g.onset_ns[2] >= 4 * longest_ns:
        copy_onset(c, 1)
    alone, shift_ns = has_positions_alone(p, c), int(1e9 * p.tuning.positions_show_step_s)
    if not alone and c.nav.t_ns - g.onset_ns[1] >= longest_ns:
        open_imu_bias_step(c, 1)
    age_ns = c.nav.t_ns - g.onset_ns[0]
    if age_ns >= longest_ns or (nothing_shows(p, c) and (not alone or age_ns >= shift_ns)):
        if alone:
            copy_onset(c, 0)
        open_imu_bias_step(c, 0)


@kernel
def state_likely_steps(p: Parameters, c: Core) -> None:
    """Store what the likely steps add to the variances of the attitude."""
    stated, V = c.imu_bias_step.attitude_variance, c.faults.sensitivity
    for i in range(3):
        stated[i] = 0.0
    for h in range(IMU_BIAS_HYPOTHESES):
        x, y, z, explained, residual = estimate_imu_bias_step(p, c, h)
        if explained > max(residual, 1.0) * p.tuning.likely_imu_bias_step_chi2:
            k = IMU_STEP_FAULT + 3 * h
            for i in range(3):
                row = V[ATTITUDE + i]
                turned = row[k] * x + row[k + 1] * y + row[k + 2] * z
                stated[i] = max(stated[i], turned * turned)


@kernel
def most_likely_hypothesis(p: Parameters, c: Core) -> int:
    """The hypothesis with the largest chi-square."""
    best, most = 0, 0.0
    for h in range(IMU_BIAS_HYPOTHESES):
        _, _, _, explained, residual = estimate_imu_bias_step(p, c, h)
        if explained > max(residual, 1.0) * most:
            best, most = h, explained / max(residual, 1.0)
    return best


@kernel
def alternative_hypothesis(p: Parameters, c: Core, sensor: int, explained_by_other: float) -> int:
    """The hypothesis of this sensor that explains nearly as much as another cause, and fits; -1: there is none."""
    best, most = -1, p.tuning.likely_imu_bias_step_chi2
    for j in range(IMU_BIAS_ONSETS):
        h = 2 * j + sensor
        _, _, _, explained, residual = estimate_imu_bias_step(p, c, h)
        possible = explained > p.tuning.imu_bias_step_alternative * explained_by_other
        if possible and explained > max(residual, 1.0) * most and fits(p, c, h, explained, residual):
            best, most = h, explained / max(residual, 1.0)
    return best


@kernel
def allow_for_imu_bias_step(p: Parameters, c: Core, sensor: int, explained: float) -> None:
    """Before a correction is injected, of a cause that explains so much: add to P a step of this sensor that may be the
    cause instead; see the file's head.
    """
    h = alternative_hypothesis(p, c, sensor, explained)
    if h < 0:
        return
    x, y, z, _, _ = estimate_imu_bias_step(p, c, h)
    k, V = IMU_STEP_FAULT + 3 * h, c.faults.sensitivity
    share = p.tuning.imu_bias_step_share if has_positions_alone(p, c) else 0.0
    var = share * share * (x * x + y * y + z * z)
    for i in range(STATES):
        e_i = V[i, k] * x + V[i, k + 1] * y + V[i, k + 2] * z + c.scratch.x[i]
        for n in range(i, STATES):
            e_n = V[n, k] * x + V[n, k + 1] * y + V[n, k + 2] * z + c.scratch.x[n]
            add_covariance(c, i, n, e_i * e_n)
            for m in range(k, k + 3):
                add_covariance(c, i, n, var * V[i, m] * V[n, m])


@kernel
def detect_imu_bias_step(p: Parameters, c: Core, explained_otherwise: float) -> bool:
    """After a fix, while navigating: True if a step is detected; then its correction is in scratch.x, not injected.

    explained_otherwise: sum of the normalised innovations squared that another cause explains.
    """
    g = c.imu_bias_step
    renew_imu_bias_onsets(p, c)
    state_likely_steps(p, c)
    h = most_likely_hypothesis(p, c)
    x, y, z, explained, residual = estimate_imu_bias_step(p, c, h)
    otherwise = max(explained_otherwise, explained_by_step_of(p, c, 1 - h % 2))
    least = p.tuning.positions_step_chi2 if has_positions_alone(p, c) else p.tuning.imu_bias_step_chi2
    proven = explained > max(max(residual, 1.0) * least, otherwise + p.tuning.imu_bias_step_excess)
    proven = proven and fits(p, c, h, explained, residual)
    g.proofs = g.proofs + 1 if proven else 0
    if g.proofs < p.tuning.imu_bias_step_proofs:
        return False
    sigma, k = p.tuning.imu_bias_step_share * math.sqrt(x * x + y * y + z * z), IMU_STEP_FAULT + 3 * h
    remove_fault(c, k, x, sigma)
    remove_fault(c, k + 1, y, sigma)
    remove_fault(c, k + 2, z, sigma)
    allow_for_imu_bias_step(p, c, 1 - h % 2, explained)
    clear_conclusions(c)
    for j in range(IMU_BIAS_ONSETS):
        open_imu_bias_step(c, j)
    return True
