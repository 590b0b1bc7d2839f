"""What changes a gyro's bias beside its random walk: the specific force on it (g-sensitivity), and warming up.

Where a boat heels or a vehicle lies on its side, gravity acts along other axes, and the bias learned before is wrong.
For a force that changes by df its variance grows by (sensitivity df)^2. Waves and vibration, whose errors cancel, are
no such change: the force is averaged twice. With m <- m + (f - m) dt / T and s <- s + (m - s) dt / T the integral of
(4 / T) |m - s|^2 dt is |df|^2 after a change. A force that comes back is another change.

A sensor that is switched on warms up, and its bias with it: by d (1 - exp(-t / T)). As a random walk whose density
falls by exp(-2 t / T) it adds sigma_d^2 to the variance of the bias, most of it at once: of a variance that is still to
come a share of 2 dt / T comes in dt.

Source: Titterton and Weston (2004), ch. 4 (acceleration-dependent bias; bias and temperature).
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
    Tunable(
        "warm_up_share",
        0.05,
        "",
        "Sigma of what warming up after a switch-on changes a gyro's bias by, as a share of its sigma at switch-on.",
        "MEMS data sheets: 0.015 to 0.05 deg/s per K, 5 K and more; of simulated vehicles 0.15 costs heading.",
    ),
    Tunable(
        "warm_up_time_s",
        60.0,
        "s",
        "Time constant of warming up.",
        "A small circuit board; 150 s finds no more of simulated biases that warm up within 60 to 300 s.",
    ),
)


@kernel
def begin_warm_up(p: Parameters, c: Core) -> None:
    """At the first sample and after each switch-on: all of the change is still to come."""
    c.bias_changes.warm_up_variance = (p.tuning.warm_up_share * p.gyro_bias_sigma) ** 2


@kernel
def begin_bias_changes(p: Parameters, c: Core, f: Reals) -> None:
    """At the first sample, whose specific force is f (m/s^2, body)."""
    for i in range(3):
        c.bias_changes.averaged_force[i] = c.bias_changes.earlier_force[i] = f[i]
    begin_warm_up(p, c)


@kernel
def add_bias_changes(p: Parameters, c: Core) -> None:
    """Add the variance that a window adds to the bias (call at its end, once classified, before it is cleared)."""
    b, dt = c.bias_changes, c.stationarity.duration
    gain, change2 = min(dt / p.tuning.force_change_time_s, 1.0), 0.0
    for i in range(3):
        b.averaged_force[i] += gain * (c.stationarity.mean_f[i] - b.averaged_force[i])
        change = b.averaged_force[i] - b.earlier_force[i]
        b.earlier_force[i] += gain * change
        change2 += 4.0 * gain * change * change
    per_force = p.tuning.gyro_force_share * p.gyro_bias_sigma / STANDARD_GRAVITY
    warmed2 = b.warm_up_variance * min(2.0 * dt / p.tuning.warm_up_time_s, 1.0)
    b.warm_up_variance -= warmed2
    for i in range(3):
        add_variance(c, GYRO_BIAS + i, per_force * per_force * change2 + warmed2)
