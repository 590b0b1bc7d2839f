"""Before the first rest: how the body moves, by a bank of hypotheses, and the tilt error that the filter may have then.

While neither the tilt nor the gyro bias is known, a velocity that lasts for seconds looks like both. How long and how
fast is what a hand, somebody who walks, a drone and a car do differently. So for each hypothesis a Kalman filter of
eleven states runs beside: errors of tilt (2) and gyro bias (3), of a velocity that is integrated without corrections
(2), the true velocity (2), a first-order Gauss-Markov process of the hypothesis' RMS speed and correlation time, and an
error of the acceleration that is constant in the body (2). The velocity of a vehicle is carried: it turns with the
body's heading. Once a second the true velocity, averaged over the second, is what was integrated plus its error
(multiple-model estimation, Magill 1965).

The axes turn with the error of yaw. In them the unknown gyro bias times the velocity is an acceleration: the part with
the hypothesis' mean velocity is linear, the rest is a part of the acceleration that is constant in the body.

The innovations' likelihood says whether the body is in a hand. Where it is, the filter, which is made for hands, is
right, and what the others say is stated with their probability in the sigmas of roll and pitch. Where it is not, they
lead: the mixture of the others becomes the filter's tilt, gyro bias and velocity. Among themselves they are weighed by
a small power of the likelihood only, as errors of these models last for many seconds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from .error_model import replace_variance, variance
from .motion import reset_motion, start_motion
from .state import ATTITUDE, GYRO_BIAS, HYPOTHESES, HYPOTHESIS_STATES, VELOCITY

if TYPE_CHECKING:
    from .types import Parameters, State

N = HYPOTHESIS_STATES  # tilt 0, 1; bias 2, 3, 4; integrated velocity 5, 6; true velocity 7, 8; acceleration 9, 10
SPEED = (0.1, 0.3, 1.0, 3.0, 3.0, 1.5, 4.0, 10.0, 20.0, 30.0, 4.0, 12.0, 2.0, 6.0, 6.0, 20.0, 20.0)  # m/s, RMS, each axis
TIME = (0.5, 0.5, 2.0, 2.0, 6.0, 60.0, 60.0, 60.0, 60.0, 60.0, 10.0, 10.0, 600.0, 600.0, 6e3, 600.0, 6e3)  # s, correlation
HANDS = 3  # hypotheses of hands: the filter itself is made for them
FREE = 5  # those before this one are not carried: their velocity does not turn with the heading
INTERVAL = 1.0  # s
SPEED_NOISE, SPEED_NOISE_SHARE = 0.05, 0.1  # m/s, and share of the speed: what the process does not describe
CARRIED_TIME = 60.0  # s, in which what is constant in the body changes


@kernel
def start_hypotheses(p: Parameters, s: State) -> None:
    """Nothing is known: roll and pitch have just been set."""
    b, tilt2 = s.hypotheses, p.tuning.hypothesis_tilt_rad**2
    b.x[:] = 0.0
    b.P[:] = 0.0
    b.v[:] = 0.0
    b.possible_tilt_error = 0.0
    b.hand = 0.0
    b.leading = 0
    b.due = 0
    for h in range(HYPOTHESES):
        b.log_likelihood[h] = p.tuning.hypothesis_hand_odds if h < HANDS else 0.0
        b.log_weight[h] = 0.0
        speed2 = SPEED[h] ** 2
        hidden2 = p.gyro_bias_var * speed2 if h >= FREE else 0.0
        for i in range(2):
            b.P[h, i, i] = tilt2
            b.P[h, 5 + i, 5 + i] = b.P[h, 7 + i, 7 + i] = b.P[h, 5 + i, 7 + i] = b.P[h, 7 + i, 5 + i] = speed2
            b.P[h, 9 + i, 9 + i] = p.accel_bias_var + hidden2
        for i in range(3):
            b.P[h, 2 + i, 2 + i] = p.gyro_bias_var
    restart_interval(s)


@kernel
def restart_interval(s: State) -> None:
    """The transition begins anew."""
    b = s.hypotheses
    b.time = b.force = b.turn = b.attitude_noise = 0.0
    b.way[:] = 0.0
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
        b.shift[5 + i] += sign * z * b.shift[k]
        for j in range(3):
            b.velocity_by_bias[i, j] += sign * z * (b.tilt_by_bias[k, j] - 0.5 * total.c[3 * k + j])
            b.shift[5 + i] -= 0.5 * sign * z * total.c[3 * k + j] * b.shift[2 + j]
    for i in range(2):
        b.way[i] += (b.v[i] + 0.5 * total.delta_v[i]) * total.time
        b.v[i] += total.delta_v[i]
        for j in range(3):
            b.tilt_by_bias[i, j] -= total.c[3 * i + j]
            b.shift[i] -= total.c[3 * i + j] * b.shift[2 + j]
    b.force += z
    b.turn += total.c_outer_w[18] + total.c_outer_w[22] + total.c_outer_w[26]
    for j in range(3):
        b.turn_by_bias[j] += total.c[6 + j]
    c = p.tuning
    b.attitude_noise += p.gyro_psd * total.time + c.hypothesis_noise_per_rate**2 * total.w2 + total.attitude_noise
    b.time += total.time


@kernel
def follow_correction(s: State) -> None:
    """The filter is about to correct its attitude and gyro bias: the errors that are left are smaller by that."""
    b, x = s.hypotheses, s.scratch.x
    for i in range(2):
        b.shift[i] -= x[ATTITUDE + i]
    for i in range(3):
        b.shift[2 + i] -= x[GYRO_BIAS + i]


@kernel
def measure_hypotheses(p: Parameters, s: State) -> None:
    """Propagate each hypothesis over the interval, compare velocities, weigh, mix."""
    b, c = s.hypotheses, p.tuning
    best = likeliest = -math.inf
    fading = b.time / (c.hypothesis_weight_time_s + b.time)
    for h in range(HYPOTHESES):
        propagate_hypothesis(p, s, h)
        log_likelihood = compare_velocity(s, h)
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
        speed2 += likelihood * (b.x[h, 7] ** 2 + b.x[h, 8] ** 2 + b.P[h, 7, 7] + b.P[h, 8, 8])
    b.hand = hand / total
    mix_hypotheses(s)
    choose_leader(p, s, b.hand < 0.5 and speed2 > total * c.travel_speed_mps**2)
    for i in range(2):
        b.v[i] += b.mean[5 + i]
        for h in range(HYPOTHESES):
            b.x[h, 5 + i] -= b.mean[5 + i]
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
        for i in range(N):
            b.mean[i] += weight * b.x[h, i]
            for j in range(N):
                b.covariance[i, j] += weight * (b.P[h, i, j] + b.x[h, i] * b.x[h, j])
    for i in range(N):
        b.mean[i] /= total
    for i in range(N):
        for j in range(N):
            b.covariance[i, j] = b.covariance[i, j] / total - b.mean[i] * b.mean[j]


@kernel
def choose_leader(p: Parameters, s: State, travels: bool) -> None:
    """Whether the filter is right or the hypotheses lead, and what the other side says of the tilt error."""
    b = s.hypotheses
    led = b.leading == 1
    b.leading = 1 if travels else 0
    b.due = b.leading
    if led and b.leading == 0:
        for i in range(3):
            start_motion(p, s, i)
    others2 = b.covariance[0, 0] + b.covariance[1, 1]
    if b.leading == 1:
        apart2 = hand2 = 0.0
        for h in range(HANDS):
            apart2 += ((b.x[h, 0] - b.mean[0]) ** 2 + (b.x[h, 1] - b.mean[1]) ** 2) / HANDS
            hand2 += (b.P[h, 0, 0] + b.P[h, 1, 1]) / HANDS
        unstated = b.hand * (apart2 + hand2 - others2)
    else:
        apart2 = b.mean[0] ** 2 + b.mean[1] ** 2
        unstated = (1.0 - b.hand) * (apart2 + others2 - variance(s, ATTITUDE) - variance(s, ATTITUDE + 1))
    b.possible_tilt_error = math.sqrt(max(0.5 * unstated, 0.0))


@kernel
def follow_hypotheses(p: Parameters, s: State) -> None:
    """The mixture of the hypotheses becomes the filter's tilt, gyro bias and velocity."""
    b, x = s.hypotheses, s.scratch.x
    if b.due == 0:
        return
    b.due = 0
    for i in range(3):
        reset_motion(p, s, i)
    for i in range(5):
        state = ATTITUDE + i if i < 2 else GYRO_BIAS + i - 2
        x[state] = b.mean[i]
        replace_variance(s, state, b.covariance[i, i])
    for i in range(2):
        x[VELOCITY + i] = b.mean[7 + i]
        replace_variance(s, VELOCITY + i, b.covariance[7 + i, 7 + i])


