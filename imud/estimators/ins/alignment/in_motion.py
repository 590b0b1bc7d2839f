"""Coarse alignment in motion, one fix at a time.

Position and velocity are those of the antenna at the epoch of the fix (`modes.transfer_lever_arm`), estimated by
the same filter that navigates later. Every fix is matched with the integrals of specific force to find the heading.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import STANDARD_GRAVITY
from ...tuning import Tunable
from ..aiding.forward_axis_search import accumulate_scatter
from ..aiding.gnss_noise import clear_gnss_bias, limit_position_confidence, mark_used, set_speed
from ..aiding.gnss_velocity import low_speed_variance, velocity_of
from ..ekf import combine, decorrelate, innovation_variance, standard_deviation, variance
from ..integrity.reset_inflation import limit_inflation
from ..lever_arm import antenna_velocity
from ..mechanization import ned_difference, set_position, set_velocity
from ..state import ATTITUDE, GNSS_BIAS, HORIZONTAL, POSITION, TIME_OFFSET, VELOCITY, VERTICAL
from .force_integrals import DELTA_V, TIME, multiply, phasor
from .heading_acceptance import find_heading
from .hypothesis_bank import frame_rotation, nearest_hypothesis
from .modes import HEADING_KNOWN, change_mode
from .vector_levelling import level_with_vectors
from .vector_pairs import match_vectors
from .velocity_pairs import is_levelled, match_pair, vertical_bias_jacobian
from .whitening import VELOCITY_STATE, unobserved_velocity

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable("unknown_height", 1000.0, "m", "Sigma of a height that is not known.", "Choice."),
    Tunable("unknown_speed", 30.0, "m/s", "Sigma of a velocity that the fix does not give.", "A car on a motorway."),
    Tunable(
        "unknown_vertical_speed", 1.0, "m/s", "Sigma of a vertical velocity that the fix does not give.", "Choice."
    ),
    Tunable("first_velocity_sigma", 0.3, "m/s", "Sigma of the first velocity taken from a fix.", "Real receivers."),
    Tunable("max_start_velocity_sigma", 5.0, "m/s", "Largest sigma of the velocity when navigation starts.", "Choice."),
    Tunable(
        "speed_sigmas",
        3.0,
        "sigma",
        "Least speed, in sigmas, from the difference of positions that is not noise.",
        "Three sigma.",
    ),
)


@kernel
def differenced_velocity_variance(p: Parameters, c: Core, dt: float) -> float:
    """Variance, m^2/s^2, of a velocity component differenced from two positions `dt` s apart."""
    bias2 = c.gnss.reported_sigma[HORIZONTAL] ** 2 * (1.0 - elementary.exp(-dt / p.tuning.gnss_bias_time_s))
    return float(2.0 * (c.gnss.noise_var[HORIZONTAL] + bias2) / dt**2)


@kernel
def low_motion_speed(p: Parameters, c: Core, lat: float, lon: float) -> float:
    """Mean speed since low motion began, m/s, differenced from positions; NaN where it is not accurate enough."""
    a = c.alignment
    dt = 1e-9 * (c.nav.t_ns - a.low_motion_ns)
    if dt > c.stationarity.low_motion_count * p.tuning.rest_window_s:
        a.low_motion_lat, a.low_motion_lon = lat, lon
        a.low_motion_ns = c.nav.t_ns
        return math.nan
    if dt <= 0.0 or p.tuning.speed_sigmas**2 * differenced_velocity_variance(p, c, dt) > p.tuning.rest_speed**2:
        return math.nan
    north, east = ned_difference(c, a.low_motion_lat, a.low_motion_lon, lat, lon)
    return float(elementary.hypot(north, east) / dt)


@kernel
def speed_from_positions(p: Parameters, c: Core, lat: float, lon: float) -> float:
    """Speed differenced from positions, m/s: of the last pair, or since low motion began; NaN where it may be noise."""
    speed_since_low_motion, a = low_motion_speed(p, c, lat, lon), c.alignment
    if a.mean_velocity_s > 0.0:
        speed = elementary.hypot(a.mean_velocity[0], a.mean_velocity[1])
        # the GNSS bias hardly changes within a pair
        sigma = math.sqrt(2.0 * c.gnss.noise_var[HORIZONTAL]) / a.mean_velocity_s
        if speed > p.tuning.speed_sigmas * sigma or p.tuning.speed_sigmas * sigma < p.tuning.rest_speed:
            return speed
    return speed_since_low_motion


@kernel
def observe_forward_axis(p: Parameters, c: Core, vn: float, ve: float) -> None:
    """Accumulate a fix's velocity (m/s; NaN: none reported) in the body axes, from which the forward axis is found.

    Without a reported velocity the mean over the last pair of positions is used: it is as old as half the pair.
    """
    noise, a = c.gnss.velocity_noise_var, c.alignment
    if not (math.isfinite(vn) and math.isfinite(ve)):
        vn, ve, dt = a.mean_velocity[0], a.mean_velocity[1], a.mean_velocity_s
        if not dt > 0.0 or a.pair_start_ns != c.nav.t_ns:
            return
        turned = 0.5 * dt * (abs(c.imu.rate_b[0]) + abs(c.imu.rate_b[1]) + abs(c.imu.rate_b[2]))
        noise = 2.0 * c.gnss.noise_var[HORIZONTAL] / dt**2 + turned**2 * (vn**2 + ve**2)
    rotation2 = innovation_variance(c, vertical_bias_jacobian(c)) * p.tuning.heading_horizon_s**2
    accumulate_scatter(p, c, (vn, ve, 0.0), noise, rotation2)


@kernel
def initialize_velocity(p: Parameters, c: Core, b: HypothesisBank) -> None:
    """Once the heading is found from positions alone: the antenna's velocity by whitening filter and force since."""
    k = nearest_hypothesis(p, c)
    delta_v = multiply(
        phasor(-c.alignment.frame_azimuth - frame_rotation(p, c, k, 0.0)),
        (unobserved_velocity(b, k, 0, DELTA_V), unobserved_velocity(b, k, 1, DELTA_V)),
    )
    tilt2 = STANDARD_GRAVITY**2 * max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1))
    r = (
        b.whitening_P[VELOCITY_STATE, VELOCITY_STATE]
        + c.alignment.heading_sigma**2 * (delta_v[0] ** 2 + delta_v[1] ** 2)
        + tilt2 * unobserved_velocity(b, k, 0, TIME) ** 2
    )
    antenna = antenna_velocity(c)
    for i in range(2):
        set_velocity(c, i, b.whitening_state[k, VELOCITY_STATE, 0, i] + delta_v[i] + antenna[i])
        decorrelate(c, VELOCITY + i, min(r, p.tuning.max_start_velocity_sigma**2))


