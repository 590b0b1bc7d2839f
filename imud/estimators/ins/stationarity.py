"""Windows of half a second over the inertial data: vibration level, noise floor, low motion, and classes of motion.

Low motion is a gyro deviation near the smallest one measured so far, and means that do not change, nor the force since
it began: it grows slowly where a tram or a ship departs. At constant speed a
smooth car vibrates hardly more than a parked one, so the gyro deviations of this vehicle at rest and in slow motion are
learned while the speed is known; where it is not, a sequential likelihood ratio compares the windows with both. The
decision is in `rest`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.earth import STANDARD_GRAVITY
from ...math.rotation import Vector
from ..tuning import Tunable
from .mechanization import body_to_ned, ned_to_body
from .state import NAVIGATING

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from .types import Core, MotionClass, Parameters, Stationarity


TUNABLES = (
    Tunable("rest_window_s", 0.5, "s", "Length of a stationarity window.", "Choice."),
    Tunable(
        "max_gyro_ratio",
        3.0,
        "",
        "Largest gyro deviation in a low-motion window, over the smallest one measured.",
        "Recorded drives.",
    ),
    Tunable(
        "low_motion_accel",
        0.35,
        "m/s^2",
        "Largest deviation of the specific force in a low-motion window.",
        "An idling engine.",
    ),
    Tunable(
        "stationary_accel",
        0.05,
        "m/s^2",
        "Largest deviation of the specific force in a window of a parked vehicle.",
        "A smooth car at walking pace has 0.06 to 0.1.",
    ),
    Tunable(
        "rate_of_change_decay",
        0.95,
        "per window",
        "Decay of the largest change between windows.",
        "About ten seconds.",
        high=0.9999,
    ),
    Tunable(
        "motion_range_decay",
        0.99,
        "per window",
        "Decay of the largest tilt and of the largest level acceleration.",
        "Fifty seconds.",
        high=0.9999,
    ),
    Tunable(
        "noise_floor_growth",
        1.001,
        "per window",
        "Growth of the smallest gyro deviation measured.",
        "About ten minutes.",
        low=1.0,
        high=1.1,
    ),
    Tunable(
        "vibration_noise_share",
        0.005,
        "",
        "Share of the vibration's power that acts as white noise.",
        "Recorded drives.",
        high=1.0,
    ),
    Tunable(
        "moving_vibration_accel",
        0.05,
        "m/s^2",
        "Vibration from sample to sample at which a vehicle counts as half under way.",
        "Recorded drives.",
    ),
    Tunable(
        "vibration_mean_time_s",
        300.0,
        "s",
        "Averaging time of the gyros' vibration under way, to which the learned noise of the attitude belongs.",
        "Some kinds of roads.",
        low=1.0,
    ),
    Tunable(
        "max_vibration_ratio",
        20.0,
        "",
        "Largest ratio of the gyros' vibration to its mean by which the learned noise of the attitude grows.",
        "Choice.",
        low=1.0,
    ),
    Tunable(
        "constant_noise_share",
        0.3,
        "",
        "Share of the learned noise of the attitude that the gyros' vibration does not change.",
        "Likelihood of recorded drives and flights; 0.1 and 0.3 hardly differ.",
        high=1.0,
    ),
    Tunable("fresh_fix_s", 2.0, "s", "Age up to which a fix gives the present speed.", "Two fixes of a 1 Hz receiver."),
    Tunable("rest_speed", 0.3, "m/s", "Largest speed of a receiver at rest.", "Three sigma of real receivers."),
    Tunable("rest_rate", 0.003, "rad/s", "Mean rate at rest, beyond the uncertainty of the bias.", "Recorded drives."),
    Tunable(
        "rest_accel",
        0.15,
        "m/s^2",
        "Mean level force at rest, beyond what tilt and bias explain.",
        "Less is no braking.",
    ),
    Tunable(
        "force_change_significance",
        9.0,
        "",
        "Squared change of the mean force between two windows, over its variance, beyond which the sensor turned.",
        "Three sigma.",
    ),
    Tunable(
        "slow_motion_min_speed", 0.5, "m/s", "Least speed of slow motion, which could be mistaken for rest.", "Choice."
    ),
    Tunable(
        "slow_motion_max_speed",
        5.0,
        "m/s",
        "Largest speed of slow motion, which could be mistaken for rest.",
        "Choice.",
    ),
    Tunable(
        "class_memory",
        0.01,
        "per window",
        "Gain of the statistics of rest and of slow motion.",
        "About fifty seconds.",
        high=1.0,
    ),
    Tunable(
        "class_min_windows",
        20.0,
        "windows",
        "Number of windows from which the statistics of rest and of slow motion are used.",
        "Choice.",
    ),
    Tunable(
        "class_min_sigma",
        0.25,
        "",
        "Least sigma of the logarithm of the gyro deviation, at rest and in slow motion.",
        "Recorded drives.",
    ),
    Tunable(
        "evidence_weight",
        0.25,
        "",
        "Weight of a window in the likelihood ratio of rest: neighbouring windows are not independent.",
        "One independent window in four.",
        high=1.0,
    ),
)


@kernel
def accumulate_window(c: Core, w: Reals, f: Reals) -> None:
    """Add one sample (rad/s, m/s^2, body axes) to the window, before it replaces the last sample."""
    s = c.stationarity
    w2, f2, difference_w2, difference_f2 = s.sum_w2, s.sum_f2, s.sum_rate_difference2, s.sum_force_difference2
    for i in range(3):
        w2 += w[i] * w[i]
        f2 += f[i] * f[i]
        difference_w2 += (w[i] - c.imu.w[i]) ** 2
        difference_f2 += (f[i] - c.imu.f[i]) ** 2
    s.sum_w2, s.sum_f2, s.sum_rate_difference2, s.sum_force_difference2 = w2, f2, difference_w2, difference_f2
    for i in range(3):
        s.sum_w[i] += w[i]
        s.sum_f[i] += f[i]
    s.sample_count += 1


@kernel
def accumulate_force(c: Core, delta_v: Vector, dt: float) -> None:
    """Add the integral of specific force over `dt` s (m/s, NED) to the window."""
    for i in range(3):
        c.stationarity.delta_v[i] += delta_v[i]
    c.stationarity.duration += dt


@kernel
def interrupt_rest(c: Core) -> None:
    """Restart the counts of low-motion windows: there may have been motion that was not measured."""
    c.stationarity.low_motion_count = c.stationarity.stationary_count = 0
    for i in range(3):
        c.stationarity.steady_f[i] = c.stationarity.mean_f[i]


@kernel
def first_window(c: Core, f: Reals) -> None:
    """Before the first window: the mean specific force is that of the first sample (m/s^2, body)."""
    for i in range(3):
        c.stationarity.mean_f[i] = c.stationarity.steady_f[i] = f[i]


@kernel
def clear_window(c: Core) -> None:
    """Clear the sums of the window."""
    s = c.stationarity
    s.sample_count = 0
    s.duration = 0.0
    s.sum_w2 = 0.0
    s.sum_f2 = 0.0
    for i in range(3):
        s.sum_w[i] = 0.0
        s.sum_f[i] = 0.0
        s.delta_v[i] = 0.0
    s.sum_rate_difference2 = 0.0
    s.sum_force_difference2 = 0.0


@kernel
def observe_motion(p: Parameters, c: Core) -> None:
    """Update what the motion has shown lately, from which a gap is judged: changes of the means, tilt, acceleration."""
    s, n, decay = c.stationarity, c.stationarity.sample_count, p.tuning.rate_of_change_decay
    w, f = s.sum_w, s.sum_f
    x, y, z = body_to_ned(c, (w[0] / n - s.mean_w[0], w[1] / n - s.mean_w[1], w[2] / n - s.mean_w[2]))
    change_f = max(abs(f[0] / n - s.mean_f[0]), abs(f[1] / n - s.mean_f[1]), abs(f[2] / n - s.mean_f[2]))
    s.level_rate_change2 = max(decay * s.level_rate_change2, (x * x + y * y) / s.duration)
    s.vertical_rate_change2 = max(decay * s.vertical_rate_change2, z * z / s.duration)
    s.force_change2 = max(decay * s.force_change2, change_f * change_f / s.duration)
    decay = p.tuning.motion_range_decay
    x, y, z = ned_to_body(c, (0.0, 0.0, 1.0))
    m = s.mean_down
    share = 1.0 if m[0] == 0.0 and m[1] == 0.0 and m[2] == 0.0 else 1.0 - decay
    m[0] += share * (x - m[0])
    m[1] += share * (y - m[1])
    m[2] += share * (z - m[2])
    s.tilt_range2 = max(decay * s.tilt_range2, (x - m[0]) ** 2 + (y - m[1]) ** 2 + (z - m[2]) ** 2)
    level2 = (s.delta_v[0] ** 2 + s.delta_v[1] ** 2) / (s.duration * s.duration)
    s.level_accel2 = max(decay * s.level_accel2, level2)


@kernel
def classify_window(p: Parameters, c: Core) -> None:
    """At the end of a window: vibration densities, noise floor, and the counts of low-motion windows in a row."""
    s = c.stationarity
    w2 = s.sum_w2 / s.sample_count
    f2 = s.sum_f2 / s.sample_count
    change_w, change_f, drift_f = 0.0, 0.0, 0.0
    if s.gyro_noise_floor > 0.0:  # not the first window
        observe_motion(p, c)
    for i in range(3):
        mean_w, mean_f = s.sum_w[i] / s.sample_count, s.sum_f[i] / s.sample_count
        w2 -= mean_w * mean_w
        f2 -= mean_f * mean_f
        change_w = max(change_w, abs(mean_w - s.mean_w[i]))
        change_f = max(change_f, abs(mean_f - s.mean_f[i]))
        drift_f = max(drift_f, abs(mean_f - s.steady_f[i]))
        s.mean_w[i], s.mean_f[i] = mean_w, mean_f
    noise2 = 2.0 * max(f2, 0.0) / (3.0 * s.sample_count)
    excess2 = max(change_f**2 - p.tuning.force_change_significance * noise2, 0.0)
    s.turn_rate_var = excess2 / (STANDARD_GRAVITY * s.duration) ** 2
    deviation = math.sqrt(max(w2, 0.0))
    dt = s.duration / s.sample_count
    s.vibration_gyro_psd = p.tuning.vibration_noise_share * s.sum_rate_difference2 / (6.0 * s.sample_count) * dt
    vibration2 = max(s.sum_force_difference2 / (6.0 * s.sample_count) - 2.0 * p.accel_psd / dt, 0.0)
    s.vibration_accel_psd = p.tuning.vibration_noise_share * vibration2 * dt
    s.vibration_level = vibration2 / (vibration2 + p.tuning.moving_vibration_accel**2)
    update_attitude_noise_level(p, s)
    least = math.sqrt(3.0 * p.gyro_psd / dt)
    if s.gyro_noise_floor <= 0.0:
        s.gyro_noise_floor = deviation
    s.gyro_noise_floor = max(min(s.gyro_noise_floor * p.tuning.noise_floor_growth, deviation), least)
    steady = change_w < p.tuning.rest_rate + s.gyro_noise_floor and max(change_f, drift_f) < p.tuning.rest_accel
    low_deviation = deviation < p.tuning.max_gyro_ratio * s.gyro_noise_floor and f2 < p.tuning.low_motion_accel**2
    low_motion = low_deviation and steady
    s.low_motion_count = s.low_motion_count + 1 if low_motion else 0
    if not low_motion:
        for i in range(3):
            s.steady_f[i] = s.mean_f[i]
    stationary = low_motion and f2 < p.tuning.stationary_accel**2
    s.stationary_count = s.stationary_count + 1 if stationary else 0
    update_evidence(p, c, elementary.log(max(deviation, least)))


@kernel
def update_attitude_noise_level(p: Parameters, s: Stationarity) -> None:
    """Update by how much the learned noise of the attitude is multiplied, after a window of known vibration.

    Vibration that turns the sensor makes its gyros err by aliasing and coning, in proportion to its power: the learned
    noise is that of its mean under way.
    """
    if s.vibration_level > 0.5:
        s.vibration_time = min(s.vibration_time + s.duration, p.tuning.vibration_mean_time_s)
        share = s.duration / s.vibration_time
        s.mean_vibration_gyro_psd += share * (s.vibration_gyro_psd - s.mean_vibration_gyro_psd)
    s.attitude_noise_level = s.vibration_level
    if s.mean_vibration_gyro_psd > 0.0:
        ratio = min(s.vibration_gyro_psd / s.mean_vibration_gyro_psd, p.tuning.max_vibration_ratio)
        constant = p.tuning.constant_noise_share
        s.attitude_noise_level *= constant + (1.0 - constant) * ratio


@kernel
def update_evidence(p: Parameters, c: Core, log_deviation: float) -> None:
    """Update the log likelihood ratio of rest with the gyro's `log_deviation`; at a known speed, learn from it."""
    s = c.stationarity
    known = c.gnss.fix_count > 0 and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < p.tuning.fresh_fix_s
    speed = (
        elementary.hypot(c.nav.v_n[0], c.nav.v_n[1])
        if c.alignment.mode == NAVIGATING and not c.gnss.speed >= 0.0
        else c.gnss.speed
    )
    if known and speed < p.tuning.slow_motion_max_speed:
        if speed < p.tuning.rest_speed and s.low_motion_count > 1:
            learn_class(p, s.rest_class, log_deviation)
        elif speed > p.tuning.slow_motion_min_speed:
            learn_class(p, s.slow_motion_class, log_deviation)
    ratio = 0.0
    if min(s.rest_class.count, s.slow_motion_class.count) >= p.tuning.class_min_windows:
        ratio = log_likelihood(p, s.rest_class, log_deviation) - log_likelihood(p, s.slow_motion_class, log_deviation)
    s.log_likelihood_ratio = (
        s.log_likelihood_ratio + p.tuning.evidence_weight * min(max(ratio, -2.0), 2.0)
        if s.low_motion_count > 1
        else 0.0
    )


@kernel
def learn_class(p: Parameters, m: MotionClass, log_deviation: float) -> None:
    """Update count, mean and variance of `log_deviation` in a class, with exponential forgetting (class_memory)."""
    m.count += 1.0
    share = max(1.0 / m.count, p.tuning.class_memory)
    left = log_deviation - m.mean
    m.mean += share * left
    m.variance += share * ((1.0 - share) * left * left - m.variance)


@kernel
def log_likelihood(p: Parameters, m: MotionClass, log_deviation: float) -> float:
    """Logarithm of the normal density of `log_deviation` in a class, without its constant."""
    variance = max(m.variance, p.tuning.class_min_sigma**2)
    return float(-0.5 * ((log_deviation - m.mean) ** 2 / variance + elementary.log(variance)))
