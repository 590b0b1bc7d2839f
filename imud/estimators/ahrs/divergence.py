"""Detection of a wrong tilt that no sensor reported, and of one that has become too uncertain to be corrected.

The integral of the specific force less gravity shows a gain of velocity that no vehicle has. Then there is none: the
attitude is wrong, as when the sensor slipped, its gyro failed for a moment, or the user gave a false attitude; gravity
counts as acceleration, and biases have been learnt from it. All of these become as uncertain as that acceleration says
they are wrong. A vehicle that did gain so much velocity loses little by it: over the time that it took, its
acceleration is a small tilt.

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
    """Must roll and pitch be initialised anew? Once per covariance interval."""
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
    """The velocity lately gained, m/s, uncorrected by measurements; the time that most of it took is kept."""
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
    """No velocity has been gained."""
    for i in range(3):
        s.divergence.velocity_gain[i] = 0.0


@kernel
def inflate_covariance(p: Parameters, s: State, acceleration: float) -> None:
    """Take an acceleration, m/s^2, as gravity seen in a wrong attitude: tilt and biases are that uncertain."""
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
    """Add the square of an error to variance i, as far as the sum does not exceed `largest`."""
    add_variance(s, i, max(min(error * error, largest - variance(s, i)), 0.0))
