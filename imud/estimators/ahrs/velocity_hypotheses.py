"""Before the first rest: whether the body is in a hand, and otherwise the tilt that other ways to move explain best.

While neither the tilt nor the gyro bias is known, a velocity that lasts for seconds looks like both. How long and how
fast is what a hand, somebody who walks, a drone and a car do differently. So a bank of filters runs beside, one for
each hypothesis of how the body moves (`hypothesis_filters`; multiple-model estimation, Magill 1965).

The innovations' likelihood says whether the body is in a hand. Where it is, the filter, which is made for hands, is
right, and what the others say is stated with their probability in the sigmas of roll and pitch. Where it is not, and
the body travels, the others lead: their mixture becomes the filter's tilt, gyro bias and velocity, once a second, and
no zero velocity is assumed. Among themselves they are weighed by a small power of the likelihood only, which fades, as
the errors of these models last for many seconds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.kalman import packed_index
from .attitude_step import is_undecided
from .error_model import add_variance, couple_yaw_to_bias, replace_variance, variance
from .history import record_yaw_corrected
from .hypothesis_filters import (
    BIAS,
    HANDS,
    INTEGRATED,
    TILT,
    TRUE_VELOCITY,
    compare_velocity,
    correct_integrated_velocity,
    propagate_hypothesis,
    start_filters,
)
from .integrals import turn_about_vertical
from .motion import reset_motion, start_motion
from .state import ATTITUDE, GYRO_BIAS, HYPOTHESES, HYPOTHESIS_STATES, STATES, VELOCITY

if TYPE_CHECKING:
    from ...math.rotation import Vector
    from .types import Parameters, State

INTERVAL = 1.0  # s


@kernel
def start_hypotheses(p: Parameters, s: State) -> None:
    """Nothing is known: roll and pitch have just been set."""
    b = s.hypotheses
    start_filters(p, s)
    b.v[:] = 0.0
    b.possible_tilt_error = b.hand = 0.0
    b.leading = b.due = 0
    for h in range(HYPOTHESES):
        b.log_likelihood[h] = p.tuning.hypothesis_hand_odds if h < HANDS else 0.0
        b.log_weight[h] = 0.0
    drop_yaw_correction(s)
    restart_interval(s)


@kernel
def drop_yaw_correction(s: State) -> None:
    """The correction that the hypotheses left is not made: the yaw may be wrong by as much."""
    add_variance(s, ATTITUDE + 2, s.hypotheses.yaw_correction**2)
    s.hypotheses.yaw_correction = 0.0


@kernel
def restart_interval(s: State) -> None:
    """The transition begins anew."""
    b = s.hypotheses
    b.time = b.force = b.turn = b.attitude_noise = 0.0
    b.displacement[:] = 0.0
    b.velocity_noise[:] = 0.0
    b.shift[:] = 0.0
    b.turn_by_bias[:] = 0.0
    b.tilt_by_bias[:] = 0.0
    b.velocity_by_bias[:] = 0.0


@kernel
def update_hypotheses(p: Parameters, s: State) -> None:
    """Before the first rest, after one covariance interval: the transition, and once a second the measurement."""
    b, total = s.hypotheses, s.integrals
    if s.stationarity.gravity_checked == 1:
        b.possible_tilt_error = 0.0
        b.leading = 0
        return
    if b.time >= INTERVAL:
        measure_hypotheses(p, s)
    z = total.delta_v[2]
    for i in range(2):
        k, sign = 1 - i, 1.0 if i == 0 else -1.0  # of the tilt that accelerates axis i
        b.shift[INTEGRATED + i] += sign * z * b.shift[TILT + k]
        for j in range(3):
            b.velocity_by_bias[i, j] += sign * z * (b.tilt_by_bias[k, j] - 0.5 * total.c[3 * k + j])
            b.shift[INTEGRATED + i] -= 0.5 * sign * z * total.c[3 * k + j] * b.shift[BIAS + j]
    for i in range(2):
        b.displacement[i] += (b.v[i] + 0.5 * total.delta_v[i]) * total.time
        b.v[i] += total.delta_v[i]
        for j in range(3):
            b.tilt_by_bias[i, j] -= total.c[3 * i + j]
            b.shift[TILT + i] -= total.c[3 * i + j] * b.shift[BIAS + j]
    b.force += z
    b.turn += turn_about_vertical(total)
    for j in range(3):
        b.turn_by_bias[j] += total.c[6 + j]
    c = p.tuning
    b.attitude_noise += p.gyro_psd * total.time + c.hypothesis_noise_per_rate**2 * total.w2 + total.attitude_noise
    for i in range(2):
        shaken = c.accel_noise_per_acceleration**2 * total.a_outer_a[3 * i]
        b.velocity_noise[i] += p.accel_psd * total.time + shaken + total.velocity_noise
    b.time += total.time


@kernel
def add_attitude_noise(s: State, variance_: float) -> None:
    """The attitude has become that much less certain about some axis, rad^2."""
    s.hypotheses.attitude_noise += variance_


@kernel
def follow_correction(s: State) -> None:
    """The filter is about to correct its attitude and gyro bias: the errors that are left are smaller by that."""
    b, x = s.hypotheses, s.scratch.x
    for i in range(2):
        b.shift[TILT + i] -= x[ATTITUDE + i]
    for i in range(3):
        b.shift[BIAS + i] -= x[GYRO_BIAS + i]


@kernel
def measure_hypotheses(p: Parameters, s: State) -> None:
    """Propagate each hypothesis over the interval, compare velocities, weigh, mix."""
    b, c = s.hypotheses, p.tuning
    best = likeliest = -math.inf
    fading = b.time / (c.hypothesis_weight_time_s + b.time)
    for h in range(HYPOTHESES):
        propagate_hypothesis(p, s, h)
        log_likelihood = compare_velocity(p, s, h)
        b.log_likelihood[h] += c.hypothesis_evidence * log_likelihood
        b.log_weight[h] += c.hypothesis_weight_evidence * log_likelihood - fading * b.log_weight[h]
        likeliest = max(likeliest, b.log_likelihood[h])
        best = max(best, b.log_weight[h])
    hand = total = speed2 = 0.0
    for h in range(HYPOTHESES):
        b.log_likelihood[h] = max(b.log_likelihood[h] - likeliest, -c.hypothesis_max_odds)
        b.log_weight[h] = max(b.log_weight[h] - best, -c.hypothesis_max_odds)
        likelihood = elementary.exp(b.log_likelihood[h])
        hand += likelihood if h < HANDS else 0.0
        total += likelihood
        n, e = TRUE_VELOCITY, TRUE_VELOCITY + 1
        speed2 += likelihood * (b.x[h, n] ** 2 + b.x[h, e] ** 2 + b.P[h, n, n] + b.P[h, e, e])
    b.hand = hand / total
    mix_hypotheses(s)
    travels = b.hand < 0.5 and speed2 > total * c.travel_speed_mps**2 and not is_undecided(p, s)
    choose_leader(p, s, travels and s.drag.per_mass == 0.0)
    b.possible_tilt_error = tilt_error_of_others(s)
    for i in range(2):
        b.v[i] += b.mean[INTEGRATED + i]
        correct_integrated_velocity(s, i, b.mean[INTEGRATED + i])
    restart_interval(s)


@kernel
def mix_hypotheses(s: State) -> None:
    """Mean and covariance of the hypotheses of other bodies than hands."""
    b, total = s.hypotheses, 0.0
    b.mean[:] = 0.0
    b.covariance[:] = 0.0
    for h in range(HANDS, HYPOTHESES):
        weight = elementary.exp(b.log_weight[h])
        total += weight
        for i in range(HYPOTHESIS_STATES):
            b.mean[i] += weight * b.x[h, i]
            for j in range(HYPOTHESIS_STATES):
                b.covariance[i, j] += weight * (b.P[h, i, j] + b.x[h, i] * b.x[h, j])
    for i in range(HYPOTHESIS_STATES):
        b.mean[i] /= total
    for i in range(HYPOTHESIS_STATES):
        for j in range(HYPOTHESIS_STATES):
            b.covariance[i, j] = b.covariance[i, j] / total - b.mean[i] * b.mean[j]


@kernel
def choose_leader(p: Parameters, s: State, travels: bool) -> None:
    """Whether the filter is right or the hypotheses lead; the latter begins and ends with an unknown velocity."""
    b = s.hypotheses
    if b.leading == 1 and not travels:
        for i in range(3):
            start_motion(p, s, i)
    b.leading = b.due = 1 if travels else 0


@kernel
def tilt_error_of_others(s: State) -> float:
    """By how much the tilt may be wrong, rad, because those are right that do not lead: not stated elsewhere."""
    b = s.hypotheses
    stated = variance(s, ATTITUDE) + variance(s, ATTITUDE + 1)
    north = east = total = unstated = 0.0
    if b.leading == 1:
        stated = b.covariance[TILT, TILT] + b.covariance[TILT + 1, TILT + 1]
        north, east = b.mean[TILT], b.mean[TILT + 1]
    for h in range(HYPOTHESES):
        likelihood = elementary.exp(b.log_likelihood[h])
        total += likelihood
        if (h < HANDS) == (b.leading == 1):
            tilt2 = (b.x[h, TILT] - north) ** 2 + (b.x[h, TILT + 1] - east) ** 2
            unstated += likelihood * (tilt2 + b.P[h, TILT, TILT] + b.P[h, TILT + 1, TILT + 1] - stated)
    return math.sqrt(max(0.5 * unstated / total, 0.0))


@kernel
def correct_yaw(s: State) -> None:
    """At rest: the correction that the hypotheses left."""
    if s.hypotheses.yaw_correction == 0.0:
        return
    s.scratch.x[ATTITUDE + 2] += s.hypotheses.yaw_correction
    s.hypotheses.yaw_correction = 0.0
    record_yaw_corrected(s)


@kernel
def yaw_by_bias(s: State) -> Vector:
    """By how much the yaw is wrong for each error of the gyro bias, s: P_yaw,bias / P_bias,bias, by elimination."""
    P = s.cov.P
    a = P[packed_index(STATES, GYRO_BIAS, GYRO_BIAS)]
    b = P[packed_index(STATES, GYRO_BIAS, GYRO_BIAS + 1)] / a
    c = P[packed_index(STATES, GYRO_BIAS, GYRO_BIAS + 2)] / a
    d = P[packed_index(STATES, GYRO_BIAS + 1, GYRO_BIAS + 1)] - a * b * b
    e = (P[packed_index(STATES, GYRO_BIAS + 1, GYRO_BIAS + 2)] - a * b * c) / d
    f = P[packed_index(STATES, GYRO_BIAS + 2, GYRO_BIAS + 2)] - a * c * c - d * e * e
    x = P[packed_index(STATES, ATTITUDE + 2, GYRO_BIAS)]
    y = P[packed_index(STATES, ATTITUDE + 2, GYRO_BIAS + 1)] - b * x
    z = (P[packed_index(STATES, ATTITUDE + 2, GYRO_BIAS + 2)] - c * x - e * y) / f
    y = y / d - e * z
    return x / a - b * y - c * z, y, z


@kernel
def correction_variance(s: State, by_bias: Vector) -> float:
    """Of the yaw's correction, rad^2: the tilt, as wrong as is found now, has turned the vertical part of the bias."""
    b, x = s.hypotheses, s.hypotheses.mean
    tilt2 = 0.0
    for i in range(2):
        tilt2 += 0.5 * (x[TILT + i] ** 2 + b.covariance[TILT + i, TILT + i])
    across2 = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        across2 += (by_bias[j] * x[BIAS + k] - by_bias[k] * x[BIAS + j]) ** 2
    return tilt2 * across2


