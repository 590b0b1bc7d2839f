"""The age of fixes beyond their epochs, found before the heading: a receiver whose stamps are late by a second.

While the heading is sought, a velocity that is matched with the specific force of another time gives a wrong heading,
and the time offset is then learned with it. So before that a bank of ages compares, between two fixes, the receiver's
acceleration A with that of the integrals of level specific force at both epochs less each age, a. Both are complex,
north + i east, and

    A = exp(i psi) (a + x1 + x2 G + x3 exp(i y)) + noise

with the unknown heading psi of the level frame and the nuisance parameters x of `force_integrals`: tilt, gyro bias and
accelerometer bias. Psi and x are eliminated by least squares, with the filter's covariance before the first pair in
motion as the prior of x. Corrections since then are not in a: levelling takes a slow acceleration for tilt, and what it
leaves of it comes earlier, so that right fixes look late.

The variance of the noise is not known either, as an engine shakes the sensor. With an inverse gamma prior from the
stated noise of the fixes it is integrated out: the likelihood of an age is then a power of its residual energy, so that
a few pairs, which some age always explains, prove nothing. The prior of the age is a mixture: the filter's time offset
with its sigma, or any age at all. An age proves nothing that does not explain most of the acceleration, as with a wrong
lever arm.

While an error of the time offset that the alignment does not bear is the more probable one, no heading is accepted;
once it is certain, the time offset is set to the age, and the alignment begins again.

Source: multiple-model estimation (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking, 11.6), as
in `aiding.source_age`; complex least squares; Gelman et al., Bayesian Data Analysis (2013), 3.2, for the variance.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.rotation import quat_rotate
from ...tuning import Tunable
from ..aiding.gnss_time import set_time_offset
from ..aiding.gnss_velocity import velocity_of
from ..ekf import variance
from ..lever_arm import velocity_of_point
from ..mechanization import ned_difference
from ..state import AGE_STEP_NS, AGES, COARSE_ALIGNMENT, HORIZONTAL, NEVER_NS, NO_AGE, SNAPSHOTS, TIME_OFFSET
from .force_integrals import DELTA_V, Complex, add_corrections, add_scaled, multiply, phasor
from .heading_posterior import eliminate_nuisance, move_prior_to_origin, residual_product, set_prior
from .hypothesis_bank import GNSS_COLUMN, INERTIAL_COLUMN, accumulate_products
from .in_motion import reset_to_fix
from .velocity_pairs import is_levelled, restart_in_motion_alignment

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import Alignment, Core, FixAge, Imu, Nav, Parameters, State

TUNABLES = (
    Tunable("fix_age_memory_s", 60.0, "s", "Time constant of the sums over pairs.", "Gyro bias turns the level frame."),
    Tunable("fix_age_accel_sigma", 0.1, "m/s^2", "Least noise of a pair's acceleration.", "Scale errors, vibration."),
    Tunable("fix_age_noise_weight", 4.0, "", "Residuals that count as much as the stated noise of fixes.", "Choice."),
    Tunable("fix_age_min_pairs", 5.0, "pairs", "Pairs of fixes from which an age is sought.", "Choice."),
    Tunable(
        "fix_age_pair_share",
        0.9,
        "",
        "Least share of the pairs that an age has which is compared with the others.",
        "Choice.",
        high=0.99,
    ),
    Tunable("fix_age_residual", 0.4, "", "Largest share of the acceleration that the age may not explain.", "Choice."),
    Tunable("fix_age_prior", 0.01, "", "Probability of any age at all.", "Choice.", high=0.5),
    Tunable("fix_age_tolerance", 0.25, "s", "Error of the time offset that the alignment bears.", "Simulated starts."),
    Tunable("fix_age_certainty", 0.99, "", "Probability of a larger error that is certain.", "Choice.", high=1.0),
    Tunable("fix_age_sigma", 0.15, "s", "Largest sigma of an age that the time offset is set to.", "Choice."),
)
PAIRS, MOVING = 0, 1  # columns of the counts: all pairs, those in motion
FITTED_PARAMETERS = 4.0  # the heading, the age, and the degrees of freedom that the nuisance parameters take


@kernel
def store_integrals(g: FixAge, k: int, a: Alignment, nav: Nav, imu: Imu) -> None:
    """g.around[k] <- integrals, m/s, and double integrals, m, of a state, of the antenna and without corrections."""
    v, arm, q = velocity_of_point(nav, imu, nav.gnss_lever_arm), nav.gnss_lever_arm, nav.q_nb
    antenna, azimuth = quat_rotate((q[0], q[1], q[2], q[3]), (arm[0], arm[1], arm[2])), phasor(a.frame_azimuth)
    turning = multiply(azimuth, (v[0] - nav.v_n[0], v[1] - nav.v_n[1]))
    place = multiply(azimuth, (antenna[0], antenna[1]))
    for i in range(4):
        for j in range(2):
            g.around[k, 0, i, j], g.around[k, 1, i, j] = a.integrals[i, j], a.double_integrals[i, j]
    for j in range(3):
        for i in range(2):
            g.undone[j, i] = -a.applied_corrections[j, i]
    add_corrections(g.undone, g.around[k, 0], DELTA_V)
    add_corrections(g.undone, g.around[k, 1], DELTA_V)
    add_scaled(g.around[k, 0, DELTA_V], turning, 1.0)
    add_scaled(g.around[k, 1, DELTA_V], place, 1.0)


@kernel
def compare_age(
    g: FixAge,
    i: int,
    earlier: int,
    share: float,
    dt: float,
    reported: bool,
    change: Complex,
    weight: float,
    moving: bool,
) -> None:
    """Add the pair of the last fix and this one at age i, `share` of the way between the states in g.around.

    earlier: which of these is the earlier one. A share of NaN: the integrals then are unknown. change: the receiver's
    acceleration, of variance 1 / weight. moving: the vehicle is not at rest.
    """
    last, pair = g.integrals[i], g.pair
    pair[GNSS_COLUMN, 0], pair[GNSS_COLUMN, 1] = change
    before, after = g.around[earlier], g.around[1 - earlier]
    for j in range(4):
        for k in range(2):
            velocity = before[0, j, k] + share * (after[0, j, k] - before[0, j, k])
            place = before[1, j, k] + share * (after[1, j, k] - before[1, j, k])
            if not reported:
                velocity = (place - last[1, j, k]) / dt
            pair[INERTIAL_COLUMN + j, k] = (velocity - last[0, j, k]) / dt
            last[0, j, k], last[1, j, k] = velocity, place
    add_corrections(g.corrections, pair, INERTIAL_COLUMN)
    if math.isfinite(pair[INERTIAL_COLUMN, 0]) and math.isfinite(change[0]):
        accumulate_products(g.products[i], pair, weight)
        g.counts[i, PAIRS] += 1.0
        g.counts[i, MOVING] += 1.0 if moving else 0.0


@kernel
def discount_pairs(g: FixAge, factor: float) -> None:
    """Multiply the sums over pairs by `factor`, 0 to 1."""
    g.products *= factor
    g.counts *= factor


@kernel
def is_moving(g: FixAge) -> bool:
    """Whether there is a pair in motion."""
    for i in range(AGES):
        if g.counts[i, MOVING] > 0.0:
            return True
    return False


@kernel
def begin_pairs(c: Core, g: FixAge) -> None:
    """Clear the sums; from now on the corrections that the filter has made so far are in the accelerations."""
    discount_pairs(g, 0.0)
    for j in range(3):
        for i in range(2):
            g.corrections[j, i] = c.alignment.applied_corrections[j, i] + c.alignment.corrections[j, i]
    set_prior(c, g.prior)
    move_prior_to_origin(c, g.prior)


@kernel
def residual_energy(g: FixAge, i: int) -> tuple[float, float]:
    """Least squares of the equation at age i, in units of the noise, and of the receiver's acceleration without a."""
    eliminate_nuisance(g.gain, g.inverse, g.prior, g.products[i])
    both = residual_product(g.gain, g.products[i], INERTIAL_COLUMN, GNSS_COLUMN)
    inertial2 = residual_product(g.gain, g.products[i], INERTIAL_COLUMN, INERTIAL_COLUMN)[0]
    gnss2 = residual_product(g.gain, g.products[i], GNSS_COLUMN, GNSS_COLUMN)[0]
    return max(inertial2 + gnss2 - 2.0 * elementary.hypot(both[0], both[1]), 0.0), gnss2


