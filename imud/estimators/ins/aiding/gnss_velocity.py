"""The GNSS velocity, component by component: reported as three components, two, or speed and course.

z = v_fix - v - gnss_velocity_bias - C_nb (w x lever_arm) + dv, in m/s, NED

dv: change of the antenna's velocity since that of the fix was true (`velocity_epoch`). An error of a
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
from ..lever_arm import antenna_velocity, attitude_row, gyro_bias_row
from ..state import (
    ATTITUDE,
    DOWN_VELOCITY_AXIS,
    GNSS_LEVER_ARM,
    GNSS_VELOCITY_BIAS,
    GYRO_BIAS,
    NAVIGATING,
    NEVER_NS,
    TIME_OFFSET,
    VELOCITY,
    VELOCITY_AXIS,
    VELOCITY_TIME_OFFSET,
)
from .gnss_noise import learn_velocity_noise, second_order_error
from .heading_contradiction import count_velocity_rejects
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

    slow: m/s, speed taken as zero: its square, twice `low_speed_variance`, since the direction stays the same for some
    fixes (a hovering quad); ratio2: variance over that of a horizontal component; reported: sigma that the receiver
    reports of it, m/s, NaN or 0 if unknown: the larger one of it and the learned one counts.
    """
    noise, second = ratio2 * c.gnss.velocity_noise_var, second_order_error(p, c)
    if reported > 0.0:
        noise = max(noise, reported * reported)
    return float(noise + second**2 + slow * slow)


@kernel
def rotation_velocity(c: Core) -> Vector:
    """C_nb (w x lever_arm) when the velocity of the fix was true, m/s, NED."""
    m, arm = c.scratch.velocity_epoch.by_lever_arm, c.nav.gnss_lever_arm
    return (
        m[0, 0] * arm[0] + m[0, 1] * arm[1] + m[0, 2] * arm[2],
        m[1, 0] * arm[0] + m[1, 1] * arm[1] + m[1, 2] * arm[2],
        m[2, 0] * arm[0] + m[2, 1] * arm[1] + m[2, 2] * arm[2],
    )


@kernel
def velocity_jacobian(c: Core, i: int) -> int:
    """Jacobian of the velocity along axis i: velocity, both time offsets, lever arm, and by it attitude and gyro bias.

    Returns the Jacobian's length.
    """
    e = c.scratch.velocity_epoch
    accel = e.acceleration[i] if c.alignment.mode == NAVIGATING else 0.0
    length = set_jacobian(c, 0, VELOCITY + i, 1.0)
    length = set_jacobian(c, length, GNSS_VELOCITY_BIAS + i, 1.0)
    length = set_jacobian(c, length, TIME_OFFSET, -accel)
    length = set_jacobian(c, length, VELOCITY_TIME_OFFSET, -accel)
    if c.alignment.mode != NAVIGATING:
        return length
    length = set_jacobian3(c, length, ATTITUDE, attitude_row(rotation_velocity(c), i))
    row = e.by_lever_arm
    length = set_jacobian3(c, length, GNSS_LEVER_ARM, (row[i, 0], row[i, 1], row[i, 2]))
    return set_jacobian3(c, length, GYRO_BIAS, gyro_bias_row(c, c.nav.gnss_lever_arm, i))


@kernel
def velocity_innovation(p: Parameters, c: Core, fix: Fix, i: int) -> float:
    """z of component i, m/s, NED (see the file's head); NaN where it is not reported.

    In coarse alignment velocity and time of the core are the antenna's.
    """
    z = velocity_of(p, fix, i) - c.nav.gnss_velocity_bias[i] - c.nav.v_n[i]
    if c.alignment.mode != NAVIGATING:
        return float(z)
    return float(z - antenna_velocity(c)[i] + c.scratch.velocity_epoch.change[i])


@kernel
def second_order_of_time(c: Core, i: int) -> float:
    """Second-order term of the velocity's time offset in component i, m/s."""
    return float(c.scratch.velocity_epoch.second_order[i] if c.alignment.mode == NAVIGATING else 0.0)


@kernel
def fuse_gnss_velocity(p: Parameters, c: Core, fix: Fix, innovations: list[Innovation], n: int) -> int:
    """Gate and fuse the velocity; returns the rows of innovations.

    n: rows of `innovations` written before.
    """
    slow = fix.speed if not math.isfinite(fix.v[0]) and fix.speed < p.tuning.min_course_speed else 0.0
    rejected, reported = 0, False
    if c.odometer.last_used_ns != NEVER_NS:
        a = c.scratch.velocity_epoch.acceleration
        r = velocity_variance(p, c, slow, 1.0, max(fix.sigma_v[0], fix.sigma_v[1]))
        r += second_order_of_time(c, 0) ** 2 + second_order_of_time(c, 1) ** 2
        check_receiver(p, c, velocity_innovation(p, c, fix, 0), velocity_innovation(p, c, fix, 1), a[0], a[1], r)
    gate = REJECT if wheels_reject(p, c) else p.tuning.gnss_velocity_gate
    for i in range(3):
        z = velocity_innovation(p, c, fix, i)
        if not math.isfinite(z):
            continue
        reported = True
        ratio2 = p.tuning.vertical_ratio**2 if i == 2 else 1.0  # of the variances, as for the position
        r = velocity_variance(p, c, slow, ratio2, fix.sigma_v[i]) + second_order_of_time(c, i) ** 2
        length = velocity_jacobian(c, i)
        z, s, nis = fix_update(p, c, length, z, r, gate, VELOCITY_AXIS + i if i < 2 else DOWN_VELOCITY_AXIS)
        used = nis >= 0.0
        if used and slow == 0.0:
            learn_velocity_noise(p, c, nis)
        n = write_innovation(innovations, n, fix.t_ns, VELOCITY_N + i, z, s, used)
        rejected += 0 if used else 1
    if reported:
        count_velocity_rejects(c, 0 if gate == REJECT else rejected)
    correct_state(p, c)
    return n
