"""The GNSS velocity, component by component: reported as three components, two, or speed and course.

z = v_fix - v - gnss_velocity_bias - C_nb (w x lever_arm) + dv, in m/s, NED

dv: change of the antenna's velocity since that of the fix was true (`fusion_horizon.fit_acceleration`). An error of a
time offset changes it by the acceleration at that time. The attitude error phi changes C_nb (w x lever_arm) by
phi x C_nb (w x lever_arm), the error of the gyro bias by C_nb (lever_arm x bias).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.rotation import Vector
from ...records import VELOCITY_N
from ...tuning import Tunable
from ..ekf import set_jacobian, set_jacobian3
from ..fusion import REJECT, correct_state, fix_update, write_innovation
from ..lever_arm import antenna_velocity, arm_velocity_row, attitude_row, gyro_bias_row
from ..state import (
    ATTITUDE,
    GNSS_LEVER_ARM,
    GNSS_VELOCITY_BIAS,
    GYRO_BIAS,
    NAVIGATING,
    NEVER_NS,
    OTHER_AXIS,
    TIME_OFFSET,
    VELOCITY,
    VELOCITY_AXIS,
    VELOCITY_TIME_OFFSET,
)
from .gnss_gate import count_velocity_rejects
from .gnss_noise import learn_velocity_noise, lever_arm_rate_variance, second_order_error
from .wheel_check import check_receiver, wheels_reject

if TYPE_CHECKING:
    from ...types import Fix, Innovation
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("min_course_speed", 0.5, "m/s", "Least speed at which the course is used.", "Real receivers."),
    Tunable("gnss_velocity_gate", 25.0, "NIS", "Gate of each component of the velocity.", "Five sigma."),
)


@kernel
def velocity_of(p: Parameters, fix: Fix, axis: int) -> float:
    """North, east or down velocity of a fix (axis 0 to 2), m/s; NaN where it is not reported."""
    if math.isfinite(fix.v[axis]):
        return float(fix.v[axis])
    if axis == 2 or not math.isfinite(fix.speed):
        return math.nan
    if fix.speed < p.tuning.min_course_speed:
        return 0.0
    return float(fix.speed) * (elementary.cos(fix.course) if axis == 0 else elementary.sin(fix.course))


@kernel
def low_speed_variance(p: Parameters, fix: Fix) -> float:
    """Variance, m^2/s^2, of a velocity component taken as zero, because at a low speed the course is noise."""
    return 0.0 if math.isfinite(fix.v[0]) or not fix.speed < p.tuning.min_course_speed else float(0.5 * fix.speed**2)


@kernel
def velocity_variance(p: Parameters, c: Core, slow: float, ratio2: float, reported: float) -> float:
    """Variance, m^2/s^2, of a velocity component, but for what the acceleration adds.

    slow: m/s, speed taken as zero; ratio2: variance over that of a horizontal component; reported: sigma
    that the receiver reports of it, m/s, NaN or 0 if unknown: the larger one of it and the learned one counts.
    """
    noise, second = ratio2 * c.gnss.velocity_noise_var, second_order_error(p, c)
    if reported > 0.0:
        noise = max(noise, reported * reported)
    return float(noise + second**2 + slow * slow + lever_arm_rate_variance(p, c))


@kernel
def velocity_jacobian(p: Parameters, c: Core, antenna: Vector, accel: float, i: int) -> int:
    """Jacobian of the velocity along axis i: velocity, both time offsets and, by the lever arm, attitude and gyro bias.

    antenna: C_nb (w x lever_arm), m/s, NED; accel: m/s^2 along the axis. Returns the Jacobian's length.
    """
    length = set_jacobian(c, 0, VELOCITY + i, 1.0)
    length = set_jacobian(c, length, GNSS_VELOCITY_BIAS + i, 1.0)
    length = set_jacobian(c, length, TIME_OFFSET, -accel)
    length = set_jacobian(c, length, VELOCITY_TIME_OFFSET, -accel)
    if c.alignment.mode != NAVIGATING:
        return length
    length = set_jacobian3(c, length, ATTITUDE, attitude_row(antenna, i))
    length = set_jacobian3(c, length, GNSS_LEVER_ARM, arm_velocity_row(c, i))
    return set_jacobian3(c, length, GYRO_BIAS, gyro_bias_row(c, c.nav.gnss_lever_arm, i))


@kernel
def fuse_gnss_velocity(p: Parameters, c: Core, fix: Fix, innovations: list[Innovation], n: int) -> int:
    """Gate and fuse the velocity; returns the rows of innovations.

    n: rows of `innovations` written before.
    """
    antenna = antenna_velocity(c) if c.alignment.mode == NAVIGATING else (0.0, 0.0, 0.0)
    slow = fix.speed if not math.isfinite(fix.v[0]) and fix.speed < p.tuning.min_course_speed else 0.0
    timed = 1.0 if c.alignment.mode == NAVIGATING else 0.0  # in coarse alignment the velocity is that at the epoch
    rejected = 0
    if c.odometer.last_used_ns != NEVER_NS:
        a, e = c.scratch.accel_fit, c.scratch.accel_fit_error
        z_n = (
            velocity_of(p, fix, 0)
            - c.nav.gnss_velocity_bias[0]
            - c.nav.v_n[0]
            - antenna[0]
            + timed * c.scratch.lag_change[0]
        )
        z_e = (
            velocity_of(p, fix, 1)
            - c.nav.gnss_velocity_bias[1]
            - c.nav.v_n[1]
            - antenna[1]
            + timed * c.scratch.lag_change[1]
        )
        r = velocity_variance(p, c, slow, 1.0, max(fix.sigma_v[0], fix.sigma_v[1])) + timed * (e[0] ** 2 + e[1] ** 2)
        check_receiver(p, c, z_n, z_e, a[0], a[1], r)
    gate = REJECT if wheels_reject(p, c) else p.tuning.gnss_velocity_gate
    for i in range(3):
        received = velocity_of(p, fix, i)
        if not math.isfinite(received):
            continue
        accel, fit_error = timed * c.scratch.accel_fit[i], timed * c.scratch.accel_fit_error[i]
        z = received - c.nav.gnss_velocity_bias[i] - c.nav.v_n[i] - antenna[i] + timed * c.scratch.lag_change[i]
        ratio2 = p.tuning.vertical_ratio**2 if i == 2 else 1.0  # of the variances, as for the position
        r = velocity_variance(p, c, slow, ratio2, fix.sigma_v[i]) + fit_error**2
        length = velocity_jacobian(p, c, antenna, accel, i)
        z, s, nis = fix_update(p, c, length, z, r, gate, VELOCITY_AXIS + i if i < 2 else OTHER_AXIS)
        used = nis >= 0.0
        if used and slow == 0.0:
            learn_velocity_noise(p, c, nis)
        n = write_innovation(innovations, n, fix.t_ns, VELOCITY_N + i, z, s, used)
        rejected += 0 if used else 1
    count_velocity_rejects(c, 0 if gate == REJECT else rejected)
    correct_state(p, c)
    return n
