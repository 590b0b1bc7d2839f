"""A bank of hypotheses of the rate at which the level frame rotates: for each, integrals in the frame turned back.

The vertical gyro bias turns the level frame. In the frame of a correct hypothesis that rotation is removed, and the
equation of `force_integrals` holds over any duration. Each interval between two fixes is turned as a
whole, because the rotation within it is small.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.earth import STANDARD_GRAVITY
from ...tuning import Tunable
from ..lever_arm import antenna_position, antenna_velocity
from ..state import HYPOTHESES
from .force_integrals import (
    DELTA_V,
    HEADING_INTEGRAL,
    Complex,
    add_corrections,
    add_scaled,
    clear_corrections,
    conjugate_product,
    element,
    multiply,
    phasor,
)
from .whitening import update_hypothesis, update_whitening, whitened_innovations

if TYPE_CHECKING:
    from ....math.arrays import Tensor
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable(
        "frame_rate_step",
        math.radians(0.35),
        "rad/s",
        "Distance between the hypotheses of the rate at which the level frame rotates.",
        "33 of them span 11 deg/s.",
    ),
    Tunable(
        "max_corrected_tilt", 0.1, "rad", "Largest tilt that is corrected afterwards, to first order.", "Linearization."
    ),
)
# columns of `products`: innovations of GNSS, of the integrated specific force, of the first of three regressors
GNSS_COLUMN, INERTIAL_COLUMN, REGRESSOR_COLUMN = 0, 1, 2


@kernel
def frame_rate(p: Parameters, k: int) -> float:
    """Rate of the level frame about down under hypothesis k, rad/s: minus the error of the vertical gyro bias."""
    return (k - HYPOTHESES // 2) * p.tuning.frame_rate_step


@kernel
def nearest_hypothesis(p: Parameters, c: Core) -> int:
    """Number of the hypothesis nearest to the frame rate that the filter's vertical gyro bias predicts."""
    return int(
        min(max(HYPOTHESES // 2 + 0.5 - c.alignment.bias_correction / p.tuning.frame_rate_step, 0.0), HYPOTHESES - 0.5)
    )


@kernel
def frame_rotation(p: Parameters, c: Core, k: int, ago: float) -> float:
    """Angle, rad, from the origin to `ago` s before now, by which the level frame turned under hypothesis k."""
    return float(
        frame_rate(p, k) * (1e-9 * (c.nav.t_ns - c.alignment.origin_ns) - ago)
        + c.alignment.corrected_rotation
        - c.alignment.bias_correction * ago
    )


@kernel
def antenna_offset(p: Parameters, c: Core, k: int, is_position: bool) -> Complex:
    """Level position (m; else velocity, m/s) of the antenna relative to the IMU, in the frame of hypothesis k."""
    offset = antenna_position(c) if is_position else antenna_velocity(c)
    return multiply(phasor(c.alignment.frame_azimuth + frame_rotation(p, c, k, 0.0)), (offset[0], offset[1]))


@kernel
def clear_hypotheses(b: HypothesisBank) -> None:
    """Clear integrals and products of every hypothesis, at the origin of the core's integrals."""
    b.integrals[:] = 0.0
    b.double_integrals[:] = 0.0
    b.last_integrals[:] = 0.0
    b.last_double_integrals[:] = 0.0
    discount(b, 0.0)


@kernel
def discount(b: HypothesisBank, factor: float) -> None:
    """Multiply the sums of matched innovations by `factor`, 0 to 1."""
    b.weight *= factor
    b.energy2 *= factor
    b.energy_age *= factor
    b.products *= factor


@kernel
def propagate_hypotheses(p: Parameters, c: Core, b: HypothesisBank, dt: float) -> None:
    """Add the core's integrals over the last `dt` s, turned back, to those of each hypothesis."""
    a = c.alignment
    for k in range(HYPOTHESES):
        rotation = phasor(frame_rotation(p, c, k, 0.5 * dt))
        for j in range(4):
            old, new = element(b.last_integrals, j), element(a.integrals, j)
            old2, new2 = element(b.last_double_integrals, j), element(a.double_integrals, j)
            change = multiply(rotation, (new[0] - old[0], new[1] - old[1]))
            change2 = multiply(rotation, (new2[0] - old2[0] - old[0] * dt, new2[1] - old2[1] - old[1] * dt))
            add_scaled(b.double_integrals[k, j], element(b.integrals[k], j), dt)
            add_scaled(b.double_integrals[k, j], change2, 1.0)
            add_scaled(b.integrals[k, j], change, 1.0)
    for j in range(4):
        for i in range(2):
            b.last_integrals[j, i], b.last_double_integrals[j, i] = a.integrals[j, i], a.double_integrals[j, i]


@kernel
def apply_corrections(p: Parameters, c: Core, b: HypothesisBank) -> None:
    """Apply the corrections of tilt and biases to the integrals and to the products, and clear them.

    The correction is of first order in the tilt, so the products are discounted by the square of the corrected tilt.
    Without the corrections the tilt of the level frame would grow without bound.
    """
    a, d = c.alignment, c.alignment.corrections
    change = multiply(element(d, 1), element(a.integrals, HEADING_INTEGRAL))
    at_origin, now = d[0, 0] ** 2 + d[0, 1] ** 2, (d[0, 0] + change[0]) ** 2 + (d[0, 1] + change[1]) ** 2
    discount(b, elementary.exp(-max(at_origin, now) / (STANDARD_GRAVITY * p.tuning.max_corrected_tilt) ** 2))
    for k in range(HYPOTHESES):
        correct_products(b.products[k], d)
        add_corrections(d, b.integrals[k], DELTA_V)
        add_corrections(d, b.double_integrals[k], DELTA_V)
        for state in range(3):
            add_corrections(d, b.whitening_state[k, state], 1 + DELTA_V)
    add_corrections(d, a.integrals, DELTA_V)
    add_corrections(d, a.double_integrals, DELTA_V)
    add_corrections(d, a.pair_integrals, DELTA_V)
    add_corrections(d, a.pair_double_integrals, DELTA_V)
    add_corrections(d, a.mean_integrals, DELTA_V)
    add_corrections(d, b.last_integrals, DELTA_V)
    add_corrections(d, b.last_double_integrals, DELTA_V)
    clear_corrections(c)


@kernel
def correct_products(products: Tensor, d: Tensor) -> None:
    """Products after d times the regressors are added to the integrated specific force (both columns and rows)."""
    for i in range(5):
        for j in range(3):
            add_scaled(
                products[i, INERTIAL_COLUMN], multiply(element(d, j), element(products[i], REGRESSOR_COLUMN + j)), 1.0
            )
    for i in range(5):
        for j in range(3):
            add_scaled(
                products[INERTIAL_COLUMN, i],
                conjugate_product(element(d, j), element(products[REGRESSOR_COLUMN + j], i)),
                1.0,
            )


@kernel
def accumulate_products(products: Tensor, z: Tensor, weight: float) -> None:
    """Add conj(z[i]) z[j] times `weight` to products[i, j]; z: (5, 2), products: (5, 5, 2)."""
    for i in range(5):
        for j in range(5):
            add_scaled(products[i, j], conjugate_product(element(z, i), element(z, j)), weight)


@kernel
def add_energy(b: HypothesisBank, weight: float, age: float) -> None:
    """Add the energy of the innovations in b.innovations, of variance 1 / weight, `age` s after the origin."""
    v2 = weight * (b.innovations[GNSS_COLUMN, 0] ** 2 + b.innovations[GNSS_COLUMN, 1] ** 2)
    b.energy2 += v2 * v2
    b.energy_age += v2 * age
    b.weight += 1.0


@kernel
def match_measurement(
    p: Parameters, c: Core, b: HypothesisBank, is_position: bool, measured: Complex, s: float, informative: bool
) -> None:
    """Whiten a position (else a velocity) of innovation variance s; add the products of informative innovations."""
    for k in range(HYPOTHESES):
        whitened_innovations(b, k, is_position, measured, antenna_offset(p, c, k, is_position))
        if informative:
            accumulate_products(b.products[k], b.innovations, 1.0 / s)
        update_hypothesis(b, k, is_position, s)
    if informative:
        add_energy(b, 1.0 / s, 1e-9 * (c.nav.t_ns - c.alignment.origin_ns))
    update_whitening(b, is_position, s)
