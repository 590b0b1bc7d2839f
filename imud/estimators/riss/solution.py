"""A row of SOLUTION from the state; between two steps position, speed and yaw are extrapolated with their rates."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary
from imud.drivers.sample import SATURATED as BEYOND_RANGE

from ...compile.jit import kernel
from ...math.earth import displaced
from ...math.kalman import packed_index
from ...math.rotation import UNKNOWN_ANGLE, quat_of_euler
from ..records import (
    AT_REST,
    ATTITUDE_VALID,
    COASTING,
    HEADING_VALID,
    HEIGHT_VALID,
    POSITION_VALID,
    REJECTING,
    SATURATED,
)
from .ekf import innovation_variance, pitch_of, roll_of, set_jacobian, variance
from .state import (
    ACCEL,
    ACCEL_BIAS_X,
    ACCEL_BIAS_Y,
    DOWN,
    EAST,
    GYRO_BIAS,
    LEAN,
    NORTH,
    PITCH,
    ROLL,
    SINK,
    SPEED,
    SQUAT,
    STATES,
    WHITE_VELOCITY,
    YAW,
)

if TYPE_CHECKING:
    from ..types import Sample, Solution
    from .types import RissParameters, RissState


@kernel
def tilt_variances(s: RissState) -> tuple[float, float]:
    """Variances of roll and pitch of the body, rad^2."""
    n = set_jacobian(s, set_jacobian(s, 0, ROLL, 1.0), LEAN, -s.x[SPEED] * s.yaw_rate)
    roll = innovation_variance(s, set_jacobian(s, n, SPEED, -s.x[LEAN] * s.yaw_rate), 0.0)
    n = set_jacobian(s, set_jacobian(s, 0, PITCH, 1.0), SQUAT, s.x[ACCEL])
    return roll, innovation_variance(s, set_jacobian(s, n, ACCEL, s.x[SQUAT]), 0.0)


@kernel
def status(p: RissParameters, s: RissState, sample: Sample) -> int:
    """The status bits."""
    bits = SATURATED if sample.flags & BEYOND_RANGE != 0 else 0
    tilt_sigma = math.sqrt(max(variance(s, ROLL), variance(s, PITCH)))
    if s.levelled == 1 and tilt_sigma < p.tuning.max_tilt_sigma:
        bits |= ATTITUDE_VALID
    if s.aligned == 1 and math.sqrt(variance(s, YAW)) < p.tuning.max_heading_sigma:
        bits |= HEADING_VALID
    if s.fix_count > 0:
        bits |= POSITION_VALID
        if s.has_height == 1:
            bits |= HEIGHT_VALID
        if (s.t_ns - s.fix_ns) * 1e-9 > p.tuning.coasting_s:
            bits |= COASTING
        if s.reject_count > 2:
            bits |= REJECTING
    return bits | (AT_REST if s.resting == 1 else 0)


@kernel
def write_solution(p: RissParameters, s: RissState, sample: Sample, out: Solution) -> None:
    """Write a row of SOLUTION; what is not known is NaN."""
    x, bits = s.x, status(p, s, sample)
    out.t_ns, out.status = s.t_ns, bits
    T = (s.t_ns - s.step_ns) * 1e-9
    yaw, speed = x[YAW] + T * s.yaw_rate, x[SPEED] + T * x[ACCEL]
    q = quat_of_euler(roll_of(s), pitch_of(s), yaw)
    for i in range(4):
        out.q_nb[i] = q[i]
    out.w[0] = out.w[1] = math.nan
    out.w[2] = sample.w[2] - x[GYRO_BIAS]
    out.f[0], out.f[1], out.f[2] = sample.f[0] - x[ACCEL_BIAS_X], sample.f[1] - x[ACCEL_BIAS_Y], sample.f[2]
    for i in range(3):
        out.bg[i] = out.sigma_bg[i] = math.nan
        out.v[i] = out.sigma_v[i] = out.sigma_p[i] = math.nan
    out.bg[2], out.sigma_bg[2] = x[GYRO_BIAS], math.sqrt(variance(s, GYRO_BIAS))
    out.ba[0], out.ba[1], out.ba[2] = x[ACCEL_BIAS_X], x[ACCEL_BIAS_Y], 0.0
    out.sigma_ba[0], out.sigma_ba[1] = math.sqrt(variance(s, ACCEL_BIAS_X)), math.sqrt(variance(s, ACCEL_BIAS_Y))
    out.sigma_ba[2] = math.sqrt(p.accel_bias_var)
    tilt_vars = tilt_variances(s)
    out.sigma_rpy[0] = min(math.sqrt(tilt_vars[0]), UNKNOWN_ANGLE)
    out.sigma_rpy[1] = min(math.sqrt(tilt_vars[1]), UNKNOWN_ANGLE)
    out.sigma_rpy[2] = min(math.sqrt(variance(s, YAW)), UNKNOWN_ANGLE)
    out.lat = out.lon = out.height = math.nan
    if bits & POSITION_VALID == 0:
        return
    cy, sy = elementary.cos(yaw), elementary.sin(yaw)
    vn, ve = (speed * cy, speed * sy) if s.aligned == 1 else (s.v[0], s.v[1])
    out.lat, out.lon = displaced(s.lat, s.lon, s.height, T * vn, T * ve)
    out.height = s.height - T * x[SINK]
    out.v[0], out.v[1], out.v[2] = vn, ve, x[SINK]
    along, across = variance(s, SPEED), variance(s, YAW) * x[SPEED] ** 2 + p.tuning.lateral_sigma**2
    both = s.P[packed_index(STATES, SPEED, YAW)] * x[SPEED]
    if s.aligned == 1:
        out.sigma_v[0] = math.sqrt(max(cy * cy * along + sy * sy * across - 2.0 * cy * sy * both, 0.0))
        out.sigma_v[1] = math.sqrt(max(sy * sy * along + cy * cy * across + 2.0 * cy * sy * both, 0.0))
    else:
        since_s = max((s.t_ns - s.fix_ns) * 1e-9, 0.0)
        out.sigma_v[0] = out.sigma_v[1] = math.sqrt(s.white_var[WHITE_VELOCITY]) + p.tuning.accel_sigma * since_s
    out.sigma_v[2] = math.sqrt(variance(s, SINK))
    out.sigma_p[0], out.sigma_p[1] = math.sqrt(variance(s, NORTH)), math.sqrt(variance(s, EAST))
    out.sigma_p[2] = math.sqrt(variance(s, DOWN)) if s.has_height == 1 else math.nan
