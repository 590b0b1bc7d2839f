"""A bank of drift rates of the level frame: for each, the integrals of `matching` turned back, matched with the fixes.

If a hypothesis is right, its frame does not turn over ground, and the equation of `matching` holds in it for as long as
one likes. A tilt turns with the level frame, too, which drifts about the axis of the body that it takes for vertical.
The drift within the interval between two fixes matters little: each interval is turned as a whole.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ....compile.jit import kernel
from ....math.earth import STANDARD_GRAVITY
from ...tuning import Tunable
from ..observers.heading_integrals import (
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
from ..state import HYPOTHESES
from .whitening import update_hypothesis, update_whitening, whitened_innovations

if TYPE_CHECKING:
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable(
        "drift_rate_step",
        math.radians(0.35),
        "rad/s",
        "Distance between the hypotheses of the heading's drift rate.",
        "33 of them span 11 deg/s.",
    ),
    Tunable(
        "max_corrected_tilt", 0.1, "rad", "Tilt corrected afterwards; more is not of first order.", "Linearization."
    ),
)
GNSS_COLUMN, INERTIAL_COLUMN, REGRESSOR_COLUMN = (
    0,
    1,
    2,
)  # products: of what the receiver saw, what was felt, and the first regressor


@kernel
def drift_rate(p: Parameters, k: int) -> float:
    """Drift rate of hypothesis k, rad/s."""
    return (k - HYPOTHESES // 2) * p.tuning.drift_rate_step


@kernel
def nearest_hypothesis(p: Parameters, c: Core) -> int:
    """The hypothesis nearest to what the filter knows of the drift."""
    return int(
        min(max(HYPOTHESES // 2 + 0.5 - c.alignment.vertical_bias / p.tuning.drift_rate_step, 0.0), HYPOTHESES - 0.5)
    )


@kernel
def frame_rotation(p: Parameters, c: Core, k: int, ago: float) -> float:
    """Angle, rad, by which the level frame had turned since the origin `ago` s before now, if hypothesis k is right."""
    return float(
        drift_rate(p, k) * (1e-9 * (c.nav.t_ns - c.alignment.origin_ns) - ago)
        + c.alignment.wander_azimuth_drift
        - c.alignment.vertical_bias * ago
    )


@kernel
def clear_hypotheses(b: HypothesisBank) -> None:
    """Forget all that was matched, at the origin of the core's integrals."""
    b.integrals[:] = 0.0
    b.double_integrals[:] = 0.0
    b.last_integrals[:] = 0.0
    b.last_double_integrals[:] = 0.0
    discount(b, 0.0)


@kernel
def discount(b: HypothesisBank, share: float) -> None:
    """Keep a share of what was matched."""
    b.weight *= share
    b.energy2 *= share
    b.energy_age *= share
    b.products *= share


@kernel
def propagate_hypotheses(p: Parameters, c: Core, b: HypothesisBank, dt: float) -> None:
    """Add the core's integrals over the last `dt` s to those of each hypothesis, turned back."""
    for k in range(HYPOTHESES):
        turn = phasor(frame_rotation(p, c, k, 0.5 * dt))
        for j in range(4):
            old, new = element(b.last_integrals, j), element(c.alignment.integrals, j)
            once = multiply(turn, (new[0] - old[0], new[1] - old[1]))
            twice, again = element(b.last_double_integrals, j), element(c.alignment.double_integrals, j)
            again = multiply(turn, (again[0] - twice[0] - old[0] * dt, again[1] - twice[1] - old[1] * dt))
            add_scaled(b.double_integrals[k, j], element(b.integrals[k], j), dt)
            add_scaled(b.double_integrals[k, j], again, 1.0)
            add_scaled(b.integrals[k, j], once, 1.0)
    for j in range(4):
        for i in range(2):
            b.last_integrals[j, i], b.last_double_integrals[j, i] = (
                c.alignment.integrals[j, i],
                c.alignment.double_integrals[j, i],
            )


@kernel
def apply_corrections(p: Parameters, c: Core, b: HypothesisBank) -> None:
    """Take the corrections as made in all that was matched, and in the integrals.

    That is of first order, so that what was matched before counts the less the more its level frame was tilted. A frame
    that never had the corrections would tilt ever further.
    """
    d = c.alignment.corrections
    drifted = multiply(element(d, 1), element(c.alignment.integrals, HEADING_INTEGRAL))
    then, now = d[0, 0] ** 2 + d[0, 1] ** 2, (d[0, 0] + drifted[0]) ** 2 + (d[0, 1] + drifted[1]) ** 2
    discount(b, math.exp(-max(then, now) / (STANDARD_GRAVITY * p.tuning.max_corrected_tilt) ** 2))
    for k in range(HYPOTHESES):
        correct_products(b.products[k], d)
        add_corrections(d, b.integrals[k], DELTA_V)
        add_corrections(d, b.double_integrals[k], DELTA_V)
        for state in range(3):
            add_corrections(d, b.whitening_state[k, state], 1 + DELTA_V)
    add_corrections(d, c.alignment.integrals, DELTA_V)
    add_corrections(d, c.alignment.double_integrals, DELTA_V)
    add_corrections(d, c.alignment.pair_integrals, DELTA_V)
    add_corrections(d, c.alignment.pair_double_integrals, DELTA_V)
    add_corrections(d, c.alignment.mean_integrals, DELTA_V)
    add_corrections(d, b.last_integrals, DELTA_V)
    add_corrections(d, b.last_double_integrals, DELTA_V)
    clear_corrections(c)


@kernel
def correct_products(products: Any, d: Any) -> None:
    """As if d times the regressors had been part of what was felt."""
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
def accumulate_products(b: HypothesisBank, k: int, share: float) -> None:
    """Add the products of the innovations in b.innovations to those of hypothesis k."""
    left = b.innovations
    for i in range(5):
        for j in range(5):
            add_scaled(b.products[k, i, j], conjugate_product(element(left, i), element(left, j)), share)


@kernel
def count_innovation(b: HypothesisBank, share: float, age: float) -> None:
    """Count the innovations in b.innovations, of variance 1 / share, `age` s from the origin."""
    v2 = share * (b.innovations[GNSS_COLUMN, 0] ** 2 + b.innovations[GNSS_COLUMN, 1] ** 2)
    b.energy2 += v2 * v2
    b.energy_age += v2 * age
    b.weight += 1.0


@kernel
def match_measurement(c: Core, b: HypothesisBank, place: bool, told: Complex, s: float, telling: bool) -> None:
    """Take a place or a velocity, whose innovation has the variance s; match it if it is telling."""
    for k in range(HYPOTHESES):
        whitened_innovations(b, k, place, told)
        if telling:
            accumulate_products(b, k, 1.0 / s)
        update_hypothesis(b, k, place, s)
    if telling:
        count_innovation(b, 1.0 / s, 1e-9 * (c.nav.t_ns - c.alignment.origin_ns))
    update_whitening(b, place, s)