@kernel
def compare_ages(p: Parameters, s: State, fix: Fix, with_velocity: bool) -> None:
    """Add the pair of the last fix and this one at each age.

    Without a reported velocity that is used, that of the fix, and of the integrals, are the means since the last fix.
    """
    g, c = s.fix_age, s.core[0]
    dt = 1e-9 * (fix.t_ns - g.last_ns) if g.last_ns != NEVER_NS else math.inf
    paired, restarted = dt < p.tuning.vector_pair_max_s, g.origin_ns != c.alignment.origin_ns
    if restarted or not is_moving(g):
        begin_pairs(c, g)
    decay = elementary.exp(-dt / p.tuning.fix_age_memory_s) if paired else 1.0
    if not paired or restarted or not is_levelled(p, c):
        g.integrals[:] = math.nan
    vn, ve = velocity_of(p, fix, 0), velocity_of(p, fix, 1)
    reported = with_velocity and math.isfinite(vn) and math.isfinite(ve)
    noise = 2.0 * c.gnss.velocity_noise_var / (dt * dt) if reported else 6.0 * c.gnss.noise_var[HORIZONTAL] / dt**4
    if not reported:
        north, east = ned_difference(c, g.lat, g.lon, fix.lat, fix.lon)
        vn, ve = north / dt, east / dt
    change = ((vn - g.velocity[0]) / dt, (ve - g.velocity[1]) / dt)
    weight, moving = 1.0 / max(noise, p.tuning.fix_age_accel_sigma**2), not c.stationarity.at_rest
    discount_pairs(g, decay)
    k, oldest = s.snapshot_count, max(0, s.snapshot_count - SNAPSHOTS)
    before_ns, after_ns, earlier = c.nav.t_ns, c.nav.t_ns, 0
    store_integrals(g, 0, c.alignment, c.nav, c.imu)
    store_integrals(g, 1, c.alignment, c.nav, c.imu)
    for i in range(AGES):
        t_ns = fix.t_ns - (i - NO_AGE) * AGE_STEP_NS
        while before_ns > t_ns and k > oldest:
            k -= 1
            e = s.snapshots[k % SNAPSHOTS]
            if e.alignment.mode != COARSE_ALIGNMENT or e.alignment.origin_ns != c.alignment.origin_ns:
                k = oldest
            else:
                after_ns, before_ns, earlier = before_ns, e.nav.t_ns, 1 - earlier
                store_integrals(g, earlier, e.alignment, e.nav, e.imu)
        share = (t_ns - before_ns) / max(after_ns - before_ns, 1) if before_ns <= t_ns <= after_ns else math.nan
        compare_age(g, i, earlier, share, dt, reported, change, weight, moving)
    g.last_ns, g.origin_ns = fix.t_ns, c.alignment.origin_ns
    g.velocity[0], g.velocity[1], g.lat, g.lon = vn, ve, fix.lat, fix.lon


