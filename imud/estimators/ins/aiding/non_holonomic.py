"""A land vehicle moves along its forward axis: velocity across it and off its floor is nearly zero.

The axis is a unit vector in the body, found as the main direction of motion, forwards and in reverse (the sensor may
be mounted in any way), then refined by two states; a third is how far the sensor is ahead of the point about which the
vehicle turns. "auto" switches the constraint on when a drive that has turned shows one steady axis, and off when the
motion contradicts it; how well the vehicle keeps to the axis is learned (`looseness`).

Source: Dissanayake et al., The aiding of a low-cost strapdown inertial measurement unit using vehicle model
constraints (2001).
"""

import math
from typing import Any

from ....compile.jit import kernel
from ....math.rotation import quat_exp, quat_rotate, quat_rotate_back
from ...records import HOP, SLIP
from ..ekf import add_variance, decorrelate, set_forward_axis, set_jacobian, variance
from ..fusion import correct_state, pseudo_measurement
from ..mechanization import ned_to_body, quaternion
from ..state import (
    ACCEL_BIAS,
    ATTITUDE,
    FREE,
    GYRO_BIAS,
    LAND,
    MOUNT_PITCH,
    MOUNT_YAW,
    NHC_LEVER_ARM,
    STATES,
    TURN_SCALE,
    VELOCITY,
)
from ..stationarity import FRESH_S
from .nhc_noise import add_innovation, clear_sums, learn_noise_scale, reset_noise_scale

NHC_INTERVAL_S = 0.1
NHC_MIN_SPEED = 0.3  # m/s, below it the constraint says little
NHC_SIGMA = 0.1  # m/s
NHC_LEVER_ARM_SIGMA = 1.5  # m
TURN_SIDESLIP, TYRE_SIDESLIP = (
    0.4,
    0.005,
)  # m, s^2/m: sideways speed in turns, per rate, and per rate times speed squared
SUSPENSION_PITCH, SUSPENSION_TIME_S = (
    math.radians(0.7),
    1.5,
)  # a body on springs pitches against the road as it brakes, for so long
NHC_GATE = 12.0
MAX_MEAN_NIS = 4.0  # mean normalised innovation squared
RETRY_S = 60.0  # doubled by each contradiction, before another drive is believed
MEAN_NIS_GAIN = 0.02
MOUNT_SIGMA = math.radians(4.0)
TYPICAL_LEVER_ARM = 1.2  # m
DIRECTION_SIGMAS = 2.0  # times its sigma, a velocity that has a direction
SCATTER_DECAY = 0.98  # per window
POWER_ITERATIONS = 4  # iterations, each begins where the last ended
# windows; normalised square across the axis in a short look, and more of it per window, as a flight looks like a drive
# for some seconds; how much more there is across any line over ground: for auto
AXIS_FOUND, AXIS_FOUND_LAND = (8.0, 0.5, 0.01, 12.0), (6.0, 4.0, 0.0, -math.inf)


@kernel
def find_forward_axis(p: Any, c: Any) -> None:
    """Once per window: gather the velocity in the body, and begin to constrain when it keeps to one axis.

    An axis is found when what is left across it is less than the doubts explain, but not what is left across any line
    over ground: then the velocity has turned with the body. In an outage the velocity is no witness.
    """
    if 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns) > FRESH_S:
        return
    level2 = max(variance(c, VELOCITY), variance(c, VELOCITY + 1))
    climb = c.nav.v_n[2] * math.sqrt(min(level2 / variance(c, VELOCITY + 2), 1.0))  # mostly not measured
    if not accumulate_scatter(p, c, (c.nav.v_n[0], c.nav.v_n[1], climb), level2, variance(c, ATTITUDE + 2)):
        return
    across = c.nhc.velocity_scatter[0] + c.nhc.velocity_scatter[3] + c.nhc.velocity_scatter[5] - principal_direction(c)
    windows, most, more, evidence = AXIS_FOUND_LAND if p.vehicle == LAND else AXIS_FOUND
    most = (most + more * c.nhc.scatter_weight) * c.nhc.scatter_weight
    if (
        c.nhc.disable_count > 0
        and 1e-9 * (c.nav.t_ns - c.nhc.disabled_ns) < RETRY_S * 2.0**c.nhc.disable_count
        and p.vehicle != LAND
    ):
        return
    if c.nhc.scatter_weight >= windows and across < most and ground_residual(c) - across > evidence:
        enable_nhc(c)


