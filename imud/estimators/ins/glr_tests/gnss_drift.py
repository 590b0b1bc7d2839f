"""The drift test: do the receiver's positions drift with a constant velocity that the vehicle does not have?

Each position of a drifting receiver is within its gate, so the filter follows the drift, a fault of
`fault_sensitivity` with three hypothetical onsets. From the innovations of the positions that are used, the drift
velocity since each onset is estimated by least squares, and its chi-square is compared with a threshold. When a drift
is detected, the fault is removed, and further positions are rejected (see `aiding.gnss_gate`). While it is likely, but
not detected, the solution states its effect as an error.

The position error of a receiver is not as large as the receiver reports. `noise_scale` is the ratio of the two
variances, learned from the drift estimates of onsets at which no drift was detected.

Source: as `fault_sensitivity`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..state import DRIFT_FAULT, EE, NE, NEVER_NS, NN, ONSETS, POSITION, POSITION_AXIS, VELOCITY, VELOCITY_AXIS
from .fault_sensitivity import open_column, remove_drift

BY_POSITIONS, BY_WHEELS = 1, 2  # what has detected a drift

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("onset_interval_s", 12.0, "s", "Time between two hypothetical onsets of a drift.", "Choice."),
    Tunable("min_drift_s", 5.0, "s", "Shortest drift that is tested.", "Choice."),
    Tunable("min_drift_fixes", 4, "fixes", "Least number of fixes in a drift that is tested.", "Choice."),
    Tunable(
        "min_drift_speed",
        0.05,
        "m/s",
        "Error of the estimated velocity that its sigma does not contain.",
        "The least sigma of a receiver's velocity.",
    ),
    Tunable(
        "likely_drift_chi2",
        6.0,
        "",
        "Chi-square (2 degrees of freedom) from which what a drift does is part of the stated sigma.",
        "Once in twenty.",
    ),
    Tunable("drift_chi2", 30.0, "", "Chi-square (2 degrees of freedom) that proves a drift.", "Once in three million."),
    Tunable(
        "min_drift_noise_scale",
        1.25,
        "",
        "Least ratio of the receiver's bias variance to the reported one.",
        "Simulated drifts.",
    ),
    Tunable(
        "first_drift_noise_scale",
        2.0,
        "",
        "First ratio of the receiver's bias variance to the reported one.",
        "Simulated drifts.",
    ),
    Tunable(
        "max_drift_noise_scale",
        10.0,
        "",
        "Largest ratio of the receiver's bias variance to the reported one.",
        "Simulated drifts.",
    ),
    Tunable("drift_noise_scale_prior", 5.0, "onsets", "Weight of first_drift_noise_scale.", "Choice."),
    Tunable(
        "drift_noise_scale_gain",
        0.05,
        "per onset",
        "Gain of the learned ratio of the receiver's bias variance to the reported one.",
        "About twenty onsets.",
        high=1.0,
    ),
)


@kernel
def clear_likely_drift(c: Core) -> None:
    """No drift is likely."""
    for i in range(2):
        c.drift.position_variance[i] = 0.0
        c.drift.velocity_variance[i] = 0.0


@kernel
def state_likely_drift(c: Core, j: int, drift: tuple[float, float], either: bool) -> None:
    """Store what the likely drift north and east, m/s, since onset j adds to the stated variances.

    either: instead of the positions the estimated velocity may be wrong, by as much the other way.
    """
    g, u, n = c.drift, c.faults.sensitivity, DRIFT_FAULT + 2 * j
    since_s = 1e-9 * (c.nav.t_ns - g.onset_ns[j])
    for i in range(2):
        p = u[POSITION + i, n] * drift[0] + u[POSITION + i, n + 1] * drift[1]
        v = u[VELOCITY + i, n] * drift[0] + u[VELOCITY + i, n + 1] * drift[1]
        g.position_variance[i] = max(g.position_variance[i], p * p)
        g.velocity_variance[i] = max(g.velocity_variance[i], v * v)
        if either:
            g.position_variance[i] = max(g.position_variance[i], (drift[i] * since_s - p) ** 2)
            g.velocity_variance[i] = max(g.velocity_variance[i], (drift[i] - v) ** 2)


@kernel
def state_detected_drift(c: Core) -> None:
    """Store what a detected drift adds to the stated variances while the estimated velocity may be wrong instead."""
    g = c.drift
    for i in range(2):
        g.position_variance[i] = (g.velocity[i] * 1e-9 * (c.nav.t_ns - g.since_ns)) ** 2
        g.velocity_variance[i] = g.velocity[i] ** 2


@kernel
def reset_drift(c: Core) -> None:
    """Close all onsets and clear the detection."""
    g = c.drift
    g.detected = 0
    g.pending_noise_scale = 0.0
    for j in range(ONSETS):
        g.onset_ns[j] = NEVER_NS
    clear_likely_drift(c)


@kernel
def all_onsets_open(c: Core) -> bool:
    """Whether every onset is open: positions have been used for as long as it takes to open them all."""
    g = c.drift
    return bool(min(g.onset_ns[0], g.onset_ns[1], g.onset_ns[2]) != NEVER_NS)


@kernel
def open_onset(c: Core, j: int) -> None:
    """Open onset j at the core's time: its sensitivity and its information are zero."""
    g = c.drift
    g.onset_ns[j] = c.nav.t_ns
    g.innovation_count[j] = 0
    for i in range(2):
        g.information_vector[j, i] = 0.0
    for i in range(3):
        g.information_matrix[j, i] = 0.0
    open_column(c, DRIFT_FAULT + 2 * j)
    open_column(c, DRIFT_FAULT + 2 * j + 1)