@kernel
def find_posterior(p: Parameters, c: Core, g: FixAge) -> None:
    """g.age, g.variance <- those of the posterior; g.probability <- of an error that the alignment does not bear.

    Without a posterior the latter two are 0.
    """
    g.probability = g.variance = 0.0
    energy = np.empty(AGES)
    best, most, accel2 = -1, 0.0, 0.0
    for i in range(AGES):
        most = max(most, g.counts[i, PAIRS])
    for i in range(AGES):
        energy[i] = math.inf
        if most >= p.tuning.fix_age_min_pairs and g.counts[i, PAIRS] > p.tuning.fix_age_pair_share * most:
            energy[i], gnss2 = residual_energy(g, i)
            if best < 0 or energy[i] < energy[best]:
                best, accel2 = i, gnss2
    if best < 0 or energy[best] > p.tuning.fix_age_residual * accel2:
        return
    weight = p.tuning.fix_age_noise_weight
    residuals = max(2.0 * g.counts[best, MOVING] - FITTED_PARAMETERS, 0.0)
    exponent = 0.5 * (residuals + weight) / p.tuning.correlation_factor
    step, offset = 1e-9 * AGE_STEP_NS, c.nav.time_offset
    spread, total = variance(c, TIME_OFFSET) + step * step / 12.0, 0.0
    for i in range(AGES):
        total += elementary.exp(-0.5 * (step * (i - NO_AGE) - offset) ** 2 / spread)
    mass, mean, square, wrong = 0.0, 0.0, 0.0, 0.0
    for i in range(AGES):
        age = step * (i - NO_AGE)
        prior = (1.0 - p.tuning.fix_age_prior) * elementary.exp(-0.5 * (age - offset) ** 2 / spread) / total
        likelihood = 0.0  # of an age that there are no pairs for
        if energy[i] < math.inf:
            ratio = (energy[i] + weight) / (energy[best] + weight)
            likelihood = elementary.exp(-exponent * elementary.log(ratio))
        posterior = (prior + p.tuning.fix_age_prior / AGES) * likelihood
        mass += posterior
        mean += posterior * age
        square += posterior * age * age
        if abs(age - offset) > p.tuning.fix_age_tolerance:
            wrong += posterior
    g.age = mean / mass
    g.variance = max(square / mass - g.age * g.age, 0.0) + step * step / 12.0
    g.probability = wrong / mass


