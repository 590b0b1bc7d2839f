"""Dead reckoning from a rest at the start, and its sensitivity to unit errors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ....math.rotation import (
    dcm_of_quat,
    euler_of_quat,
    quat_exp,
    quat_normalised,
    quat_of_euler,
    quat_of_gravity,
    quat_product,
    quat_rotate,
)
from .state import DEVICE, EARTH, RATE_ERROR, SCALE_ERROR, SOURCES

if TYPE_CHECKING:
    from ...types import Sample
    from ..types import Ins9State


@kernel
def average_rest(s: Ins9State, sample: Sample) -> None:
    """Mean rate and force so far: gyro bias, gravity, tilt."""
    s.rest_s = (sample.t_ns - s.first_sample_ns) * 1e-9
    for i in range(3):
        s.w_sum[i] += sample.w[i]
        s.f_sum[i] += sample.f[i]
        s.bg[i] = s.w_sum[i] / s.samples
        s.w[i], s.f[i] = sample.w[i], sample.f[i]
    fx, fy, fz = s.f_sum[0] / s.samples, s.f_sum[1] / s.samples, s.f_sum[2] / s.samples
    s.gravity = math.sqrt(fx * fx + fy * fy + fz * fz)
    roll, pitch, _ = euler_of_quat(quat_of_gravity(fx, fy, fz))
    q = quat_of_euler(roll, pitch, s.initial_yaw if math.isfinite(s.initial_yaw) else 0.0)
    for i in range(4):
        s.q[i] = q[i]
    C = dcm_of_quat(q)
    for i in range(9):
        s.C_rest[i] = C[i]


@kernel
def has_device_tilt(sample: Sample) -> bool:
    """Did the device itself compute where down is?"""
    down = sample.down
    return bool(down[0] * down[0] + down[1] * down[1] + down[2] * down[2] > 0.5)


@kernel
def rotate_attitude(s: Ins9State, sample: Sample, T: float) -> None:
    """The attitude after T s: the gyros' turn, then the device's own tilt if it computes one."""
    half = 0.5 * T
    q = (s.q[0], s.q[1], s.q[2], s.q[3])
    q = quat_product(
        q,
        quat_exp(
            half * (s.w[0] + sample.w[0]) - T * s.bg[0],
            half * (s.w[1] + sample.w[1]) - T * s.bg[1],
            half * (s.w[2] + sample.w[2]) - T * s.bg[2],
        ),
    )
    down = sample.down
    if has_device_tilt(sample):
        _, _, yaw = euler_of_quat(q)
        roll, pitch, _ = euler_of_quat(quat_of_gravity(-down[0], -down[1], -down[2]))
        q = quat_of_euler(roll, pitch, yaw)
    s.q[0], s.q[1], s.q[2], s.q[3] = quat_normalised(q)


@kernel
def propagate_errors(s: Ins9State, sample: Sample, T: float) -> None:
    """Propagate the sensitivity of dead reckoning to unit errors over T s.

    Levelling at rest hid the accelerometer's bias b in the tilt; a turn brings (C - C_rest) b out of it. A rate error
    tilts by its integral, a scale error by its part of the turn, the earth's rate, taken for bias at rest, by as much
    as the turn has moved it in the body, a device's tilt by its own error. A tilt accelerates by its part of gravity.
    """
    C = dcm_of_quat((s.q[0], s.q[1], s.q[2], s.q[3]))
    trace = 0.0
    for i in range(9):
        trace += C[i] * s.C_rest[i]
        s.distance_by_bias[i] += T * s.velocity_by_bias[i]
        s.velocity_by_bias[i] += T * (C[i] - s.C_rest[i])
    s.rotation_from_rest = elementary.acos(min(max(0.5 * (trace - 1.0), -1.0), 1.0))
    for k in range(SOURCES):
        s.distance_by[k] += T * s.velocity_by[k]
        s.velocity_by[k] += T * s.gravity * s.tilt_by[k]
    if has_device_tilt(sample):
        s.tilt_by[DEVICE] = 1.0
    else:
        s.tilt_by[RATE_ERROR] += T
        s.tilt_by[SCALE_ERROR] = s.rotation_from_rest
        s.tilt_by[EARTH] += T * 2.0 * elementary.sin(0.5 * s.rotation_from_rest)


@kernel
def dead_reckon(s: Ins9State, sample: Sample, T: float) -> None:
    """His integration, vel = vel' + accl dt, dist = dist' + vel dt, by the trapezoid rule."""
    before = quat_rotate((s.q[0], s.q[1], s.q[2], s.q[3]), (s.f[0], s.f[1], s.f[2]))
    rotate_attitude(s, sample, T)
    after = quat_rotate((s.q[0], s.q[1], s.q[2], s.q[3]), (sample.f[0], sample.f[1], sample.f[2]))
    for i in range(3):
        a = 0.5 * (before[i] + after[i]) + (s.gravity if i == 2 else 0.0)
        s.reckoned_p[i] += T * s.reckoned_v[i] + 0.5 * T * T * a
        s.reckoned_v[i] += T * a
        s.w[i], s.f[i] = sample.w[i], sample.f[i]
