"""Whether the body is at rest, from the inertial sensor alone, and whether its rate may then be the gyro's bias.

Rest is: for `stationary_time_s` no sample far from the running means, mean rate and direction of the force unchanged
since, a rate that a bias can explain, and a force that is gravity in the known attitude: else it is steady
acceleration. A rate that keeps changing, however slowly, is a smooth road and no bias.

A vehicle on a smooth road moves as little as one that stands. Which it does, its vibration tells: roads shake a vehicle
that moves, whatever its engine does. Where its way shook it no more than its engine, the velocity tells that it should
have moved on, zero but for the errors of the integral if it stands. The longer the low motion, the likelier it stands.

What seems to accelerate and yet stands, or does so evenly for longer than vehicles do, rests in a wrong attitude. Until
then it is stated that it may.

Steady slow rotation about the vertical looks just like a bias; only what is known already distinguishes the two. A mean
rate that contradicts the known bias is not fused until the growing variance of the bias allows it; unless it is the
smaller and so the likelier bias: then the body turned before and rests now. That is believed soon if the force is the
one at which the bias was measured, as on a turntable; in an even curve the force is another, and then only what lasts
longer than curves do is believed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.kalman import measure
from ...math.rotation import Vector, dcm_of_quat, quat_rotate
from .attitude_step import level_by_force
from .divergence import inflate_covariance
from .ekf import fuse_state
from .error_model import add_bias_variance, add_variance, reset_variance, variance, widen_bias
from .mechanization import compensate_force
from .motion import is_beyond_usual_biases
from .state import ACCEL_BIAS, ACCEL_SCALE, ATTITUDE, GYRO_BIAS, GYRO_MATRIX, STATES, VELOCITY

if TYPE_CHECKING:
    from .types import Parameters, State


@kernel
def update_means(p: Parameters, s: State, w: Vector, f: Vector, dt: float) -> None:
    """Running means, and for how long samples have been near them; a sample that is not restarts the means."""
    c, m = p.tuning, s.stationarity
    gain = dt / (min(c.mean_time_s, m.low_motion_s + dt) + dt)
    rate2 = force2 = force_change2 = rate_change2 = mean2 = 0.0
    for i in range(3):
        m.w_mean[i] += gain * (w[i] - m.w_mean[i])
        m.f_mean[i] += gain * (f[i] - m.f_mean[i])
        if m.low_motion_s < c.mean_time_s:
            m.w_start[i], m.f_start[i] = m.w_mean[i], m.f_mean[i]
        rate2 += (w[i] - m.w_mean[i]) ** 2
        force2 += (f[i] - m.f_mean[i]) ** 2
        force_change2 += (m.f_mean[i] - m.f_start[i]) ** 2
        rate_change2 += (m.w_mean[i] - m.w_start[i]) ** 2
        mean2 = max(mean2, m.w_mean[i] ** 2)
    m.low_motion_s += dt
    m.force_psd += gain * (force2 * dt / 3.0 - m.force_psd)
    low = rate2 < c.max_rate_deviation_radps**2 and force2 < c.max_force_deviation_mps2**2
    low = low and force_change2 < c.max_force_change_mps2**2
    low = low and rate_change2 < c.min_bias_sigma_radps**2 + c.rate_change_gate**2 * p.gyro_psd / c.mean_time_s
    if not low or mean2 > c.max_bias_sigma**2 * (p.gyro_bias_var + p.gyro_bias_inflation):
        restart_means(s, w, f)


@kernel
def restart_means(s: State, w: Vector, f: Vector) -> None:
    """Low motion begins now, with the means at these readings."""
    m = s.stationarity
    m.low_motion_s = 0.0
    for i in range(3):
        m.w_mean[i], m.f_mean[i] = w[i], f[i]
        m.w_start[i], m.f_start[i] = w[i], f[i]


@kernel
def restart_means_at_last(s: State) -> None:
    """The same at the newest sample."""
    w, f = s.imu.w, s.imu.f
    restart_means(s, (w[0], w[1], w[2]), (f[0], f[1], f[2]))


@kernel
def restart_stationarity(s: State, w: Vector, f: Vector) -> None:
    """After a gap: nothing is known of the motion before these readings."""
    restart_means(s, w, f)
    s.stationarity.bias_mismatch_s = 0.0
    s.stationarity.stationary = 0


@kernel
def reset_rest(s: State) -> None:
    """After a power-on: whatever was learnt at rest is judged anew."""
    restart_means_at_last(s)
    s.stationarity.bias_mismatch_s = 0.0
    s.stationarity.gravity_checked = 0
    s.stationarity.unmeasured_s = 0.0


@kernel
def unexplained_acceleration(p: Parameters, s: State) -> float:
    """The acceleration in the mean force, m/s^2, if errors of attitude and accelerometer do not explain it, else 0.

    The Jacobian of C f + g by attitude is -(C f)x, by accelerometer bias -C, by scale -C diag(f).
    """
    q, t = s.nav.q_nb, s.scratch
    C = dcm_of_quat((q[0], q[1], q[2], q[3]))
    f = compensate_force(s.nav, s.stationarity.f_mean[0], s.stationarity.f_mean[1], s.stationarity.f_mean[2])
    n = quat_rotate((q[0], q[1], q[2], q[3]), f)
    acceleration = (n[0], n[1], n[2] + s.nav.gravity)
    by_tilt = ((0.0, n[2]), (-n[2], 0.0), (n[1], -n[0]))
    for i in range(3):
        t.columns[0], t.values[0] = ATTITUDE, by_tilt[i][0]
        t.columns[1], t.values[1] = ATTITUDE + 1, by_tilt[i][1]
        for m in range(3):
            t.columns[2 + m], t.values[2 + m] = ACCEL_BIAS + m, -C[3 * i + m]
            t.columns[5 + m], t.values[5 + m] = ACCEL_SCALE + m, -C[3 * i + m] * f[m]
        explained = measure(s.cov.P, STATES, t.columns, t.values, 8, t.ph) + p.tuning.min_force_sigma_mps2**2
        if acceleration[i] * acceleration[i] > p.tuning.acceleration_gate**2 * explained:
            return math.sqrt(acceleration[0] ** 2 + acceleration[1] ** 2 + acceleration[2] ** 2)
    return 0.0


@kernel
def force_is_only_turned(p: Parameters, s: State, acceleration: float) -> bool:
    """Is the mean force as large as at the last rest? With a level acceleration, m/s^2, it would be larger.

    Then the sensor has been turned, or slipped, and the gyro has not shown it.
    """
    now, before, g = s.stationarity.f_mean, s.stationarity.f_at_rest, s.nav.gravity
    before2 = before[0] ** 2 + before[1] ** 2 + before[2] ** 2
    change = math.sqrt(now[0] ** 2 + now[1] ** 2 + now[2] ** 2) - math.sqrt(before2)
    larger = math.sqrt(g * g + acceleration * acceleration) - g
    var = 2.0 * p.accel_bias_var * (acceleration / g) ** 2 + p.tuning.min_force_sigma_mps2**2
    gate2 = p.tuning.force_change_gate**2 * var
    return bool(before2 > 0.0 and change * change < gate2 and change < larger and (larger - change) ** 2 > gate2)


@kernel
def level_by_mean_force(p: Parameters, s: State) -> None:
    """The sensor has been turned at rest: its mean force is the vertical."""
    q, m, g = s.nav.q_nb, s.stationarity, s.nav.gravity
    f = compensate_force(s.nav, m.f_mean[0], m.f_mean[1], m.f_mean[2])
    var = (p.accel_bias_var + p.tuning.min_force_sigma_mps2**2) / (g * g)
    level_by_force(p, s, quat_rotate((q[0], q[1], q[2], q[3]), f), var, m.low_motion_s)


@kernel
def vibrates_less_than_in_travel(p: Parameters, s: State) -> bool:
    """Does the body vibrate far less than it did while it travelled?"""
    return bool(p.tuning.standing_vibration_ratio * s.motion.vibration_level < s.motion.travel_vibration_level)


@kernel
def is_standing(p: Parameters, s: State) -> bool:
    """Likelihood ratio of a body that travelled: zero velocity, or the sustained one in whichever direction?"""
    c = p.tuning
    travel2 = s.motion.travel_speed2[0] + s.motion.travel_speed2[1]
    if travel2 < c.travel_speed_mps**2 or vibrates_less_than_in_travel(p, s):
        return True
    for i in range(2):
        standing = variance(s, VELOCITY + i)
        moving = standing + travel2
        v = s.nav.v_n[i]
        log_odds = 0.5 * (elementary.log(moving / standing) - v * v * (1.0 / standing - 1.0 / moving))
        if log_odds + s.stationarity.low_motion_s / c.travel_time_s < c.moving_log_odds:
            return False
    return True


@kernel
def check_gravity(p: Parameters, s: State) -> None:
    """At the first rest: a force whose magnitude is not gravity shows a sensor worse than assumed."""
    c, f, g = p.tuning, s.stationarity.f_mean, s.nav.gravity
    s.stationarity.gravity_checked = 1
    s.stationarity.since_first_s = s.stationarity.hidden_angle = 0.0
    for i in range(3):
        s.stationarity.bg_before[i] = s.nav.bg[i]
    excess = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) - g
    if excess * excess >= c.gravity_magnitude_gate**2 * (p.accel_bias_var + g * g * p.accel_scale_var):
        widen_accel_bias(p, s, excess)


@kernel
def widen_gyro_bias(p: Parameters, s: State) -> None:
    """At the first rest: the gyro's bias may be that of the worst parts, and has turned the attitude meanwhile."""
    q, m = s.nav.q_nb, s.stationarity
    C = dcm_of_quat((q[0], q[1], q[2], q[3]))
    widen_bias(s, p.gyro_bias_inflation, C, m.low_motion_s, m.unmeasured_s + s.levelling.duration)
    level_by_mean_force(p, s)