@kernel
def add_row(s: State, h: int, i: int, j: int, k: float) -> None:
    """State i of hypothesis h has grown by k times state j."""
    b = s.hypotheses
    b.x[h, i] += k * b.x[h, j]
    for m in range(N):
        b.P[h, i, m] += k * b.P[h, j, m]
    for m in range(N):
        b.P[h, m, i] += k * b.P[h, m, j]


@kernel
def rotate_pair(s: State, h: int, i: int, cosine: float, sine: float) -> None:
    """States i and i + 1 of hypothesis h are turned, and scaled."""
    b = s.hypotheses
    north, east = b.x[h, i], b.x[h, i + 1]
    b.x[h, i], b.x[h, i + 1] = cosine * north - sine * east, sine * north + cosine * east
    for m in range(N):
        north, east = b.P[h, i, m], b.P[h, i + 1, m]
        b.P[h, i, m], b.P[h, i + 1, m] = cosine * north - sine * east, sine * north + cosine * east
    for m in range(N):
        north, east = b.P[h, m, i], b.P[h, m, i + 1]
        b.P[h, m, i], b.P[h, m, i + 1] = cosine * north - sine * east, sine * north + cosine * east


@kernel
def add_hidden_turn(s: State, h: int) -> float:
    """Velocity times the error of the turn rate is an acceleration; returns the variance of the turn rate, (rad/s)^2."""
    b = s.hypotheses
    turn = variance2 = 0.0
    for j in range(3):
        turn += b.turn_by_bias[j] * b.x[h, 2 + j]
        for k in range(3):
            variance2 += b.turn_by_bias[j] * b.turn_by_bias[k] * b.P[h, 2 + j, 2 + k]
    north, east = b.x[h, 7], b.x[h, 8]
    for j in range(3):
        add_row(s, h, 5, 2 + j, -east * b.turn_by_bias[j])
        add_row(s, h, 6, 2 + j, north * b.turn_by_bias[j])
    add_row(s, h, 5, 8, -turn)
    add_row(s, h, 6, 7, turn)
    b.x[h, 5] += turn * east
    b.x[h, 6] -= turn * north
    return variance2 / (b.time * b.time)


