"""How the body moves: scatter of velocity and position, sustained speed of a vehicle, vibration by its road.

A hand or a robot moves to and fro: its velocity scatters about a mean near zero, its position about a place. A vehicle
sustains a velocity: the mean over a second exceeds `travel_speed_mps` by more than the error of the integral explains.
The sustained speed rises at once, so that the departure itself is not taken as tilt, and decays afterwards. A motion
that began without a rest leaves tilt and gyro bias too uncertain for that at first: there a mean velocity is travel
only if it is far beyond its sigma; one that is less far may as well come from a wrong tilt, whose variance grows.

Vibration is measured by second differences of the mean forces over covariance intervals: an engine is averaged out of
the means, and manoeuvres are too slow for second differences.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from .error_model import add_variance, reset_variance, variance
from .integrals import turn_about_vertical
from .mechanization import clear_motion
from .state import ATTITUDE, POSITION, VELOCITY

if TYPE_CHECKING:
    from .types import Parameters, State


@kernel
def update_scatter(p: Parameters, s: State, dt: float) -> None:
    """Mean and scatter of velocity, and scatter of position, after one sample."""
    motion, v, position = s.motion, s.nav.v_n, s.nav.p_n
    velocity_gain = dt / (p.tuning.velocity_scatter_time_s + dt)
    position_gain = dt / (p.tuning.position_scatter_time_s + dt)
    for i in range(3):
        motion.v_mean[i] += velocity_gain * (v[i] - motion.v_mean[i])
        motion.v_scatter[i] += velocity_gain * ((v[i] - motion.v_mean[i]) ** 2 - motion.v_scatter[i])
        motion.p_scatter[i] += position_gain * (position[i] * position[i] - motion.p_scatter[i])


@kernel
def is_beyond_usual_biases(p: Parameters, s: State) -> bool:
    """Is the mean rate more than what gyros usually have at switch-on?"""
    w = s.stationarity.w_mean
    largest = max(abs(w[0]), abs(w[1]), abs(w[2]))
    return bool(largest * largest > p.tuning.max_bias_sigma**2 * p.gyro_bias_var)


@kernel
def begins_at_rest(p: Parameters, s: State) -> bool:
    """Has there been low motion for most of this interval, at a rate that gyros usually have?"""
    return bool(s.stationarity.low_motion_s > 0.5 * s.integrals.time and not is_beyond_usual_biases(p, s))


@kernel
def update_travel(p: Parameters, s: State) -> None:
    """Sustained speed and vibration after one covariance interval."""
    c, motion, time = p.tuning, s.motion, s.integrals.time
    gain = time / (c.travel_time_s + time)
    sustained2 = second_difference2 = 0.0
    in_motion = motion.moving_s / c.travel_time_s
    update_hidden_tilt(p, s)
    unknown = 0.0 if s.stationarity.gravity_checked == 1 else 1.0 / (1.0 + in_motion) ** 2
    if s.attitude_step.hand_held_s >= c.hand_time_s and s.attitude_step.rise_s > 0.0:
        unknown = 1.0
    evidence = c.travel_evidence + unknown * c.travel_evidence_at_start
    for i in range(3):
        excess2 = motion.v_mean[i] * motion.v_mean[i] - c.travel_speed_mps**2
        axis2 = max(excess2 - evidence * variance(s, VELOCITY + i), 0.0)
        if i < 2:
            add_unexplained_tilt(p, s, 1 - i, unknown * (excess2 - c.travel_evidence * variance(s, VELOCITY + i)))
        motion.travel_speed2[i] = max(axis2, motion.travel_speed2[i] - gain * (motion.travel_speed2[i] - axis2))
        sustained2 += axis2
        force = s.integrals.delta_v[i] / time
        change = force - motion.mean_force[i]
        second_difference2 += (change - motion.mean_force_change[i]) ** 2
        motion.mean_force[i], motion.mean_force_change[i] = force, change
    second_difference = math.sqrt(second_difference2)
    motion.vibration_level += time / (c.vibration_time_s + time) * (second_difference - motion.vibration_level)
    if sustained2 > 0.0:
        motion.travel_vibration_level += gain * (second_difference - motion.travel_vibration_level)


@kernel
def update_hidden_tilt(p: Parameters, s: State) -> None:
    """Before the first rest: the tilt that the centripetal force of a steady turn looks like, with a gyro bias.

    A turn whose rate changes tells them apart.
    """
    c, motion, total = p.tuning, s.motion, s.integrals
    turned = turn_about_vertical(total)
    remembered_s = min(c.unseen_velocity_time_s + motion.moving_s, c.steady_turn_time_s) + total.time
    motion.turn_rate += (turned - motion.turn_rate * total.time) / remembered_s
    motion.turn_rate2 += (turned * turned / total.time - motion.turn_rate2 * total.time) / remembered_s
    steady2 = max(2.0 * motion.turn_rate**2 - motion.turn_rate2, 0.0)  # the mean squared less the variance
    known = s.stationarity.gravity_checked == 1
    motion.hidden_tilt = 0.0 if known else math.sqrt(steady2) * c.hidden_speed_mps / s.nav.gravity


@kernel
def add_unexplained_tilt(p: Parameters, s: State, i: int, speed2: float) -> None:
    """The excess of a mean velocity squared over its variance may be travel, or gravity in a wrong tilt i."""
    tilt2 = max(speed2, 0.0) / (s.nav.gravity * p.tuning.gain_time_s) ** 2
    add_variance(s, ATTITUDE + i, tilt2 * s.integrals.time / p.tuning.gain_time_s)


@kernel
def reset_motion(p: Parameters, s: State, i: int) -> None:
    """Reset velocity and position along axis i, and their statistics, to zero."""
    clear_motion(s, i)
    s.motion.v_mean[i] = s.motion.v_scatter[i] = s.motion.p_scatter[i] = 0.0
    reset_variance(s, VELOCITY + i, p.tuning.reset_velocity_var)
    reset_variance(s, POSITION + i, p.tuning.reset_position_var)


@kernel
def start_motion(p: Parameters, s: State, i: int) -> None:
    """Reset velocity and position along axis i, for a body that may already move."""
    reset_motion(p, s, i)
    reset_variance(s, VELOCITY + i, p.tuning.initial_velocity_var)
    s.motion.v_scatter[i] = p.tuning.initial_velocity_scatter


@kernel
def forget_travel(s: State) -> None:
    """The velocity came from a wrong tilt."""
    for i in range(3):
        s.motion.travel_speed2[i] = 0.0


@kernel
def shift_mean_velocity(s: State, i: int, change: float) -> None:
    """Correct the mean velocity along axis i, m/s."""
    s.motion.v_mean[i] += change