@kernel
def widen_accel_bias(p: Parameters, s: State, excess: float) -> None:
    """The accelerometer is worse than assumed, by an error of `excess`, m/s^2, on one axis.

    Three accelerometers of one sensor are alike: the excess is one observation of the variance of their biases, of as
    much weight as the profile's.
    """
    of_profile = p.accel_bias_var + p.accel_bias_inflation
    most2 = p.tuning.max_bias_sigma**2 * of_profile  # more is an acceleration
    of_excess = (0.5 * (of_profile + excess * excess) if excess * excess < most2 else of_profile) - p.accel_bias_var
    for i in range(3):
        add_variance(s, ACCEL_BIAS + i, max(p.accel_bias_inflation, of_excess))
        add_variance(s, ACCEL_SCALE + i, p.accel_scale_inflation)
    for i in range(9):
        add_variance(s, GYRO_MATRIX + i, p.gyro_matrix_inflation)
    beyond_profile = max(of_excess - p.accel_bias_inflation, 0.0) / s.nav.gravity**2
    for i in range(2):  # a bias beyond the profile's has made a tilt; twice its sigma, as its size is a guess
        add_variance(s, ATTITUDE + i, p.tuning.relevel_tilt_rad**2 + 4.0 * beyond_profile)


@kernel
def rate_contradicts_bias(p: Parameters, s: State) -> bool:
    """Is the mean rate not the bias that is known?"""
    c = p.tuning
    for i in range(3):
        d = s.stationarity.w_mean[i] - s.nav.bg[i]
        if d * d > c.bias_gate**2 * (variance(s, GYRO_BIAS + i) + c.min_bias_sigma_radps**2):
            return True
    return False