@kernel
def propagate_hypothesis(p: Parameters, s: State, h: int) -> None:
    """Transition and process noise of hypothesis h over the interval."""
    b = s.hypotheses
    add_row(s, h, 5, 1, b.force)
    add_row(s, h, 6, 0, -b.force)
    for i in range(2):
        add_row(s, h, 5 + i, 9 + i, b.time)
        for j in range(3):
            add_row(s, h, 5 + i, 2 + j, b.velocity_by_bias[i, j])
    turn_rate_var = add_hidden_turn(s, h)
    hidden_north = turn_rate_var * b.P[h, 8, 8] if h >= FREE else 0.0
    hidden_east = turn_rate_var * b.P[h, 7, 7] if h >= FREE else 0.0
    for i in range(2):
        for j in range(3):
            add_row(s, h, i, 2 + j, b.tilt_by_bias[i, j])
    turn = b.turn if h >= FREE else 0.0
    cosine, sine = elementary.cos(turn), elementary.sin(turn)
    kept, constant = elementary.exp(-b.time / TIME[h]), elementary.exp(-b.time / CARRIED_TIME)
    rotate_pair(s, h, 7, kept * cosine, kept * sine)
    rotate_pair(s, h, 9, constant * cosine, constant * sine)
    for i in range(7):
        b.x[h, i] += b.shift[i]
    for i in range(2):
        b.P[h, i, i] += b.attitude_noise
        b.P[h, 5 + i, 5 + i] += p.accel_psd * b.time
        b.P[h, 7 + i, 7 + i] += SPEED[h] ** 2 * (1.0 - kept * kept)
        hidden = hidden_north if i == 0 else hidden_east
        b.P[h, 9 + i, 9 + i] += (p.accel_bias_var + hidden) * (1.0 - constant * constant)
    for i in range(3):
        b.P[h, 2 + i, 2 + i] += p.gyro_bias_psd * b.time


@kernel
def compare_velocity(s: State, h: int) -> float:
    """The true velocity is the integrated one and its error; returns the log likelihood of both components.

    Both are means over the interval: there the error of the integrated velocity is half an acceleration behind.
    """
    b, log_likelihood = s.hypotheses, 0.0
    r = SPEED_NOISE**2 + (SPEED_NOISE_SHARE * SPEED[h]) ** 2
    for i in range(2):
        k, lag = 1 - i, -0.5 * b.force if i == 0 else 0.5 * b.force
        for j in range(N):
            b.ph[j] = b.P[h, j, 5 + i] + lag * b.P[h, j, k] - b.P[h, j, 7 + i]
        variance = b.ph[5 + i] + lag * b.ph[k] - b.ph[7 + i] + r
        innovation = b.x[h, 7 + i] - b.x[h, 5 + i] - lag * b.x[h, k] - b.way[i] / b.time
        log_likelihood -= 0.5 * (elementary.log(variance) + innovation * innovation / variance)
        for j in range(N):
            b.x[h, j] += b.ph[j] * innovation / variance
            for m in range(N):
                b.P[h, j, m] -= b.ph[j] * b.ph[m] / variance
    return log_likelihood
