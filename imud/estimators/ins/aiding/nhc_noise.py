"""How well does the vehicle keep to its axis? Learned from sums of the constraint's innovations.

What slips sideways, or off the floor, does so for seconds: the innovations of a tenth of a second each are small, and
all of one sign. The square of their sum over ten seconds is what the sum of their variances promises where these are
honest, less on a vehicle that keeps to its axis better than assumed, and far more on a boat in a current. A constraint
that has just begun is weaker than any land vehicle's: the first sums that show no slip tighten it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("nhc_sum_length", 100, "innovations", "Innovations of a sum.", "Ten seconds."),
    Tunable("nhc_sum_gain", 0.2, "", "Gain of the noise scale.", "Choice."),
    Tunable(
        "nhc_first_sums",
        4.0,
        "sums",
        "Small first sums tell more than each of many.",
        "A slow UGV and simulated boats.",
    ),
    Tunable("nhc_max_sum_nis", 9.0, "", "Largest normalised square that counts: a kerb.", "Three sigma."),
    Tunable("nhc_max_noise_scale", 100.0, "", "Noise scale of what is no land vehicle.", "Simulated boats."),
    Tunable("nhc_min_noise_scale", 0.3, "", "Least noise scale.", "Recorded drives."),
)


@kernel
def add_innovation(c: Core, k: int, z: float, s: float) -> None:
    """Add innovation z of variance s: sideways (k 0) or off the floor (1)."""
    c.nhc.innovation_sum[k, 0] += z
    c.nhc.innovation_sum[k, 1] += s


@kernel
def clear_sums(c: Core) -> None:
    """Begin new sums."""
    c.nhc.innovation_count = 0
    for k in range(2):
        c.nhc.innovation_sum[k, 0] = c.nhc.innovation_sum[k, 1] = 0.0


@kernel
def reset_noise_scale(p: Parameters, c: Core) -> None:
    """Nothing is known of the vehicle."""
    c.nhc.sum_count = 0
    for k in range(2):
        c.nhc.noise_scale[k] = math.sqrt(p.tuning.nhc_min_noise_scale * p.tuning.nhc_max_noise_scale)


@kernel
def learn_noise_scale(p: Parameters, c: Core) -> bool:
    """Once per pair of innovations: learn when the sums are long enough. True: this is no land vehicle.

    In an outage nothing contradicts: the constraint is then its own witness.
    """
    if 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) > p.tuning.fresh_fix_s:
        clear_sums(c)
        return False
    c.nhc.innovation_count += 1
    if c.nhc.innovation_count < p.tuning.nhc_sum_length:
        return False
    for k in range(2):
        surprise = min(c.nhc.innovation_sum[k, 0] ** 2 / c.nhc.innovation_sum[k, 1], p.tuning.nhc_max_sum_nis)
        gain = (
            p.tuning.nhc_sum_gain
            if surprise > 1.0
            else max(p.tuning.nhc_sum_gain, p.tuning.nhc_first_sums / (p.tuning.nhc_first_sums + c.nhc.sum_count))
        )
        loose = c.nhc.noise_scale[k] * math.exp(gain * (surprise - 1.0))
        c.nhc.noise_scale[k] = min(max(loose, p.tuning.nhc_min_noise_scale), p.tuning.nhc_max_noise_scale)
    c.nhc.sum_count += 1
    clear_sums(c)
    return bool(max(c.nhc.noise_scale[0], c.nhc.noise_scale[1]) >= p.tuning.nhc_max_noise_scale)
