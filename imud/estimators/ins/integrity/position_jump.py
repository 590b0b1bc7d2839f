"""A receiver's positions that jump, as with multipath or another set of satellites, and yet are within their gate.

The estimate follows such a position at a small sigma. The probability of a jump, given the innovation, is that of
Bayes: without one the innovation has its own variance, with one that of the jumps besides. The expected square of the
jump, given the innovation, is stated as an error of the position: after an outage, where the estimate is far off, it is
no more than elsewhere. The part that no innovation shows counts there only, where jumps are frequent. It fades as the
GNSS bias does, for jumps end.
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
    Tunable(
        "reacquired_jump_probability",
        0.1,
        "per fix",
        "Probability of a jump of the first position after an outage.",
        "Receivers that have just found their satellites again.",
        low=1e-9,
        high=0.5,
    ),
)
MAX_EXPONENT = 50.0  # of a probability that is 1 with any prior


@kernel
def jump_share(p: Parameters, variance: float) -> float:
    """Share of an innovation of this variance, m^2, that is a jump, if there is one."""
    return float(p.tuning.jump_sigma**2 / (variance + p.tuning.jump_sigma**2))


@kernel
def state_likely_jump(p: Parameters, c: Core, variances: tuple[float, float], least: float) -> None:
    """Before a horizontal position is fused, whose innovations have these variances, m^2: state a likely jump.

    least: probability that other positions have shown of all of the innovation being an error.
    """
    z, exponent = c.scratch.position_innovation, 0.0
    outage = 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) > p.tuning.coasting_s
    prior = p.tuning.reacquired_jump_probability if outage else p.tuning.jump_probability
    odds = prior / (1.0 - prior)
    for i in range(2):
        share = jump_share(p, variances[i])
        odds *= math.sqrt(1.0 - share)
        exponent += 0.5 * share * z[i] * z[i] / variances[i]
    odds *= elementary.exp(min(exponent, MAX_EXPONENT))
    for i in range(2):
        share = jump_share(p, variances[i])
        hidden2 = (1.0 - share) * p.tuning.jump_sigma**2
        jump2 = (share * z[i]) ** 2 + (hidden2 if outage else 0.0)
        inflate_position_to(c, i, max(odds / (1.0 + odds) * jump2, least * z[i] * z[i]))
