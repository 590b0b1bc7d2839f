"""How good a fix is: what the receiver reports, and what its innovations have shown.

A receiver's position error is almost purely correlated over tens of seconds, so it is mostly the GNSS bias, a
first-order Gauss-Markov state; the white part is learned from the innovations.
"""

import math
from typing import Any

from ....compile.jit import kernel
from ..ekf import add_covariance, add_variance, clear_gnss_bias, variance
from ..observers.gnss_drift import reset_drift
from ..state import ATTITUDE, NAVIGATING, POSITION, TIME_OFFSET, VELOCITY_TIME_OFFSET

UERE = 2.0  # m per HDOP, horizontal
VERTICAL_RATIO = 2.2  # times the horizontal sigma
UNKNOWN_HDOP = 1.5
RTK_FIXED, RTK_FLOAT = 0.03, 0.4  # m, when nothing better is reported
MIN_BIAS_SHARE = 0.3  # of what a receiver reports of its error, where all that is seen of it is white
VELOCITY_SIGMA_RANGE = (0.05, 0.3)  # m/s, of what is learned: errors that last do not show in innovations
NOISE_GAIN = 0.03
SECOND_ORDER_HEADING = 10.0  # m, m/s per rad^2 of heading variance: what the linear model leaves out
LEVER_ARM_SIGMA = 0.03  # m, of a lever arm taken by rule
TIME_OFFSET_FLOOR = 0.01  # s per metre of sigma
CONSTANT_ERROR_SHARE = 0.5  # of a receiver's error, outlasts any wait: no repetition takes it away


@kernel
def horizontal_sigma(fix: Any) -> float:
    """1 sigma of the position, m, from what the receiver reports."""
    if math.isfinite(fix.sigma[0]) and math.isfinite(fix.sigma[1]):
        return max(math.sqrt(0.5 * (fix.sigma[0] ** 2 + fix.sigma[1] ** 2)), 1e-3)
    hdop = fix.hdop if fix.hdop > 0.0 else UNKNOWN_HDOP
    unit = RTK_FIXED if fix.quality == 4 else (RTK_FLOAT if fix.quality == 5 else UERE)
    return unit * hdop


@kernel
def set_gnss_noise(c: Any, fix: Any) -> None:
    """Scale bias and white noise to the reported quality; another kind of solution has another bias."""
    g = c.gnss
    h = horizontal_sigma(fix)
    v = max(fix.sigma[2], 1e-3) if math.isfinite(fix.sigma[2]) else VERTICAL_RATIO * h
    for k in range(2):
        sigma = h if k == 0 else v
        if not 0.5 * g.reported_sigma[k] < sigma < 2.0 * g.reported_sigma[k]:
            g.noise_var[k] = min(sigma, 0.03 + 0.5 * sigma) ** 2
            if math.isfinite(fix.sigma[2 * k]):
                g.noise_var[k] = min(g.noise_var[k], 0.5 * sigma * sigma)
            for i in range(2 * k, 2 + k):
                clear_gnss_bias(c, i, sigma * sigma)
            reset_drift(c)
        g.reported_sigma[k] = g.bias_sigma[k] = sigma
        if math.isfinite(fix.sigma[2 * k]):  # what the receiver itself states is the whole error
            g.bias_sigma[k] = math.sqrt(max(sigma * sigma - g.noise_var[k], (MIN_BIAS_SHARE * sigma) ** 2))
    floor = TIME_OFFSET_FLOOR * h
    q = max(0.0, floor * floor - variance(c, TIME_OFFSET))  # of positions, whose errors last: velocities show the sum
    add_variance(c, TIME_OFFSET, q)
    add_variance(c, VELOCITY_TIME_OFFSET, q)
    add_covariance(c, TIME_OFFSET, VELOCITY_TIME_OFFSET, -q)


@kernel
def learn_position_noise(c: Any, axis: int, nis: float, s: float) -> None:
    """Adapt the white variance of a position to its normalised innovation squared `nis`, of variance s."""
    k = axis // 2
    least = (0.3 * min(c.gnss.reported_sigma[k], 0.3)) ** 2
    most = (2.0 * c.gnss.reported_sigma[k]) ** 2
    learned = c.gnss.noise_var[k] + NOISE_GAIN * (min(nis, 9.0) - 1.0) * s
    c.gnss.noise_var[k] = min(max(learned, least), most)


@kernel
def learn_velocity_noise(c: Any, nis: float, s: float) -> None:
    """Adapt the variance of a velocity component to its normalised innovation squared `nis`, of variance s."""
    share = c.gnss.velocity_noise_var / s
    learned = c.gnss.velocity_noise_var + NOISE_GAIN * share * (min(nis, 9.0) - 1.0) * s
    c.gnss.velocity_noise_var = min(max(learned, VELOCITY_SIGMA_RANGE[0] ** 2), VELOCITY_SIGMA_RANGE[1] ** 2)


@kernel
def second_order_error(c: Any) -> float:
    """What the linear model leaves out, m or m/s, where an uncertain heading has a part in it."""
    return float(SECOND_ORDER_HEADING * variance(c, ATTITUDE + 2)) if c.alignment.mode == NAVIGATING else 0.0


@kernel
def lever_arm_rate_variance(c: Any) -> float:
    """Variance of the antenna's velocity, m^2/s^2, by an error of the lever arm in the present turn."""
    w = c.imu.rate_b
    return float(LEVER_ARM_SIGMA**2 * (w[0] ** 2 + w[1] ** 2 + w[2] ** 2))


@kernel
def limit_position_confidence(p: Any, c: Any) -> None:
    """The position is never known better than what lasts of the receiver's error, and no better than the lever arm."""
    a = p.gnss_lever_arm
    arm2 = a[0] ** 2 + a[1] ** 2 + a[2] ** 2 if c.alignment.mode != NAVIGATING else 0.0
    for i in range(3):
        lasting2 = (CONSTANT_ERROR_SHARE * c.gnss.reported_sigma[i // 2]) ** 2
        add_variance(c, POSITION + i, max(0.0, lasting2 + arm2 - variance(c, POSITION + i)))


@kernel
def mark_used(c: Any) -> None:
    """A fix has been used now."""
    c.gnss.last_used_ns = c.nav.t_ns


@kernel
def count_fix(c: Any) -> None:
    """Another fix has been processed."""
    c.gnss.fix_count += 1


@kernel
def set_speed(c: Any, speed: float) -> None:
    """Speed over ground of the last fix, m/s; NaN: unknown."""
    c.gnss.speed = speed
