"""Initialisation: the first sample, roll and pitch from gravity, and the restart after a long gap.

One sample alone may be damaged, and nothing shows it: what the first specific force says of roll and pitch is not valid
yet. They are taken from the second, and the change since the first is a part of their sigma. A specific force is the
vertical only if the body does not accelerate. Unless the first moment is one of low motion it is but a guess: for
`levelling_time_s` (coarse levelling) the mean force, in axes carried by the gyro, is rotated to the vertical, whatever
rotation that takes; from then on the filter corrects what is left. The less that force changed, the better its mean is
known to be the vertical.

Source of the mean force in such axes: Laidig and Seel, VQF: Highly accurate IMU orientation estimation (2023).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.rotation import (
    UNKNOWN_ANGLE,
    Vector,
    dcm_of_quat,
    euler_of_quat,
    quat_exp,
    quat_normalised,
    quat_of_euler,
    quat_of_gravity,
    quat_product,
    quat_rotate,
)
from .attitude_step import restart_attitude_step
from .divergence import restart_velocity_gain
from .ekf import update_sigmas
from .error_model import add_variance, age_tilt, reset_variance, variance
from .history import record_coarse, record_restart
from .integrals import reset_integrals
from .last_sample import store_first_sample
from .mechanization import set_attitude
from .motion import begins_at_rest, reset_motion, start_motion
from .stamps import forget_stamps
from .state import ATTITUDE, GYRO_BIAS
from .stationarity import restart_stationarity

if TYPE_CHECKING:
    from .types import Parameters, State


@kernel
def restart_imu(s: State, w: Vector, f: Vector) -> None:
    """Take the first sample, or the first one after a long gap: running means start from it."""
    forget_stamps(s)
    store_first_sample(s, w, f)
    restart_stationarity(s, w, f)


@kernel
def require_initialisation(s: State) -> None:
    """Roll and pitch are initialised anew from the next sample; yaw may be wrong by as much as that turns them.

    A body that accelerates turns them by more than they were wrong, and levelling turns them back: two sigmas at most.
    """
    q, f = s.nav.q_nb, s.imu.f
    s.levelling.initialised = 0
    n = quat_rotate((q[0], q[1], q[2], q[3]), (f[0], f[1], f[2]))
    turned = elementary.atan2(elementary.hypot(n[0], n[1]), -n[2])
    add_variance(s, ATTITUDE + 2, min(turned, 2.0 * s.cov.sigma_tilt) ** 2)


@kernel
def restart_after_gap(p: Parameters, s: State, w: Vector, f: Vector, dt: float) -> None:
    """After a long gap: tilt and heading unknown, biases as they were, a little older."""
    restart_imu(s, w, f)
    reset_integrals(s)
    s.levelling.initialised = s.levelling.true_heading = 0
    for i in range(3):
        add_variance(s, GYRO_BIAS + i, p.gyro_bias_psd * dt)
        reset_variance(s, ATTITUDE + i, UNKNOWN_ANGLE**2)


@kernel
def initialise_attitude(p: Parameters, s: State, f: Vector, last_f: Vector, is_first: bool) -> None:
    """Take roll and pitch from specific force f, or from the user, yaw as it is; forget velocity and position.

    last_f: the specific force one sample before. What changed since may be damage of either sample. is_first: there is
    none before; the next one initialises again.
    """
    c, known, q = p.tuning, s.levelling, s.nav.q_nb
    ratio = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) / s.nav.gravity
    if not c.min_gravity_ratio < ratio < c.max_gravity_ratio:
        return
    _, _, yaw = euler_of_quat((q[0], q[1], q[2], q[3]))
    roll, pitch, _ = euler_of_quat(quat_of_gravity(f[0], f[1], f[2]))
    change2 = (f[0] - last_f[0]) ** 2 + (f[1] - last_f[1]) ** 2 + (f[2] - last_f[2]) ** 2
    tilt_var = c.initial_tilt_rad**2 + (ratio - 1.0) ** 2 + change2 / s.nav.gravity**2
    if is_first:
        tilt_var = UNKNOWN_ANGLE**2
    known.coarse, known.force2, known.initialised = 1, 0.0, 0 if is_first else 1
    heading_var = variance(s, ATTITUDE + 2)
    given = known.initial_rpy
    if math.isfinite(given[0]) and math.isfinite(given[1]):
        roll, pitch, tilt_var = given[0], given[1], c.initial_angle_sigma_rad**2
        known.coarse, known.initialised = 0, 1
    if math.isfinite(given[2]):
        yaw, heading_var = given[2], c.initial_angle_sigma_rad**2
    set_attitude(s, quat_of_euler(roll, pitch, yaw))
    for i in range(3):
        reset_variance(s, ATTITUDE + i, tilt_var if i < 2 else heading_var)
        given[i] = math.nan
        known.delta_v[i] = 0.0
        reset_motion(p, s, i)
    restart_velocity_gain(s)
    restart_attitude_step(p, s)
    known.duration = 0.0
    reset_integrals(s)
    record_restart(s)
    update_sigmas(s)


@kernel
def is_coarse(p: Parameters, s: State) -> bool:
    """Is coarse levelling needed, or has there been low motion since the beginning?"""
    if s.levelling.duration == 0.0 and begins_at_rest(p, s):
        s.levelling.coarse = 0
    return bool(s.levelling.coarse == 1)


@kernel
def coarse_level(p: Parameters, s: State) -> None:
    """Rotate the mean force since the beginning to the vertical, and start velocity and position again from there."""
    c, known, total, q = p.tuning, s.levelling, s.integrals, s.nav.q_nb
    delta_v2 = 0.0
    for i in range(3):
        known.delta_v[i] += total.delta_v[i]
        delta_v2 += total.delta_v[i] ** 2
    known.duration += total.time
    known.force2 += delta_v2 / total.time
    align_with_vertical(s)
    record_coarse(s)
    t = known.duration
    change_var = max(known.force2 / t - (known.delta_v[2] / t) ** 2, 0.0)  # (m/s^2)^2
    rate2 = total.w2 / total.time + (c.initial_tilt_rad * s.nav.gravity) ** 2 / c.initial_velocity_var  # (rad/s)^2
    mean_var = c.initial_velocity_var / (t * t + 1.0 / rate2)
    mean_var = mean_var + change_var * c.acceleration_time_s / (t + c.acceleration_time_s)
    C = dcm_of_quat((q[0], q[1], q[2], q[3]))
    for i in range(3):
        start_motion(p, s, i)
        if i < 2:
            reset_variance(s, ATTITUDE + i, min(mean_var / s.nav.gravity**2, UNKNOWN_ANGLE**2))
            age_tilt(s, i, (C[3 * i], C[3 * i + 1], C[3 * i + 2]), 0.5 * t)
    if t > c.levelling_time_s:
        known.coarse = 0


@kernel
def align_with_vertical(s: State) -> None:
    """Rotate the attitude about a level axis so that the integral of the force points upward."""
    v, q = s.levelling.delta_v, s.nav.q_nb
    x, y, z = v[0], v[1], v[2]
    level = elementary.hypot(x, y)
    angle = elementary.atan2(level, -z)
    k = angle / level if level > 0.0 else 0.0
    turned = quat_product(quat_exp(-k * y, k * x, 0.0), (q[0], q[1], q[2], q[3]))
    set_attitude(s, quat_normalised(turned))
    v[0], v[1], v[2] = 0.0, 0.0, -elementary.hypot(level, z)
