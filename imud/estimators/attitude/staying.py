"""What a small velocity and a place not left tell of tilt, biases and the gyro's matrix.

No sensor sees velocity; that a body does not run away is the knowledge that levels it. Its velocity is taken to be zero
with a noise as large as the motion is lively, and its place to be where it was, with a noise that grows with how far it
has lately been: a hand or a robot comes back, and over the time that it takes this is the stronger knowledge; a vehicle
soon is so far that its place tells nothing.

Nor is the velocity of a vehicle white noise about zero: it lasts. Noise of variance v^2 that stays correlated for T
is to a filter that takes it as white one of density 2 T v^2 (that of a first-order Gauss-Markov process at frequency
zero); with less, curves and long braking are learnt as tilt and accelerometer bias, and believed. A speed counts
as soon as it is reached, else the departure itself is learnt so, and fades when it is not kept up; one that may be no
more than the integral of a false tilt does not count. A vehicle climbs: while it travels fast, its vertical velocity is
no better known than roads are level.

The noise densities were found on hand-held recordings with optical truth (BROAD), and on simulated vehicles such that
their tilt errors are no larger than without a place. TRAVEL is where BROAD no longer notices it.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from .covariance import grow, observe, variance
from .state import GYRO_BIAS, PLACE, STATES, VELOCITY

VELOCITY_NOISE = 0.023  # m/s sqrt(s), of zero velocity in slow motion
VELOCITY_LIVELY = 3.0  # sqrt(s), of it in proportion to the liveliness
ALL_AROUND = 0.5  # the part of the liveliness that is shared by all axes: a hand or a car moves along several
REST_VELOCITY_NOISE = 0.09  # m/s sqrt(s)
UNIFORM_MOTION = 4.0  # sigma
TRAVEL = 1.0  # m/s, the mean over a second: what is faster is a vehicle
TRAVEL_S = 30.0  # for which a vehicle keeps its velocity
SHOWN = 2.0  # of the variance, by the square of a velocity that is no error: Akaike's criterion for one parameter more
SHAKING_S = 0.5  # over which it is judged how a body is shaken
SLOPE = 0.03  # of roads, 1 sigma
PLACE_NOISE = 0.5  # m sqrt(s)
PLACE_LIVELY = 6.0  # sqrt(s), in proportion to the distance
START_VELOCITY_VAR = 0.1
START_PLACE_VAR = 0.1


@kernel
def hold(s: Any, i: int, psd: float) -> None:
    """Take velocity along axis i as zero with noise of this density; what is beyond it is real, and forgotten."""
    if s.v[i] * s.v[i] > UNIFORM_MOTION**2 * (variance(s, VELOCITY + i) + psd):
        forget_motion(s, i)
    observe(s, VELOCITY + i, -s.v[i], psd / s.span)


@kernel
def follow_travel(s: Any) -> None:
    """Keep in mind how fast the body has lately travelled, and how its way shook it.

    What shakes is seen in means over an interval, which leave out most of an engine, and in how unevenly they change:
    manoeuvres are too slow for that.
    """
    fade = s.span / (TRAVEL_S + s.span)
    lasting2 = jolt2 = 0.0
    for i in range(3):
        axis2 = max(s.v_mean[i] * s.v_mean[i] - TRAVEL**2 - SHOWN * variance(s, VELOCITY + i), 0.0)
        s.travel[i] = max(axis2, s.travel[i] - fade * (s.travel[i] - axis2))
        lasting2 += axis2
        force = s.push[i] / s.span
        change = force - s.mean_force[i]
        jolt2 += (change - s.mean_change[i]) ** 2
        s.mean_force[i], s.mean_change[i] = force, change
    jolt = math.sqrt(jolt2)
    s.shaking += s.span / (SHAKING_S + s.span) * (jolt - s.shaking)
    if lasting2 > 0.0:
        s.way_shaking += fade * (jolt - s.way_shaking)


@kernel
def hold_still(p: Any, s: Any) -> None:
    """At rest the mean rate is the gyro bias, and velocity zero."""
    for i in range(3):
        observe(s, GYRO_BIAS + i, s.w_mean[i] - s.bg[i], p.rest_rate_psd / s.span)
        hold(s, i, REST_VELOCITY_NOISE**2)


@kernel
def leave(s: Any) -> None:
    """The gyro bias in motion is that at rest but for what rest cut off unknown."""
    for i in range(3):
        grow(s, GYRO_BIAS + i, s.cut_var[i])


@kernel
def hold_near(s: Any) -> None:
    """In motion velocity is about zero, the livelier and the farther travelled the less surely."""
    level2 = s.travel[0] + s.travel[1]  # whatever the heading: a vehicle turns
    around2 = (s.v_energy[0] + s.v_energy[1] + s.v_energy[2]) / 3.0
    for i in range(3):
        lively2 = s.v_energy[i] + ALL_AROUND * (around2 - s.v_energy[i])
        travel2 = level2 if i < 2 else s.travel[2] + SLOPE**2 * level2
        hold(s, i, VELOCITY_NOISE**2 + VELOCITY_LIVELY**2 * lively2 + 2.0 * TRAVEL_S * travel2)


@kernel
def hold_place(s: Any) -> None:
    """Take the place as the old one, the farther it has lately been the less surely."""
    for i in range(3):
        psd = PLACE_NOISE**2 + PLACE_LIVELY**2 * s.p_energy[i]
        observe(s, PLACE + i, -s.p[i], psd / s.span)


@kernel
def forget_motion(s: Any, i: int) -> None:
    """Count velocity and place along axis i from zero anew, and learn nothing from what they were."""
    s.v[i] = s.v_mean[i] = s.v_energy[i] = s.p[i] = s.p_energy[i] = 0.0
    reset(s.P, STATES, VELOCITY + i, START_VELOCITY_VAR)
    reset(s.P, STATES, PLACE + i, START_PLACE_VAR)
