"""Windows of half a second over the inertial data: is the sensor quiet, how strongly does it vibrate, is it at rest?

Quiet alone is not rest: at constant speed a smooth car is nearly as quiet as a parked one. Rest needs the quiet of
the quietest time seen, a mean rate that is the bias, and a speed, from a fresh fix or from the filter, near zero.
Where no speed is known, as in the first seconds of a start under way, the quietest time seen may itself be motion:
there only a stillness will do that no vehicle under way has. In an outage the speed is known less and less: there
the quiet is compared with what this vehicle has shown at rest and in slow motion while its speed was known.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ...compile.jit import kernel
from ...math.earth import STANDARD_GRAVITY
from ..tuning import Tunable
from .ekf import innovation_variance, set_jacobian, variance
from .mechanization import Vector, rotation_matrix
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, NAVIGATING, VELOCITY

if TYPE_CHECKING:
    from .types import Core, Floats, Parameters


TUNABLES = (
    Tunable("rest_window_s", 0.5, "s", "Length of a stationarity window.", "Choice."),
    Tunable(
        "max_gyro_ratio",
        3.0,
        "",
        "Gyro deviation of a low-motion window over the smallest one seen.",
        "Recorded drives.",
    ),
    Tunable("low_motion_accel", 0.35, "m/s^2", "Deviation of the force in a low-motion window.", "An idling engine."),
    Tunable(
        "stationary_accel",
        0.05,
        "m/s^2",
        "Deviation of the force when parked.",
        "A smooth car that creeps has 0.06 to 0.1.",
    ),
    Tunable(
        "rate_of_change_decay", 0.95, "per window", "Decay of the largest change between windows.", "About ten seconds."
    ),
    Tunable(
        "noise_floor_growth", 1.001, "per window", "Growth of the smallest gyro deviation seen.", "About ten minutes."
    ),
    Tunable(
        "vibration_noise_share",
        0.005,
        "",
        "Share of the vibration's power that acts as white noise.",
        "Recorded drives.",
    ),
    Tunable(
        "moving_vibration_accel",
        0.05,
        "m/s^2",
        "Vibration, sample to sample, of a vehicle under way.",
        "Recorded drives.",
    ),
    Tunable("fresh_fix_s", 2.0, "s", "Age up to which a fix tells the present speed.", "Two fixes of a 1 Hz receiver."),
    Tunable("rest_speed", 0.3, "m/s", "Largest speed of a receiver at rest.", "Three sigma of real receivers."),
    Tunable(
        "long_rest_windows", 10, "windows", "Low motion for so long is rest even where no speed is known.", "Choice."
    ),
    Tunable(
        "long_rest_variance", 10.0, "m^2/s^2", "Largest variance of a velocity that allows a long rest.", "Choice."
    ),
    Tunable("rest_variance", 0.5, "m^2/s^2", "Largest variance of a velocity that allows a rest.", "Choice."),
    Tunable("rest_rate", 0.003, "rad/s", "Mean rate at rest, beyond the uncertainty of the bias.", "Recorded drives."),
    Tunable(
        "rest_accel",
        0.15,
        "m/s^2",
        "Mean level force at rest, beyond what tilt and bias explain.",
        "Less is no braking.",
    ),
    Tunable(
        "slow_motion_min_speed", 0.5, "m/s", "Slow motion, which rest could be mistaken for, begins here.", "Choice."
    ),
    Tunable("slow_motion_max_speed", 5.0, "m/s", "Slow motion ends here.", "Choice."),
    Tunable("class_memory", 0.01, "per window", "Gain of the statistics of rest and of slow motion.", "Choice."),
    Tunable("class_min_windows", 20.0, "windows", "Number of windows from which these are known.", "Choice."),
    Tunable("class_min_sigma", 0.25, "", "Smallest deviation of the logarithm in these.", "Recorded drives."),
    Tunable("evidence_weight", 0.25, "", "Weight of a window: neighbouring ones are not independent.", "Choice."),
    Tunable("rest_log_likelihood", 3.0, "", "Log likelihood ratio that proves rest.", "Odds of 20 to 1."),
)


@kernel
def accumulate_window(c: Core, w: Floats, f: Floats) -> None:
    """Add one sample (body axes), before it replaces the last; duration and delta_v are added by the mechanization."""
    for i in range(3):
        c.stationarity.sum_w[i] += w[i]
        c.stationarity.sum_f[i] += f[i]
        c.stationarity.sum_w2 += w[i] * w[i]
        c.stationarity.sum_f2 += f[i] * f[i]
        c.stationarity.sum_difference2[0] += (w[i] - c.imu.w[i]) ** 2
        c.stationarity.sum_difference2[1] += (f[i] - c.imu.f[i]) ** 2
    c.stationarity.sample_count += 1


@kernel
def accumulate_force(c: Core, delta_v: Vector, dt: float) -> None:
    """Add the specific force (navigation axes, integrated over `dt` s, m/s) of a sample."""
    for i in range(3):
        c.stationarity.delta_v[i] += delta_v[i]
    c.stationarity.duration += dt


@kernel
def interrupt_rest(c: Core) -> None:
    """Count windows of low motion anew: there may have been motion that the sensor did not show."""
    c.stationarity.low_motion_count = c.stationarity.stationary_count = 0


@kernel
def withdraw_rest(c: Core) -> None:
    """The sensor does not show whether it is at rest now."""
    interrupt_rest(c)
    c.stationarity.at_rest = 0


@kernel
def first_window(c: Core, f: Floats) -> None:
    """Before the first window: the mean specific force is that of the first sample."""
    for i in range(3):
        c.stationarity.mean_f[i] = f[i]


@kernel
def clear_window(c: Core) -> None:
    """Begin a new window."""
    c.stationarity.sample_count = 0
    c.stationarity.duration = 0.0
    c.stationarity.sum_w2 = 0.0
    c.stationarity.sum_f2 = 0.0
    for i in range(3):
        c.stationarity.sum_w[i] = 0.0
        c.stationarity.sum_f[i] = 0.0
        c.stationarity.delta_v[i] = 0.0
    for i in range(2):
        c.stationarity.sum_difference2[i] = 0.0


@kernel
def classify_window(p: Parameters, c: Core) -> None:
    """At the end of a window: vibration densities, and how many windows in a row were quiet."""
    w2 = c.stationarity.sum_w2 / c.stationarity.sample_count
    f2 = c.stationarity.sum_f2 / c.stationarity.sample_count
    turned, pushed = 0.0, 0.0
    for i in range(3):
        mean_w, mean_f = (
            c.stationarity.sum_w[i] / c.stationarity.sample_count,
            c.stationarity.sum_f[i] / c.stationarity.sample_count,
        )
        w2 -= mean_w * mean_w
        f2 -= mean_f * mean_f
        turned = max(turned, abs(mean_w - c.stationarity.mean_w[i]))
        pushed = max(pushed, abs(mean_f - c.stationarity.mean_f[i]))
        c.stationarity.mean_w[i], c.stationarity.mean_f[i] = mean_w, mean_f
    if c.stationarity.gyro_noise_floor > 0.0:  # not the first window
        c.stationarity.max_rate_of_change[0] = max(
            p.tuning.rate_of_change_decay * c.stationarity.max_rate_of_change[0], turned**2 / c.stationarity.duration
        )
        c.stationarity.max_rate_of_change[1] = max(
            p.tuning.rate_of_change_decay * c.stationarity.max_rate_of_change[1], pushed**2 / c.stationarity.duration
        )
    deviation = math.sqrt(max(w2, 0.0))
    dt = c.stationarity.duration / c.stationarity.sample_count
    c.stationarity.vibration_gyro_psd = (
        p.tuning.vibration_noise_share * c.stationarity.sum_difference2[0] / (6.0 * c.stationarity.sample_count) * dt
    )
    jolt2 = max(c.stationarity.sum_difference2[1] / (6.0 * c.stationarity.sample_count) - 2.0 * p.accel_psd / dt, 0.0)
    c.stationarity.vibration_accel_psd = p.tuning.vibration_noise_share * jolt2 * dt
    c.stationarity.vibration_level = jolt2 / (jolt2 + p.tuning.moving_vibration_accel**2)
    least = math.sqrt(3.0 * p.gyro_psd / dt)
    if c.stationarity.gyro_noise_floor <= 0.0:
        c.stationarity.gyro_noise_floor = deviation
    c.stationarity.gyro_noise_floor = max(
        min(c.stationarity.gyro_noise_floor * p.tuning.noise_floor_growth, deviation), least
    )
    even = turned < p.tuning.rest_rate + c.stationarity.gyro_noise_floor and pushed < p.tuning.rest_accel
    quiet = (
        deviation < p.tuning.max_gyro_ratio * c.stationarity.gyro_noise_floor
        and f2 < p.tuning.low_motion_accel**2
        and even
    )
    c.stationarity.low_motion_count = c.stationarity.low_motion_count + 1 if quiet else 0
    c.stationarity.stationary_count = (
        c.stationarity.stationary_count + 1 if quiet and f2 < p.tuning.stationary_accel**2 else 0
    )
    update_evidence(p, c, math.log(max(deviation, least)))


@kernel
def update_evidence(p: Parameters, c: Core, x: float) -> None:
    """Learn the log deviation x of this window where the speed is known, and gather evidence of rest elsewhere."""
    known = c.gnss.fix_count > 0 and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < p.tuning.fresh_fix_s
    speed = (
        math.hypot(c.nav.v_n[0], c.nav.v_n[1])
        if c.alignment.mode == NAVIGATING and not c.gnss.speed >= 0.0
        else c.gnss.speed
    )
    if known and speed < p.tuning.slow_motion_max_speed:
        if speed < p.tuning.rest_speed and c.stationarity.low_motion_count > 1:
            learn_class(p, c.stationarity.motion_class[0], x)
        elif speed > p.tuning.slow_motion_min_speed:
            learn_class(p, c.stationarity.motion_class[1], x)
    ratio = 0.0
    if min(c.stationarity.motion_class[0, 0], c.stationarity.motion_class[1, 0]) >= p.tuning.class_min_windows:
        ratio = log_likelihood(p, c.stationarity.motion_class[0], x) - log_likelihood(
            p, c.stationarity.motion_class[1], x
        )
    c.stationarity.log_likelihood_ratio = (
        c.stationarity.log_likelihood_ratio + p.tuning.evidence_weight * min(max(ratio, -2.0), 2.0)
        if c.stationarity.low_motion_count > 1
        else 0.0
    )


@kernel
def learn_class(p: Parameters, manner: Any, x: float) -> None:
    """Count, mean and variance of x, of which the past is slowly forgotten."""
    manner[0] += 1.0
    share = max(1.0 / manner[0], p.tuning.class_memory)
    left = x - manner[1]
    manner[1] += share * left
    manner[2] += share * ((1.0 - share) * left * left - manner[2])


@kernel
def log_likelihood(p: Parameters, manner: Any, x: float) -> float:
    """Logarithm of the normal density, but for its constant."""
    variance = max(manner[2], p.tuning.class_min_sigma**2)
    return float(-0.5 * ((x - manner[1]) ** 2 / variance + math.log(variance)))


@kernel
def speed_allows_rest(p: Parameters, c: Core) -> bool:
    """Whether nothing known of the speed speaks against rest."""
    fresh = c.gnss.fix_count > 0 and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < p.tuning.fresh_fix_s
    known = fresh and c.gnss.speed >= 0.0
    if known and c.gnss.speed > p.tuning.rest_speed:
        return False
    if c.alignment.mode != NAVIGATING:
        return bool(known or c.stationarity.stationary_count > p.tuning.long_rest_windows)
    speed2 = c.nav.v_n[0] ** 2 + c.nav.v_n[1] ** 2 + c.nav.v_n[2] ** 2
    s2 = max(variance(c, VELOCITY), variance(c, VELOCITY + 1))
    return bool(
        (known and speed2 < 1.0 + 9.0 * s2)
        or (
            speed2 < p.tuning.rest_speed**2
            and s2
            < (
                p.tuning.long_rest_variance
                if c.stationarity.low_motion_count > p.tuning.long_rest_windows
                else p.tuning.rest_variance
            )
        )
        or (
            fresh
            and not known
            and c.stationarity.stationary_count > p.tuning.long_rest_windows
            and speed2 < p.tuning.rest_speed**2 + 9.0 * s2
        )
        or (
            c.stationarity.log_likelihood_ratio > p.tuning.rest_log_likelihood
            and speed2 < p.tuning.rest_speed**2 + 9.0 * s2
            and s2 < p.tuning.long_rest_variance
        )
    )


@kernel
def gnss_confirms_rest(p: Parameters, c: Core) -> bool:
    """Whether the receiver's own speed says rest, too."""
    return bool(
        c.gnss.speed <= p.tuning.rest_speed and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < p.tuning.fresh_fix_s
    )


