"""What changes a sensor's biases beside their random walk: the force on it, and its warmth after switch-on.

A gyro's bias depends on the specific force (g-sensitivity), and an accelerometer's scale error is a bias that does.
Where a boat heels or a vehicle lies on its side, gravity acts along other axes, and what was learned before is wrong.
For a force that changes by df both variances grow by (sensitivity df)^2. Waves and vibration, whose errors cancel, are
no such change: the force is averaged twice. With m <- m + (f - m) dt / T and s <- s + (m - s) dt / T the integral of
(4 / T) |m - s|^2 dt is |df|^2 after a change. To the variances a force that comes back is another change.

A sensor warms up by its own heat. Of the bias that goes with it, an exponential of the time since switch-on, the
variance that is still to come falls by exp(-2 dt / T); by so much that of the bias grows.

Source: Titterton and Weston (2004), ch. 4 (acceleration-dependent bias).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.earth import STANDARD_GRAVITY
from ..tuning import Tunable
from .ekf import add_variance
from .state import ACCEL_BIAS, GYRO_BIAS

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from .types import Core, Parameters


TUNABLES = (
    Tunable(
        "force_change_time_s",
        10.0,
        "s",
        "Time constant of the averages whose difference is a change of the force.",
        "Longer than waves; simulated sailing boats: 4 to 20 s are alike.",
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
        0.025,
        "",
        "Sigma of what warmth changes a gyro's bias by, as a share of its sigma at switch-on.",
        "MEMS data sheets: 0.01 to 0.1 deg/s per K.",
    ),
    Tunable("warm_up_time_s", 100.0, "s", "Time constant with which a sensor warms up.", "Choice."),
)


@kernel
def begin_warm_up(p: Parameters, c: Core) -> None:
    """The sensor was switched on now."""
    c.bias_changes.warm_up_variance = (p.tuning.warm_up_share * p.gyro_bias_sigma) ** 2


@kernel
def begin_bias_changes(p: Parameters, c: Core, f: Reals) -> None:
    """At the first sample, whose specific force is f (m/s^2, body)."""
    begin_warm_up(p, c)
    for i in range(3):
        c.bias_changes.averaged_force[i] = c.bias_changes.earlier_force[i] = f[i]


@kernel
def add_bias_changes(p: Parameters, c: Core) -> None:
    """Add the variance of a window to both biases (call at its end, once classified, before it is cleared)."""
    b, dt = c.bias_changes, c.stationarity.duration
    gain, change2 = min(dt / p.tuning.force_change_time_s, 1.0), 0.0
    for i in range(3):
        b.averaged_force[i] += gain * (c.stationarity.mean_f[i] - b.averaged_force[i])
        change = b.averaged_force[i] - b.earlier_force[i]
        b.earlier_force[i] += gain * change
        change2 += 4.0 * gain * change * change
    warmed2 = min(2.0 * dt / p.tuning.warm_up_time_s, 1.0) * b.warm_up_variance
    b.warm_up_variance -= warmed2
    per_force = p.tuning.gyro_force_share * p.gyro_bias_sigma / STANDARD_GRAVITY
    for i in range(3):
        add_variance(c, GYRO_BIAS + i, per_force * per_force * change2 + warmed2)
        add_variance(c, ACCEL_BIAS + i, p.accel_scale**2 * change2)
