"""How well does the vehicle keep to its axis? Learned from sums of the constraint's innovations.

What slips sideways, or off the floor, does so for seconds: the innovations of a tenth of a second each are small, and
all of one sign. The square of their sum over ten seconds is what the sum of their variances promises where these are
honest, less on a vehicle that keeps to its axis better than assumed, and far more on a boat in a current. A constraint
that has just begun is weaker than any land vehicle's: the first sums that show no slip tighten it.
"""

import math
from typing import Any

from ....compile.jit import kernel
from ..stationarity import FRESH_S

SUM_LENGTH = 100  # innovations
SUM_GAIN = 0.2
FIRST_SUMS = 4.0  # sums: so few, if small, tell more together than each of many, but one that is large may be a kerb
MAX_SUM_NIS = 9.0
NOISE_SCALE_RANGE = (
    0.3,
    100.0,
)  # least, and that of what is no land vehicle: there the constraint says next to nothing
INITIAL_NOISE_SCALE = math.sqrt(
    NOISE_SCALE_RANGE[0] * NOISE_SCALE_RANGE[1]
)  # at first, as far from one as from the other


@kernel
def add_innovation(c: Any, k: int, z: float, s: float) -> None:
    """Add innovation z of variance s: sideways (k 0) or off the floor (1)."""
    c.nhc.innovation_sum[k, 0] += z
    c.nhc.innovation_sum[k, 1] += s


@kernel
def clear_sums(c: Any) -> None:
    """Begin new sums."""
    c.nhc.innovation_count = 0
    for k in range(2):
        c.nhc.innovation_sum[k, 0] = c.nhc.innovation_sum[k, 1] = 0.0


@kernel
def reset_noise_scale(c: Any) -> None:
    """Nothing is known of the vehicle."""
    c.nhc.sum_count = 0
    for k in range(2):
        c.nhc.noise_scale[k] = INITIAL_NOISE_SCALE


@kernel
def learn_noise_scale(c: Any) -> bool:
    """Once per pair of innovations: learn when the sums are long enough. True: this is no land vehicle.

    In an outage nothing contradicts: the constraint is then its own witness.
    """
    if 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) > FRESH_S:
        clear_sums(c)
        return False
    c.nhc.innovation_count += 1
    if c.nhc.innovation_count < SUM_LENGTH:
        return False
    for k in range(2):
        surprise = min(c.nhc.innovation_sum[k, 0] ** 2 / c.nhc.innovation_sum[k, 1], MAX_SUM_NIS)
        gain = SUM_GAIN if surprise > 1.0 else max(SUM_GAIN, FIRST_SUMS / (FIRST_SUMS + c.nhc.sum_count))
        loose = c.nhc.noise_scale[k] * math.exp(gain * (surprise - 1.0))
        c.nhc.noise_scale[k] = min(max(loose, NOISE_SCALE_RANGE[0]), NOISE_SCALE_RANGE[1])
    c.nhc.sum_count += 1
    clear_sums(c)
    return bool(max(c.nhc.noise_scale[0], c.nhc.noise_scale[1]) >= NOISE_SCALE_RANGE[1])
