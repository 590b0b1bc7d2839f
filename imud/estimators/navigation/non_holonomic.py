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

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from ...kernels.rotation import quat_exp, quat_rotate, quat_rotate_back
from ..records import HOP, SLIP
from .correction import assume, correct, row
from .covariance import grow, variance
from .looseness import forget_looseness, learn_looseness, relax, strain
from .motion import FRESH_S
from .state import (
    ACCEL_BIAS,
    ARM,
    ATTITUDE,
    FREE,
    GYRO_BIAS,
    LAND,
    MOUNT_PITCH,
    MOUNT_YAW,
    STATES,
    TURN_SCALE,
    VELOCITY,
)

INTERVAL_S = 0.1
SPEED = 0.3  # m/s, below it the constraint says little
SIGMA = 0.1  # m/s
ARM_SIGMA = 1.5  # m
DRIFT, TYRE_DRIFT = 0.4, 0.005  # m, s^2/m: sideways speed in turns, per rate, and per rate times speed squared
SQUAT, SQUAT_S = math.radians(0.7), 1.5  # a body on springs pitches against the road as it brakes, for so long
GATE = 12.0
CONTRADICTION = 4.0  # mean normalised innovation squared
PATIENCE_S = 60.0  # doubled by each contradiction, before another drive is believed
MEMORY = 0.02
MOUNT_SIGMA = math.radians(4.0)
LIKELY_ARM = 1.2  # m
PLAIN = 2.0  # times its sigma, a velocity that has a direction
KEEP = 0.98  # per window
POWERS = 4  # iterations, each begins where the last ended
# windows; normalised square across the axis in a short look, and more of it per window, as a flight looks like a drive
# for some seconds; how much more there is across any line over ground: for auto
FOUND, FOUND_LAND = (8.0, 0.5, 0.01, 12.0), (6.0, 4.0, 0.0, -math.inf)


@kernel
def learn_axis(p: Any, c: Any) -> None:
    """Once per window: gather the velocity in the body, and begin to constrain when it keeps to one axis.

    An axis is found when what is left across it is less than the doubts explain, but not what is left across any line
    over ground: then the velocity has turned with the body. In an outage the velocity is no witness.
    """
    if 1e-9 * (c.t_ns - c.fix_ns) > FRESH_S:
        return
    level2 = max(variance(c, VELOCITY), variance(c, VELOCITY + 1))
    climb = c.v[2] * math.sqrt(min(level2 / variance(c, VELOCITY + 2), 1.0))  # mostly not measured
    if not witness(p, c, (c.v[0], c.v[1], climb), level2, variance(c, ATTITUDE + 2)):
        return
    across = c.spread[0] + c.spread[3] + c.spread[5] - principal(c)
    windows, most, more, evidence = FOUND_LAND if p.vehicle == LAND else FOUND
    most = (most + more * c.axis_n) * c.axis_n
    if c.stops > 0 and 1e-9 * (c.t_ns - c.stopped_ns) < PATIENCE_S * 2.0**c.stops and p.vehicle != LAND:
        return
    if c.axis_n >= windows and across < most and across_ground(c) - across > evidence:
        begin(c)


@kernel
def witness(p: Any, c: Any, v: Any, level2: float, heading2: float) -> bool:
    """Gather v (m/s, NED, level variance `level2`) in a body of heading variance `heading2`, if it tells a direction.

    It counts by how well it tells: it may be wrong by its sigma, slip, squat, the heading and where the sensor sits.
    """
    if p.vehicle == FREE or c.constrained:
        return False
    q = (c.q[0], c.q[1], c.q[2], c.q[3])
    u = quat_rotate_back(q, v)
    speed2 = u[0] ** 2 + u[1] ** 2 + u[2] ** 2
    turn2 = c.rate[0] ** 2 + c.rate[1] ** 2 + c.rate[2] ** 2
    s2 = level2 + SIGMA**2 + LIKELY_ARM**2 * turn2 + (SQUAT**2 + heading2) * speed2
    if speed2 < PLAIN**2 * s2:
        return False
    down = quat_rotate_back(q, (0.0, 0.0, 1.0))
    for i in range(3):
        c.down[i] = KEEP * c.down[i] + down[i]
    k = 0
    for i in range(3):
        for j in range(i, 3):
            c.spread[k] = KEEP * c.spread[k] + u[i] * u[j] / s2
            k += 1
    c.ground[0] = KEEP * c.ground[0] + v[0] * v[0] / s2
    c.ground[1] = KEEP * c.ground[1] + v[0] * v[1] / s2
    c.ground[2] = KEEP * c.ground[2] + v[1] * v[1] / s2
    c.axis_n = KEEP * c.axis_n + 1.0
    if c.axis_n <= 1.0:
        c.axis[0], c.axis[1], c.axis[2] = u[0], u[1], u[2]
    return True


