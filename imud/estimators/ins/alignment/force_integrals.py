"""In-motion alignment: the integrals of specific force that are compared with the receiver's velocity changes.

In a level frame of arbitrary heading the strapdown integrates specific force to dz. Between two fixes the receiver
measures the velocity change dV. As complex numbers, north + i east,

    exp(-i psi) dV = dz + x1 dt + x2 GG + x3 G,   G = integral of exp(i y), GG = integral of G.

psi is the heading of the level frame, which is estimated. The nuisance parameters are x1, a tilt times gravity; x2, a
level gyro bias times gravity, whose tilt grows with time; x3, an accelerometer bias. The biases are fixed in the body,
whose heading in the level frame is y. The velocity of the antenna relative to the IMU is added to dz where it is
compared (`hypothesis_bank.antenna_offset`). The prior of the three is the filter's covariance. The filter
corrects attitude and biases between fixes; dz is kept as if it had not (`record_corrections`), and the corrections are
the prior's mean.

This file accumulates the integrals. The vertical gyro bias turns the level frame, so fixes are matched in a bank of
frames, each turned back at its own rate (`hypothesis_bank`); the posterior of the heading is in
`heading_posterior`.

Source: Wu and Pan, Velocity/position integration formula, part I (2013), in the plane; Schweppe, Uncertain Dynamic
Systems (1973), ch. 6, for nuisance parameters with a prior; matched-filter bank.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import STANDARD_GRAVITY
from ..mechanization import rotation_matrix
from ..state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS
from .vector_pairs import accumulate_vectors

if TYPE_CHECKING:
    from ....math.arrays import Reals, Tensor
    from ....math.rotation import Matrix, Vector
    from ..types import Core


Complex = tuple[float, float]  # a complex number

DELTA_V, TIME, DOUBLE_HEADING_INTEGRAL, HEADING_INTEGRAL = range(4)  # running integrals: of force, of 1, of G, G


@kernel
def multiply(a: Complex, b: Complex) -> Complex:
    """The product a b."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


@kernel
def conjugate_product(a: Complex, b: Complex) -> Complex:
    """The product conj(a) b."""
    return a[0] * b[0] + a[1] * b[1], a[0] * b[1] - a[1] * b[0]


@kernel
def phasor(angle: float) -> Complex:
    """exp(i angle); angle: rad."""
    return elementary.cos(angle), elementary.sin(angle)


@kernel
def accumulate_integrals(c: Core, turn_angle: float, dt: float) -> None:
    """Add the interval's integral of level specific force, imu.delta_v, over `dt` s; turn_angle: of the body, rad."""
    accumulate_vectors(c, dt)
    a = c.alignment
    integrals, double_integrals, d = a.integrals, a.double_integrals, a.corrections
    y = (a.heading_phasor[0], a.heading_phasor[1])
    heading_integral = element(integrals, HEADING_INTEGRAL)
    force = multiply(phasor(a.frame_azimuth), (c.imu.delta_v[0], c.imu.delta_v[1]))
    tilt_change, bias = multiply(element(d, 1), heading_integral), multiply(element(d, 2), y)
    after = multiply(phasor(turn_angle), y)
    zn, ze = force[0] - (d[0, 0] + tilt_change[0] + bias[0]) * dt, force[1] - (d[0, 1] + tilt_change[1] + bias[1]) * dt
    new = ((zn, ze), (dt, 0.0), (heading_integral[0] * dt, heading_integral[1] * dt), (y[0] * dt, y[1] * dt))
    for k in range(4):
        for i in range(2):
            double_integrals[k, i] += (integrals[k, i] + 0.5 * new[k][i]) * dt
            integrals[k, i] += new[k][i]
    a.heading_phasor[0], a.heading_phasor[1] = after
    a.corrected_rotation += a.bias_correction * dt


@kernel
def record_corrections(c: Core) -> None:
    """Before the correction in scratch.x is injected: note it, so that the integrals stay those without it."""
    x, a, d = c.scratch.x, c.alignment, c.alignment.corrections
    C_nb = rotation_matrix(c)
    gyro = (x[GYRO_BIAS], x[GYRO_BIAS + 1], x[GYRO_BIAS + 2])
    accel = (x[ACCEL_BIAS], x[ACCEL_BIAS + 1], x[ACCEL_BIAS + 2])
    frame = phasor(a.frame_azimuth)
    body = multiply(frame, (a.heading_phasor[0], -a.heading_phasor[1]))
    tilt = multiply(frame, (-STANDARD_GRAVITY * x[ATTITUDE + 1], STANDARD_GRAVITY * x[ATTITUDE]))
    tilt_rate = multiply(
        body, (STANDARD_GRAVITY * component(C_nb, 1, gyro), -STANDARD_GRAVITY * component(C_nb, 0, gyro))
    )
    bias = multiply(body, (-component(C_nb, 0, accel), -component(C_nb, 1, accel)))
    tilt_since_origin = multiply(tilt_rate, element(a.integrals, HEADING_INTEGRAL))
    for i in range(2):
        d[0, i] += tilt[i] - tilt_since_origin[i]
        d[1, i] += tilt_rate[i]
        d[2, i] += bias[i]
    a.frame_azimuth -= x[ATTITUDE + 2]
    a.bias_correction += component(C_nb, 2, gyro)


@kernel
def rotate_level_frame(c: Core, psi: float) -> None:
    """Before the level frame of q_nb is rotated by psi (rad, about down): the frame of the integrals stays."""
    c.alignment.frame_azimuth -= psi


@kernel
def component(C_nb: Matrix, axis: int, v: Vector | Reals) -> float:
    """Component of the body vector v along an axis of the level frame; C_nb: row by row."""
    return float(C_nb[3 * axis] * v[0] + C_nb[3 * axis + 1] * v[1] + C_nb[3 * axis + 2] * v[2])


@kernel
def clear_corrections(c: Core) -> None:
    """All corrections have been applied to what is kept."""
    for j in range(3):
        for i in range(2):
            c.alignment.applied_corrections[j, i] += c.alignment.corrections[j, i]
    c.alignment.corrections[:] = 0.0


@kernel
def clear_integrals(c: Core) -> None:
    """Start the integrals at the core's time, in the level frame of q_nb."""
    a = c.alignment
    a.frame_azimuth = a.bias_correction = a.corrected_rotation = 0.0
    a.integrals[:] = 0.0
    a.double_integrals[:] = 0.0
    a.corrections[:] = 0.0
    a.applied_corrections[:] = 0.0
    a.heading_phasor[0], a.heading_phasor[1] = 1.0, 0.0
    a.origin_ns = c.nav.t_ns


@kernel
def add_corrections(d: Tensor, a: Tensor, first: int) -> None:
    """a[first] += sum of d[j] a[first + 1 + j], j = 0 to 2: the corrections d times the regressors, complex."""
    for j in range(3):
        add_scaled(a[first], multiply(element(d, j), element(a, first + 1 + j)), 1.0)


@kernel
def element(a: Tensor, i: int) -> Complex:
    """a[i] as a complex number; a: (n, 2)."""
    return a[i, 0], a[i, 1]


@kernel
def add_scaled(a: Reals, b: Complex, scale: float) -> None:
    """a += scale b, complex."""
    a[0] += scale * b[0]
    a[1] += scale * b[1]
