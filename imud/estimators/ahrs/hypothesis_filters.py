"""Kalman filters of what a tilt, a gyro bias and a true velocity would be if the body moved as a hypothesis says.

Each has eleven states: errors of tilt (2) and gyro bias (3), of a velocity that is integrated without corrections (2),
the true velocity (2), a first-order Gauss-Markov process of the hypothesis' RMS speed and correlation time, and an
error of the acceleration that is constant in the body (2). The velocity of a vehicle is carried: it turns with the
body's heading. Once a second the true velocity, averaged over the second, is what was integrated plus its error. All
are linearised about the filter's own attitude and bias.

The axes turn with the error of yaw. In them the unknown gyro bias times the velocity is an acceleration: the part with
the hypothesis' mean velocity is linear, the rest is a part of the acceleration that is constant in the body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from .state import HYPOTHESES, HYPOTHESIS_STATES

if TYPE_CHECKING:
    from .types import Parameters, State

N = HYPOTHESIS_STATES
TILT, BIAS, INTEGRATED, TRUE_VELOCITY, ACCELERATION = 0, 2, 5, 7, 9  # the bias has three axes, the others two
HANDS = 3  # hypotheses of hands: the filter itself is made for them
FREE = 5  # those before this one are not carried: their velocity does not turn with the heading
SPEED = (0.1, 0.3, 1.0, 3.0, 3.0, 1.5, 4.0, 10.0, 20.0, 30.0, 4.0, 12.0, 2.0, 6.0, 6.0, 20.0, 20.0)  # m/s, RMS
TIME = (0.5, 0.5, 2.0, 2.0, 6.0, 60.0, 60.0, 60.0, 60.0, 60.0, 10.0, 10.0, 600.0, 600.0, 6e3, 600.0, 6e3)  # s


@kernel
def start_filters(p: Parameters, s: State) -> None:
    """Tilt, gyro bias and velocity are unknown."""
    b, tilt2 = s.hypotheses, p.tuning.hypothesis_tilt_rad**2
    b.x[:] = 0.0
    b.P[:] = 0.0
    for h in range(HYPOTHESES):
        speed2 = SPEED[h] ** 2
        hidden2 = p.gyro_bias_var * speed2 if h >= FREE else 0.0
        for i in range(2):
            b.P[h, TILT + i, TILT + i] = tilt2
            v, w = INTEGRATED + i, TRUE_VELOCITY + i
            b.P[h, v, v] = b.P[h, w, w] = b.P[h, v, w] = b.P[h, w, v] = speed2
            b.P[h, ACCELERATION + i, ACCELERATION + i] = p.accel_bias_var + hidden2
        for i in range(3):
            b.P[h, BIAS + i, BIAS + i] = p.gyro_bias_var


@kernel
def correct_integrated_velocity(s: State, i: int, change: float) -> None:
    """The integrated velocity of axis i has been changed, m/s: so much less is wrong with it."""
    for h in range(HYPOTHESES):
        s.hypotheses.x[h, INTEGRATED + i] -= change


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
    """Velocity times the error of the turn rate is an acceleration; returns the variance of that rate, (rad/s)^2."""
    b = s.hypotheses
    turn = variance2 = 0.0
    for j in range(3):
        turn += b.turn_by_bias[j] * b.x[h, BIAS + j]
        for k in range(3):
            variance2 += b.turn_by_bias[j] * b.turn_by_bias[k] * b.P[h, BIAS + j, BIAS + k]
    north, east = b.x[h, TRUE_VELOCITY], b.x[h, TRUE_VELOCITY + 1]
    for j in range(3):
        add_row(s, h, INTEGRATED, BIAS + j, -east * b.turn_by_bias[j])
        add_row(s, h, INTEGRATED + 1, BIAS + j, north * b.turn_by_bias[j])
    add_row(s, h, INTEGRATED, TRUE_VELOCITY + 1, -turn)
    add_row(s, h, INTEGRATED + 1, TRUE_VELOCITY, turn)
    b.x[h, INTEGRATED] += turn * east
    b.x[h, INTEGRATED + 1] -= turn * north
    return variance2 / (b.time * b.time)


@kernel
def propagate_hypothesis(p: Parameters, s: State, h: int) -> None:
    """Transition and process noise of hypothesis h over the interval."""
    b = s.hypotheses
    add_row(s, h, INTEGRATED, TILT + 1, b.force)
    add_row(s, h, INTEGRATED + 1, TILT, -b.force)
    for i in range(2):
        add_row(s, h, INTEGRATED + i, ACCELERATION + i, b.time)
        for j in range(3):
            add_row(s, h, INTEGRATED + i, BIAS + j, b.velocity_by_bias[i, j])
    turn_rate_var = add_hidden_turn(s, h)
    hidden_north = turn_rate_var * b.P[h, TRUE_VELOCITY + 1, TRUE_VELOCITY + 1] if h >= FREE else 0.0
    hidden_east = turn_rate_var * b.P[h, TRUE_VELOCITY, TRUE_VELOCITY] if h >= FREE else 0.0
    for i in range(2):
        for j in range(3):
            add_row(s, h, i, BIAS + j, b.tilt_by_bias[i, j])
    turn = b.turn if h >= FREE else 0.0
    cosine, sine = elementary.cos(turn), elementary.sin(turn)
    kept, constant = elementary.exp(-b.time / TIME[h]), elementary.exp(-b.time / p.tuning.hypothesis_carried_time_s)
    rotate_pair(s, h, TRUE_VELOCITY, kept * cosine, kept * sine)
    rotate_pair(s, h, ACCELERATION, constant * cosine, constant * sine)
    for i in range(TRUE_VELOCITY):
        b.x[h, i] += b.shift[i]
    for i in range(2):
        b.P[h, TILT + i, TILT + i] += b.attitude_noise
        b.P[h, INTEGRATED + i, INTEGRATED + i] += b.velocity_noise[i]
        b.P[h, TRUE_VELOCITY + i, TRUE_VELOCITY + i] += SPEED[h] ** 2 * (1.0 - kept * kept)
        hidden = hidden_north if i == 0 else hidden_east
        b.P[h, ACCELERATION + i, ACCELERATION + i] += (p.accel_bias_var + hidden) * (1.0 - constant * constant)
    for i in range(3):
        b.P[h, BIAS + i, BIAS + i] += p.gyro_bias_psd * b.time


@kernel
def compare_velocity(p: Parameters, s: State, h: int) -> float:
    """The true velocity is the integrated one and its error; returns the log likelihood of both components.

    Both are means over the interval: there the error of the integrated velocity is half an acceleration behind.
    """
    b, log_likelihood = s.hypotheses, 0.0
    r = p.tuning.hypothesis_speed_noise_mps**2 + (p.tuning.hypothesis_speed_noise_share * SPEED[h]) ** 2
    for i in range(2):
        k, lag = TILT + 1 - i, -0.5 * b.force if i == 0 else 0.5 * b.force
        for j in range(N):
            b.ph[j] = b.P[h, j, INTEGRATED + i] + lag * b.P[h, j, k] - b.P[h, j, TRUE_VELOCITY + i]
        variance = b.ph[INTEGRATED + i] + lag * b.ph[k] - b.ph[TRUE_VELOCITY + i] + r
        innovation = b.x[h, TRUE_VELOCITY + i] - b.x[h, INTEGRATED + i] - lag * b.x[h, k] - b.displacement[i] / b.time
        log_likelihood -= 0.5 * (elementary.log(variance) + innovation * innovation / variance)
        for j in range(N):
            b.x[h, j] += b.ph[j] * innovation / variance
            for m in range(N):
                b.P[h, j, m] -= b.ph[j] * b.ph[m] / variance
    return log_likelihood
