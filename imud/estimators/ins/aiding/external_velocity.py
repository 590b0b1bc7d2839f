"""Velocity of another system, in NED or in body axes: visual or lidar odometry, Doppler log (DVL), motion capture.

z = v_m - v - C_nb (w x l), in m/s, NED, or z = v_m - C_nb' v - w x l, in the body; l: the point of the velocity, from
the IMU, in the body. A relative motion is the velocity in the body at the middle of its time. A measurement has
value[0:3]: the components, m/s, NaN where they are not known, and their sigma[0:3], NaN where it is not reported.

Gate, repetition and time are as those of an external pose. The scale of such systems is wrong by some percent, a
lasting error in proportion to the speed; of velocities in NED so are the axes. How a sensor that measures in its own
axes is turned is estimated (`boresights`): v_m = C_bs' (C_nb' v + w x l). If most of its velocities are rejected, what
was known of that is forgotten, as it may have been mounted otherwise than the settings say, or turned on the way.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.rotation import Vector, cross, quat_rotate, quat_rotate_back
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
from ..boresights import (
    begin_velocity_boresight,
    boresight_part,
    forget_velocity_boresight,
    is_turned_too_far,
    sensor_axes,
    set_velocity_row,
)
from ..ekf import innovation_variance, set_jacobian, set_jacobian3
from ..fusion import NO_GATE, REJECT, correct_state, correlated_update, write_innovation
from ..lever_arm import arm_velocity_b, attitude_row, gyro_bias_row
from ..mechanization import body_to_ned, ned_to_body
from ..state import ATTITUDE, BODY_VELOCITY_AXIS, GYRO_BIAS, OTHER_AXIS, VELOCITY
from .external_aid import is_new, others_of_error, time_since_last

if TYPE_CHECKING:
    from ...types import Innovation, Measurement
    from ..types import Core, ExternalAid, Parameters

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
        "Correlation time of the error of an external velocity that is a share of the speed.",
        "It lasts; views change.",
    ),
    Tunable("external_velocity_time_sigma", 0.02, "s", "Unknown age of a velocity.", "Choice: half of 25 Hz."),
    Tunable(
        "external_velocity_min_share",
        0.5,
        "",
        "Share of external velocities that agree with the estimate below which none is used.",
        "Wrong units agree now and then, near standstill.",
        high=1.0,
    ),
    Tunable(
        "external_velocity_agreement",
        9.0,
        "NIS",
        "NIS of each component up to which an external velocity agrees.",
        "Three sigma: wrong axes may pass the gate again and again.",
    ),
    Tunable(
        "min_velocity_ratio",
        0.5,
        "",
        "Least regression of a component on the estimate, by limit_sigmas, with which an external velocity agrees.",
        "As min_turn_ratio: a reversed axis has -1.",
        high=1.0,
    ),
    Tunable(
        "external_velocity_memory_s",
        30.0,
        "s",
        "Time over which a component of an external velocity is regressed on the estimate.",
        "Choice: some turns.",
    ),
    Tunable(
        "external_velocity_share_s",
        10.0,
        "s",
        "Time over which the share of external velocities that agree is taken.",
        "As odometer_share_s.",
    ),
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
    return quat_rotate_back(sensor_axes(c), ned_to_body(c, ned)) if m.kind == BODY_VELOCITY_SOURCE else ned


@kernel
def external_velocity_jacobian(p: Parameters, c: Core, m: Measurement, i: int) -> int:
    """Jacobian of component i; returns its length."""
    arm = p.velocity_lever_arm
    if m.kind != BODY_VELOCITY_SOURCE:
        k = set_jacobian(c, 0, VELOCITY + i, 1.0)
        k = set_jacobian3(c, k, ATTITUDE, attitude_row(body_to_ned(c, arm_velocity_b(c, arm)), i))
        return set_jacobian3(c, k, GYRO_BIAS, gyro_bias_row(c, arm, i))
    axis = quat_rotate(sensor_axes(c), (1.0 if i == 0 else 0.0, 1.0 if i == 1 else 0.0, 1.0 if i == 2 else 0.0))
    u = body_to_ned(c, axis)  # the sensor's axis in NED: v_i = u' v, changed by (u x v)' phi
    k = set_jacobian3(c, 0, VELOCITY, u)
    k = set_jacobian3(c, k, ATTITUDE, cross(u, (c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2])))
    return set_jacobian3(c, k, GYRO_BIAS, cross(axis, (arm[0], arm[1], arm[2])))


@kernel
def check_share(p: Parameters, c: Core, g: ExternalAid, agrees: bool, dt: float) -> bool:
    """Whether enough of the velocities have agreed lately, this one included. dt: since the last, s.

    Beside a receiver no single one decides: those of a sensor that comes, or is back, have to agree for some seconds.
    """
    beside = 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) < p.tuning.external_velocity_share_s
    most = 0.5 * p.tuning.external_velocity_min_share if beside else 1.0
    g.used_share += ((1.0 if agrees else 0.0) - g.used_share) * min(dt / p.tuning.external_velocity_share_s, most)
    return bool(g.used_share >= p.tuning.external_velocity_min_share)


@kernel
def is_reversed(p: Parameters, g: ExternalAid, i: int, measured: float, predicted: float, s: float, dt: float) -> bool:
    """Whether component i changes otherwise than the estimate, as that of a reversed axis: by weighted regression.

    s: variance of the measured less the predicted component; dt: since the last, s.
    """
    keep = max(1.0 - dt / p.tuning.external_velocity_memory_s, 0.0)
    together = 1.0 + others_of_error(dt, p.tuning.external_velocity_correlation_s)
    g.shown[i] = keep * g.shown[i] + measured * predicted / s
    g.expected[i] = keep * g.expected[i] + predicted * predicted / s
    g.shown_noise[i] = keep * g.shown_noise[i] + together * predicted * predicted / s
    least = p.tuning.min_velocity_ratio * g.expected[i] - p.tuning.limit_sigmas * math.sqrt(g.shown_noise[i])
    return bool(g.shown[i] < least)


@kernel
def error_of_component(p: Parameters, c: Core, m: Measurement, v: Vector, i: int) -> tuple[float, float]:
    """Variances of component i, (m/s)^2: of its scale; of what is not linear in the angles of the sensor.

    v: the predicted velocity. The scale of a sensor with axes of its own changes no more than the size of each; of
    others it stands for an error of their axes, too. Sets the row of the boresights.
    """
    scale2 = p.tuning.external_velocity_scale**2
    if m.kind == BODY_VELOCITY_SOURCE:
        return scale2 * v[i] * v[i], set_velocity_row(c, v, i)
    return scale2 * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2), 0.0


@kernel
def fuse_external_velocity(p: Parameters, c: Core, m: Measurement, innovations: list[Innovation]) -> int:
    """Gate and fuse a velocity while navigating; returns the rows of innovations."""
    if m.kind == VELOCITY_SOURCE:
        return fuse_velocity(p, c, c.external_velocity, m, innovations)
    begin_velocity_boresight(p, c)
    n = fuse_velocity(p, c, c.body_velocity, m, innovations)
    if c.body_velocity.used_share < p.tuning.external_velocity_min_share:
        forget_velocity_boresight(c)
    return n


@kernel
def fuse_velocity(p: Parameters, c: Core, g: ExternalAid, m: Measurement, innovations: list[Innovation]) -> int:
    """The same with the record of its kind."""
    body = m.kind == BODY_VELOCITY_SOURCE
    first, measured = (EXTERNAL_VX, BODY_VELOCITY_AXIS) if body else (EXTERNAL_VN, OTHER_AXIS)
    if not is_new(g, m):
        return write_innovation(innovations, 0, m.t_ns, first, math.nan, math.nan, False)
    v, a = predicted_velocity(p, c, m), c.imu.accel_n
    timing = (p.tuning.external_velocity_time_sigma**2 + c.scratch.age_variance) * (a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
    dt = time_since_last(g, m)
    others = others_of_error(dt, p.tuning.external_velocity_correlation_s)
    others_of_scale = others_of_error(dt, p.tuning.external_velocity_scale_s)
    used, agrees = True, not (body and is_turned_too_far(p, c))
    for i in range(3):
        length = external_velocity_jacobian(p, c, m, i)
        z, s = m.value[i] - v[i], innovation_variance(c, length)
        scale, turned = error_of_component(p, c, m, v, i)
        if body:
            s += boresight_part(c, length)
        sigma = m.sigma[i] if m.sigma[i] > 0.0 else p.tuning.external_velocity_sigma
        s += sigma * sigma + scale + turned + timing
        used = used and not z * z > p.tuning.external_velocity_gate * s
        if math.isfinite(z):
            wrong = is_reversed(p, g, i, m.value[i], v[i], s, dt)
            agrees = agrees and not wrong and not z * z > p.tuning.external_velocity_agreement * s
    used = check_share(p, c, g, agrees, dt) and used
    n = 0
    for i in range(3):
        if not math.isfinite(m.value[i]):
            continue
        v = predicted_velocity(p, c, m)  # the sensor's axes have changed with the component before
        length = external_velocity_jacobian(p, c, m, i)
        scale, turned = error_of_component(p, c, m, v, i)
        sigma = m.sigma[i] if m.sigma[i] > 0.0 else p.tuning.external_velocity_sigma
        r = sigma * sigma + timing + turned
        shared, gate = others * r + others_of_scale * scale, NO_GATE if used else REJECT
        z, s, _ = correlated_update(c, length, m.value[i] - v[i], r + scale, shared, gate, measured)
        n = write_innovation(innovations, n, m.t_ns, first + i, z, s, used)
    if used:
        correct_state(p, c)
        g.last_used_ns = c.nav.t_ns
    g.rejected = 0 if used else 1
    return n