@kernel
def follow_hypotheses(p: Parameters, s: State) -> None:
    """The mixture of the hypotheses becomes the filter's tilt, gyro bias and velocity.

    The yaw follows the gyro bias, which has turned it: what else is known of the yaw stays. All velocities are in axes
    that turn with the yaw, so that it is corrected at rest.
    """
    b, x = s.hypotheses, s.scratch.x
    if b.due == 0:
        return
    b.due = 0
    for i in range(3):
        reset_motion(p, s, i)
    by_bias = yaw_by_bias(s)
    for i in range(3):
        b.yaw_correction += by_bias[i] * b.mean[BIAS + i]
    add_variance(s, ATTITUDE + 2, correction_variance(s, by_bias))
    couple_yaw_to_bias(s, (-by_bias[0], -by_bias[1], -by_bias[2]))
    for i in range(INTEGRATED):
        state = ATTITUDE + i - TILT if i < BIAS else GYRO_BIAS + i - BIAS
        x[state] = b.mean[i]
        replace_variance(s, state, b.covariance[i, i])
    couple_yaw_to_bias(s, by_bias)
    for i in range(2):
        x[VELOCITY + i] = b.mean[TRUE_VELOCITY + i]
        replace_variance(s, VELOCITY + i, b.covariance[TRUE_VELOCITY + i, TRUE_VELOCITY + i])