@kernel
def reset_to_fix(p: Parameters, c: Core, fix: Fix) -> None:
    """Set position and velocity to those of the fix, with the variances of the receiver and of its bias."""
    set_position(c, fix.lat, fix.lon, fix.height)
    guess = 0.0  # m, sigma of the height that the filter has, where the fix gives none; 0: the fix gives one
    if not math.isfinite(fix.height):
        guess = min(max(standard_deviation(c, POSITION + 2), c.gnss.reported_sigma[VERTICAL]), p.tuning.unknown_height)
    for i in range(3):
        v = velocity_of(p, fix, i)
        known = math.isfinite(v)
        set_velocity(c, i, v if known else 0.0)
        sigma = (
            p.tuning.first_velocity_sigma
            if known
            else p.tuning.unknown_vertical_speed
            if i == 2
            else p.tuning.unknown_speed
        )
        decorrelate(c, VELOCITY + i, sigma**2)
        decorrelate(c, POSITION + i, c.gnss.noise_var[i // 2] if i < 2 or guess == 0.0 else guess**2)
        clear_gnss_bias(c, i, c.gnss.reported_sigma[i // 2] ** 2)
        if i < 2 or guess == 0.0:
            combine(c, POSITION + i, GNSS_BIAS + i, -1.0)
    limit_position_confidence(p, c)
    mark_used(c)


@kernel
def align_with_fix(p: Parameters, c: Core, b: HypothesisBank, fix: Fix) -> None:
    """Match a fix before it is fused; start navigation when roll, pitch and heading are known."""
    vn, ve = velocity_of(p, fix, 0), velocity_of(p, fix, 1)
    slow2 = low_speed_variance(p, fix)
    match_pair(p, c, b, fix.lat, fix.lon, vn, ve, slow2)
    if not math.isfinite(c.gnss.speed):
        set_speed(c, speed_from_positions(p, c, fix.lat, fix.lon))
    observe_forward_axis(p, c, vn, ve)
    noise2 = c.gnss.velocity_noise_var + slow2
    matched = match_vectors(p, c, b, (vn, ve, velocity_of(p, fix, 2)), noise2)
    if matched and not c.stationarity.at_rest and level_with_vectors(p, c, b):
        return
    found = c.alignment.heading_sigma > 0.0
    if is_levelled(p, c) and (found or (c.scratch.fix_age_probability < 0.5 and find_heading(p, c, b))):
        decorrelate(c, TIME_OFFSET, max(variance(c, TIME_OFFSET), c.scratch.fix_age_error2))
        if math.isfinite(vn) and math.isfinite(ve):  # the velocity is fused next, at the sensor, with the heading known
            for i in range(2):
                decorrelate(c, VELOCITY + i, p.tuning.max_start_velocity_sigma**2)
        elif c.alignment.last_match_ns == c.nav.t_ns:
            initialize_velocity(p, c, b)
        if not found:
            limit_inflation(p, c)
        change_mode(p, c, HEADING_KNOWN)