@kernel
def accumulate_scatter(p: Any, c: Any, v: Any, level2: float, heading2: float) -> bool:
    """Gather v (m/s, NED, level variance `level2`) in a body of heading variance `heading2`, if it tells a direction.

    It counts by how well it tells: it may be wrong by its sigma, slip, squat, the heading and where the sensor sits.
    """
    if p.vehicle == FREE or c.nhc.enabled:
        return False
    q = quaternion(c)
    u = quat_rotate_back(q, v)
    speed2 = u[0] ** 2 + u[1] ** 2 + u[2] ** 2
    turn2 = c.imu.rate_b[0] ** 2 + c.imu.rate_b[1] ** 2 + c.imu.rate_b[2] ** 2
    s2 = level2 + NHC_SIGMA**2 + TYPICAL_LEVER_ARM**2 * turn2 + (SUSPENSION_PITCH**2 + heading2) * speed2
    if speed2 < DIRECTION_SIGMAS**2 * s2:
        return False
    down = quat_rotate_back(q, (0.0, 0.0, 1.0))
    for i in range(3):
        c.nhc.down_sum[i] = SCATTER_DECAY * c.nhc.down_sum[i] + down[i]
    k = 0
    for i in range(3):
        for j in range(i, 3):
            c.nhc.velocity_scatter[k] = SCATTER_DECAY * c.nhc.velocity_scatter[k] + u[i] * u[j] / s2
            k += 1
    c.nhc.ground_scatter[0] = SCATTER_DECAY * c.nhc.ground_scatter[0] + v[0] * v[0] / s2
    c.nhc.ground_scatter[1] = SCATTER_DECAY * c.nhc.ground_scatter[1] + v[0] * v[1] / s2
    c.nhc.ground_scatter[2] = SCATTER_DECAY * c.nhc.ground_scatter[2] + v[1] * v[1] / s2
    c.nhc.scatter_weight = SCATTER_DECAY * c.nhc.scatter_weight + 1.0
    if c.nhc.scatter_weight <= 1.0:
        c.nhc.principal_axis[0], c.nhc.principal_axis[1], c.nhc.principal_axis[2] = u[0], u[1], u[2]
    return True


@kernel
def rotate_scatter(c: Any, psi: float) -> None:
    """What was gathered in a level frame of arbitrary heading, which is about to be turned by psi."""
    down = ned_to_body(c, (0.0, 0.0, 1.0))
    turn = quat_exp(-psi * down[0], -psi * down[1], -psi * down[2])
    x, y, z = quat_rotate(turn, (1.0, 0.0, 0.0)), quat_rotate(turn, (0.0, 1.0, 0.0)), quat_rotate(turn, (0.0, 0.0, 1.0))
    a = quat_rotate(turn, (c.nhc.principal_axis[0], c.nhc.principal_axis[1], c.nhc.principal_axis[2]))
    xx, xy, xz, yy, yz, zz = (
        c.nhc.velocity_scatter[0],
        c.nhc.velocity_scatter[1],
        c.nhc.velocity_scatter[2],
        c.nhc.velocity_scatter[3],
        c.nhc.velocity_scatter[4],
        c.nhc.velocity_scatter[5],
    )
    k = 0
    for i in range(3):
        c.nhc.principal_axis[i] = a[i]
        for j in range(i, 3):
            diagonal = xx * x[i] * x[j] + yy * y[i] * y[j] + zz * z[i] * z[j]
            mixed = xy * (x[i] * y[j] + y[i] * x[j]) + xz * (x[i] * z[j] + z[i] * x[j])
            c.nhc.velocity_scatter[k] = diagonal + mixed + yz * (y[i] * z[j] + z[i] * y[j])
            k += 1


