"""Wheel speed: reading = (1 + scale) (u - yaw_rate y), y being the wheel's lateral position; signed or not.

Tyres slip in proportion to the force on them, for about a second, so that readings in that time share an error: the
gate has the variance of one reading, the update that of all readings in the correlation time. A reading without a sign
gets that of u where u is significant. Before the heading is known u is the speed, which is not negative.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ..records import ODOMETER, SPEED_VALUE
from .ekf import add_variance, fuse, inject_error, innovation_variance, set_jacobian, travelled_since, variance
from .state import ACCEL, SPEED, TRAVEL_SPEED, WHEEL_SCALE

if TYPE_CHECKING:
    from ..types import Innovation, Measurement
    from .types import RissParameters, RissState


@kernel
def signed(p: RissParameters, s: RissState, reading: float, u: float) -> float:
    """The reading with the sign of the motion; NaN where that is not known."""
    dead, sigma = p.tuning.wheel_dead_speed, math.sqrt(variance(s, SPEED))
    if s.aligned == 0:
        return abs(reading)
    if abs(u) > p.tuning.wheel_sign_sigmas * sigma + dead:
        return math.copysign(reading, u)
    if abs(reading) <= dead:
        return 0.0
    return reading if reading < 0.0 else math.nan


@kernel
def fuse_wheel_speed(p: RissParameters, s: RissState, m: Measurement, innovations: list[Innovation]) -> int:
    """Gate and fuse a reading at its epoch; returns the rows of innovations."""
    late_s = (s.step_ns - m.t_ns) * 1e-9
    if s.started == 0 or late_s > p.tuning.max_late_s or not math.isfinite(m.value[SPEED_VALUE]) or m.sigma[1] > 0.0:
        return 0  # m.sigma[1] > 0: a speed through the water
    x, dead = s.x, p.tuning.wheel_dead_speed
    u = x[SPEED] - travelled_since(s, m.t_ns, TRAVEL_SPEED) - min(late_s, 0.0) * x[ACCEL]
    u -= p.odometer_lever_arm[1] * s.yaw_rate
    reading = signed(p, s, m.value[SPEED_VALUE], u)
    if not math.isfinite(reading):
        return 0
    slip_s = p.tuning.wheel_slip_time_s
    every_s = min(max((m.t_ns - s.wheel_ns) * 1e-9, 1e-3), slip_s) if s.wheel_ns > 0 else slip_s
    s.wheel_ns = m.t_ns
    add_variance(s, WHEEL_SCALE, p.tuning.wheel_scale_walk**2 * every_s)
    sigma = m.sigma[0] if m.sigma[0] > 0.0 else p.tuning.wheel_sigma
    still = 0.5 * dead if abs(reading) <= dead else 0.0
    slip_sigma = (p.tuning.wheel_slip + p.tuning.wheel_slip_per_accel * abs(x[ACCEL])) * abs(reading)
    n = set_jacobian(s, set_jacobian(s, 0, SPEED, 1.0 + x[WHEEL_SCALE]), WHEEL_SCALE, u)
    z = reading - (1.0 + x[WHEEL_SCALE]) * u
    noise = sigma * sigma + still * still + slip_sigma * slip_sigma
    total = innovation_variance(s, n, noise)
    used = z * z < p.tuning.wheel_gate * total
    row = innovations[0]
    row.t_ns, row.kind, row.value, row.variance, row.used = m.t_ns, ODOMETER, z, total, 1 if used else 0
    if used:
        fuse(s, n, z, noise + (2.0 * slip_s / every_s - 1.0) * slip_sigma * slip_sigma)
        inject_error(s)
    return 1
