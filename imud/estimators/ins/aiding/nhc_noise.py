"""The noise scale of the non-holonomic constraint, learned from sums of its innovations.

Lateral and vertical velocities are correlated over seconds: innovations, every tenth of a second, are small but of one
sign. So the innovations of ten seconds are summed. The square of the sum equals the sum of the variances where the
assumed noise is right; it is smaller on a vehicle with less sideslip, and far larger on a boat in a current. The first
noise scale is larger than that of any land vehicle; the first sums without sideslip reduce it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "nhc_sum_length",
        100,
        "innovations",
        "Number of innovations in a sum from which the constraint's noise scale is learned.",
        "Ten seconds.",
    ),
    Tunable("nhc_sum_gain", 0.2, "", "Gain of the constraint's noise scale.", "About five sums.", high=1.0),
    Tunable(
        "nhc_first_sums",
        4.0,
        "sums",
        "Weight of the first sums that reduce the constraint's noise scale.",
        "A slow UGV and simulated boats.",
    ),
    Tunable(
        "nhc_max_sum_nis",
        9.0,
        "",
        "Largest normalised squared sum of innovations that is learned from.",
        "Three sigma.",
    ),
    Tunable(
        "nhc_max_noise_scale",
        100.0,
        "",
        "Noise scale of the constraint from which a vehicle is no land vehicle.",
        "Simulated boats.",
    ),
    Tunable("nhc_min_noise_scale", 0.3, "", "Least noise scale of the constraint.", "Recorded drives."),
)


@kernel
def add_innovation(c: Core, k: int, z: float, s: float) -> None:
    """Add an innovation z (m/s) of variance s to the sums; k: 0 lateral, 1 vertical."""
    c.nhc.innovation_sum[k, 0] += z
    c.nhc.innovation_sum[k, 1] += s


@kernel
def clear_innovation_sums(c: Core) -> None:
    """Clear the sums."""
    h = c.nhc
    h.innovation_count = 0
    for k in range(2):
        h.innovation_sum[k, 0] = h.innovation_sum[k, 1] = 0.0


@kernel
def reset_noise_scale(p: Parameters, c: Core) -> None:
    """Reset both noise scales to the geometric mean of the least and the largest."""
    c.nhc.sum_count = 0
    for k in range(2):
        c.nhc.noise_scale[k] = math.sqrt(p.tuning.nhc_min_noise_scale * p.tuning.nhc_max_noise_scale)


@kernel
def learn_noise_scale(p: Parameters, c: Core) -> bool:
    """Call once per pair of innovations; adapts the noise scales at the end of a sum. True: this is no land vehicle.

    Nothing is learned in a GNSS outage, where the velocity is known from the constraint itself.
    """
    h = c.nhc
    if 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) > p.tuning.fresh_fix_s:
        clear_innovation_sums(c)
        return False
    h.innovation_count += 1
    if h.innovation_count < p.tuning.nhc_sum_length:
        return False
    for k in range(2):
        nis = min(h.innovation_sum[k, 0] ** 2 / h.innovation_sum[k, 1], p.tuning.nhc_max_sum_nis)
        gain = (
            p.tuning.nhc_sum_gain
            if nis > 1.0
            else max(p.tuning.nhc_sum_gain, p.tuning.nhc_first_sums / (p.tuning.nhc_first_sums + h.sum_count))
        )
        noise_scale_new = h.noise_scale[k] * elementary.exp(gain * (nis - 1.0))
        h.noise_scale[k] = min(max(noise_scale_new, p.tuning.nhc_min_noise_scale), p.tuning.nhc_max_noise_scale)
    h.sum_count += 1
    clear_innovation_sums(c)
    return bool(max(h.noise_scale[0], h.noise_scale[1]) >= p.tuning.nhc_max_noise_scale)
