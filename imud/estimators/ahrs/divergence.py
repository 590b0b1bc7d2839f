"""Detection of a wrong tilt that no sensor reported, and of one that has become too uncertain to be corrected.

If the integral of the specific force less gravity shows a gain of velocity that no vehicle has, the attitude is wrong:
the sensor slipped, its gyro failed for a moment, or the user gave a false attitude. Then a part of gravity is taken as
acceleration, and biases have been learned from it. The variances of tilt and biases are inflated by what would explain
that acceleration. A vehicle that did gain so much velocity loses little: its mean acceleration is a small tilt.

Where roll and pitch have become very uncertain, corrections, which are linear in small errors, would be far off for
long; roll and pitch are then initialised as at a start.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from .ekf import inflate_sigma_tilt
from .error_model import add_variance, variance
from .motion import reset_motion
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS

if TYPE_CHECKING:
    from .types import Parameters, State


@kernel
def tilt_is_lost(p: Parameters, s: State) -> bool:
    """Whether roll and pitch must be initialized anew; inflates P if the velocity gain is too large."""
    c = p.tuning
    gain = update_velocity_gain(p, s)
    if gain > c.max_velocity_gain_mps:
        inflate_covariance(p, s, gain * (1.0 - c.common_velocity_gain) / s.divergence.gain_duration)
    if s.cov.sigma_tilt < c.converged_tilt_rad:
        s.divergence.converged = 1
    if s.divergence.converged == 0 or s.cov.sigma_tilt < c.lost_tilt_rad:
        return False
    s.divergence.converged = 0
    return True


@kernel
def update_velocity_gain(p: Parameters, s: State) -> float:
    """The recent gain of velocity, m/s, not corrected by measurements; stores the time that most of it took."""
    c, d, time = p.tuning, s.divergence, s.integrals.time
    forgetting = time / (c.velocity_gain_time_s + time)
    gain2 = 0.0
    for i in range(3):
        weight = s.nav.gravity * time if i == 2 else 0.0
        d.velocity_gain[i] += s.integrals.delta_v[i] + weight - forgetting * d.velocity_gain[i]
        gain2 += d.velocity_gain[i] * d.velocity_gain[i]
    uncommon = gain2 > (c.common_velocity_gain * c.max_velocity_gain_mps) ** 2
    d.gain_duration = d.gain_duration + time if uncommon else time
    return math.sqrt(gain2)


@kernel
def restart_velocity_gain(s: State) -> None:
    """Set the gain of velocity to zero."""
    for i in range(3):
        s.divergence.velocity_gain[i] = 0.0


@kernel
def inflate_covariance(p: Parameters, s: State, acceleration: float) -> None:
    """Inflate the variances of tilt and biases by an acceleration, m/s^2, that is gravity in a wrong attitude."""
    tilt = acceleration / s.nav.gravity
    for i in range(3):
        add_variance(s, ATTITUDE + i, tilt * tilt)
        inflate_variance(s, GYRO_BIAS + i, tilt / p.tuning.velocity_gain_time_s, p.gyro_bias_var)
        inflate_variance(s, ACCEL_BIAS + i, acceleration, p.accel_bias_var)
        reset_motion(p, s, i)
    restart_velocity_gain(s)
    inflate_sigma_tilt(s, tilt)
    s.divergence.gain_duration = 0.0


@kernel
def inflate_variance(s: State, i: int, error: float, largest: float) -> None:
    """Add the square of an error to variance i, up to `largest`."""
    add_variance(s, i, max(min(error * error, largest - variance(s, i)), 0.0))
