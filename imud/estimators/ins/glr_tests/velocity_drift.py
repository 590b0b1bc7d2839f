"""GLR test for a receiver whose positions and velocities drift alike; it runs where wheels support the velocity.

Positions and velocities of such a receiver agree with each other, so without wheels the filter follows it. With wheels
the two contradict each other, and the innovations show it (`fault_sensitivity`). On a straight road a drift across it
looks like a heading error; P says how large that may be. Where the motion has not confirmed the heading yet, a step of
it is a third unknown, which is eliminated. Velocities count, those of a second together. The first onset is the last
fix after which no drift is likely, or that before a fix which a drift since then does not explain: the filter would
have followed a drift that began before, so one that begins now looks otherwise. The others are kept for longer.

When a drift is detected, here or by `aiding.wheel_check`, the fault is removed, and the receiver is rejected. If there
was no fix for a while after its onset, it may have begun at any time in that gap, which the position's variance gets.
While it is likely, but not detected, the solution states V d as an error.

Source: as `fault_sensitivity`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_variance
from ..state import (
    ATTITUDE,
    EE,
    EH,
    HH,
    NE,
    NEVER_NS,
    NH,
    NN,
    ONSETS,
    POSITION,
    VELOCITY,
    VELOCITY_AXIS,
    VELOCITY_DRIFT_FAULT,
)
from .fault_sensitivity import open_column, remove_drift, set_sensitivity

if TYPE_CHECKING:
    from ..types import Core, Parameters

UNKNOWNS = 3  # of an onset: drift velocity north and east, step of the heading
TUNABLES = (
    Tunable(
        "velocity_drift_onset_s",
        16.0,
        "s",
        "Longest age of a drift's first onset, in position and velocity; of each further one twice as long.",
        "A goal: found within 30 s.",
    ),
    Tunable(
        "velocity_drift_chi2",
        30.0,
        "",
        "Chi-square (2 degrees of freedom) that proves a drift in position and velocity.",
        "Once in three million.",
    ),
    Tunable(
        "likely_velocity_drift_chi2",
        6.0,
        "",
        "Chi-square (2 degrees of freedom) from which a drift in position and velocity is in the stated sigma.",
        "Once in twenty.",
    ),
    Tunable(
        "min_velocity_drift_s",
        5.0,
        "s",
        "Least age of an onset at which a drift in position and velocity is detected.",
        "A slip of a wheel, which may be believed for a while, is mostly shorter.",
    ),
    Tunable("min_velocity_drift", 0.1, "m/s", "Velocity error of wheels and receiver beyond their sigmas.", "Choice."),
    Tunable(
        "velocity_drift_correlation_s",
        1.0,
        "s",
        "Velocities of so long share their error.",
        "Receivers of 1 Hz are white.",
    ),
    Tunable(
        "heading_confirmations",
        20,
        "fixes",
        "So many fixes that a wrong heading would contradict confirm it.",
        "Choice.",
    ),
    Tunable(
        "unconfirmed_heading_sigma",
        math.radians(30.0),
        "rad",
        "Sigma of a heading step where the motion has not confirmed the heading.",
        "Choice.",
    ),
)


@kernel
def reset_velocity_drift(c: Core) -> None:
    """Close all onsets."""
    g = c.velocity_drift
    for j in range(ONSETS):
        g.onset_ns[j] = NEVER_NS
    for i in range(2):
        g.position_variance[i] = 0.0
        g.velocity_variance[i] = 0.0
    g.heading_variance = 0.0


@kernel
def reset_confirmations(c: Core) -> None:
    """Count confirmations of the heading from zero: it is new, or may be wrong."""
    reset_velocity_drift(c)
    c.velocity_drift.confirmations = 0


@kernel
def count_confirmation(p: Parameters, c: Core, agrees: bool) -> None:
    """Count a fix that a wrong heading would contradict: it agrees, or does not."""
    g = c.velocity_drift
    if agrees:
        g.confirmations += 1
    elif g.confirmations < p.tuning.heading_confirmations:
        g.confirmations = 0


@kernel
def column_of(j: int) -> int:
    """Of onset j, the first of its sensitivities."""
    return VELOCITY_DRIFT_FAULT + UNKNOWNS * j


@kernel
def open_velocity_drift(c: Core, j: int) -> None:
    """Open onset j at the core's time."""
    g = c.velocity_drift
    g.onset_ns[j] = c.nav.t_ns
    g.energy[j] = 0.0
    g.count[j] = 0.0
    for i in range(UNKNOWNS):
        g.vector[j, i] = 0.0
        open_column(c, column_of(j) + i)
    for i in range(6):
        g.information[j, i] = 0.0
    set_sensitivity(c, ATTITUDE + 2, column_of(j) + 2, -1.0)


