"""Fixes for the alignment: each is matched with the integrals of specific force; pairs of them level the frame.

The equation is in `force_integrals`. This file decides which velocity or position of a fix is matched, with which
variance, and for how long matched fixes are compared.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import STANDARD_GRAVITY
from ...tuning import Tunable
from ..ekf import innovation_variance, set_jacobian3, variance
from ..mechanization import ned_difference, rotation_matrix
from ..state import ATTITUDE, COARSE_ALIGNMENT, GYRO_BIAS, HORIZONTAL, NAVIGATING, NEVER_NS, TIME_OFFSET, VELOCITY_NOISE
from .force_integrals import DELTA_V, TIME, Complex, clear_integrals, element, multiply, phasor
from .hypothesis_bank import (
    antenna_offset,
    apply_corrections,
    clear_hypotheses,
    discount,
    match_measurement,
    nearest_hypothesis,
    propagate_hypotheses,
)
from .levelling import level_from_velocity_change
from .vector_pairs import restart_vectors
from .whitening import predict_whitening, reset_whitening, whitened_innovations, whitened_variance

if TYPE_CHECKING:
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable("pair_min_s", 0.9, "s", "Shortest time between two fixes of a pair.", "1 Hz receivers with jitter."),
    Tunable("pair_max_s", 6.0, "s", "Longest time between two positions of a pair.", "Choice."),
    Tunable("pair_velocity_sigma", 0.4, "m/s", "Sigma of a velocity change differenced from positions.", "Choice."),
    Tunable(
        "match_gate",
        25.0,
        "NIS",
        "Gate of velocity changes that the integrated specific force must explain.",
        "Five sigma.",
    ),
    Tunable(
        "match_min_duration_s",
        100.0,
        "s",
        "Least time over which velocities and integrated specific force are compared.",
        "Biases are taken as constant.",
    ),
    Tunable(
        "match_max_duration_s",
        400.0,
        "s",
        "Longest time over which velocities and integrated specific force are compared.",
        "Biases are taken as constant.",
    ),
    Tunable(
        "match_rotation",
        math.radians(20.0),
        "rad",
        "Largest unknown rotation of the level frame over which velocities and integrated specific force are compared.",
        "Distance between hypotheses.",
    ),
    Tunable(
        "match_outage_share",
        0.2,
        "",
        "Outage, as a share of the compared time, after which the comparison starts again.",
        "Choice.",
        high=1.0,
    ),
    Tunable(
        "levelled_sigma", math.radians(6.0), "rad", "Largest tilt sigma to start navigation with.", "Linearization."
    ),
)


@kernel
def start_pair(c: Core, lat: float, lon: float, vn: float, ve: float) -> None:
    """Store this fix (rad; m/s) and the integrals as the first of the next pair."""
    a = c.alignment
    a.pair_start_ns = c.nav.t_ns
    for k in range(4):
        for i in range(2):
            a.pair_integrals[k, i], a.pair_double_integrals[k, i] = a.integrals[k, i], a.double_integrals[k, i]
    a.pair_velocity[0], a.pair_velocity[1], a.pair_lat, a.pair_lon = vn, ve, lat, lon
    a.pair_accel[0], a.pair_accel[1] = c.imu.accel_n[0], c.imu.accel_n[1]


@kernel
def is_levelled(p: Parameters, c: Core) -> bool:
    """Whether roll and pitch are known well enough to navigate."""
    return max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1)) < p.tuning.levelled_sigma**2


@kernel
def level_with_pair(p: Parameters, c: Core, vn: float, ve: float, dt: float) -> None:
    """Level with the force in scratch.integral_change over `dt` s, in which the velocity changed by (vn, ve) m/s."""
    zn, ze = multiply(phasor(-c.alignment.frame_azimuth), element(c.scratch.integral_change, DELTA_V))
    if c.alignment.mode == COARSE_ALIGNMENT:
        level_from_velocity_change(p, c, zn / dt, ze / dt, dt, elementary.hypot(vn, ve) / dt)


@kernel
def timing_velocity_variance(c: Core) -> float:
    """Variance, m^2/s^2, of the velocity change since the pair's start that the time offset's variance causes."""
    now, then = c.imu.accel_n, c.alignment.pair_accel
    return float(variance(c, TIME_OFFSET) * ((now[0] - then[0]) ** 2 + (now[1] - then[1]) ** 2))


@kernel
def timing_position_variance(c: Core, b: HypothesisBank) -> float:
    """Variance, m^2, of the displacement since the last matched fix that the time offset's variance causes."""
    north, east = (
        c.alignment.integrals[DELTA_V, 0] - b.last_integrals[DELTA_V, 0],
        c.alignment.integrals[DELTA_V, 1] - b.last_integrals[DELTA_V, 1],
    )
    return float(variance(c, TIME_OFFSET) * (north * north + east * east))


