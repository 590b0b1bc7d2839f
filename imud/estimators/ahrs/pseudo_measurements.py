"""Zero velocity and zero position as measurements: what they tell of tilt, biases and the gyro's matrix.

No sensor sees velocity; that a body does not run away is the knowledge that levels it. Its velocity is taken to be zero
with a noise as large as the motion, and its position to be at the origin, with a noise that grows with its scatter: a
hand or a robot comes back, and over the time that it takes this is the stronger knowledge; a vehicle soon is so far
that its position tells nothing.

The velocity of a vehicle is no white noise about zero: it lasts. Noise of variance v^2 that stays correlated for T is
to a filter that takes it as white one of density 2 T v^2 (that of a first-order Gauss-Markov process at frequency
zero); with less, curves and long braking are learnt as tilt and accelerometer bias, and believed. A vehicle climbs:
while it travels fast, its vertical velocity is no better known than roads are level.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from .drag import velocity_by_drag
from .ekf import fuse_state
from .error_model import add_bias_variance, variance
from .motion import begins_at_rest, reset_motion
from .state import GYRO_BIAS, POSITION, VELOCITY

if TYPE_CHECKING:
    from .types import Parameters, State


@kernel
def fuse_zero_velocity_axis(p: Parameters, s: State, i: int, psd: float) -> None:
    """Zero velocity along axis i with noise of this density. A velocity far beyond is real: it is reset first."""
    v = s.nav.v_n
    if v[i] * v[i] > p.tuning.velocity_reset_gate**2 * (variance(s, VELOCITY + i) + psd):
        reset_motion(p, s, i)
    fuse_state(s, VELOCITY + i, -v[i], psd / s.integrals.time)


@kernel
def fuse_stationary(p: Parameters, s: State) -> None:
    """At rest the mean rate is the gyro bias (ZARU), and velocity zero (ZUPT)."""
    for i in range(3):
        bias_error = s.stationarity.w_mean[i] - s.nav.bg[i]
        fuse_state(s, GYRO_BIAS + i, bias_error, p.mean_rate_psd / s.integrals.time)
        fuse_zero_velocity_axis(p, s, i, p.tuning.stationary_velocity_noise**2)


@kernel
def add_truncation_noise(p: Parameters, s: State) -> None:
    """When rest ends: the gyro bias in motion is that at rest but for the unknown truncation error there."""
    R = p.sensor_axes
    for k in range(3):
        sigma = s.quantization.error_var[k] ** 0.5
        add_bias_variance(s, (sigma * R[k], sigma * R[3 + k], sigma * R[6 + k]))


@kernel
def unseen_scatter(p: Parameters, s: State) -> float:
    """Of a velocity that changes slowly, (m/s)^2: where there was no rest, it may for a while be hidden in the tilt."""
    c, motion = p.tuning, s.motion
    if s.stationarity.gravity_checked == 1:
        return 0.0
    if motion.moving_s == 0.0 and begins_at_rest(p, s):
        return 0.0
    motion.moving_s += s.integrals.time
    return float(c.unseen_velocity_var * c.unseen_velocity_time_s / (c.unseen_velocity_time_s + motion.moving_s))


@kernel
def fuse_zero_velocity(p: Parameters, s: State) -> None:
    """In motion velocity is about zero; the noise follows its scatter and the sustained speed."""
    c, motion = p.tuning, s.motion
    level2 = motion.travel_speed2[0] + motion.travel_speed2[1]  # whatever the heading: a vehicle turns
    unseen2 = unseen_scatter(p, s)
    mean2 = (motion.v_scatter[0] + motion.v_scatter[1] + motion.v_scatter[2]) / 3.0
    for i in range(3):
        scatter2 = unseen2 + motion.v_scatter[i] + c.shared_scatter * (mean2 - motion.v_scatter[i])
        travel2 = level2 if i < 2 else motion.travel_speed2[2] + c.road_slope**2 * level2
        psd = c.zero_velocity_noise**2 + c.zero_velocity_noise_per_scatter**2 * scatter2
        psd += 2.0 * c.travel_time_s * travel2
        if i < 2 and s.drag.per_mass > 0.0 and s.drag.psd < psd:
            fuse_state(s, VELOCITY + i, velocity_by_drag(s, i) - s.nav.v_n[i], s.drag.psd / s.integrals.time)
        else:
            fuse_zero_velocity_axis(p, s, i, psd)


@kernel
def fuse_zero_position(p: Parameters, s: State) -> None:
    """Position is about the origin; the noise follows its scatter."""
    c = p.tuning
    for i in range(3):
        psd = c.zero_position_noise**2 + c.zero_position_noise_per_scatter**2 * s.motion.p_scatter[i]
        fuse_state(s, POSITION + i, -s.nav.p_n[i], psd / s.integrals.time)