@kernel
def rate_is_likelier_bias(p: Parameters, s: State) -> bool:
    """Is the mean rate, which contradicts the known bias, smaller than it, and has it been for long enough?

    Where the known bias is one of the worst parts', a slow turn about one axis can make a rate smaller that is no
    likelier: then the likelihood has to differ by a factor of e.
    """
    c, m = p.tuning, s.stationarity
    known2 = shown2 = moved2 = 0.0
    for i in range(3):
        known2 += s.nav.bg[i] ** 2
        shown2 += m.w_mean[i] ** 2
        moved2 += (m.f_mean[i] - m.f_at_rest[i]) ** 2
    needed_s = c.confirmation_time_s if moved2 < c.max_force_change_mps2**2 else c.max_curve_time_s
    worst = known2 > c.max_bias_sigma**2 * p.gyro_bias_var
    least = 2.0 * (p.gyro_bias_var + p.gyro_bias_inflation) if worst else 0.0
    return known2 - shown2 > least and m.bias_mismatch_s > needed_s


@kernel
def gravity_is_fixed(p: Parameters, s: State) -> bool:
    """Does gravity stay where it is in the body, although the mean rate less the known bias would have turned it?

    Then the body rests, and what contradicts is the bias. A rate about the vertical turns no gravity, and nearly level
    curves turn about it; so one that is not mostly across the force tells nothing. The mean force is that of
    `mean_time_s` ago, the one at the start that of the first `mean_time_s`.
    """
    c, m = p.tuning, s.stationarity
    w = (m.w_mean[0] - s.nav.bg[0], m.w_mean[1] - s.nav.bg[1], m.w_mean[2] - s.nav.bg[2])
    f = m.f_mean
    time = m.low_motion_s - 1.5 * c.mean_time_s
    across = (f[1] * w[2] - f[2] * w[1], f[2] * w[0] - f[0] * w[2], f[0] * w[1] - f[1] * w[0])
    across2 = across[0] ** 2 + across[1] ** 2 + across[2] ** 2
    rate2 = w[0] ** 2 + w[1] ** 2 + w[2] ** 2
    force2 = f[0] ** 2 + f[1] ** 2 + f[2] ** 2
    change2 = 0.0
    for i in range(3):
        change2 += (f[i] - m.f_start[i]) ** 2
    noise2 = 1.5 * max(m.force_psd, p.accel_psd) / c.mean_time_s
    turn2 = across2 * time * time  # (m/s^2)^2, by which the force would have changed
    no_curve = across2 > c.min_rate_across_gravity**2 * rate2 * force2
    return bool(no_curve and turn2 > c.fixed_gravity_gate**2 * noise2 and change2 < 0.25 * turn2)