@kernel
def pair_duration(p: Parameters, c: Core) -> float:
    """Time between positions, s, from which a velocity change follows with the sigma pair_velocity_sigma.

    The velocity change is a second difference: of three positions with white noise, and of two increments of the GNSS
    bias, taken as a random walk.
    """
    walk = 4.0 * c.gnss.reported_sigma[HORIZONTAL] ** 2 / p.tuning.gnss_bias_time_s
    root = math.sqrt(walk * walk + 24.0 * c.gnss.noise_var[HORIZONTAL] * p.tuning.pair_velocity_sigma**2)
    seconds: float = (walk + root) / (2.0 * p.tuning.pair_velocity_sigma**2)
    return min(max(seconds, p.tuning.pair_min_s), p.tuning.pair_max_s)


@kernel
def match_duration(p: Parameters, c: Core) -> float:
    """Time, s, for which matched fixes are compared: in it the unknown gyro bias turns the frame by match_rotation.

    While navigating it is the least, because the estimate of the gyro's scale factor changes, too.
    """
    if c.alignment.mode == NAVIGATING:
        return p.tuning.match_min_duration_s
    rate_sigma = math.sqrt(innovation_variance(c, vertical_bias_jacobian(c)))
    return min(max(p.tuning.match_rotation / rate_sigma, p.tuning.match_min_duration_s), p.tuning.match_max_duration_s)


@kernel
def match_pair(
    p: Parameters, c: Core, b: HypothesisBank, lat: float, lon: float, vn: float, ve: float, noise2: float
) -> None:
    """Match a fix at the core's time and level with it; (vn, ve): its velocity, NaN if it reports none.

    noise2: m^2/s^2, variance of its velocity in addition to gnss.velocity_noise_var.
    """
    a = c.alignment
    matching = 1e-9 * (c.nav.t_ns - a.last_match_ns) >= p.tuning.pair_min_s
    if matching:
        apply_corrections(p, c, b)
        match_fix(p, c, b, lat, lon, vn, ve, noise2)
    dt = 1e-9 * (c.nav.t_ns - a.pair_start_ns)
    known = math.isfinite(vn) and math.isfinite(a.pair_velocity[0])
    if dt < p.tuning.pair_min_s or (not known and dt < pair_duration(p, c)):
        return
    if not matching:
        apply_corrections(p, c, b)
    if dt > max(p.tuning.pair_max_s, 2.0 * pair_duration(p, c)):
        a.mean_velocity_s = 0.0
    elif known:
        for k in range(4):
            for i in range(2):
                c.scratch.integral_change[k, i] = a.integrals[k, i] - a.pair_integrals[k, i]
        level_with_pair(p, c, vn - a.pair_velocity[0], ve - a.pair_velocity[1], dt)
    else:
        north, east = ned_difference(c, a.pair_lat, a.pair_lon, lat, lon)
        pair_mean_velocities(p, c, north / dt, east / dt, dt)
    start_pair(c, lat, lon, vn, ve)


@kernel
def contradicts_force(p: Parameters, c: Core, b: HypothesisBank, s: float) -> bool:
    """Whether GNSS and inertial innovations (variance s) differ in magnitude by more than noise and tilt explain."""
    inertial = elementary.hypot(b.innovations[1 + DELTA_V, 0], b.innovations[1 + DELTA_V, 1])
    tilt2 = STANDARD_GRAVITY**2 * max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    allowed = s + tilt2 * (b.innovations[1 + TIME, 0] ** 2 + b.innovations[1 + TIME, 1] ** 2)
    apart = inertial - elementary.hypot(b.innovations[0, 0], b.innovations[0, 1])
    return bool(apart**2 > p.tuning.match_gate * allowed)


@kernel
def match_fix(
    p: Parameters, c: Core, b: HypothesisBank, lat: float, lon: float, vn: float, ve: float, noise2: float
) -> None:
    """Match the velocity of a fix, or its position if it reports none, with the integrals of specific force.

    After an outage, or when the matched fixes are too old, the integrals start again at this fix.
    """
    a = c.alignment
    dt = 1e-9 * (c.nav.t_ns - a.last_match_ns)
    duration = match_duration(p, c)
    if 1e-9 * (c.nav.t_ns - a.origin_ns) > duration or dt > p.tuning.match_outage_share * duration:
        restart_in_motion_alignment(c)
        dt = math.inf
    a.last_match_ns = c.nav.t_ns
    timing2 = timing_position_variance(c, b)
    if dt == math.inf:
        a.origin_lat, a.origin_lon = lat, lon
        clear_integrals(c)
        clear_hypotheses(b)
        restart_matching(p, c, b)
    else:
        propagate_hypotheses(p, c, b, dt)
        predict_whitening(p, b, c.gnss.reported_sigma[HORIZONTAL], c.process_noise.psd[VELOCITY_NOISE], dt)
        discount(b, elementary.exp(-2.0 * dt / duration))
    if math.isfinite(vn) and math.isfinite(ve):
        match_if_consistent(p, c, b, False, (vn, ve), c.gnss.velocity_noise_var + timing_velocity_variance(c) + noise2)
    else:
        match_if_consistent(
            p,
            c,
            b,
            True,
            ned_difference(c, a.origin_lat, a.origin_lon, lat, lon),
            c.gnss.noise_var[HORIZONTAL] + timing2,
        )


