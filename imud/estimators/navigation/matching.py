"""Heading from motion: what the accelerometer felt is matched with the velocity changes that the receiver saw.

In a level frame of arbitrary heading the strapdown integrates specific force to dz. Between two fixes the receiver
shows dV, and as complex numbers, north + i east,

    exp(-i psi) dV = dz + x1 dt + x2 GG + x3 G,   G = integral of exp(i y), GG = integral of G,

with psi the heading sought, and of what the level frame does not know x1, a tilt (turned into force by gravity); x2, a
level gyro bias, which tilts it ever further; x3, an accelerometer bias. The biases turn with the body, whose heading in
the frame is y. All three have the filter's covariance as their prior, so that pairs from before a rest are worth as
much as it has told since. The filter corrects attitude and biases on the way; dz is kept as if it never had (`shift`),
and what has been corrected is the prior's mean.

Here are the integrals, sample by sample. The vertical gyro bias turns their frame, so fixes are matched with them in
a bank of frames that are turned back, each at its rate (`hypotheses`); likelihoods weigh the answer (`posterior`).

Source: Wu and Pan, Velocity/position integration formula, part I (2013), in the plane; Schweppe, Uncertain Dynamic
Systems (1973), ch. 6, for nuisance parameters with a prior; matched-filter bank.
"""

import math
from typing import Any

from ...kernels.earth import STANDARD_GRAVITY
from ...kernels.jit import kernel
from ...kernels.rotation import dcm_of_quat
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS

Pair = tuple[float, float]  # a complex number

ZETA, TIME, TILTING, SWAY = range(4)  # running integrals: of force, of 1, of G, G


@kernel
def times(a: Pair, b: Pair) -> Pair:
    """a b"""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


@kernel
def inner(a: Pair, b: Pair) -> Pair:
    """conj(a) b"""
    return a[0] * b[0] + a[1] * b[1], a[0] * b[1] - a[1] * b[0]


@kernel
def unit(angle: float) -> Pair:
    """exp(i angle)"""
    return math.cos(angle), math.sin(angle)


@kernel
def feel(c: Any, turn: float, dt: float) -> None:
    """Add the level specific force gathered in c.dv over `dt` s, in which the body turned by `turn` rad."""
    total, twice, d = c.running, c.twice, c.shifted
    y, sway = (c.swing[0], c.swing[1]), (total[SWAY, 0], total[SWAY, 1])
    force = times(unit(c.frame), (c.dv[0], c.dv[1]))
    tilted, biased = times((d[1, 0], d[1, 1]), sway), times((d[2, 0], d[2, 1]), y)
    after = times(unit(turn), y)
    zn, ze = force[0] - (d[0, 0] + tilted[0] + biased[0]) * dt, force[1] - (d[0, 1] + tilted[1] + biased[1]) * dt
    new = ((zn, ze), (dt, 0.0), (sway[0] * dt, sway[1] * dt), (y[0] * dt, y[1] * dt))
    for k in range(4):
        for i in range(2):
            twice[k, i] += (total[k, i] + 0.5 * new[k][i]) * dt
            total[k, i] += new[k][i]
    c.swing[0], c.swing[1] = after
    c.drifted += c.frame_rate * dt


@kernel
def shift(c: Any) -> None:
    """Before the corrections in c.x are applied: keep the running integrals as if they were not."""
    x, d = c.x, c.shifted
    m = dcm_of_quat((c.q[0], c.q[1], c.q[2], c.q[3]))
    gyro = (x[GYRO_BIAS], x[GYRO_BIAS + 1], x[GYRO_BIAS + 2])
    accel = (x[ACCEL_BIAS], x[ACCEL_BIAS + 1], x[ACCEL_BIAS + 2])
    frame = unit(c.frame)
    body = times(frame, (c.swing[0], -c.swing[1]))
    tilt = times(frame, (-STANDARD_GRAVITY * x[ATTITUDE + 1], STANDARD_GRAVITY * x[ATTITUDE]))
    drift = times(body, (STANDARD_GRAVITY * along(m, 1, gyro), -STANDARD_GRAVITY * along(m, 0, gyro)))
    bias = times(body, (-along(m, 0, accel), -along(m, 1, accel)))
    since = times(drift, (c.running[SWAY, 0], c.running[SWAY, 1]))
    for i in range(2):
        d[0, i] += tilt[i] - since[i]
        d[1, i] += drift[i]
        d[2, i] += bias[i]
    c.frame -= x[ATTITUDE + 2]
    c.frame_rate += along(m, 2, gyro)


@kernel
def along(m: Any, axis: int, v: Any) -> float:
    """Component of the body vector v along an axis of the level frame, by the direction cosines m."""
    return float(m[3 * axis] * v[0] + m[3 * axis + 1] * v[1] + m[3 * axis + 2] * v[2])


@kernel
def clear_matching(c: Any) -> None:
    """Begin with the level frame as it is."""
    c.frame = c.frame_rate = c.drifted = 0.0
    c.running[:] = 0.0
    c.twice[:] = 0.0
    c.shifted[:] = 0.0
    c.swing[0], c.swing[1] = 1.0, 0.0
    c.origin_ns = c.t_ns


@kernel
def add_shifted(d: Any, a: Any, first: int) -> None:
    """Element `first` of a += what was corrected, d, times the three elements after it."""
    for j in range(3):
        blend(a[first], times(pick(d, j), pick(a, first + 1 + j)), 1.0)


@kernel
def pick(a: Any, i: int) -> Pair:
    """One complex element."""
    return a[i, 0], a[i, 1]


@kernel
def blend(sums: Any, new: Pair, share: float) -> None:
    """Add to a sum."""
    sums[0] += share * new[0]
    sums[1] += share * new[1]