@kernel
def forget_fix_age(g: FixAge) -> None:
    """Nothing is known of the age."""
    g.last_ns, g.origin_ns, g.probability, g.variance = NEVER_NS, NEVER_NS, 0.0, 0.0


@kernel
def learn_fix_age(p: Parameters, s: State, fix: Fix, with_velocity: bool) -> None:
    """Compare a fix at all ages, before the rewind to its epoch; only while the heading is sought.

    with_velocity: the velocity that it reports is used.
    """
    g, c = s.fix_age, s.core[0]
    if c.alignment.mode != COARSE_ALIGNMENT or c.alignment.heading_sigma > 0.0:
        forget_fix_age(g)
        return
    if g.last_ns != NEVER_NS and 1e-9 * (fix.t_ns - g.last_ns) < p.tuning.pair_min_s:
        return
    compare_ages(p, s, fix, with_velocity)
    find_posterior(p, c, g)


@kernel
def is_fix_age_found(p: Parameters, g: FixAge) -> bool:
    """Whether the time offset is wrong for certain, and the age known."""
    return bool(g.probability > p.tuning.fix_age_certainty and g.variance < p.tuning.fix_age_sigma**2)


@kernel
def mean_square_error(c: Core, g: FixAge) -> float:
    """Mean square of the time offset's error, s^2, by the posterior of the age; 0 where there is none."""
    return float((g.age - c.nav.time_offset) ** 2 + g.variance) if g.variance > 0.0 else 0.0


@kernel
def use_fix_age(p: Parameters, c: Core, g: FixAge, fix: Fix) -> None:
    """From a rewound core: set the time offset to the age, and begin the alignment again with the fix."""
    set_time_offset(c, g.age, g.variance)
    g.probability = g.variance = 0.0
    restart_in_motion_alignment(c)
    reset_to_fix(p, c, fix)
