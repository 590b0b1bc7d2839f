"""Does the receiver creep away? A constant velocity that its positions had, and the vehicle had not, since some moment.

A filter that is not told of the receiver's velocity follows such positions: each of them is within its gate. But what
creeping at 1 m/s would do to the estimate, and to every innovation, follows from the filter's own gains. So for some
moments at which it may have begun, that pull is carried along, and the creeping velocity is estimated from the
innovations by least squares. When it is certainly not nothing, the estimate is put back to where it had been without,
as unsure as that velocity is, and the positions are refused (see `admission`).

How far a receiver's positions wander is not what it reports: what this one has seemed to creep in earlier times
is the measure.

Source: Friedland, Treatment of bias in recursive filtering (1969); Willsky and Jones, A generalized likelihood ratio
approach to the detection and estimation of jumps in linear systems (1976).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_correction, add_covariance
from ..error_model import apply_phi
from ..state import NEVER_NS, ONSETS, STATES, VELOCITY

if TYPE_CHECKING:
    from ..types import Core, Parameters, Transition


TUNABLES = (
    Tunable("onset_interval_s", 12.0, "s", "Time between two hypothetical onsets of a drift.", "Choice."),
    Tunable("min_drift_s", 5.0, "s", "Shortest drift that is tested.", "Choice."),
    Tunable("min_drift_fixes", 4, "fixes", "Fewest fixes that are tested.", "Choice."),
    Tunable("min_drift_speed", 0.05, "m/s", "Error of a velocity that its sigma may not have.", "Choice."),
    Tunable("drift_chi2", 30.0, "", "Chi-square (2 degrees of freedom) that proves a drift.", "Once in three million."),
    Tunable("min_drift_noise_scale", 1.25, "", "Least scale of the receiver's bias variance.", "Simulated drifts."),
    Tunable("first_drift_noise_scale", 2.0, "", "First scale of it.", "Simulated drifts."),
    Tunable("max_drift_noise_scale", 10.0, "", "Largest scale of it.", "Simulated drifts."),
    Tunable("drift_noise_scale_prior", 5.0, "onsets", "Weight of the first scale.", "Choice."),
    Tunable("drift_noise_scale_gain", 0.05, "per onset", "Gain of the scale.", "Choice."),
)


@kernel
def reset_drift(c: Core) -> None:
    """Begin anew, with the receiver trusted."""
    c.drift.detected = 0
    c.drift.pending_noise_scale = 0.0
    for j in range(ONSETS):
        c.drift.onset_ns[j] = NEVER_NS


@kernel
def all_onsets_open(c: Core) -> bool:
    """Have estimate and receiver agreed for as long as it takes to let every moment begin?"""
    return bool(min(c.drift.onset_ns[0], c.drift.onset_ns[1], c.drift.onset_ns[2]) != NEVER_NS)


@kernel
def open_hypothesis(c: Core, j: int) -> None:
    """Let moment j be now."""
    c.drift.onset_ns[j] = c.nav.t_ns
    c.drift.innovation_count[j] = 0
    for i in range(2):
        c.drift.information_vector[j, i] = 0.0
    for i in range(3):
        c.drift.information_matrix[j, i] = 0.0
    for i in range(STATES):
        c.drift.bias_sensitivity[i, 2 * j] = 0.0
        c.drift.bias_sensitivity[i, 2 * j + 1] = 0.0


@kernel
def clear_detection(c: Core) -> None:
    """The receiver is back where it should be."""
    c.drift.detected = 0


@kernel
def clear_velocity_sensitivity(c: Core) -> None:
    """The velocity has been set from elsewhere: no drift has a part in it."""
    for i in range(3):
        for j in range(2 * ONSETS):
            c.drift.bias_sensitivity[VELOCITY + i, j] = 0.0


@kernel
def propagate_sensitivity(c: Core, phi: Transition) -> None:
    """Propagate the sensitivities as errors."""
    apply_phi(c.drift.bias_sensitivity, 2 * ONSETS, phi)


@kernel
def update_sensitivity(c: Core, m: int, s: float, z: float, axis: int) -> None:
    """A row of length m with innovation z, variance s, P h in scratch.d will be fused next: of position `axis`, or -1.

    Call before the covariance is changed.
    """
    for j in range(ONSETS):
        if c.drift.onset_ns[j] == NEVER_NS:
            continue
        first = 2 * j
        north, east = 0.0, 0.0
        for k in range(m):
            north -= c.scratch.values[k] * c.drift.bias_sensitivity[c.scratch.columns[k], first]
            east -= c.scratch.values[k] * c.drift.bias_sensitivity[c.scratch.columns[k], first + 1]
        if axis >= 0:
            since = 1e-9 * (c.nav.t_ns - c.drift.onset_ns[j])
            if axis == 0:
                north += since
            else:
                east += since
            c.drift.information_vector[j, 0] += north * z / s
            c.drift.information_vector[j, 1] += east * z / s
            c.drift.information_matrix[j, 0] += north * north / s
            c.drift.information_matrix[j, 1] += north * east / s
            c.drift.information_matrix[j, 2] += east * east / s
            c.drift.innovation_count[j] += 1
        for i in range(STATES):
            gain = c.scratch.d[i] / s
            c.drift.bias_sensitivity[i, first] += gain * north
            c.drift.bias_sensitivity[i, first + 1] += gain * east


@kernel
def estimate_drift(p: Parameters, c: Core, j: int, restless: float) -> Any:
    """Velocity north and east that the receiver has crept with since moment j, its covariance, and chi squared."""
    nn, ne, ee = c.drift.information_matrix[j, 0], c.drift.information_matrix[j, 1], c.drift.information_matrix[j, 2]
    determinant = nn * ee - ne * ne
    if not determinant > 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    pnn, pne, pee = ee / determinant, -ne / determinant, nn / determinant
    vn = pnn * c.drift.information_vector[j, 0] + pne * c.drift.information_vector[j, 1]
    ve = pne * c.drift.information_vector[j, 0] + pee * c.drift.information_vector[j, 1]
    pnn, pne, pee = (
        restless * pnn + p.tuning.min_drift_speed**2,
        restless * pne,
        restless * pee + p.tuning.min_drift_speed**2,
    )
    determinant = pnn * pee - pne * pne
    chi2 = (pee * vn * vn - 2.0 * pne * vn * ve + pnn * ve * ve) / determinant
    return vn, ve, pnn, pne, pee, chi2


@kernel
def remove_drift(c: Core, j: int, found: Any) -> None:
    """Take out of the estimate (gather in c.scratch.x) what creeping as found since moment j has done to it."""
    vn, ve, pnn, pne, pee = found[0], found[1], found[2], found[3], found[4]
    u, first = c.drift.bias_sensitivity, 2 * j
    for i in range(STATES):
        add_correction(c, i, -(u[i, first] * vn + u[i, first + 1] * ve))
        a = pnn * u[i, first] + pne * u[i, first + 1]
        b = pne * u[i, first] + pee * u[i, first + 1]
        for k in range(i, STATES):
            add_covariance(c, i, k, a * u[k, first] + b * u[k, first + 1])


@kernel
def learn_gnss_noise_scale(p: Parameters, c: Core, seen: float) -> None:
    """A receiver that has not been found to creep has seemed to, by `seen` times the variance expected.

    What was seen the time before is learned: what is seen now may yet be found to be creeping.
    """
    seen, c.drift.pending_noise_scale = c.drift.pending_noise_scale, seen
    if not seen > 0.0:
        return
    c.drift.noise_scale_count += 1
    share = max(p.tuning.drift_noise_scale_gain, 1.0 / (p.tuning.drift_noise_scale_prior + c.drift.noise_scale_count))
    c.drift.noise_scale = max(
        c.drift.noise_scale + share * (min(seen, p.tuning.max_drift_noise_scale) - c.drift.noise_scale),
        p.tuning.min_drift_noise_scale,
    )


@kernel
def detect_drift(p: Parameters, c: Core) -> bool:
    """After a position was taken: does the receiver creep? Then the correction to put back is in c.scratch.x."""
    best, worst, oldest, youngest_s = 0, 0.0, 0, math.inf
    for j in range(ONSETS):
        age = math.inf if c.drift.onset_ns[j] == NEVER_NS else 1e-9 * (c.nav.t_ns - c.drift.onset_ns[j])
        if c.drift.onset_ns[j] < c.drift.onset_ns[oldest]:
            oldest = j
        youngest_s = min(youngest_s, age)
        if p.tuning.min_drift_s < age < math.inf and c.drift.innovation_count[j] >= 2 * p.tuning.min_drift_fixes:
            chi2 = estimate_drift(p, c, j, c.drift.noise_scale)[5]
            if chi2 > worst:
                best, worst = j, chi2
    if worst > p.tuning.drift_chi2 and all_onsets_open(c):
        remove_drift(c, best, estimate_drift(p, c, best, c.drift.noise_scale))
        reset_drift(c)
        c.drift.detected = 1
        return True
    if youngest_s >= p.tuning.onset_interval_s:
        if c.drift.onset_ns[oldest] != NEVER_NS:
            learn_gnss_noise_scale(p, c, 0.5 * estimate_drift(p, c, oldest, 1.0)[5])
        open_hypothesis(c, oldest)
    return False