@kernel
def probability_of_motion(p: Parameters, evidence: float) -> float:
    """That a rest is even motion; evidence: 1 where it is half as probable as it can be."""
    return float(p.tuning.even_motion_probability * evidence**4 / (1.0 + evidence**4))


@kernel
def update_hidden_motion(p: Parameters, s: State) -> None:
    """What a rest hides if it is even motion, times the root of the probability that it is.

    A constant acceleration is a tilt, a constant turn about the vertical a gyro bias. What moves is shaken, even in its
    quietest moment, by more than the noise of its sensor; and a turn makes one rate of three alike gyros the largest.
    No such motion lasts. The turn is what the bias known before the first rest does not explain; the yaw has been
    turned back by it since the start.
    """
    c, m = p.tuning, s.stationarity
    f, w, known = m.f_mean, m.w_mean, m.bg_before
    force2 = f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    along = (w[0] * f[0] + w[1] * f[1] + w[2] * f[2]) / force2
    across2 = max(w[0] * w[0] + w[1] * w[1] + w[2] * w[2] - along * along * force2, 0.0)
    turn = along - (known[0] * f[0] + known[1] * f[1] + known[2] * f[2]) / force2  # over the force
    turn2 = turn * turn * force2
    shaken = m.least_force_psd / (c.moving_vibration_ratio**2 * p.accel_psd)
    turning = turn2 / (c.turn_ratio**2 * (0.5 * across2 + c.min_bias_sigma_radps**2))
    lasting = elementary.exp(-m.since_first_s / c.max_curve_time_s)
    root = math.sqrt(probability_of_motion(p, shaken + turning) * lasting)
    m.hidden_tilt = math.sqrt(probability_of_motion(p, shaken) * lasting) * c.even_acceleration_mps2 / s.nav.gravity
    for i in range(3):
        m.hidden_turn[i] = root * turn * f[i]
    since_s = s.integrals.time if m.hidden_angle > 0.0 else m.unmeasured_s + s.levelling.duration
    turned = root * math.sqrt(turn2) * since_s
    add_variance(s, ATTITUDE + 2, (2.0 * m.hidden_angle + turned) * turned)
    m.hidden_angle += turned


