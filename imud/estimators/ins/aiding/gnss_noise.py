"""The noise of a fix: the sigma that the receiver reports, and the white noise learned from the innovations.

The position error of a receiver is correlated over tens of seconds. Most of it is the GNSS bias, a first-order
Gauss-Markov state; the variance of the white part is adapted to the innovations (cf. Sage and Husa).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import add_covariance, add_variance, decorrelate, variance
from ..glr_tests.gnss_drift import reset_drift
from ..state import ATTITUDE, GNSS_BIAS, NAVIGATING, POSITION, TIME_OFFSET, VELOCITY_TIME_OFFSET

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("uere", 2.0, "m", "Horizontal position error per HDOP.", "Real receivers."),
    Tunable("vertical_ratio", 2.2, "", "Vertical over horizontal sigma.", "Real receivers."),
    Tunable("unknown_hdop", 1.5, "", "HDOP where none is reported.", "Choice."),
    Tunable("rtk_fixed", 0.03, "m", "Position error per HDOP, RTK fixed.", "Real receivers."),
    Tunable("rtk_float", 0.4, "m", "Position error per HDOP, RTK float.", "Real receivers."),
    Tunable(
        "min_bias_share",
        0.3,
        "",
        "Least share of the reported error that is correlated.",
        "Four real receivers: their white part is the smaller.",
        high=1.0,
    ),
    Tunable(
        "new_quality_ratio",
        2.0,
        "",
        "Ratio of a reported sigma to the last one from which bias and noise are learned anew.",
        "Choice.",
        low=1.001,
    ),
    Tunable("first_white_sigma", 0.03, "m", "White sigma before any is learned.", "RTK."),
    Tunable(
        "first_white_share",
        0.5,
        "",
        "White sigma before any is learned, per reported sigma, beside first_white_sigma.",
        "Real receivers.",
    ),
    Tunable(
        "first_white_variance_share",
        0.5,
        "",
        "Largest share of the variance that a receiver itself reports which is white, before any is learned.",
        "Half of it is the correlated error.",
        high=1.0,
    ),
    Tunable("min_white_share", 0.3, "", "Least white sigma that is learned, per reported sigma.", "Real receivers."),
    Tunable(
        "min_white_of",
        0.3,
        "m",
        "Largest reported sigma of which min_white_share is a share.",
        "Choice: 0.1 m at most.",
    ),
    Tunable("max_white_ratio", 2.0, "", "Largest white sigma that is learned, per reported sigma.", "Choice."),
    Tunable(
        "min_velocity_sigma",
        0.05,
        "m/s",
        "Least sigma that is learned of a velocity: innovations do not show constant errors.",
        "Real receivers.",
    ),
    Tunable("max_velocity_sigma", 0.3, "m/s", "Largest sigma that is learned of a velocity.", "Real receivers."),
    Tunable(
        "noise_gain",
        0.03,
        "per fix",
        "Gain of the learned variances.",
        "Sage-Husa: fading factors are 0.95 to 0.99.",
        high=1.0,
    ),
    Tunable(
        "second_order_heading",
        10.0,
        "m/rad^2",
        "Error of the linear model per heading variance; also m/s/rad^2.",
        "Simulated starts.",
    ),
    Tunable(
        "time_offset_floor",
        0.01,
        "s/m",
        "Least sigma of the time offset, per metre of position sigma.",
        "Recorded drives.",
    ),
    Tunable(
        "constant_error_share",
        0.5,
        "",
        "Share of the receiver's error that no averaging removes.",
        "Real receivers.",
        high=1.0,
    ),
)


@kernel
def horizontal_sigma(p: Parameters, fix: Fix) -> float:
    """1 sigma of the position, m, from what the receiver reports."""
    if math.isfinite(fix.sigma[0]) and math.isfinite(fix.sigma[1]):
        return max(math.sqrt(0.5 * (fix.sigma[0] ** 2 + fix.sigma[1] ** 2)), 1e-3)
    hdop = fix.hdop if fix.hdop > 0.0 else p.tuning.unknown_hdop
    unit = p.tuning.rtk_fixed if fix.quality == 4 else (p.tuning.rtk_float if fix.quality == 5 else p.tuning.uere)
    return unit * hdop


@kernel
def clear_gnss_bias(c: Core, axis: int, variance: float) -> None:
    """Set the GNSS bias along an axis to zero, with `variance` (m^2)."""
    decorrelate(c, GNSS_BIAS + axis, variance)
    c.nav.gnss_bias[axis] = 0.0


@kernel
def set_gnss_noise(p: Parameters, c: Core, fix: Fix) -> None:
    """Set sigma of the GNSS bias and white variance from the reported quality; a new quality resets bias and noise."""
    g = c.gnss
    h = horizontal_sigma(p, fix)
    v = max(fix.sigma[2], 1e-3) if math.isfinite(fix.sigma[2]) else p.tuning.vertical_ratio * h
    for k in range(2):
        sigma = h if k == 0 else v
        last = g.reported_sigma[k]
        if not last / p.tuning.new_quality_ratio < sigma < p.tuning.new_quality_ratio * last:
            g.noise_var[k] = min(sigma, p.tuning.first_white_sigma + p.tuning.first_white_share * sigma) ** 2
            if math.isfinite(fix.sigma[2 * k]):
                g.noise_var[k] = min(g.noise_var[k], p.tuning.first_white_variance_share * sigma * sigma)
            for i in range(2 * k, 2 + k):
                clear_gnss_bias(c, i, sigma * sigma)
            reset_drift(c)
        g.reported_sigma[k] = g.bias_sigma[k] = sigma
        if math.isfinite(fix.sigma[2 * k]):  # a sigma that the receiver reports is that of the whole error
            g.bias_sigma[k] = math.sqrt(max(sigma * sigma - g.noise_var[k], (p.tuning.min_bias_share * sigma) ** 2))
    floor = p.tuning.time_offset_floor * h
    q = max(0.0, floor * floor - variance(c, TIME_OFFSET))  # position errors are correlated; the sum of both is kept
    add_variance(c, TIME_OFFSET, q)
    add_variance(c, VELOCITY_TIME_OFFSET, q)
    add_covariance(c, TIME_OFFSET, VELOCITY_TIME_OFFSET, -q)


@kernel
def learn_position_noise(p: Parameters, c: Core, axis: int, nis: float, s: float) -> None:
    """Adapt the white variance of a position (m^2) to an innovation of variance s (m^2) and of this NIS."""
    g = c.gnss
    k = axis // 2
    least = (p.tuning.min_white_share * min(g.reported_sigma[k], p.tuning.min_white_of)) ** 2
    most = (p.tuning.max_white_ratio * g.reported_sigma[k]) ** 2
    learned = g.noise_var[k] + p.tuning.noise_gain * (min(nis, p.tuning.max_learned_nis) - 1.0) * s
    g.noise_var[k] = min(max(learned, least), most)


@kernel
def learn_velocity_noise(p: Parameters, c: Core, nis: float) -> None:
    """Adapt the variance of a velocity component (m^2/s^2) to an innovation of this NIS."""
    g = c.gnss
    learned = g.velocity_noise_var * (1.0 + p.tuning.noise_gain * (min(nis, p.tuning.max_learned_nis) - 1.0))
    g.velocity_noise_var = min(max(learned, p.tuning.min_velocity_sigma**2), p.tuning.max_velocity_sigma**2)


@kernel
def second_order_error(p: Parameters, c: Core) -> float:
    """Error of the linear model by an uncertain heading: m of a position, m/s of a velocity."""
    return float(p.tuning.second_order_heading * variance(c, ATTITUDE + 2)) if c.alignment.mode == NAVIGATING else 0.0


@kernel
def limit_position_confidence(p: Parameters, c: Core) -> None:
    """Keep the position variance at or above that of the receiver's constant error.

    During coarse alignment the position is the antenna's, so the squared lever arm is added. Not while external poses
    are used, which know the position better.
    """
    if 1e-9 * (c.nav.t_ns - c.pose.last_used_ns) < p.tuning.fresh_fix_s:
        return
    a = c.nav.gnss_lever_arm
    arm2 = a[0] ** 2 + a[1] ** 2 + a[2] ** 2 if c.alignment.mode != NAVIGATING else 0.0
    for i in range(3):
        constant2 = (p.tuning.constant_error_share * c.gnss.reported_sigma[i // 2]) ** 2
        add_variance(c, POSITION + i, max(0.0, constant2 + arm2 - variance(c, POSITION + i)))


@kernel
def mark_used(c: Core) -> None:
    """Store that a fix was used at the core's time."""
    c.gnss.last_used_ns = c.nav.t_ns


@kernel
def count_fix(c: Core) -> None:
    """Count a processed fix."""
    c.gnss.fix_count += 1


@kernel
def set_speed(c: Core, speed: float) -> None:
    """Store the speed over ground of the last fix, m/s; NaN: unknown."""
    c.gnss.speed = speed
