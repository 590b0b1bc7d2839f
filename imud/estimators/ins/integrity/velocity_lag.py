"""By how much a receiver's velocity lags behind its own positions, found from fixes alone.

A receiver that smooths its velocity reports it late, one that averages its positions reports these late. Where the
velocity is that of a time lag before the position, the way from fix to fix less the integral of the velocity changes by
the lag times the change of the velocity (`velocity_discrepancy` has that sum):

    S = lag dv + scale v dt + noise

Least squares over the pairs of points of the last minutes give the lag; the scale, as of a velocity in other units, is
eliminated with a prior. The variance of the noise is that of the residuals, with the stated one as a prior, so that
jumps of the positions are no evidence; a pair that no credible lag and scale explain does not count.

A lag of up to `max_lag_s` is estimated as an error state (VELOCITY_TIME_OFFSET). A velocity that is later for certain
is smoothed, or of an earlier epoch, and is not used: neither its time nor its size is known. Positions that are later
than the velocity are used, with time offsets that fit the lag.

Source: weighted least squares with exponential forgetting (Ljung, System Identification, 2nd ed., 11.2).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...records import NEW_RECEIVER
from ...tuning import Tunable
from ..aiding.gnss_noise import horizontal_sigma
from ..aiding.gnss_time import move_time_offset
from ..state import CHORD_POINTS, NAVIGATING
from .velocity_discrepancy import chord_variance

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import Core, Parameters, VelocityDiscrepancy, VelocityLag

OUTLIER_SIGMAS = 5.0  # of a pair, beyond what a credible lag explains
# whether the velocity is used; late, but the filter still has what it did; late
USED, FOUND_LATE, LATE = 0, 1, 2
TUNABLES = (
    Tunable("lag_memory_s", 300.0, "s", "Time constant of the sums over pairs of fixes.", "Choice."),
    Tunable("lag_scale_sigma", 0.3, "", "Sigma of the scale of a receiver's velocity, less one.", "Knots, feet."),
    Tunable("max_lag_s", 0.2, "s", "Largest lag that the filter finds by itself.", "Recorded receivers: 0.13 s."),
    Tunable(
        "lag_sigmas", 3.0, "sigma", "Sigmas by which a lag must be beyond max_lag_s before it is certain.", "Choice."
    ),
    Tunable("lag_noise_weight", 4.0, "", "Residuals that count as much as the stated noise of fixes.", "Choice."),
    Tunable("min_lag_pairs", 8.0, "pairs", "Pairs of fixes from which a lag is found.", "Choice."),
    Tunable("max_credible_lag_s", 3.0, "s", "What looks like a larger lag is another fault.", "Choice."),
)


@kernel
def forget_pairs(g: VelocityLag) -> None:
    """Another receiver: whether its velocity is late is found anew; until then what was found before counts."""
    g.change2 = g.cross = g.travel2 = g.change_sum = g.travel_sum = g.energy = g.pairs = g.variance = 0.0


@kernel
def learn_lag(p: Parameters, c: Core, g: VelocityLag, d: VelocityDiscrepancy, fix: Fix) -> None:
    """After a fix was compared with the positions: add the last two points of that.

    Not at rest, where fixes have less noise than stated, and not where a position repeats: such a delay passes.
    """
    if fix.flags & NEW_RECEIVER != 0:
        forget_pairs(g)
    b = d.points[(d.count - 1) % CHORD_POINTS]
    if d.count < 1 or b.t_ns == g.last_ns:
        return
    repeated = g.repeated + d.repeated
    g.last_ns, g.repeated = b.t_ns, d.repeated
    if d.count < 2 or repeated != 0 or c.stationarity.at_rest != 0:
        return
    a = d.points[(d.count - 2) % CHORD_POINTS]
    t = 1e-9 * (b.t_ns - a.t_ns)
    weight = 1.0 / chord_variance(p, c, a, b, t, horizontal_sigma(p, fix))
    decay = elementary.exp(-t / p.tuning.lag_memory_s)
    change2 = cross = travel2 = change_sum = travel_sum = energy = 0.0
    for i in range(2):
        change, travel, s = (
            b.velocity[i] - a.velocity[i],
            0.5 * t * (a.velocity[i] + b.velocity[i]),
            b.sum[i] - a.sum[i],
        )
        change2 += change * change
        cross += change * travel
        travel2 += travel * travel
        change_sum += change * s
        travel_sum += travel * s
        energy += s * s
    credible = p.tuning.max_credible_lag_s * math.sqrt(change2) + 3.0 * p.tuning.lag_scale_sigma * math.sqrt(travel2)
    if math.sqrt(energy) > credible + OUTLIER_SIGMAS / math.sqrt(weight):
        return
    g.change2 = decay * g.change2 + weight * change2
    g.cross = decay * g.cross + weight * cross
    g.travel2 = decay * g.travel2 + weight * travel2
    g.change_sum = decay * g.change_sum + weight * change_sum
    g.travel_sum = decay * g.travel_sum + weight * travel_sum
    g.energy = decay * g.energy + weight * energy
    g.pairs = decay * g.pairs + 1.0
    find_lag(p, g)


@kernel
def find_lag(p: Parameters, g: VelocityLag) -> None:
    """Least squares: g.lag, g.variance; a variance of 0 where nothing is known."""
    scale = g.travel2 + 1.0 / p.tuning.lag_scale_sigma**2
    information = g.change2 - g.cross * g.cross / scale
    g.variance = 0.0
    if g.pairs < p.tuning.min_lag_pairs or information <= 1e-6 * g.change2:
        return
    vector = g.change_sum - g.cross * g.travel_sum / scale
    g.lag = vector / information
    residual = g.energy - g.travel_sum * g.travel_sum / scale - vector * g.lag
    weight = p.tuning.lag_noise_weight
    g.variance = (residual + weight) / (2.0 * g.pairs - 2.0 + weight) / information


@kernel
def lag_beyond(p: Parameters, g: VelocityLag, expected: float) -> float:
    """What the lag differs by from the expected one, s, if the filter does not find that by itself; else 0."""
    away = g.lag - expected
    certain = abs(away) - p.tuning.lag_sigmas * math.sqrt(g.variance)
    if g.variance == 0.0 or certain < p.tuning.max_lag_s or abs(g.lag) > p.tuning.max_credible_lag_s:
        return 0.0
    return away


@kernel
def detect_late_velocity(p: Parameters, g: VelocityLag) -> None:
    """After a fix: set whether its velocity is late."""
    if g.late == USED:
        g.late = FOUND_LATE if lag_beyond(p, g, 0.0) > 0.0 else USED
    elif g.variance > 0.0 and g.lag + p.tuning.lag_sigmas * math.sqrt(g.variance) < p.tuning.max_lag_s:
        g.late = USED


@kernel
def restarts_filter(g: VelocityLag) -> bool:
    """At a fix that is fused: whether the filter begins anew with it, as its velocity has been found to be late."""
    found = g.late == FOUND_LATE
    if found:
        g.late = LATE
    return bool(found)


@kernel
def fit_time_offsets(p: Parameters, c: Core, g: VelocityLag) -> None:
    """While navigating: time offsets that fit the lag, if it contradicts them."""
    d = -lag_beyond(p, g, c.nav.velocity_time_offset)
    if d != 0.0 and c.alignment.mode == NAVIGATING:
        move_time_offset(c, d, g.variance + (p.tuning.time_offset_step_sigma * d) ** 2)