@kernel
def restart_matching(p: Parameters, c: Core, b: HypothesisBank) -> None:
    """Reset the whitening filter: its position and velocity are those of the next fix."""
    reset_whitening(p, b, c.gnss.reported_sigma[HORIZONTAL])
    c.alignment.reject_count = 0


@kernel
def match_if_consistent(
    p: Parameters, c: Core, b: HypothesisBank, is_position: bool, measured: Complex, r: float
) -> None:
    """Match a position (m; else a velocity, m/s) of variance r, unless the specific force contradicts it.

    Its products count once roll and pitch are known, in motion. Three contradictions in a row reset the whitening.
    """
    a = c.alignment
    s = whitened_variance(b, is_position, r)
    certain = is_levelled(p, c) and s < 0.5 * p.tuning.whitening_speed_sigma**2
    k = nearest_hypothesis(p, c)
    whitened_innovations(b, k, is_position, measured, antenna_offset(p, c, k, is_position))
    if certain and contradicts_force(p, c, b, s):
        a.reject_count += 1
        if a.reject_count > 2:
            restart_matching(p, c, b)
        return
    a.reject_count = 0
    match_measurement(p, c, b, is_position, measured, s, certain and not c.stationarity.at_rest)


@kernel
def pair_mean_velocities(p: Parameters, c: Core, vn: float, ve: float, dt: float) -> None:
    """From positions alone: level with the change of the mean velocity (vn, ve; m/s, over `dt` s)."""
    a, v = c.alignment, c.alignment.mean_velocity
    for k in range(4):
        for i in range(2):
            mean = (a.double_integrals[k, i] - a.pair_double_integrals[k, i]) / dt
            c.scratch.integral_change[k, i] = mean - a.mean_integrals[k, i]
            a.mean_integrals[k, i] = mean
    if a.mean_velocity_s > 0.0 and exceeds_force(p, c, vn - v[0], ve - v[1], dt):
        a.mean_velocity_s = 0.0
        return
    if a.mean_velocity_s > 0.0:
        level_with_pair(p, c, vn - v[0], ve - v[1], c.scratch.integral_change[TIME, 0])
    v[0], v[1], a.mean_velocity_s = vn, ve, dt


@kernel
def exceeds_force(p: Parameters, c: Core, vn: float, ve: float, dt: float) -> bool:
    """Whether this change of mean velocity (m/s, over `dt` s) is more than force, tilt errors and noise explain."""
    change = c.scratch.integral_change
    inertial = elementary.hypot(change[DELTA_V, 0], change[DELTA_V, 1])
    tilt2 = STANDARD_GRAVITY**2 * max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    noise2 = 6.0 * (c.gnss.noise_var[HORIZONTAL] + c.gnss.reported_sigma[HORIZONTAL] ** 2) / dt**2
    allowed = noise2 + tilt2 * change[TIME, 0] ** 2
    return bool(max(elementary.hypot(vn, ve) - inertial, 0.0) ** 2 > p.tuning.match_gate * allowed)


@kernel
def vertical_bias_jacobian(c: Core) -> int:
    """Set the Jacobian of the vertical gyro bias, (C_nb bg)_down; returns its length."""
    C_nb = rotation_matrix(c)
    return set_jacobian3(c, 0, GYRO_BIAS, (C_nb[6], C_nb[7], C_nb[8]))


@kernel
def restart_in_motion_alignment(c: Core) -> None:
    """Clear integrals, pairs and the count of contradictions: the next fix starts a new origin."""
    a = c.alignment
    clear_integrals(c)
    restart_vectors(c)
    a.pair_start_ns = a.last_match_ns = NEVER_NS
    a.mean_velocity_s = 0.0
    a.heading_fault_count = 0


@kernel
def count_heading_fault(c: Core, wrong: bool) -> None:
    """Count pairs in a row that contradict the heading; `wrong`: the last one does."""
    c.alignment.heading_fault_count = c.alignment.heading_fault_count + 1 if wrong else 0