@kernel
def clear_detection(c: Core) -> None:
    """Clear the detection: the receiver's positions agree with the estimate again."""
    c.drift.detected = 0
    clear_likely_drift(c)


@kernel
def declare_drift(c: Core, by: int) -> None:
    """A drift was detected by something else than this test, which begins anew."""
    reset_drift(c)
    c.drift.detected = by


@kernel
def add_to_drift(c: Core, z: float, s: float, axis: int) -> None:
    """Add an innovation z of variance s that is fused, if it is of a horizontal position; axis: see `fuse`."""
    if not POSITION_AXIS <= axis < VELOCITY_AXIS:
        return
    g = c.drift
    for j in range(ONSETS):
        north = c.scratch.fault_innovation[DRIFT_FAULT + 2 * j]
        east = c.scratch.fault_innovation[DRIFT_FAULT + 2 * j + 1]
        if g.onset_ns[j] != NEVER_NS:
            g.information_vector[j, 0] += north * z / s
            g.information_vector[j, 1] += east * z / s
            g.information_matrix[j, NN] += north * north / s
            g.information_matrix[j, NE] += north * east / s
            g.information_matrix[j, EE] += east * east / s
            g.innovation_count[j] += 1


@kernel
def estimate_drift(
    p: Parameters, c: Core, j: int, noise_scale: float
) -> tuple[float, float, float, float, float, float]:
    """Drift velocity since onset j: north, east (m/s), covariance nn, ne, ee (m^2/s^2), chi-square.

    The covariance is that of the innovations times `noise_scale`, plus min_drift_speed squared.
    """
    g = c.drift
    nn, ne, ee = g.information_matrix[j, NN], g.information_matrix[j, NE], g.information_matrix[j, EE]
    determinant = nn * ee - ne * ne
    if not determinant > 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    pnn, pne, pee = ee / determinant, -ne / determinant, nn / determinant
    vn = pnn * g.information_vector[j, 0] + pne * g.information_vector[j, 1]
    ve = pne * g.information_vector[j, 0] + pee * g.information_vector[j, 1]
    pnn, pne, pee = (
        noise_scale * pnn + p.tuning.min_drift_speed**2,
        noise_scale * pne,
        noise_scale * pee + p.tuning.min_drift_speed**2,
    )
    determinant = pnn * pee - pne * pne
    chi2 = (pee * vn * vn - 2.0 * pne * vn * ve + pnn * ve * ve) / determinant
    return vn, ve, pnn, pne, pee, chi2


@kernel
def explained_by_drift(p: Parameters, c: Core) -> float:
    """Most of the sum of the normalised innovations squared of positions that a drift since an onset explains.

    With the learned variance of the positions.
    """
    g, most = c.drift, 0.0
    for j in range(ONSETS):
        if g.onset_ns[j] != NEVER_NS:
            north, east, _, _, _, _ = estimate_drift(p, c, j, g.noise_scale)
            most = max(most, north * g.information_vector[j, 0] + east * g.information_vector[j, 1])
    return float(most / g.noise_scale)


@kernel
def learn_gnss_noise_scale(p: Parameters, c: Core, ratio: float) -> None:
    """Learn from `ratio`, the squared drift velocity over its variance, of an onset at which no drift was detected.

    The value of the onset before is learned, and `ratio` is pending: a drift that has begun may not be detected yet.
    """
    g = c.drift
    ratio, g.pending_noise_scale = g.pending_noise_scale, ratio
    if not ratio > 0.0:
        return
    g.noise_scale_count += 1
    share = max(p.tuning.drift_noise_scale_gain, 1.0 / (p.tuning.drift_noise_scale_prior + g.noise_scale_count))
    g.noise_scale = max(
        g.noise_scale + share * (min(ratio, p.tuning.max_drift_noise_scale) - g.noise_scale),
        p.tuning.min_drift_noise_scale,
    )


@kernel
def detect_drift(p: Parameters, c: Core, either: bool) -> bool:
    """After a position was fused: True if a drift is detected; then its correction is in scratch.x, not injected.

    either: see `state_likely_drift`.
    """
    g = c.drift
    best, worst, oldest, youngest_s = 0, 0.0, 0, math.inf
    clear_likely_drift(c)
    for j in range(ONSETS):
        age = math.inf if g.onset_ns[j] == NEVER_NS else 1e-9 * (c.nav.t_ns - g.onset_ns[j])
        if g.onset_ns[j] < g.onset_ns[oldest]:
            oldest = j
        youngest_s = min(youngest_s, age)
        if p.tuning.min_drift_s < age < math.inf and g.innovation_count[j] >= 2 * p.tuning.min_drift_fixes:
            north, east, _, _, _, chi2 = estimate_drift(p, c, j, g.noise_scale)
            if chi2 > p.tuning.likely_drift_chi2:
                state_likely_drift(c, j, (north, east), either)
            if chi2 > worst:
                best, worst = j, chi2
    if worst > p.tuning.drift_chi2 and all_onsets_open(c):
        north, east, nn, ne, ee, _ = estimate_drift(p, c, best, g.noise_scale)
        remove_drift(c, DRIFT_FAULT + 2 * best, (north, east), nn, ne, ee)
        g.since_ns, g.velocity[0], g.velocity[1] = g.onset_ns[best], north, east
        reset_drift(c)
        g.detected = BY_POSITIONS
        return True
    if youngest_s >= p.tuning.onset_interval_s:
        if g.onset_ns[oldest] != NEVER_NS:
            _, _, _, _, _, chi2 = estimate_drift(p, c, oldest, 1.0)
            learn_gnss_noise_scale(p, c, 0.5 * chi2)
        open_onset(c, oldest)
    return False
