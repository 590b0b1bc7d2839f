"""What changes a gyro's bias beside its random walk: the specific force on it (g-sensitivity).

Where a boat heels or a vehicle lies on its side, gravity acts along other axes, and the bias learned before is wrong.
For a force that changes by df its variance grows by (sensitivity df)^2. Waves and vibration, whose errors cancel, are
no such change: the force is averaged twice. With m <- m + (f - m) dt / T and s <- s + (m - s) dt / T the integral of
(4 / T) |m - s|^2 dt is |df|^2 after a change. A force that comes back is another change.

Source: Titterton and Weston (2004), ch. 4 (acceleration-dependent bias).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.earth import STANDARD_GRAVITY
from ..tuning import Tunable
from .ekf import add_variance
from .state import GYRO_BIAS

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from .types import Core, Parameters


TUNABLES = (
    Tunable(
        "force_change_time_s",
        10.0,
        "s",
        "Time constant of the averages whose difference is a change of the force.",
        "Longer than waves; of simulated sailing boats 20 s leave some wrong and sure.",
    ),
    Tunable(
        "gyro_force_share",
        0.025,
        "per g",
        "Sigma of what a force changes a gyro's bias by, as a share of its sigma at switch-on.",
        "MEMS data sheets: 0.01 to 0.1 deg/s per g.",
    ),
)


@kernel
def begin_bias_changes(c: Core, f: Reals) -> None:
    """At the first sample, whose specific force is f (m/s^2, body)."""
    for i in range(3):
        c.bias_changes.averaged_force[i] = c.bias_changes.earlier_force[i] = f[i]


@kernel
def add_bias_changes(p: Parameters, c: Core) -> None:
    """Add the variance of a window to the bias (call at its end, once classified, before it is cleared)."""
    b, dt = c.bias_changes, c.stationarity.duration
    gain, change2 = min(dt / p.tuning.force_change_time_s, 1.0), 0.0
    for i in range(3):
        b.averaged_force[i] += gain * (c.stationarity.mean_f[i] - b.averaged_force[i])
        change = b.averaged_force[i] - b.earlier_force[i]
        b.earlier_force[i] += gain * change
        change2 += 4.0 * gain * change * change
    per_force = p.tuning.gyro_force_share * p.gyro_bias_sigma / STANDARD_GRAVITY
    for i in range(3):
        add_variance(c, GYRO_BIAS + i, per_force * per_force * change2)
