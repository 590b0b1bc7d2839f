"""How well does the vehicle keep to its axis? Learned from sums of the constraint's innovations.

What slips sideways, or off the floor, does so for seconds: the innovations of a tenth of a second each are small, and
all of one sign. The square of their sum over ten seconds is what the sum of their variances promises where these are
honest, less on a vehicle that keeps to its axis better than assumed, and far more on a boat in a current. A constraint
that has just begun is weaker than any land vehicle's: the first sums that show no slip tighten it.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from .motion import FRESH_S

SUMMED = 100  # innovations
LEARNING = 0.2
FIRST = 4.0  # sums: so few, if small, tell more together than each of many, but one that is large may be a kerb
MOST_SURPRISING = 9.0
LOOSE = (0.3, 100.0)  # least, and that of what is no land vehicle: there the constraint says next to nothing
UNKNOWN = math.sqrt(LOOSE[0] * LOOSE[1])  # at first, as far from one as from the other


@kernel
def strain(c: Any, k: int, z: float, s: float) -> None:
    """Add innovation z of variance s: sideways (k 0) or off the floor (1)."""
    c.strain[k, 0] += z
    c.strain[k, 1] += s


@kernel
def relax(c: Any) -> None:
    """Begin new sums."""
    c.strained = 0
    for k in range(2):
        c.strain[k, 0] = c.strain[k, 1] = 0.0


@kernel
def forget_looseness(c: Any) -> None:
    """Nothing is known of the vehicle."""
    c.strains = 0
    for k in range(2):
        c.loose[k] = UNKNOWN


@kernel
def learn_looseness(c: Any) -> bool:
    """Once per pair of innovations: learn when the sums are long enough. True: this is no land vehicle.

    In an outage nothing contradicts: the constraint is then its own witness.
    """
    if 1e-9 * (c.t_ns - c.fix_ns) > FRESH_S:
        relax(c)
        return False
    c.strained += 1
    if c.strained < SUMMED:
        return False
    for k in range(2):
        surprise = min(c.strain[k, 0] ** 2 / c.strain[k, 1], MOST_SURPRISING)
        gain = LEARNING if surprise > 1.0 else max(LEARNING, FIRST / (FIRST + c.strains))
        loose = c.loose[k] * math.exp(gain * (surprise - 1.0))
        c.loose[k] = min(max(loose, LOOSE[0]), LOOSE[1])
    c.strains += 1
    relax(c)
    return bool(max(c.loose[0], c.loose[1]) >= LOOSE[1])