@kernel
def add_hidden_motion(s: State) -> None:
    """When rest ends: the mean rate may have been a turn."""
    turn = s.stationarity.hidden_turn
    add_bias_variance(s, (turn[0], turn[1], turn[2]))
    turn[:] = 0.0


@kernel
def fade_hidden_tilt(p: Parameters, s: State) -> None:
    """In motion, with the time that even motion lasts: a hand shows at once what is tilt."""
    m = s.stationarity
    m.hidden_tilt -= m.hidden_tilt * min(s.integrals.time / p.tuning.max_curve_time_s, 1.0)
    if s.attitude_step.hand_held_s >= p.tuning.hand_time_s:
        m.hidden_tilt = 0.0


@kernel
def take_rate_for_bias(p: Parameters, s: State, fuse: bool) -> None:
    """The gyro bias has changed when the low motion began, and has turned the attitude since; `fuse`: no rest will."""
    q, m = s.nav.q_nb, s.stationarity
    C = dcm_of_quat((q[0], q[1], q[2], q[3]))
    widen_bias(s, p.gyro_bias_var, C, m.low_motion_s, m.low_motion_s)
    if fuse:
        for i in range(3):
            fuse_state(s, GYRO_BIAS + i, m.w_mean[i] - s.nav.bg[i], p.mean_rate_psd / p.tuning.mean_time_s)


@kernel
def detect_stationary(p: Parameters, s: State) -> bool:
    """Is this rest, with a mean rate that may correct the gyro bias? Once per covariance interval."""
    c, m = p.tuning, s.stationarity
    was_stationary = m.stationary == 1
    m.stationary = 0
    m.since_first_s += s.integrals.time
    m.since_rest_s = 0.0 if was_stationary else m.since_rest_s + s.integrals.time
    m.possible_tilt = 0.0
    fade_hidden_tilt(p, s)
    if m.gravity_checked == 0:
        m.unmeasured_s += s.integrals.time
    if m.low_motion_s < c.stationary_time_s:
        m.bias_mismatch_s = 0.0
        return False
    if m.gravity_checked == 0:
        if is_beyond_usual_biases(p, s):
            if not gravity_is_fixed(p, s) and m.low_motion_s < c.confirmation_time_s:
                return False
            widen_gyro_bias(p, s)
        check_gravity(p, s)
    contradicts = rate_contradicts_bias(p, s)
    acceleration = unexplained_acceleration(p, s)
    if m.since_rest_s - m.low_motion_s < c.stationary_time_s:  # it began at rest
        m.possible_tilt = math.sqrt(c.rise_slip_probability) * acceleration / s.nav.gravity
    turned = acceleration > 0.0 and force_is_only_turned(p, s, acceleration)
    needed_s = c.confirmation_time_s if turned or vibrates_less_than_in_travel(p, s) else c.travel_time_s
    rested = m.since_rest_s - m.low_motion_s < c.confirmation_time_s
    undisturbed_s = c.confirmation_time_s if rested else needed_s  # what flies has not just rested
    if contradicts and (acceleration == 0.0 or m.low_motion_s > undisturbed_s) and gravity_is_fixed(p, s):
        take_rate_for_bias(p, s, acceleration > 0.0)
        contradicts = False
        m.bias_mismatch_s = 0.0
    if acceleration > 0.0 and not contradicts and m.low_motion_s > needed_s:
        if turned:
            level_by_mean_force(p, s)
        else:
            inflate_covariance(p, s, acceleration)
        restart_means_at_last(s)
    if acceleration > 0.0 or not is_standing(p, s):
        return False
    if not contradicts:
        if m.bias_mismatch_s > 0.0:  # the rate has just changed
            restart_means_at_last(s)
            m.bias_mismatch_s = 0.0
            return False
        m.least_force_psd = min(m.least_force_psd, m.force_psd) if was_stationary else m.force_psd
        m.stationary = 1
        for i in range(3):
            m.f_at_rest[i] = m.f_mean[i]
        update_hidden_motion(p, s)
        return True
    m.bias_mismatch_s += s.integrals.time
    if rate_is_likelier_bias(p, s):
        for i in range(3):
            reset_variance(s, GYRO_BIAS + i, p.gyro_bias_var)
    return False
