"""Before the first rest: how the body moves, by a bank of hypotheses, and the tilt error that the filter may have then.

While neither the tilt nor the gyro bias is known, a velocity that lasts for seconds looks like both. How long and how
fast is what a hand, somebody who walks, a drone and a car do differently. So for each hypothesis a Kalman filter of
nine states runs beside: errors of tilt (2) and gyro bias (3), of a velocity that is integrated without corrections (2),
and the true velocity (2), a first-order Gauss-Markov process of the hypothesis' RMS speed and correlation time. That
of a vehicle is carried: it turns with the body's heading. Once a second the true velocity is what was integrated plus
its error; the innovations' likelihood weighs the hypotheses (multiple-model estimation, Magill 1965).

All are linearised about the filter's own attitude and bias. What the hypotheses say of its tilt error, with their
probability, is stated in the sigmas of roll and pitch: those of faster bodies all that is more than the filter states,
those of hands only a contradiction, since the filter itself is made for hands.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from .error_model import variance
from .state import ATTITUDE, GYRO_BIAS, HYPOTHESES

if TYPE_CHECKING:
    from .types import Parameters, State

N = 9  # states: tilt 0, 1; gyro bias 2, 3, 4; error of the integrated velocity 5, 6; true velocity 7, 8
SPEED = (0.3, 1.0, 3.0, 3.0, 1.5, 4.0, 10.0, 20.0, 4.0, 12.0)  # m/s, RMS of each level component
TIME = (1.0, 2.0, 2.0, 6.0, 60.0, 60.0, 60.0, 60.0, 10.0, 10.0)  # s, correlation time
CARRIED = (0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)  # 1: it turns with the heading
HANDS = 2  # hypotheses of hands: the filter itself is made for them
INTERVAL = 1.0  # s
SPEED_NOISE, SPEED_NOISE_SHARE = 0.05, 0.1  # m/s, and share of the speed: what the process does not describe


@kernel
def start_hypotheses(p: Parameters, s: State) -> None:
    """Nothing is known: roll and pitch have just been set."""
    b, tilt2 = s.hypotheses, p.tuning.hypothesis_tilt_rad**2
    b.x[:] = 0.0
    b.P[:] = 0.0
    b.v[:] = 0.0
    b.possible_tilt_error = 0.0
    for h in range(HYPOTHESES):
        b.log_likelihood[h] = p.tuning.hypothesis_hand_odds if h < HANDS else 0.0
        speed2 = SPEED[h] ** 2
        for i in range(2):
            b.P[h, i, i] = tilt2
            b.P[h, 5 + i, 5 + i] = b.P[h, 7 + i, 7 + i] = b.P[h, 5 + i, 7 + i] = b.P[h, 7 + i, 5 + i] = speed2
        for i in range(3):
            b.P[h, 2 + i, 2 + i] = p.gyro_bias_var
    restart_interval(s)


@kernel
def restart_interval(s: State) -> None:
    """The transition begins anew."""
    b = s.hypotheses
    b.time = b.force = b.turn = b.attitude_noise = 0.0
    b.shift[:] = 0.0
    b.tilt_by_bias[:] = 0.0
    b.velocity_by_bias[:] = 0.0


@kernel
def update_hypotheses(p: Parameters, s: State) -> None:
    """Before the first rest, after one covariance interval: the transition, and once a second the measurement."""
    b, total = s.hypotheses, s.integrals
    if s.stationarity.gravity_checked == 1:
        b.possible_tilt_error = 0.0
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
        b.v[i] += total.delta_v[i]
        for j in range(3):
            b.tilt_by_bias[i, j] -= total.c[3 * i + j]
            b.shift[i] -= total.c[3 * i + j] * b.shift[2 + j]
    b.force += z
    b.turn += total.c_outer_w[18] + total.c_outer_w[22] + total.c_outer_w[26]
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
    """Propagate each hypothesis over the interval, compare velocities, weigh."""
    b = s.hypotheses
    best = -math.inf
    for h in range(HYPOTHESES):
        propagate_hypothesis(p, s, h)
        b.log_likelihood[h] += p.tuning.hypothesis_evidence * compare_velocity(s, h)
        best = max(best, b.log_likelihood[h])
    total = unstated = 0.0
    stated = variance(s, ATTITUDE) + variance(s, ATTITUDE + 1)
    mean0 = mean1 = 0.0
    for h in range(HYPOTHESES):
        b.log_likelihood[h] = max(b.log_likelihood[h] - best, -p.tuning.hypothesis_max_odds)
        weight = elementary.exp(b.log_likelihood[h])
        total += weight
        mean0 += weight * b.x[h, 5]
        mean1 += weight * b.x[h, 6]
        tilt2 = b.x[h, 0] ** 2 + b.x[h, 1] ** 2
        if h >= HANDS:
            unstated += weight * (tilt2 + b.P[h, 0, 0] + b.P[h, 1, 1] - stated)
        else:
            unstated += weight * max(tilt2 - p.tuning.hypothesis_hand_gate * stated, 0.0)
    b.possible_tilt_error = math.sqrt(max(0.5 * unstated / total, 0.0))
    b.v[0] += mean0 / total
    b.v[1] += mean1 / total
    for h in range(HYPOTHESES):
        b.x[h, 5] -= mean0 / total
        b.x[h, 6] -= mean1 / total
    restart_interval(s)


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
def propagate_hypothesis(p: Parameters, s: State, h: int) -> None:
    """Transition and process noise of hypothesis h over the interval."""
    b = s.hypotheses
    add_row(s, h, 5, 1, b.force)
    add_row(s, h, 6, 0, -b.force)
    for i in range(2):
        for j in range(3):
            add_row(s, h, 5 + i, 2 + j, b.velocity_by_bias[i, j])
    for i in range(2):
        for j in range(3):
            add_row(s, h, i, 2 + j, b.tilt_by_bias[i, j])
    kept = elementary.exp(-b.time / TIME[h])
    cosine, sine = kept * elementary.cos(CARRIED[h] * b.turn), kept * elementary.sin(CARRIED[h] * b.turn)
    north, east = b.x[h, 7], b.x[h, 8]
    b.x[h, 7], b.x[h, 8] = cosine * north - sine * east, sine * north + cosine * east
    for m in range(N):
        north, east = b.P[h, 7, m], b.P[h, 8, m]
        b.P[h, 7, m], b.P[h, 8, m] = cosine * north - sine * east, sine * north + cosine * east
    for m in range(N):
        north, east = b.P[h, m, 7], b.P[h, m, 8]
        b.P[h, m, 7], b.P[h, m, 8] = cosine * north - sine * east, sine * north + cosine * east
    for i in range(7):
        b.x[h, i] += b.shift[i]
    for i in range(2):
        b.P[h, i, i] += b.attitude_noise
        b.P[h, 5 + i, 5 + i] += p.accel_psd * b.time
        b.P[h, 7 + i, 7 + i] += SPEED[h] ** 2 * (1.0 - kept * kept)
    for i in range(3):
        b.P[h, 2 + i, 2 + i] += p.gyro_bias_psd * b.time


@kernel
def compare_velocity(s: State, h: int) -> float:
    """The true velocity is the integrated one and its error; returns the log likelihood of both components."""
    b, log_likelihood = s.hypotheses, 0.0
    r = SPEED_NOISE**2 + (SPEED_NOISE_SHARE * SPEED[h]) ** 2
    for i in range(2):
        for j in range(N):
            b.ph[j] = b.P[h, j, 5 + i] - b.P[h, j, 7 + i]
        variance = b.ph[5 + i] - b.ph[7 + i] + r
        innovation = b.x[h, 7 + i] - b.x[h, 5 + i] - b.v[i]
        log_likelihood -= 0.5 * (elementary.log(variance) + innovation * innovation / variance)
        for j in range(N):
            b.x[h, j] += b.ph[j] * innovation / variance
            for k in range(N):
                b.P[h, j, k] -= b.ph[j] * b.ph[k] / variance
    return log_likelihood
