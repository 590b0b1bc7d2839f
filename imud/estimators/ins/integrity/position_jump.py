"""A receiver's positions that jump, as with multipath or another set of satellites, and yet are within their gate.

The estimate follows such a position at a small sigma. The probability of a jump, given the innovation, is that of
Bayes: without one the innovation has its own variance, with one that of the jumps besides. The expected square of the
jump is stated as an error of the position; it fades as the GNSS bias does, for jumps end.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable
from .reset_inflation import inflate_position_to

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("jump_sigma", 10.0, "m", "Distance by which positions jump, in each axis.", "Multipath in streets."),
    Tunable("jump_probability", 0.01, "per fix", "Probability of a jump.", "Choice.", low=1e-9, high=0.5),
)
MAX_EXPONENT = 50.0  # of a probability that is 1 with any prior


@kernel
def state_likely_jump(p: Parameters, c: Core, variances: tuple[float, float], least: float) -> None:
    """Before a horizontal position is fused, whose innovations have these variances, m^2: state a likely jump.

    least: probability of a jump that other positions have shown.
    """
    z, exponent = c.scratch.position_innovation, 0.0
    odds = p.tuning.jump_probability / (1.0 - p.tuning.jump_probability)
    for i in range(2):
        share = p.tuning.jump_sigma**2 / (variances[i] + p.tuning.jump_sigma**2)
        odds *= math.sqrt(1.0 - share)
        exponent += 0.5 * share * z[i] * z[i] / variances[i]
    odds *= elementary.exp(min(exponent, MAX_EXPONENT))
    for i in range(2):
        inflate_position_to(c, i, max(odds / (1.0 + odds), least) * z[i] * z[i])