@kernel
def add_to_velocity_drift(p: Parameters, c: Core, z: float, s: float, axis: int) -> None:
    """Add an innovation z of variance s of a fix, used or not, if it is a horizontal velocity; axis: see `fuse`."""
    g = c.velocity_drift
    if axis < VELOCITY_AXIS or g.onset_ns[0] == NEVER_NS:
        return
    weight = min(1e-9 * (c.nav.t_ns - g.last_ns) / p.tuning.velocity_drift_correlation_s, 1.0) / s
    mean = c.scratch.fault_innovation
    for j in range(ONSETS):
        if g.count[j] == 0.0:
            g.gap_s[j] = 1e-9 * (c.nav.t_ns - g.onset_ns[j])
        north, east, turned = mean[column_of(j)], mean[column_of(j) + 1], mean[column_of(j) + 2]
        g.vector[j, 0] += weight * north * z
        g.vector[j, 1] += weight * east * z
        g.vector[j, 2] += weight * turned * z
        g.information[j, NN] += weight * north * north
        g.information[j, NE] += weight * north * east
        g.information[j, EE] += weight * east * east
        g.information[j, NH] += weight * north * turned
        g.information[j, EH] += weight * east * turned
        g.information[j, HH] += weight * turned * turned
        g.energy[j] += weight * z * z
        g.count[j] += weight * s


@kernel
def heading_step_share(p: Parameters, c: Core, j: int) -> float:
    """Variance of the heading step since onset j, rad^2, if there is no drift; 0 where the heading is confirmed."""
    if c.velocity_drift.confirmations >= p.tuning.heading_confirmations:
        return 0.0
    return float(1.0 / (c.velocity_drift.information[j, HH] + 1.0 / p.tuning.unconfirmed_heading_sigma**2))


@kernel
def estimate_velocity_drift(p: Parameters, c: Core, j: int) -> Any:
    """Drift velocity since onset j: north, east (m/s), covariance nn, ne, ee, chi-square, explained sum of squares."""
    g = c.velocity_drift
    m, v = g.information[j], g.vector[j]
    share = heading_step_share(p, c, j)
    nn, ne, ee = m[NN] - share * m[NH] ** 2, m[NE] - share * m[NH] * m[EH], m[EE] - share * m[EH] ** 2
    yn, ye = v[0] - share * m[NH] * v[2], v[1] - share * m[EH] * v[2]
    determinant = nn * ee - ne * ne
    if not determinant > 1e-9 * nn * ee:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    pnn, pne, pee = ee / determinant, -ne / determinant, nn / determinant
    north, east = pnn * yn + pne * ye, pne * yn + pee * ye
    explained = north * yn + east * ye
    rest = g.energy[j] - share * v[2] ** 2 - explained
    scale = max(rest / max(g.count[j] - 2.0, 1.0), 1.0)
    least2 = p.tuning.min_velocity_drift**2
    pnn, pne, pee = scale * pnn + least2, scale * pne, scale * pee + least2
    determinant = pnn * pee - pne * pne
    chi2 = (pee * north * north - 2.0 * pne * north * east + pnn * east * east) / determinant
    return north, east, pnn, pne, pee, chi2, explained


@kernel
def renew_contradicted_onset(p: Parameters, c: Core, z: tuple[float, float], s: tuple[float, float]) -> None:
    """Before a velocity is fused that contradicts the estimate: open the first onset anew unless it explains that.

    z, s: innovations of the fix, north and east, m/s, and their variances. Not of a drift that is proven, and only
    where the heading is confirmed: a step of it would explain innovations, too.
    """
    g, u, n = c.velocity_drift, c.faults.sensitivity, column_of(0)
    if g.onset_ns[0] == NEVER_NS or g.confirmations < p.tuning.heading_confirmations:
        return
    north, east, _, _, _, chi2, _ = estimate_velocity_drift(p, c, 0)
    if chi2 > p.tuning.velocity_drift_chi2:
        return
    mean_n = north - u[VELOCITY, n] * north - u[VELOCITY, n + 1] * east
    mean_e = east - u[VELOCITY + 1, n] * north - u[VELOCITY + 1, n + 1] * east
    energy = z[0] * z[0] / s[0] + z[1] * z[1] / s[1]
    explained = mean_n * (2.0 * z[0] - mean_n) / s[0] + mean_e * (2.0 * z[1] - mean_e) / s[1]
    if energy > p.tuning.wheel_check_gate and explained < 0.5 * energy:
        open_velocity_drift(c, 0)


@kernel
def explained_by_velocity_drift(p: Parameters, c: Core) -> float:
    """Most of the sum of the normalised innovations squared that drift and heading step since an onset explain.

    Of drifts that are fast enough to be detected.
    """
    g, most = c.velocity_drift, 0.0
    for j in range(ONSETS):
        if g.onset_ns[j] != NEVER_NS:
            north, east, _, _, _, _, explained = estimate_velocity_drift(p, c, j)
            if elementary.hypot(north, east) > p.tuning.wheel_min_contradiction:
                most = max(most, explained + heading_step_share(p, c, j) * g.vector[j, 2] ** 2)
    return float(most)


