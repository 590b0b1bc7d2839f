"""The beginning: when is the heading that the fixes tell (`fix_matching`, `posterior`) known well enough?

And how navigation begins with it, and is given up again.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset, shear, shear3
from ...kernels.rotation import quat_of_gravity, quat_rotate
from .correction import correct, predicted, take, turn_tilt
from .covariance import doubt_turn_scale, grow, predict, variance
from .creep import forget_creep
from .fix_matching import forget_pairs, vertical_bias
from .non_holonomic import stop, turn_witnesses
from .posterior import believe, solve
from .state import (
    ACCEL_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    LATENCY,
    LEVELLING,
    NAVIGATING,
    NEVER_NS,
    POSITION,
    STATES,
    VELOCITY,
)
from .strapdown import displace, rotate

READY = math.radians(10.0), math.radians(11.0)  # with a receiver that tells its velocity, and without: that cannot wait
HORIZON_S = 10.0  # for which the heading has to stay known
LEAST_HEADING = math.radians(3.0)
MOVING_TILT = math.radians(1.0)  # of a tilt found while the level frame turned by an unknown angle
LOST_TILT = math.radians(20.0)


@kernel
def turn_north(c: Any, psi: float) -> None:
    """Turn the level frame by psi about down, and what is given in it: tilt errors, velocities in the body."""
    turn_witnesses(c, psi)
    rotate(c, 0.0, 0.0, psi)
    c.frame -= psi
    turn_tilt(c, psi)


@kernel
def find_heading(c: Any, b: Any) -> bool:
    """Turn the level frame to north when the pairs tell how; its sigma goes to c.heading_sigma."""
    bias_variance = predicted(c, vertical_bias(c))
    turned2 = bias_variance * (1e-9 * (c.t_ns - c.origin_ns)) ** 2
    believe(c, b)
    if not adopt(c, solve(c, b, bias_variance)):
        return False
    for i in range(2):
        grow(c, ATTITUDE + i, MOVING_TILT**2 * min(turned2, 1.0))
    return True


@kernel
def adopt(c: Any, found: Any) -> bool:
    """Turn to the heading that `solve` found, if that is good enough to navigate with."""
    psi, sigma, rate, rate_variance, together = found
    ready = READY[1] if c.slope[2] > 0.0 else READY[0]
    if sigma * sigma + rate_variance * HORIZON_S**2 > ready**2:
        return False
    n = vertical_bias(c)
    news = 1.0 / rate_variance - 1.0 / predicted(c, n)  # beside what the filter knew, which `solve` has counted in
    if news > 0.0:
        take(c, n, -rate / (rate_variance * news), 1.0 / news, 0.0)
    c.x[ATTITUDE + 2] = 0.0
    correct(c)
    turn_north(c, psi)
    c.heading_sigma = max(sigma, LEAST_HEADING)
    c.heading_age = together / rate_variance
    return True


@kernel
def refer(p: Any, c: Any, sign: float) -> None:
    """From the antenna at the fixes' own time, which is followed while levelling, to the sensor now; back with -1.

    What the fixes' latency is not known by is no error there, as all comes from the same fixes. A place that a user
    gave, and no fix has told yet, is the sensor's all the time.
    """
    if c.fix_ns == NEVER_NS:
        return
    arm = quat_rotate((c.q[0], c.q[1], c.q[2], c.q[3]), (p.lever[0], p.lever[1], p.lever[2]))
    arm2 = p.lever[0] ** 2 + p.lever[1] ** 2 + p.lever[2] ** 2
    late2 = variance(c, LATENCY)
    n, e, d = sign * arm[0], sign * arm[1], sign * arm[2]
    displace(c, -n, -e, -d)
    shear3(c.P, STATES, POSITION, ATTITUDE, 0.0, -d, e)
    shear3(c.P, STATES, POSITION + 1, ATTITUDE, d, 0.0, -n)
    shear3(c.P, STATES, POSITION + 2, ATTITUDE, -e, n, 0.0)
    for i in range(3):
        shear(c.P, STATES, POSITION + i, LATENCY, sign * c.v[i])
        grow(c, VELOCITY + i, late2 * c.accel[i] ** 2 + arm2 * c.rate[i] ** 2)


@kernel
def engage(p: Any, c: Any) -> None:
    """Begin to navigate, at the position and velocity in hand, with the heading in hand and its sigma."""
    predict(p, c)
    drifted = c.heading_age**2 * predicted(c, vertical_bias(c))
    reset(c.P, STATES, ATTITUDE + 2, max(c.heading_sigma**2 - drifted, LEAST_HEADING**2))
    for k in range(vertical_bias(c)):
        shear(c.P, STATES, ATTITUDE + 2, c.columns[k], -c.heading_age * c.values[k])
    c.heading_age = 0.0
    if c.phase == LEVELLING:
        refer(p, c, 1.0)
    c.phase = NAVIGATING
    forget_creep(c)
    forget_pairs(c)


@kernel
def disengage(p: Any, c: Any) -> None:
    """Back to levelling with the heading unknown, and all else as it is."""
    if c.phase == NAVIGATING:
        refer(p, c, -1.0)
    c.phase = LEVELLING
    c.heading_sigma = 0.0
    reset(c.P, STATES, ATTITUDE + 2, math.pi**2)
    forget_creep(c)


@kernel
def forget_attitude(p: Any, c: Any) -> None:
    """Back to levelling: nothing is known of roll, pitch and heading."""
    disengage(p, c)
    stop(c)
    forget_pairs(c)
    q = quat_of_gravity(c.f[0], c.f[1], c.f[2] - 1e-3)
    c.q[0], c.q[1], c.q[2], c.q[3] = q
    for i in range(2):
        reset(c.P, STATES, ATTITUDE + i, LOST_TILT**2)


@kernel
def forget_heading(p: Any, c: Any) -> None:
    """Back to levelling: the heading was wrong, and what was learned with it."""
    forget_attitude(p, c)
    for i in range(3):
        c.bg[i] = 0.0
        c.ba[i] = 0.0
        c.turn_scale[i] = 0.0
        reset(c.P, STATES, GYRO_BIAS + i, p.gyro_initial**2)
        reset(c.P, STATES, ACCEL_BIAS + i, p.accel_initial**2)
    doubt_turn_scale(p, c)