@kernel
def ground_residual(c: Any) -> float:
    """Sum of squares across the line over ground that explains the gathered velocities best."""
    half = 0.5 * (c.nhc.ground_scatter[0] + c.nhc.ground_scatter[2])
    return float(half - math.hypot(0.5 * (c.nhc.ground_scatter[0] - c.nhc.ground_scatter[2]), c.nhc.ground_scatter[1]))


@kernel
def principal_direction(c: Any) -> float:
    """Turn the principal axis into the main direction of the gathered velocities; returns their squares along it."""
    a, s, n = c.nhc.principal_axis, c.nhc.velocity_scatter, 0.0
    for _ in range(POWER_ITERATIONS):
        x = s[0] * a[0] + s[1] * a[1] + s[2] * a[2]
        y = s[1] * a[0] + s[3] * a[1] + s[4] * a[2]
        z = s[2] * a[0] + s[4] * a[1] + s[5] * a[2]
        n = math.sqrt(x * x + y * y + z * z)
        a[0], a[1], a[2] = x / n, y / n, z / n
    return n


@kernel
def is_due(c: Any, dt: float) -> bool:
    """Another `dt` s have passed: is it time for the constraint, if it is enabled?"""
    c.nhc.since_update += dt
    return bool(c.nhc.enabled and c.nhc.since_update >= NHC_INTERVAL_S)


@kernel
def enable_nhc(c: Any) -> None:
    """Constrain along the axis found; the lateral axis is the one across it that was level in the mean."""
    n = math.sqrt(c.nhc.down_sum[0] ** 2 + c.nhc.down_sum[1] ** 2 + c.nhc.down_sum[2] ** 2)
    down = (c.nhc.down_sum[0] / n, c.nhc.down_sum[1] / n, c.nhc.down_sum[2] / n)
    fx, fy, fz = c.nhc.principal_axis[0], c.nhc.principal_axis[1], c.nhc.principal_axis[2]
    lx, ly, lz = down[1] * fz - down[2] * fy, down[2] * fx - down[0] * fz, down[0] * fy - down[1] * fx
    s = math.sqrt(lx * lx + ly * ly + lz * lz)
    if s < 0.5:  # motion is up or down: no land vehicle
        return
    set_forward_axis(c, (fx, fy, fz), (lx / s, ly / s, lz / s))
    decorrelate(c, MOUNT_PITCH, MOUNT_SIGMA**2)
    decorrelate(c, MOUNT_YAW, MOUNT_SIGMA**2 + variance(c, ATTITUDE + 2))
    decorrelate(c, NHC_LEVER_ARM, NHC_LEVER_ARM_SIGMA**2)
    for i in range(STATES):
        c.nhc.start_variance[i] = variance(c, i)
    c.nhc.enabled = 1
    c.nhc.mean_nis = 1.0
    clear_sums(c)


@kernel
def reset_nhc(c: Any) -> None:
    """Give the constraint up and look for an axis anew."""
    c.nhc.enabled = 0
    c.nhc.scatter_weight = 0.0
    for i in range(6):
        c.nhc.velocity_scatter[i] = 0.0
    for i in range(3):
        c.nhc.ground_scatter[i] = 0.0
        c.nhc.down_sum[i] = 0.0


@kernel
def disable_nhc(c: Any, along: float) -> None:
    """No land vehicle, at `along` m/s: its velocity across was not nothing, which has bent the heading until now.

    And with it whatever else was learned: of attitude, biases and turns no more is known than when it began.
    """
    add_variance(c, ATTITUDE + 2, c.nhc.noise_scale[0] * (NHC_SIGMA / along) ** 2)
    for first in (ATTITUDE, GYRO_BIAS, ACCEL_BIAS, TURN_SCALE):
        for i in range(first, first + 3):
            add_variance(c, i, max(c.nhc.start_variance[i] - variance(c, i), 0.0))
    reset_nhc(c)
    c.nhc.disable_count += 1
    c.nhc.disabled_ns = c.nav.t_ns
    reset_noise_scale(c)