@kernel
def turn_witnesses(c: Any, psi: float) -> None:
    """What was gathered in a level frame of arbitrary heading, which is about to be turned by psi."""
    down = quat_rotate_back((c.q[0], c.q[1], c.q[2], c.q[3]), (0.0, 0.0, 1.0))
    turn = quat_exp(-psi * down[0], -psi * down[1], -psi * down[2])
    x, y, z = quat_rotate(turn, (1.0, 0.0, 0.0)), quat_rotate(turn, (0.0, 1.0, 0.0)), quat_rotate(turn, (0.0, 0.0, 1.0))
    a = quat_rotate(turn, (c.axis[0], c.axis[1], c.axis[2]))
    xx, xy, xz, yy, yz, zz = c.spread[0], c.spread[1], c.spread[2], c.spread[3], c.spread[4], c.spread[5]
    k = 0
    for i in range(3):
        c.axis[i] = a[i]
        for j in range(i, 3):
            diagonal = xx * x[i] * x[j] + yy * y[i] * y[j] + zz * z[i] * z[j]
            mixed = xy * (x[i] * y[j] + y[i] * x[j]) + xz * (x[i] * z[j] + z[i] * x[j])
            c.spread[k] = diagonal + mixed + yz * (y[i] * z[j] + z[i] * y[j])
            k += 1


@kernel
def across_ground(c: Any) -> float:
    """Sum of squares across the line over ground that explains the gathered velocities best."""
    half = 0.5 * (c.ground[0] + c.ground[2])
    return float(half - math.hypot(0.5 * (c.ground[0] - c.ground[2]), c.ground[1]))


@kernel
def principal(c: Any) -> float:
    """Turn c.axis into the main direction of the gathered velocities; returns their sum of squares along it."""
    a, s, n = c.axis, c.spread, 0.0
    for _ in range(POWERS):
        x = s[0] * a[0] + s[1] * a[1] + s[2] * a[2]
        y = s[1] * a[0] + s[3] * a[1] + s[4] * a[2]
        z = s[2] * a[0] + s[4] * a[1] + s[5] * a[2]
        n = math.sqrt(x * x + y * y + z * z)
        a[0], a[1], a[2] = x / n, y / n, z / n
    return n


@kernel
def begin(c: Any) -> None:
    """Constrain along the axis found; the lateral axis is the one across it that was level in the mean."""
    n = math.sqrt(c.down[0] ** 2 + c.down[1] ** 2 + c.down[2] ** 2)
    down = (c.down[0] / n, c.down[1] / n, c.down[2] / n)
    fx, fy, fz = c.axis[0], c.axis[1], c.axis[2]
    lx, ly, lz = down[1] * fz - down[2] * fy, down[2] * fx - down[0] * fz, down[0] * fy - down[1] * fx
    s = math.sqrt(lx * lx + ly * ly + lz * lz)
    if s < 0.5:  # motion is up or down: no land vehicle
        return
    c.forward[0], c.forward[1], c.forward[2] = fx, fy, fz
    c.lateral[0], c.lateral[1], c.lateral[2] = lx / s, ly / s, lz / s
    reset(c.P, STATES, MOUNT_PITCH, MOUNT_SIGMA**2)
    reset(c.P, STATES, MOUNT_YAW, MOUNT_SIGMA**2 + variance(c, ATTITUDE + 2))
    reset(c.P, STATES, ARM, ARM_SIGMA**2)
    c.arm = 0.0
    for i in range(STATES):
        c.before[i] = variance(c, i)
    c.constrained = 1
    c.contradiction = 1.0
    relax(c)