@kernel
def drift_is_likely(c: Core) -> bool:
    """Whether the last fix left such a drift likely."""
    return bool(c.velocity_drift.position_variance[0] + c.velocity_drift.position_variance[1] > 0.0)


@kernel
def state_likely_drift(c: Core, j: int, north: float, east: float) -> None:
    """Store what the likely drift north and east, m/s, since onset j adds to the stated variances."""
    g, u, n = c.velocity_drift, c.faults.sensitivity, column_of(j)
    for i in range(2):
        p = u[POSITION + i, n] * north + u[POSITION + i, n + 1] * east
        v = u[VELOCITY + i, n] * north + u[VELOCITY + i, n + 1] * east
        g.position_variance[i] = max(g.position_variance[i], p * p)
        g.velocity_variance[i] = max(g.velocity_variance[i], v * v)
    turned = u[ATTITUDE + 2, n] * north + u[ATTITUDE + 2, n + 1] * east
    g.heading_variance = max(g.heading_variance, turned * turned)


@kernel
def store_drift(c: Core, north: float, east: float) -> None:
    """The velocity, m/s, of the drift that was detected."""
    c.velocity_drift.drift[0], c.velocity_drift.drift[1] = north, east


@kernel
def remove_velocity_drift(p: Parameters, c: Core, j: int) -> tuple[float, float]:
    """Gather in scratch.x the correction for a drift since onset j, and add its covariance to P; the drift, m/s."""
    north, east, nn, ne, ee, _, _ = estimate_velocity_drift(p, c, j)
    remove_drift(c, column_of(j), (north, east), nn, ne, ee)
    later2 = c.velocity_drift.gap_s[j] ** 2 / 3.0  # mean square of a time within the gap
    add_variance(c, POSITION, north * north * later2)
    add_variance(c, POSITION + 1, east * east * later2)
    return north, east


@kernel
def remove_most_likely_drift(p: Parameters, c: Core) -> None:
    """The same since the onset that explains most, if there is one: the drift was detected by something else."""
    best, most = -1, 0.0
    for j in range(ONSETS):
        if c.velocity_drift.onset_ns[j] != NEVER_NS:
            _, _, _, _, _, _, explained = estimate_velocity_drift(p, c, j)
            if explained > most:
                best, most = j, explained
    if best >= 0:
        remove_velocity_drift(p, c, best)


@kernel
def detect_velocity_drift(p: Parameters, c: Core, explained_otherwise: float) -> float:
    """After the velocity of a fix: the speed of a drift that is detected, m/s, else 0.

    Its correction is in scratch.x then, not injected, and its velocity in `drift` of the record. explained_otherwise:
    sum of the normalised innovations squared that another cause explains; a drift has to explain more.
    """
    g, best, most = c.velocity_drift, -1, 0.0
    g.last_ns = c.nav.t_ns
    for i in range(2):
        g.position_variance[i] = 0.0
        g.velocity_variance[i] = 0.0
    g.heading_variance = 0.0
    for j in range(ONSETS):
        if g.onset_ns[j] != NEVER_NS and g.count[j] >= 3.0:
            north, east, _, _, _, chi2, explained = estimate_velocity_drift(p, c, j)
            if explained > explained_otherwise and chi2 > p.tuning.likely_velocity_drift_chi2:
                state_likely_drift(c, j, north, east)
            fast = elementary.hypot(north, east) > p.tuning.wheel_min_contradiction
            if fast and explained > explained_otherwise and chi2 > most:
                best, most = j, chi2
    waits = best >= 0 and 1e-9 * (c.nav.t_ns - g.onset_ns[best]) < p.tuning.min_velocity_drift_s
    if most > p.tuning.velocity_drift_chi2 and not waits:
        north, east = remove_velocity_drift(p, c, best)
        store_drift(c, north, east)
        reset_velocity_drift(c)
        return float(elementary.hypot(north, east))
    renew_onsets(p, c)
    return 0.0


@kernel
def renew_onsets(p: Parameters, c: Core) -> None:
    """Open the first onset anew unless a drift since then explains much; open anew those that are too old.

    A gap without fixes does not age an onset: the first fix after it may be the first of a drift.
    """
    g, longest_s = c.velocity_drift, p.tuning.velocity_drift_onset_s
    for j in range(ONSETS):
        gap_s = g.gap_s[j] if g.count[j] > 0.0 else 0.0
        too_old = 1e-9 * (c.nav.t_ns - g.onset_ns[j]) - gap_s >= longest_s
        renewed = too_old
        if j == 0 and not too_old:
            _, _, _, _, _, _, explained = estimate_velocity_drift(p, c, j)
            renewed = explained < p.tuning.likely_velocity_drift_chi2
        if renewed:
            open_velocity_drift(c, j)
        longest_s *= 2.0
