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

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ....compile.jit import kernel
from ....math.earth import STANDARD_GRAVITY
from ..mechanization import rotation_matrix
from ..state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS

if TYPE_CHECKING:
    from ..types import Core


Complex = tuple[float, float]  # a complex number

DELTA_V, TIME, DOUBLE_HEADING_INTEGRAL, HEADING_INTEGRAL = range(4)  # running integrals: of force, of 1, of G, G


@kernel
def multiply(a: Complex, b: Complex) -> Complex:
    """a b"""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


@kernel
def conjugate_product(a: Complex, b: Complex) -> Complex:
    """conj(a) b"""
    return a[0] * b[0] + a[1] * b[1], a[0] * b[1] - a[1] * b[0]


@kernel
def phasor(angle: float) -> Complex:
    """exp(i angle)"""
    return math.cos(angle), math.sin(angle)


@kernel
def accumulate_integrals(c: Core, turn: float, dt: float) -> None:
    """Add the level specific force gathered in c.imu.delta_v over `dt` s, in which the body turned by `turn` rad."""
    total, twice, d = c.alignment.integrals, c.alignment.double_integrals, c.alignment.corrections
    y, sway = (
        (c.alignment.heading_phasor[0], c.alignment.heading_phasor[1]),
        (total[HEADING_INTEGRAL, 0], total[HEADING_INTEGRAL, 1]),
    )
    force = multiply(phasor(c.alignment.wander_azimuth), (c.imu.delta_v[0], c.imu.delta_v[1]))
    tilted, biased = multiply((d[1, 0], d[1, 1]), sway), multiply((d[2, 0], d[2, 1]), y)
    after = multiply(phasor(turn), y)
    zn, ze = force[0] - (d[0, 0] + tilted[0] + biased[0]) * dt, force[1] - (d[0, 1] + tilted[1] + biased[1]) * dt
    new = ((zn, ze), (dt, 0.0), (sway[0] * dt, sway[1] * dt), (y[0] * dt, y[1] * dt))
    for k in range(4):
        for i in range(2):
            twice[k, i] += (total[k, i] + 0.5 * new[k][i]) * dt
            total[k, i] += new[k][i]
    c.alignment.heading_phasor[0], c.alignment.heading_phasor[1] = after
    c.alignment.wander_azimuth_drift += c.alignment.vertical_bias * dt


@kernel
def retain_integrals(c: Core) -> None:
    """Before the corrections in c.scratch.x are applied: keep the running integrals as if they were not."""
    x, d = c.scratch.x, c.alignment.corrections
    m = rotation_matrix(c)
    gyro = (x[GYRO_BIAS], x[GYRO_BIAS + 1], x[GYRO_BIAS + 2])
    accel = (x[ACCEL_BIAS], x[ACCEL_BIAS + 1], x[ACCEL_BIAS + 2])
    frame = phasor(c.alignment.wander_azimuth)
    body = multiply(frame, (c.alignment.heading_phasor[0], -c.alignment.heading_phasor[1]))
    tilt = multiply(frame, (-STANDARD_GRAVITY * x[ATTITUDE + 1], STANDARD_GRAVITY * x[ATTITUDE]))
    drift = multiply(body, (STANDARD_GRAVITY * component(m, 1, gyro), -STANDARD_GRAVITY * component(m, 0, gyro)))
    bias = multiply(body, (-component(m, 0, accel), -component(m, 1, accel)))
    since = multiply(drift, (c.alignment.integrals[HEADING_INTEGRAL, 0], c.alignment.integrals[HEADING_INTEGRAL, 1]))
    for i in range(2):
        d[0, i] += tilt[i] - since[i]
        d[1, i] += drift[i]
        d[2, i] += bias[i]
    c.alignment.wander_azimuth -= x[ATTITUDE + 2]
    c.alignment.vertical_bias += component(m, 2, gyro)


@kernel
def rotate_level_frame(c: Core, psi: float) -> None:
    """The level frame of q_nb is about to be turned by psi; the frame of the integrals stays."""
    c.alignment.wander_azimuth -= psi


@kernel
def component(m: Any, axis: int, v: Any) -> float:
    """Component of the body vector v along an axis of the level frame, by the direction cosines m."""
    return float(m[3 * axis] * v[0] + m[3 * axis + 1] * v[1] + m[3 * axis + 2] * v[2])


@kernel
def clear_corrections(c: Core) -> None:
    """All corrections have been applied to what is kept."""
    c.alignment.corrections[:] = 0.0


@kernel
def clear_integrals(c: Core) -> None:
    """Begin with the level frame as it is."""
    c.alignment.wander_azimuth = c.alignment.vertical_bias = c.alignment.wander_azimuth_drift = 0.0
    c.alignment.integrals[:] = 0.0
    c.alignment.double_integrals[:] = 0.0
    c.alignment.corrections[:] = 0.0
    c.alignment.heading_phasor[0], c.alignment.heading_phasor[1] = 1.0, 0.0
    c.alignment.origin_ns = c.nav.t_ns


@kernel
def add_corrections(d: Any, a: Any, first: int) -> None:
    """Element `first` of a += what was corrected, d, times the three elements after it."""
    for j in range(3):
        add_scaled(a[first], multiply(element(d, j), element(a, first + 1 + j)), 1.0)


@kernel
def element(a: Any, i: int) -> Complex:
    """One complex element."""
    return a[i, 0], a[i, 1]


@kernel
def add_scaled(sums: Any, new: Complex, share: float) -> None:
    """Add to a sum."""
    sums[0] += share * new[0]
    sums[1] += share * new[1]