@kernel
def max_rest_rate(p: Parameters, c: Core, i: int) -> float:
    """Most mean rate about axis i, less the bias estimated, that may be rest, rad/s."""
    return p.tuning.rest_rate + 3.0 * math.sqrt(variance(c, GYRO_BIAS + i))


@kernel
def level_force_variance(c: Core, axis: int) -> float:
    """Variance, m^2/s^4, of the level specific force for what tilt and bias may contribute: a rest ties the two."""
    m = rotation_matrix(c)
    k = set_jacobian(c, 0, ATTITUDE + 1 - axis, STANDARD_GRAVITY if axis == 1 else -STANDARD_GRAVITY)
    for j in range(3):
        k = set_jacobian(c, k, ACCEL_BIAS + j, -m[3 * axis + j])
    return innovation_variance(c, k)


@kernel
def is_unaccelerated(p: Parameters, c: Core) -> bool:
    """Whether the mean specific force of the window is gravity, but for what tilt and bias may contribute."""
    most = p.tuning.rest_accel + 3.0 * math.sqrt(max(level_force_variance(c, 0), level_force_variance(c, 1)))
    return bool(math.hypot(c.stationarity.delta_v[0], c.stationarity.delta_v[1]) < most * c.stationarity.duration)


@kernel
def is_resting(p: Parameters, c: Core) -> bool:
    """Whether the last two windows at least were at rest."""
    s = c.stationarity
    if s.low_motion_count < 2 or not speed_allows_rest(p, c):
        return False
    if s.stationary_count > p.tuning.long_rest_windows and gnss_confirms_rest(p, c):
        return True  # whatever tilt and biases: they are wrong if they contradict
    if not is_unaccelerated(p, c):
        return False
    for i in range(3):
        if abs(s.mean_w[i] - c.nav.bg[i]) > max_rest_rate(p, c, i):
            return False
    return True


@kernel
def detect_rest(p: Parameters, c: Core) -> bool:
    """Decide, and keep, whether the sensor is at rest."""
    resting = is_resting(p, c)
    c.stationarity.at_rest = 1 if resting else 0
    return resting
