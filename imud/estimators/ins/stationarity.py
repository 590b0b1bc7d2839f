"""Windows of half a second over the inertial data: is the sensor quiet, how strongly does it vibrate, is it at rest?

Quiet alone is not rest: at constant speed a smooth car is nearly as quiet as a parked one. Rest needs the quiet of
the quietest time seen, a mean rate that is the bias, and a speed, from a fresh fix or from the filter, near zero.
Where no speed is known, as in the first seconds of a start under way, the quietest time seen may itself be motion:
there only a stillness will do that no vehicle under way has. In an outage the speed is known less and less: there
the quiet is compared with what this vehicle has shown at rest and in slow motion while its speed was known.
"""

import math
from typing import Any

from ...compile.jit import kernel
from ...math.earth import STANDARD_GRAVITY
from .ekf import innovation_variance, set_jacobian, variance
from .mechanization import Vector, rotation_matrix
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, NAVIGATING, VELOCITY

WINDOW_S = 0.5
MAX_GYRO_RATIO = 3.0  # times the quietest gyro deviation seen
LOW_MOTION_ACCEL = 0.35  # m/s^2, an idling engine
STATIONARY_ACCEL = 0.05  # m/s^2, parked; a smooth car that creeps has 0.06 to 0.1
RATE_OF_CHANGE_DECAY = 0.95  # per window: the most fitful motion is forgotten within some ten seconds
NOISE_FLOOR_GROWTH = 1.001  # per window: the quietest is forgotten within some ten minutes
VIBRATION_NOISE_SHARE = 0.005  # share of the vibration's power that acts as white noise
MOVING_VIBRATION_ACCEL = 0.05  # m/s^2, sample to sample, of a vehicle under way
FRESH_S = 2.0
REST_SPEED = 0.3  # m/s, three sigma of a receiver's speed at rest
LONG_REST_WINDOWS = 10  # windows, enough when no speed is known
REST_VARIANCE, LONG_REST_VARIANCE = 0.5, 10.0  # m^2/s^2, a velocity less certain than that cannot tell rest
REST_RATE = 0.003  # rad/s beyond the uncertainty of the bias
REST_ACCEL = 0.15  # m/s^2 beyond what tilt and bias may be wrong: less is no braking
SLOW_MOTION_SPEED = (0.5, 5.0)  # m/s, slow motion: what rest could be mistaken for
CLASS_MEMORY, CLASS_MIN_WINDOWS = 0.01, 20.0  # per window; windows before a manner is known
CLASS_MIN_SIGMA = 0.25  # least standard deviation of the logarithm
EVIDENCE_WEIGHT, REST_LOG_LIKELIHOOD = 0.25, 3.0  # neighbouring windows are not independent; log likelihood ratio


@kernel
def accumulate_window(c: Any, w: Any, f: Any) -> None:
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
def accumulate_force(c: Any, delta_v: Vector, dt: float) -> None:
    """Add the specific force (navigation axes, integrated over `dt` s, m/s) of a sample."""
    for i in range(3):
        c.stationarity.delta_v[i] += delta_v[i]
    c.stationarity.duration += dt


@kernel
def interrupt_rest(c: Any) -> None:
    """Count windows of low motion anew: there may have been motion that the sensor did not show."""
    c.stationarity.low_motion_count = c.stationarity.stationary_count = 0


@kernel
def withdraw_rest(c: Any) -> None:
    """The sensor does not show whether it is at rest now."""
    interrupt_rest(c)
    c.stationarity.at_rest = 0


@kernel
def first_window(c: Any, f: Any) -> None:
    """Before the first window: the mean specific force is that of the first sample."""
    for i in range(3):
        c.stationarity.mean_f[i] = f[i]


@kernel
def clear_window(c: Any) -> None:
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
def classify_window(p: Any, c: Any) -> None:
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
            RATE_OF_CHANGE_DECAY * c.stationarity.max_rate_of_change[0], turned**2 / c.stationarity.duration
        )
        c.stationarity.max_rate_of_change[1] = max(
            RATE_OF_CHANGE_DECAY * c.stationarity.max_rate_of_change[1], pushed**2 / c.stationarity.duration
        )
    deviation = math.sqrt(max(w2, 0.0))
    dt = c.stationarity.duration / c.stationarity.sample_count
    c.stationarity.vibration_gyro_psd = (
        VIBRATION_NOISE_SHARE * c.stationarity.sum_difference2[0] / (6.0 * c.stationarity.sample_count) * dt
    )
    jolt2 = max(c.stationarity.sum_difference2[1] / (6.0 * c.stationarity.sample_count) - 2.0 * p.accel_psd / dt, 0.0)
    c.stationarity.vibration_accel_psd = VIBRATION_NOISE_SHARE * jolt2 * dt
    c.stationarity.vibration_level = jolt2 / (jolt2 + MOVING_VIBRATION_ACCEL**2)
    least = math.sqrt(3.0 * p.gyro_psd / dt)
    if c.stationarity.gyro_noise_floor <= 0.0:
        c.stationarity.gyro_noise_floor = deviation
    c.stationarity.gyro_noise_floor = max(min(c.stationarity.gyro_noise_floor * NOISE_FLOOR_GROWTH, deviation), least)
    even = turned < REST_RATE + c.stationarity.gyro_noise_floor and pushed < REST_ACCEL
    quiet = deviation < MAX_GYRO_RATIO * c.stationarity.gyro_noise_floor and f2 < LOW_MOTION_ACCEL**2 and even
    c.stationarity.low_motion_count = c.stationarity.low_motion_count + 1 if quiet else 0
    c.stationarity.stationary_count = c.stationarity.stationary_count + 1 if quiet and f2 < STATIONARY_ACCEL**2 else 0
    update_evidence(c, math.log(max(deviation, least)))


