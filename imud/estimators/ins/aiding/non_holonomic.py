"""The non-holonomic constraint (NHC): the lateral and vertical velocities of a land vehicle are nearly zero.

Lateral: z = lever_arm turn_rate - lateral . v_b. Vertical: z = -vertical . v_b, with vertical = forward x lateral and
`turn_rate` the rate about it. The forward axis, a unit vector of the body, is the principal direction of the velocity
in the body (`forward_axis_search`). Two error states refine it; a third is the lever arm, by which the sensor is ahead
of the point about which the vehicle turns. With vehicle = "auto" the constraint is enabled when the velocity has turned
over ground but not in the body, and disabled when the motion contradicts it; its noise scale is learned (`nhc_noise`).

Source: Dissanayake et al., The aiding of a low-cost strapdown inertial measurement unit using vehicle model
constraints (2001).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.rotation import cross, dot, quat_rotate, quat_rotate_back
from ...records import NHC_LATERAL, NHC_VERTICAL
from ...tuning import Tunable
from ..ekf import add_variance, decorrelate, set_jacobian, set_jacobian3, variance
from ..fusion import correct_state, pseudo_measurement
from ..glr_tests.current import close_current, judge_current, open_current, remove_current
from ..glr_tests.velocity_drift import drift_is_likely
from ..mechanization import quaternion
from ..state import (
    ACCEL_BIAS,
    ATTITUDE,
    AUTO,
    CONSTRAINT_AXIS,
    GYRO_BIAS,
    GYRO_SCALE,
    LAND,
    MOUNT_PITCH,
    MOUNT_YAW,
    NHC_LEVER_ARM,
    STATES,
    VELOCITY,
)
from ..vehicle_axes import forward_axis, lateral_axis, set_vehicle_axes, vertical_axis
from .forward_axis_search import clear_scatter
from .land_evidence import add_heave, current_variance, refutes_land_vehicle, set_log_likelihood, slip_variance
from .nhc_noise import add_innovation, clear_innovation_sums, learn_noise_scale, reset_noise_scale

if TYPE_CHECKING:
    from ....math.rotation import Quaternion, Vector
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "nhc_interval_s",
        0.1,
        "s",
        "Time between two updates of the non-holonomic constraint.",
        "A prototype on recorded drives.",
    ),
    Tunable("nhc_min_speed", 0.3, "m/s", "Least speed at which the non-holonomic constraint is fused.", "Choice."),
    Tunable("nhc_sigma", 0.1, "m/s", "Sigma of the lateral and of the vertical velocity.", "Recorded drives."),
    Tunable(
        "nhc_lever_arm_sigma",
        1.5,
        "m",
        "Sigma of the distance of the sensor ahead of the axle without sideslip.",
        "Cars.",
    ),
    Tunable("turn_sideslip", 0.4, "m", "Lateral speed in turns, per yaw rate.", "Recorded drives."),
    Tunable(
        "tyre_sideslip",
        0.005,
        "s^2/m",
        "Lateral speed in turns, per yaw rate and squared speed.",
        "Cornering stiffness of cars.",
    ),
    Tunable("suspension_pitch", math.radians(0.7), "rad", "Pitch of the body against the road when braking.", "Cars."),
    Tunable("suspension_time_s", 1.5, "s", "Correlation time of the body's pitch against the road.", "Cars."),
    Tunable("nhc_gate", 12.0, "NIS", "Gate of the lateral and of the vertical velocity.", "3.5 sigma."),
    Tunable(
        "nhc_max_mean_nis",
        4.0,
        "",
        "Mean NIS beyond which the non-holonomic constraint is disabled.",
        "Recorded drives.",
    ),
    Tunable(
        "nhc_retry_s",
        60.0,
        "s",
        "Half of the time before a disabled constraint is enabled again; each contradiction doubles it.",
        "Choice.",
    ),
    Tunable(
        "nhc_mean_nis_gain",
        0.02,
        "",
        "Gain of the mean NIS of the non-holonomic constraint.",
        "Five seconds.",
        high=1.0,
    ),
    Tunable(
        "unknown_mount_sigma",
        math.radians(20.0),
        "rad",
        "Sigma of the forward axis, along which an odometer measures, about the body's x axis before it is found.",
        "Choice: a sensor that was mounted by eye, or on a slope, without a word in the settings.",
    ),
    Tunable("mount_sigma", math.radians(4.0), "rad", "Sigma of the forward axis when it is found.", "Recorded drives."),
)


@kernel
def is_due(p: Parameters, c: Core, dt: float) -> bool:
    """Whether the constraint, or the search for heave, is due, after another `dt` s."""
    h = c.nhc
    h.since_update += dt
    return bool((h.enabled or p.vehicle == AUTO) and h.since_update >= p.tuning.nhc_interval_s)


@kernel
def observe_heave(p: Parameters, c: Core) -> None:
    """While the constraint is disabled: the vertical velocity in the body, across the principal axis."""
    h = c.nhc
    dt, h.since_update = h.since_update, 0.0
    if h.scatter_weight <= 0.0 or variance(c, VELOCITY + 2) > p.tuning.max_heave_velocity_sigma**2:
        return
    axis = (h.principal_axis[0], h.principal_axis[1], h.principal_axis[2])
    q = quaternion(c)
    down = quat_rotate_back(q, (0.0, 0.0, 1.0))
    vb = quat_rotate_back(q, (c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2]))
    length2, level = dot(axis, axis), dot(down, axis)
    along = dot(axis, vb) / math.sqrt(length2)
    vertical = (dot(down, vb) - level * dot(axis, vb) / length2) / math.sqrt(max(1.0 - level * level / length2, 0.1))
    add_heave(p, c, vertical, abs(along), dt)


@kernel
def enable_nhc(p: Parameters, c: Core) -> None:
    """Enable the constraint along the principal axis; the lateral axis is across it and across the mean vertical."""
    h = c.nhc
    n = math.sqrt(h.down_sum[0] ** 2 + h.down_sum[1] ** 2 + h.down_sum[2] ** 2)
    down = (h.down_sum[0] / n, h.down_sum[1] / n, h.down_sum[2] / n)
    forward = (h.principal_axis[0], h.principal_axis[1], h.principal_axis[2])
    lx, ly, lz = cross(down, forward)
    s = math.sqrt(lx * lx + ly * ly + lz * lz)
    if s < 0.5:  # vertical motion: no land vehicle
        return
    set_vehicle_axes(c, forward, (lx / s, ly / s, lz / s))
    decorrelate(c, MOUNT_PITCH, p.tuning.mount_sigma**2)
    decorrelate(c, MOUNT_YAW, p.tuning.mount_sigma**2 + variance(c, ATTITUDE + 2))
    decorrelate(c, NHC_LEVER_ARM, p.tuning.nhc_lever_arm_sigma**2)
    for i in range(STATES):
        h.start_variance[i] = variance(c, i)
    h.enabled = 1
    h.direction = 0.0
    h.mean_nis = 1.0
    clear_innovation_sums(c)
    open_current(c)


@kernel
def reset_nhc(p: Parameters, c: Core) -> None:
    """Disable the constraint and clear the scatter matrices; its axis is as uncertain as at the start."""
    c.nhc.enabled = 0
    decorrelate(c, MOUNT_PITCH, p.tuning.unknown_mount_sigma**2)
    decorrelate(c, MOUNT_YAW, p.tuning.unknown_mount_sigma**2)
    close_current(c)
    clear_scatter(c)


@kernel
def disable_nhc(p: Parameters, c: Core, along: float) -> None:
    """Disable the constraint after a contradiction, at a forward speed of `along` m/s.

    The assumed zero velocity was wrong and has biased the heading, so the heading variance is increased; the variances
    of attitude, biases and gyro_scale are put back to those at which the constraint was enabled.
    """
    h = c.nhc
    remove_current(c, current_variance(p, along * along))
    correct_state(p, c)
    add_variance(c, ATTITUDE + 2, h.noise_scale[0] * (p.tuning.nhc_sigma / along) ** 2)
    for first in (ATTITUDE, GYRO_BIAS, ACCEL_BIAS, GYRO_SCALE, GYRO_SCALE + 3, GYRO_SCALE + 6):
        for i in range(first, first + 3):
            add_variance(c, i, max(h.start_variance[i] - variance(c, i), 0.0))
    reset_nhc(p, c)
    h.disable_count += 1
    h.disabled_ns = c.nav.t_ns
    reset_noise_scale(p, c)


@kernel
def nhc_jacobian(c: Core, q: Quaternion, e: Vector, along: float, mount: int) -> int:
    """Jacobian of the velocity along body vector e: velocity, attitude and mounting; returns its length.

    e: lateral or vertical axis of the vehicle; mount: the error state that turns e (MOUNT_YAW or MOUNT_PITCH); along:
    forward speed, m/s. The change of a vector with the attitude is phi x C e, so that of the velocity C e x v.
    """
    en = quat_rotate(q, e)
    length = set_jacobian3(c, 0, VELOCITY, en)
    length = set_jacobian3(c, length, ATTITUDE, cross(en, (c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2])))
    return set_jacobian(c, length, mount, -along if mount == MOUNT_YAW else along)


@kernel
def leans(p: Parameters, c: Core, q: Quaternion) -> bool:
    """Whether the vehicle leans sideways further than one on wheels, as an aircraft in a turn."""
    lean = dot(lateral_axis(c), quat_rotate_back(q, (0.0, 0.0, 1.0)))
    sigma = math.sqrt(max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1)))
    return bool(abs(lean) > p.tuning.max_lean + p.tuning.limit_sigmas * sigma)


@kernel
def sideslip_sigma(p: Parameters, c: Core, speed: float) -> float:
    """Sigma of the lateral velocity of a land vehicle, m/s: tyres slip in proportion to their load."""
    w = c.imu.rate_b
    rate = math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    return float(p.tuning.nhc_sigma + (p.tuning.turn_sideslip + p.tuning.tyre_sideslip * speed * speed) * rate)


@kernel
def fuse_nhc(p: Parameters, c: Core) -> None:
    """Fuse lateral and vertical velocity above a minimum speed; disable the constraint if they contradict it.

    The lateral velocity of the sensor is the lever arm times the rate of turn; tyres slip in proportion to their load.
    Where a receiver that drifts is likely, it has moved the velocity that contradicts: the constraint stays.
    """
    h = c.nhc
    q = quaternion(c)
    vb = quat_rotate_back(q, (c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2]))
    forward, lateral, vertical = forward_axis(c), lateral_axis(c), vertical_axis(c)
    along = dot(forward, vb)
    dt, h.since_update = h.since_update, 0.0
    if p.vehicle == AUTO:
        add_heave(p, c, dot(vertical, vb), abs(along), dt)
    if abs(along) < p.tuning.nhc_min_speed:
        return
    if abs(along) > p.tuning.least_course_speed:
        h.direction = 1.0 if along > 0.0 else -1.0
    turn_rate = dot(vertical, (c.imu.rate_b[0], c.imu.rate_b[1], c.imu.rate_b[2]))
    r = sideslip_sigma(p, c, along) ** 2
    suspension2 = (p.tuning.suspension_pitch * along) ** 2 * 2.0 * p.tuning.suspension_time_s / p.tuning.nhc_interval_s
    length = set_jacobian(c, nhc_jacobian(c, q, lateral, along, MOUNT_YAW), NHC_LEVER_ARM, -turn_rate)
    z = c.nav.nhc_lever_arm * turn_rate - dot(lateral, vb)
    value, s, lateral_nis = pseudo_measurement(
        c, NHC_LATERAL, length, z, h.noise_scale[0] * r, p.tuning.nhc_gate, CONSTRAINT_AXIS
    )
    add_innovation(c, 0, value, s)
    length = nhc_jacobian(c, q, vertical, along, MOUNT_PITCH)
    z = -dot(vertical, vb)
    value, s, vertical_nis = pseudo_measurement(
        c, NHC_VERTICAL, length, z, h.noise_scale[1] * r + suspension2, p.tuning.nhc_gate, CONSTRAINT_AXIS
    )
    add_innovation(c, 1, value, s)
    correct_state(p, c)
    if p.vehicle == AUTO:
        set_log_likelihood(c, judge_current(c, slip_variance(p, along * along), current_variance(p, along * along)))
    if p.vehicle != LAND and (leans(p, c, q) or refutes_land_vehicle(p, c)):
        disable_nhc(p, c, along)
        return
    h.mean_nis += p.tuning.nhc_mean_nis_gain * (
        min(max(abs(lateral_nis), abs(vertical_nis)), 4.0 * p.tuning.nhc_gate) - h.mean_nis
    )
    refuted = learn_noise_scale(p, c) or (h.mean_nis > p.tuning.nhc_max_mean_nis and p.vehicle != LAND)
    if refuted and drift_is_likely(c):
        h.mean_nis = 1.0
    elif refuted:
        disable_nhc(p, c, along)
