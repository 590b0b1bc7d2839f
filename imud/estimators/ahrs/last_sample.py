"""The newest good sample, and for how long its rate has been held since."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Vector

if TYPE_CHECKING:
    from .types import State


@kernel
def store_sample(s: State, w: Vector, f: Vector) -> None:
    """Make rate w and specific force f the newest sample."""
    for i in range(3):
        s.imu.w[i] = w[i]
        s.imu.f[i] = f[i]
        if s.stamps.waiting == 0 or s.stamps.late == 0:
            s.imu.gap_w[i] = w[i]
            s.imu.gap_f[i] = f[i]


@kernel
def set_gap(s: State, w: Vector, f: Vector) -> None:
    """What is lost before the next sample read rate w and force f in the mean."""
    for i in range(3):
        s.imu.gap_w[i] = w[i]
        s.imu.gap_f[i] = f[i]


@kernel
def store_first_sample(s: State, w: Vector, f: Vector) -> None:
    """Make w and f the newest sample, without a sample before: at the start, or after a long gap."""
    store_sample(s, w, f)
    for i in range(3):
        s.imu.f_change[i] = 0.0
    s.imu.outage_s = 0.0


@kernel
def subtract_biases(s: State) -> None:
    """Subtract the biases from the newest sample."""
    for i in range(3):
        s.imu.w[i] -= s.nav.bg[i]
        s.imu.f[i] -= s.nav.ba[i]
        s.imu.gap_w[i] -= s.nav.bg[i]
        s.imu.gap_f[i] -= s.nav.ba[i]


@kernel
def update_force_change(s: State, f: Vector) -> float:
    """Square of the change from the last force to f that the change before did not announce, (m/s^2)^2."""
    unannounced2 = 0.0
    for i in range(3):
        change = f[i] - s.imu.f[i]
        unannounced2 += (change - s.imu.f_change[i]) ** 2
        s.imu.f_change[i] = change
    return unannounced2


@kernel
def update_mean_square_rate(s: State, w: Vector, share: float) -> None:
    """A good rate w is so much of the mean."""
    s.imu.rate2 += min(share, 1.0) * ((w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) / 3.0 - s.imu.rate2)


@kernel
def set_outage(s: State, seconds: float, fault_s: float) -> None:
    """The last rate has been held for so long. fault_s: the sensor's fault has lasted; 0: it has none."""
    s.imu.outage_s, s.imu.fault_s = seconds, fault_s