@kernel
def stop(c: Any) -> None:
    """Give the constraint up and look for an axis anew."""
    c.constrained = 0
    c.axis_n = 0.0
    for i in range(6):
        c.spread[i] = 0.0
    for i in range(3):
        c.ground[i] = 0.0
        c.down[i] = 0.0


@kernel
def disown(c: Any, along: float) -> None:
    """No land vehicle, at `along` m/s: its velocity across was not nothing, which has bent the heading until now.

    And with it whatever else was learned: of attitude, biases and turns no more is known than when it began.
    """
    grow(c, ATTITUDE + 2, c.loose[0] * (SIGMA / along) ** 2)
    for first in (ATTITUDE, GYRO_BIAS, ACCEL_BIAS, TURN_SCALE):
        for i in range(first, first + 3):
            grow(c, i, max(c.before[i] - variance(c, i), 0.0))
    stop(c)
    c.stops += 1
    c.stopped_ns = c.t_ns
    forget_looseness(c)


@kernel
def crossing(c: Any, q: Any, e: Any, along: float, mount: int) -> int:
    """Row of the velocity along body vector `e`, which is across a forward axis that may be wrong by state `mount`."""
    en = quat_rotate(q, e)
    k = 0
    for i in range(3):
        k = row(c, k, VELOCITY + i, en[i])
    k = row(c, k, ATTITUDE, en[1] * c.v[2] - en[2] * c.v[1])
    k = row(c, k, ATTITUDE + 1, en[2] * c.v[0] - en[0] * c.v[2])
    k = row(c, k, ATTITUDE + 2, en[0] * c.v[1] - en[1] * c.v[0])
    return row(c, k, mount, -along if mount == MOUNT_YAW else along)


@kernel
def constrain(p: Any, c: Any) -> None:
    """Fuse the two velocities across, if it is time and there is motion: none off the floor, sideways that of turning.

    A sensor ahead of the point about which the vehicle turns swings out; tyres slip in proportion to their load.
    """
    q = (c.q[0], c.q[1], c.q[2], c.q[3])
    vb = quat_rotate_back(q, (c.v[0], c.v[1], c.v[2]))
    f = (c.forward[0], c.forward[1], c.forward[2])
    lateral = (c.lateral[0], c.lateral[1], c.lateral[2])
    vertical = (
        f[1] * lateral[2] - f[2] * lateral[1],
        f[2] * lateral[0] - f[0] * lateral[2],
        f[0] * lateral[1] - f[1] * lateral[0],
    )
    along = f[0] * vb[0] + f[1] * vb[1] + f[2] * vb[2]
    c.since_constraint = 0.0
    if abs(along) < SPEED:
        return
    turn = vertical[0] * c.rate[0] + vertical[1] * c.rate[1] + vertical[2] * c.rate[2]
    rate = math.sqrt(c.rate[0] ** 2 + c.rate[1] ** 2 + c.rate[2] ** 2)
    r = (SIGMA + (DRIFT + TYRE_DRIFT * along * along) * rate) ** 2
    rough2 = (SQUAT * along) ** 2 * 2.0 * SQUAT_S / INTERVAL_S
    k = row(c, crossing(c, q, lateral, along, MOUNT_YAW), ARM, -turn)
    z = c.arm * turn - (lateral[0] * vb[0] + lateral[1] * vb[1] + lateral[2] * vb[2])
    left, s, sideways = assume(c, SLIP, k, z, c.loose[0] * r, GATE)
    strain(c, 0, left, s)
    k = crossing(c, q, vertical, along, MOUNT_PITCH)
    z = -(vertical[0] * vb[0] + vertical[1] * vb[1] + vertical[2] * vb[2])
    left, s, upwards = assume(c, HOP, k, z, c.loose[1] * r + rough2, GATE)
    strain(c, 1, left, s)
    correct(c)
    c.contradiction += MEMORY * (min(max(abs(sideways), abs(upwards)), 4.0 * GATE) - c.contradiction)
    if (learn_looseness(c) or c.contradiction > CONTRADICTION) and p.vehicle != LAND:
        disown(c, along)