@kernel
def nhc_jacobian(c: Any, q: Any, e: Any, along: float, mount: int) -> int:
    """Row of the velocity along body vector `e`, which is across a forward axis that may be wrong by state `mount`."""
    en = quat_rotate(q, e)
    k = 0
    for i in range(3):
        k = set_jacobian(c, k, VELOCITY + i, en[i])
    k = set_jacobian(c, k, ATTITUDE, en[1] * c.nav.v_n[2] - en[2] * c.nav.v_n[1])
    k = set_jacobian(c, k, ATTITUDE + 1, en[2] * c.nav.v_n[0] - en[0] * c.nav.v_n[2])
    k = set_jacobian(c, k, ATTITUDE + 2, en[0] * c.nav.v_n[1] - en[1] * c.nav.v_n[0])
    return set_jacobian(c, k, mount, -along if mount == MOUNT_YAW else along)


@kernel
def fuse_nhc(p: Any, c: Any) -> None:
    """Fuse the two velocities across, if it is time and there is motion: none off the floor, sideways that of turning.

    A sensor ahead of the point about which the vehicle turns swings out; tyres slip in proportion to their load.
    """
    q = quaternion(c)
    vb = quat_rotate_back(q, (c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2]))
    f = (c.nav.forward[0], c.nav.forward[1], c.nav.forward[2])
    lateral = (c.nav.lateral[0], c.nav.lateral[1], c.nav.lateral[2])
    vertical = (
        f[1] * lateral[2] - f[2] * lateral[1],
        f[2] * lateral[0] - f[0] * lateral[2],
        f[0] * lateral[1] - f[1] * lateral[0],
    )
    along = f[0] * vb[0] + f[1] * vb[1] + f[2] * vb[2]
    c.nhc.since_update = 0.0
    if abs(along) < NHC_MIN_SPEED:
        return
    turn = vertical[0] * c.imu.rate_b[0] + vertical[1] * c.imu.rate_b[1] + vertical[2] * c.imu.rate_b[2]
    rate = math.sqrt(c.imu.rate_b[0] ** 2 + c.imu.rate_b[1] ** 2 + c.imu.rate_b[2] ** 2)
    r = (NHC_SIGMA + (TURN_SIDESLIP + TYRE_SIDESLIP * along * along) * rate) ** 2
    rough2 = (SUSPENSION_PITCH * along) ** 2 * 2.0 * SUSPENSION_TIME_S / NHC_INTERVAL_S
    k = set_jacobian(c, nhc_jacobian(c, q, lateral, along, MOUNT_YAW), NHC_LEVER_ARM, -turn)
    z = c.nav.nhc_lever_arm * turn - (lateral[0] * vb[0] + lateral[1] * vb[1] + lateral[2] * vb[2])
    left, s, sideways = pseudo_measurement(c, SLIP, k, z, c.nhc.noise_scale[0] * r, NHC_GATE)
    add_innovation(c, 0, left, s)
    k = nhc_jacobian(c, q, vertical, along, MOUNT_PITCH)
    z = -(vertical[0] * vb[0] + vertical[1] * vb[1] + vertical[2] * vb[2])
    left, s, upwards = pseudo_measurement(c, HOP, k, z, c.nhc.noise_scale[1] * r + rough2, NHC_GATE)
    add_innovation(c, 1, left, s)
    correct_state(c)
    c.nhc.mean_nis += MEAN_NIS_GAIN * (min(max(abs(sideways), abs(upwards)), 4.0 * NHC_GATE) - c.nhc.mean_nis)
    if (learn_noise_scale(c) or c.nhc.mean_nis > MAX_MEAN_NIS) and p.vehicle != LAND:
        disable_nhc(c, along)
