"""Detection of a tilt that became wrong at once, and its correction from the mean force since.

A sensor slips in its mount, or its readings fail for a moment while it turns. Then the attitude is wrong by a constant
rotation, and a part of gravity appears as an acceleration that does not change: the velocity grows without end. A body
in a hand or on a robot never gains much velocity, however hard it is shaken, and what it gains is about the same from
one second to the next; so a gain far beyond what it usually has shows a slip after a second or two. A vehicle may gain
any velocity. A body counts as none after `hand_time_s` of lively motion, at rest less and less, in which it did not
travel; before, only `divergence` notices a wrong tilt, later.

The gain is that of `gain_time_s`: the integral of the specific force in NED, corrected by whatever corrects the
attitude, less gravity. From where it began to grow the mean force shows the vertical; its variance is that of the
velocity that the body may have gained. Until the gain is large enough to tell, the tilt is that uncertain: from when
the gain itself is beyond its usual, which in a quiet hand is long before its mean over a second is.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.rotation import cross, dot, quat_exp, quat_normalised, quat_product, quat_rotate, quat_rotate_back
from .divergence import inflate_variance, restart_velocity_gain
from .drag import interrupt_drag
from .error_model import add_variance, reset_variance
from .history import record_wrong_tilt
from .integrals import turn_across_vertical2
from .mechanization import set_attitude
from .motion import forget_travel, start_motion
from .state import ACCEL_BIAS, ATTITUDE

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from ...math.rotation import Vector
    from .types import Parameters, State


@kernel
def correct_attitude_step(p: Parameters, s: State) -> bool:
    """Has the tilt become wrong at once? Then it is put right. Once per covariance interval."""
    c, step, total, time, q = p.tuning, s.attitude_step, s.integrals, s.integrals.time, s.nav.q_nb
    body_v = quat_rotate_back((q[0], q[1], q[2], q[3]), (total.delta_v[0], total.delta_v[1], total.delta_v[2]))
    update_hand_held(p, s)
    step.span += time - step.span * time / c.gain_time_s
    step.window_s += time
    gain2 = mean2 = 0.0
    for i in range(3):
        step.delta_v[i] += total.delta_v[i] - step.delta_v[i] * time / c.gain_time_s
        step.mean_force[i] += (total.delta_v[i] - step.mean_force[i] * time) / (c.velocity_scatter_time_s + time)
        step.window_delta_v[i] += total.delta_v[i]
        step.window_mean_v[i] += step.mean_force[i] * time
        step.window_body_v[i] += body_v[i]
        gain = step.delta_v[i] + (s.nav.gravity * step.span if i == 2 else 0.0)
        step.mean_gain[i] += time / (c.velocity_scatter_time_s + time) * (gain - step.mean_gain[i])
        gain2 += gain * gain
        mean2 += step.mean_gain[i] ** 2
    if step.rise_s == 0.0:
        learn_body_force(p, s, body_v)
    may_be_slip = is_undecided(p, s) and force_lasts(p, s) and not is_in_a_hand(p, s)
    if step.hand_held_s == 0.0:
        step.usual_s = 0.0
    elif s.stationarity.stationary == 0 and not may_be_slip:
        step.usual_s = min(step.usual_s + time, c.usual_gain_time_s)
        part = time / (min(step.hand_held_s, step.usual_s) + time)
        least2 = 0.25 * c.min_gain_mps**2  # what is not usual counts in part: else a slip becomes usual
        step.usual_gain2 += part * (min(gain2, 4.0 * step.usual_gain2 + least2) - step.usual_gain2)
        step.usual_mean2 += part * (min(mean2, 4.0 * step.usual_mean2 + least2) - step.usual_mean2)
    step.levelled_angle -= 0.5 * step.levelled_angle * time / c.hand_time_s
    levelled = math.sqrt(c.rise_slip_probability) * step.levelled_angle
    step.possible_tilt_error = max(angle_of_rise(p, s, gain2), levelled)
    if not is_in_a_hand(p, s) or mean2 < c.usual_gain_sigmas**2 * step.usual_mean2 + c.min_gain_mps**2:
        restart_window(s)
        return False
    use_mean, angle, var = window_angle(p, s)
    step.possible_tilt_error = max(angle, step.possible_tilt_error)
    least2 = c.step_gain_sigmas**2 * step.usual_mean2 + c.step_gain_mps**2
    if mean2 < least2 or step.window_s < c.min_step_s or angle * angle < c.usual_gain_sigmas**2 * var:
        return False
    if leans_with_thrust(p, s, angle):
        step.hand_held_s = 0.0
        restart_window(s)
        return False
    level_by_window(p, s, use_mean, var)
    return True


@kernel
def learn_body_force(p: Parameters, s: State, body_v: Vector) -> None:
    """Where the force usually stands in the body, and how far from there it scatters.

    body_v: integral of the force over the interval, m/s.
    """
    step, time = s.attitude_step, s.integrals.time
    weight = time / (min(step.body_s, p.tuning.hand_time_s) + time)
    short_s = min(step.body_s, p.tuning.lean_time_s) + time
    step.body_s += time
    distance2 = 0.0
    for i in range(3):
        step.body_force[i] += (body_v[i] - step.body_force[i] * time) / short_s
        distance = step.body_force[i] - step.usual_body_force[i]
        distance2 += distance * distance
        step.usual_body_force[i] += weight * distance
    step.body_scatter2 += weight * (distance2 - step.body_scatter2)


@kernel
def leans_with_thrust(p: Parameters, s: State, angle: float) -> bool:
    """Does the force of the window, at this angle to the vertical, stand in the body where it always does?

    Then the body has leaned and its force with it, as what hangs on its thrust does when it sets off. A slip moves the
    force in the body. In a body that is turned in a hand it is elsewhere, or all over the place.
    """
    step, v, mean = s.attitude_step, s.attitude_step.window_body_v, s.attitude_step.usual_body_force
    force, usual = (v[0], v[1], v[2]), (mean[0], mean[1], mean[2])
    across = cross(force, usual)
    moved = elementary.atan2(math.sqrt(dot(across, across)), dot(force, usual))
    most = p.tuning.lean_share * min(angle, p.tuning.rise_angle_rad)
    steady = step.body_scatter2 < most * most * dot(usual, usual)
    return bool(steady and step.body_s > p.tuning.gain_time_s and moved < most)


@kernel
def is_in_a_hand(p: Parameters, s: State) -> bool:
    """Has the body moved as no vehicle does for long enough, and before the first rest, did the hypotheses say so?

    They know no slips, to them one is a vehicle that sets off: what they said before the gain began to grow counts.
    """
    return bool(hand_share(p, s) == 1.0)


@kernel
def hand_share(p: Parameters, s: State) -> float:
    """The part of the time that this takes which has passed, up to 1."""
    if s.stationarity.gravity_checked == 0 and s.attitude_step.likely_hand_s == 0.0:
        return 0.0
    return min(s.attitude_step.hand_held_s / p.tuning.hand_time_s, 1.0)


@kernel
def is_undecided(p: Parameters, s: State) -> bool:
    """Does the mean velocity grow because of a slip in a hand, or because a vehicle sets off?"""
    mean2 = s.motion.v_mean[0] ** 2 + s.motion.v_mean[1] ** 2
    return bool(mean2 > p.tuning.travel_speed_mps**2 and s.attitude_step.rise_s > 0.0 and hand_share(p, s) > 0.0)


@kernel
def angle_of_rise(p: Parameters, s: State, gain2: float) -> float:
    """The sigma of a tilt error, rad, that may begin to show: the gain, squared `gain2`, is beyond its usual.

    With the probability of a slip it is the angle from the vertical to the force since, else zero.
    """
    c, step = p.tuning, s.attitude_step
    probability = c.rise_slip_probability * hand_share(p, s)
    if probability == 0.0 or gain2 < c.rise_gain_sigmas**2 * step.usual_gain2 + c.rise_gain_mps**2:
        clear_rise(p, s)
        return 0.0
    step.rise_s += s.integrals.time
    for i in range(3):
        step.rise_delta_v[i] += s.integrals.delta_v[i]
    angle2 = angle_to_vertical(step.rise_delta_v) ** 2
    by_gain2 = step.usual_gain2 / step.rise_delta_v[2] ** 2
    return float(math.sqrt(probability * angle2 * c.rise_angle_rad**2 / (c.rise_angle_rad**2 + by_gain2)))


@kernel
def window_angle(p: Parameters, s: State) -> tuple[bool, float, float]:
    """The angle from the vertical to the force of the window, rad, and its variance; first: of the mean force?

    The force itself has the velocity that the body usually gains as its error. Where that hides the angle, the mean
    force is taken, which has less of it, but follows a step late. Its newest value must show the angle, too: the
    acceleration of somebody who begins to walk is over.
    """
    c, step = p.tuning, s.attitude_step
    gravity2 = (s.nav.gravity * step.window_s) ** 2
    angle = angle_to_vertical(step.window_delta_v)
    var = (2.0 * step.usual_gain2 + c.min_gain_mps**2) / gravity2
    if angle * angle > c.usual_gain_sigmas**2 * var:
        return False, angle, var
    angle, f = angle_to_vertical(step.window_mean_v), step.mean_force
    newest = (f[0] * step.window_mean_v[0] + f[1] * step.window_mean_v[1]) * step.window_s
    level2 = step.window_mean_v[0] ** 2 + step.window_mean_v[1] ** 2
    if step.window_s < c.velocity_scatter_time_s or newest < c.steady_share * level2:
        return True, angle, math.inf
    lag = (c.velocity_scatter_time_s / (c.velocity_scatter_time_s + step.window_s)) ** 2
    var = (2.0 * step.usual_mean2 + c.min_gain_mps**2) / gravity2 + step.clipping_variance
    return True, angle, var + (lag * angle) ** 2


@kernel
def angle_to_vertical(f: Reals) -> float:
    """Of a force in NED, rad."""
    return elementary.atan2(elementary.hypot(f[0], f[1]), -f[2])


@kernel
def update_hand_held(p: Parameters, s: State) -> None:
    """For how long the body has moved as no vehicle does."""
    c, step, total, time = p.tuning, s.attitude_step, s.integrals, s.integrals.time
    change2 = 0.0  # (m/s)^2, of what vibrates faster than the interval only the mean
    for i in range(3):
        change2 += (total.delta_v[i] - step.mean_force[i] * time) ** 2
    mean2 = s.motion.v_mean[0] ** 2 + s.motion.v_mean[1] ** 2
    travels = mean2 > c.travel_speed_mps**2
    likely = s.hypotheses.hand > c.min_hand_probability
    step.likely_hand_s = c.gain_time_s if likely else max(step.likely_hand_s - time, 0.0)
    turned2 = min(turn_across_vertical2(total) / (time * c.hand_rate_radps) ** 2, 1.0)
    undecided = is_undecided(p, s)
    if step.hand_held_s < c.hand_time_s and not undecided:
        step.travel_s += time if travels else -step.travel_s * time / c.vehicle_time_s
    if s.stationarity.stationary == 1:
        step.hand_held_s = max(step.hand_held_s - 2.0 * time, 0.0)
    elif step.travel_s > c.travel_proof_s or (s.hypotheses.leading == 1 and step.likely_hand_s == 0.0):
        step.hand_held_s = 0.0
    elif change2 > (c.lively_acceleration_mps2 * time) ** 2 or total.w2 > c.lively_rate_radps**2 * time:
        growth = step.hand_held_s / c.hand_time_s if force_lasts(p, s) else -step.hand_held_s / c.hand_time_s
        counted = growth if undecided else 1.0
        step.hand_held_s = min(step.hand_held_s + time * (counted + turned2), 2.0 * c.hand_time_s)


@kernel
def force_lasts(p: Parameters, s: State) -> bool:
    """Is the newest mean force as far from the vertical as it was since the gain is beyond its usual?"""
    step = s.attitude_step
    f, rise = step.mean_force, step.rise_delta_v
    newest = (f[0] * rise[0] + f[1] * rise[1]) * step.rise_s
    return bool(newest >= p.tuning.steady_share * (rise[0] ** 2 + rise[1] ** 2))


@kernel
def add_clipping_variance(s: State, variance: float) -> None:
    """A rate beyond the range has added `variance`, rad^2, to the attitude, and so to the angle of the mean force."""
    s.attitude_step.clipping_variance += variance


@kernel
def restart_window(s: State) -> None:
    """The gain begins to grow now, if it does."""
    s.attitude_step.window_s = s.attitude_step.clipping_variance = 0.0
    for i in range(3):
        s.attitude_step.window_delta_v[i] = s.attitude_step.window_mean_v[i] = 0.0
        s.attitude_step.window_body_v[i] = 0.0


@kernel
def clear_rise(p: Parameters, s: State) -> None:
    """The gain is a usual one: a rise would begin with a force that has been vertical."""
    s.attitude_step.rise_s = 0.0
    for i in range(3):
        s.attitude_step.rise_delta_v[i] = -s.nav.gravity * p.tuning.rise_time_s if i == 2 else 0.0


@kernel
def restart_gain(p: Parameters, s: State) -> None:
    """Nothing has been gained: the attitude has just been set."""
    restart_window(s)
    clear_rise(p, s)
    interrupt_drag(s)
    s.attitude_step.span = s.attitude_step.possible_tilt_error = 0.0
    for i in range(3):
        s.attitude_step.delta_v[i] = s.attitude_step.mean_gain[i] = 0.0
        s.attitude_step.mean_force[i] = -s.nav.gravity if i == 2 else 0.0


@kernel
def restart_attitude_step(p: Parameters, s: State) -> None:
    """The attitude is a new one: nothing that was found of slips belongs to it."""
    restart_gain(p, s)
    s.attitude_step.levelled_angle = s.attitude_step.likely_hand_s = s.attitude_step.body_s = 0.0


@kernel
def level_by_window(p: Parameters, s: State, use_mean: bool, var: float) -> None:
    """Rotate the force of the window, or its mean force, to the vertical."""
    step = s.attitude_step
    f = step.window_mean_v if use_mean else step.window_delta_v
    angle = angle_to_vertical(f)
    unlikely = (s.nav.gravity * angle / p.tuning.vehicle_acceleration_mps2) ** 2
    step.levelled_angle = angle * elementary.exp(-0.5 * unlikely)
    level_by_force(p, s, (f[0], f[1], f[2]), var, step.window_s)


@kernel
def level_by_force(p: Parameters, s: State, f: Vector, var: float, wrong_s: float) -> None:
    """Rotate f, in NED, to the vertical, which the tilt has not shown for so long; yaw may be wrong by as much."""
    c, step, q = p.tuning, s.attitude_step, s.nav.q_nb
    angle, level = elementary.atan2(elementary.hypot(f[0], f[1]), -f[2]), elementary.hypot(f[0], f[1])
    record_wrong_tilt(s, wrong_s)
    k = angle / max(level, 1e-9)
    turn = quat_exp(-k * f[1], k * f[0], 0.0)
    turned = quat_product(turn, (q[0], q[1], q[2], q[3]))
    set_attitude(s, quat_normalised(turned))
    for i in range(2):
        reset_variance(s, ATTITUDE + i, var)
    add_variance(s, ATTITUDE + 2, angle * angle)
    for i in range(3):
        start_motion(p, s, i)
        inflate_variance(s, ACCEL_BIAS + i, c.min_force_sigma_mps2, p.accel_bias_var)
    forget_travel(s)
    restart_velocity_gain(s)
    restart_gain(p, s)
    step.travel_s = 0.0
    step.hand_held_s = min(step.hand_held_s, 0.5 * c.hand_time_s)  # this may have been a vehicle that leaves


@kernel
def rotate_gain(s: State, x: float, y: float, z: float) -> None:
    """The attitude is corrected by this rotation (rad, NED): so is what was integrated with it."""
    step, turn = s.attitude_step, quat_exp(x, y, z)
    a = quat_rotate(turn, (step.delta_v[0], step.delta_v[1], step.delta_v[2]))
    b = quat_rotate(turn, (step.window_delta_v[0], step.window_delta_v[1], step.window_delta_v[2]))
    m = quat_rotate(turn, (step.window_mean_v[0], step.window_mean_v[1], step.window_mean_v[2]))
    f = quat_rotate(turn, (step.mean_force[0], step.mean_force[1], step.mean_force[2]))
    r = quat_rotate(turn, (step.rise_delta_v[0], step.rise_delta_v[1], step.rise_delta_v[2]))
    for i in range(3):
        step.rise_delta_v[i] = r[i]
        step.delta_v[i], step.window_delta_v[i], step.window_mean_v[i], step.mean_force[i] = a[i], b[i], m[i], f[i]