@kernel
def update_evidence(c: Any, x: float) -> None:
    """Learn the log deviation x of this window where the speed is known, and gather evidence of rest elsewhere."""
    known = c.gnss.fix_count > 0 and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < FRESH_S
    speed = (
        math.hypot(c.nav.v_n[0], c.nav.v_n[1])
        if c.alignment.mode == NAVIGATING and not c.gnss.speed >= 0.0
        else c.gnss.speed
    )
    if known and speed < SLOW_MOTION_SPEED[1]:
        if speed < REST_SPEED and c.stationarity.low_motion_count > 1:
            learn_class(c.stationarity.motion_class[0], x)
        elif speed > SLOW_MOTION_SPEED[0]:
            learn_class(c.stationarity.motion_class[1], x)
    ratio = 0.0
    if min(c.stationarity.motion_class[0, 0], c.stationarity.motion_class[1, 0]) >= CLASS_MIN_WINDOWS:
        ratio = log_likelihood(c.stationarity.motion_class[0], x) - log_likelihood(c.stationarity.motion_class[1], x)
    c.stationarity.log_likelihood_ratio = (
        c.stationarity.log_likelihood_ratio + EVIDENCE_WEIGHT * min(max(ratio, -2.0), 2.0)
        if c.stationarity.low_motion_count > 1
        else 0.0
    )


@kernel
def learn_class(manner: Any, x: float) -> None:
    """Count, mean and variance of x, of which the past is slowly forgotten."""
    manner[0] += 1.0
    share = max(1.0 / manner[0], CLASS_MEMORY)
    left = x - manner[1]
    manner[1] += share * left
    manner[2] += share * ((1.0 - share) * left * left - manner[2])


@kernel
def log_likelihood(manner: Any, x: float) -> float:
    """Logarithm of the normal density, but for its constant."""
    variance = max(manner[2], CLASS_MIN_SIGMA**2)
    return float(-0.5 * ((x - manner[1]) ** 2 / variance + math.log(variance)))


@kernel
def speed_allows_rest(c: Any) -> bool:
    """Whether nothing known of the speed speaks against rest."""
    fresh = c.gnss.fix_count > 0 and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < FRESH_S
    known = fresh and c.gnss.speed >= 0.0
    if known and c.gnss.speed > REST_SPEED:
        return False
    if c.alignment.mode != NAVIGATING:
        return bool(known or c.stationarity.stationary_count > LONG_REST_WINDOWS)
    speed2 = c.nav.v_n[0] ** 2 + c.nav.v_n[1] ** 2 + c.nav.v_n[2] ** 2
    s2 = max(variance(c, VELOCITY), variance(c, VELOCITY + 1))
    return bool(
        (known and speed2 < 1.0 + 9.0 * s2)
        or (
            speed2 < REST_SPEED**2
            and s2 < (LONG_REST_VARIANCE if c.stationarity.low_motion_count > LONG_REST_WINDOWS else REST_VARIANCE)
        )
        or (
            fresh
            and not known
            and c.stationarity.stationary_count > LONG_REST_WINDOWS
            and speed2 < REST_SPEED**2 + 9.0 * s2
        )
        or (
            c.stationarity.log_likelihood_ratio > REST_LOG_LIKELIHOOD
            and speed2 < REST_SPEED**2 + 9.0 * s2
            and s2 < LONG_REST_VARIANCE
        )
    )


@kernel
def gnss_confirms_rest(c: Any) -> bool:
    """Whether the receiver's own speed says rest, too."""
    return bool(c.gnss.speed <= REST_SPEED and 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < FRESH_S)


@kernel
def max_rest_rate(c: Any, i: int) -> float:
    """Most mean rate about axis i, less the bias estimated, that may be rest, rad/s."""
    return REST_RATE + 3.0 * math.sqrt(variance(c, GYRO_BIAS + i))


@kernel
def level_force_variance(c: Any, axis: int) -> float:
    """Variance, m^2/s^4, of the level specific force for what tilt and bias may contribute: a rest ties the two."""
    m = rotation_matrix(c)
    k = set_jacobian(c, 0, ATTITUDE + 1 - axis, STANDARD_GRAVITY if axis == 1 else -STANDARD_GRAVITY)
    for j in range(3):
        k = set_jacobian(c, k, ACCEL_BIAS + j, -m[3 * axis + j])
    return innovation_variance(c, k)


@kernel
def is_unaccelerated(c: Any) -> bool:
    """Whether the mean specific force of the window is gravity, but for what tilt and bias may contribute."""
    most = REST_ACCEL + 3.0 * math.sqrt(max(level_force_variance(c, 0), level_force_variance(c, 1)))
    return bool(math.hypot(c.stationarity.delta_v[0], c.stationarity.delta_v[1]) < most * c.stationarity.duration)


@kernel
def is_resting(c: Any) -> bool:
    """Whether the last two windows at least were at rest."""
    s = c.stationarity
    if s.low_motion_count < 2 or not speed_allows_rest(c):
        return False
    if s.stationary_count > LONG_REST_WINDOWS and gnss_confirms_rest(c):
        return True  # whatever tilt and biases: they are wrong if they contradict
    if not is_unaccelerated(c):
        return False
    for i in range(3):
        if abs(s.mean_w[i] - c.nav.bg[i]) > max_rest_rate(c, i):
            return False
    return True


@kernel
def detect_rest(c: Any) -> bool:
    """Decide, and keep, whether the sensor is at rest."""
    resting = is_resting(c)
    c.stationarity.at_rest = 1 if resting else 0
    return resting
