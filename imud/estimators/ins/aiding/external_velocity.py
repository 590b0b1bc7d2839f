"""Velocity of another system, in NED or in body axes: visual or lidar odometry, Doppler log (DVL), motion capture.

z = v_m - v - C_nb (w x l), in m/s, NED, or z = v_m - C_nb' v - w x l, in the body; l: the point of the velocity, from
the IMU, in the body. A relative motion is the velocity in the body at the middle of its time. A measurement has
value[0:3]: the components, m/s, NaN where they are not known, and their sigma[0:3], NaN where it is not reported.

Gate, repetition and time are as those of an external pose. The scale and the axes of such systems are wrong by some
percent, a lasting error in proportion to the speed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.rotation import Vector
from ...aiding_source import AidingSource, Column
from ...innovation_kinds import KINDS
from ...records import (
    BODY_VELOCITY_SOURCE,
    EXTERNAL_VD,
    EXTERNAL_VE,
    EXTERNAL_VN,
    EXTERNAL_VX,
    EXTERNAL_VY,
    EXTERNAL_VZ,
    VELOCITY_SOURCE,
)
from ...tuning import Tunable
from ..ekf import innovation_variance, set_jacobian, set_jacobian3
from ..fusion import NO_GATE, REJECT, correct_state, correlated_update, write_innovation
from ..lever_arm import arm_velocity_b, attitude_row, gyro_bias_row
from ..mechanization import body_to_ned, ned_to_body, rotation_matrix
from ..state import ATTITUDE, GYRO_BIAS, OTHER_AXIS, VELOCITY
from .external_aid import is_new, others_of_error, time_since_last

if TYPE_CHECKING:
    from ...types import Innovation, Measurement
    from ..types import Core, Parameters

_SPEED, _SIGMA = Column(1.0, -1000.0, 1000.0), Column(1.0, 1e-3, 100.0)
NED_SOURCE = AidingSource(
    "velocity",
    VELOCITY_SOURCE,
    "VEL",
    {"vn_mps": _SPEED, "ve_mps": _SPEED, "vd_mps": _SPEED},
    {"svn_mps": _SIGMA, "sve_mps": _SIGMA, "svd_mps": _SIGMA},
    {kind: KINDS[kind] for kind in (EXTERNAL_VN, EXTERNAL_VE, EXTERNAL_VD)},
    reversed_sign=-1.0,
    optional=("vd_mps",),
)
BODY_SOURCE = AidingSource(
    "body_velocity",
    BODY_VELOCITY_SOURCE,
    "BODYVEL",
    {"vx_mps": _SPEED, "vy_mps": _SPEED, "vz_mps": _SPEED},
    {"svx_mps": _SIGMA, "svy_mps": _SIGMA, "svz_mps": _SIGMA},
    {kind: KINDS[kind] for kind in (EXTERNAL_VX, EXTERNAL_VY, EXTERNAL_VZ)},
    reversed_sign=-1.0,
    optional=("vy_mps", "vz_mps"),
)
TUNABLES = (
    Tunable("external_velocity_sigma", 0.2, "m/s", "Sigma of a velocity that reports none.", "Choice."),
    Tunable(
        "external_velocity_scale",
        0.02,
        "",
        "Sigma of an external velocity as a share of the speed.",
        "Calibration and 1 deg.",
    ),
    Tunable(
        "external_velocity_correlation_s", 1.0, "s", "Correlation time of the error of an external velocity.", "Choice."
    ),
    Tunable(
        "external_velocity_scale_s",
        60.0,
        "s",
        "Correlation time of its error that is a share of the speed.",
        "It lasts; views change.",
    ),
    Tunable("external_velocity_time_sigma", 0.02, "s", "Unknown age of a velocity.", "Choice: half of 25 Hz."),
    Tunable(
        "external_velocity_min_share",
        0.5,
        "",
        "Share of velocities that pass the gate below which none is used.",
        "Wrong units agree now and then, near standstill.",
        high=1.0,
    ),
    Tunable("external_velocity_share_s", 10.0, "s", "Time of that share.", "As odometer_share_s."),
    Tunable("external_velocity_gate", 25.0, "NIS", "Gate of each component of an external velocity.", "Five sigma."),
)


@kernel
def predicted_velocity(p: Parameters, c: Core, m: Measurement) -> Vector:
    """Velocity of the point, and its change until an epoch after the newest sample, in the axes of the measurement."""
    v = body_to_ned(c, arm_velocity_b(c, p.velocity_lever_arm))
    ahead_s = 1e-9 * (m.t_ns - c.nav.t_ns)  # 0 but for an epoch after the newest sample
    a = c.imu.accel_n
    ned = (
        c.nav.v_n[0] + v[0] + a[0] * ahead_s,
        c.nav.v_n[1] + v[1] + a[1] * ahead_s,
        c.nav.v_n[2] + v[2] + a[2] * ahead_s,
    )
    return ned_to_body(c, ned) if m.kind == BODY_VELOCITY_SOURCE else ned


@kernel
def external_velocity_jacobian(p: Parameters, c: Core, m: Measurement, i: int) -> int:
    """Jacobian of component i; returns its length."""
    arm = p.velocity_lever_arm
    if m.kind != BODY_VELOCITY_SOURCE:
        k = set_jacobian(c, 0, VELOCITY + i, 1.0)
        k = set_jacobian3(c, k, ATTITUDE, attitude_row(body_to_ned(c, arm_velocity_b(c, arm)), i))
        return set_jacobian3(c, k, GYRO_BIAS, gyro_bias_row(c, arm, i))
    C_nb, v = rotation_matrix(c), c.nav.v_n
    u = (C_nb[i], C_nb[3 + i], C_nb[6 + i])  # axis i of the body in NED: v_i = u' v, changed by (u x v)' phi
    k = set_jacobian3(c, 0, VELOCITY, u)
    cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    k = set_jacobian3(c, k, ATTITUDE, cross)
    return set_jacobian3(c, k, GYRO_BIAS, attitude_row_of_arm(arm[0], arm[1], arm[2], i))


@kernel
def attitude_row_of_arm(x: float, y: float, z: float, i: int) -> Vector:
    """Component i of l x bias by the error of the gyro bias, in the body."""
    row = attitude_row((x, y, z), i)  # of bias x l
    return -row[0], -row[1], -row[2]


@kernel
def fuse_external_velocity(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Gate and fuse a velocity while navigating; returns the rows of innovations."""
    g, body = c.external_velocity, m.kind == BODY_VELOCITY_SOURCE
    first = EXTERNAL_VX if body else EXTERNAL_VN
    if not is_new(g, m):
        return write_innovation(innovations, 0, m.t_ns, first, math.nan, math.nan, False)
    v, a = predicted_velocity(p, c, m), c.imu.accel_n
    speed2, accel2 = v[0] ** 2 + v[1] ** 2 + v[2] ** 2, a[0] ** 2 + a[1] ** 2 + a[2] ** 2
    scale = p.tuning.external_velocity_scale**2 * speed2
    timing = (p.tuning.external_velocity_time_sigma**2 + c.scratch.age_variance) * accel2
    dt = time_since_last(g, m)
    others = others_of_error(dt, p.tuning.external_velocity_correlation_s)
    lasting = others_of_error(dt, p.tuning.external_velocity_scale_s) * scale
    used = True
    for i in range(3):
        z, s = m.value[i] - v[i], innovation_variance(c, external_velocity_jacobian(p, c, m, i))
        sigma = m.sigma[i] if m.sigma[i] > 0.0 else p.tuning.external_velocity_sigma
        used = used and not z * z > p.tuning.external_velocity_gate * (s + sigma * sigma + scale + timing)
    g.used_share += ((1.0 if used else 0.0) - g.used_share) * min(dt / p.tuning.external_velocity_share_s, 1.0)
    used = used and g.used_share >= p.tuning.external_velocity_min_share
    n = 0
    for i in range(3):
        if not math.isfinite(m.value[i]):
            continue
        sigma = m.sigma[i] if m.sigma[i] > 0.0 else p.tuning.external_velocity_sigma
        r = sigma * sigma + timing
        length, gate = external_velocity_jacobian(p, c, m, i), NO_GATE if used else REJECT
        z, s, _ = correlated_update(c, length, m.value[i] - v[i], r + scale, others * r + lasting, gate, OTHER_AXIS)
        n = write_innovation(innovations, n, m.t_ns, first + i, z, s, used)
    if used:
        correct_state(p, c)
        g.last_used_ns = c.nav.t_ns
    g.rejected = 0 if used else 1
    return n
