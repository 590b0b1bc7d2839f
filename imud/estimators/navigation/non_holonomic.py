"""A land vehicle moves along its forward axis: velocity across it and off its floor is nearly zero.

The axis is a unit vector in the body, found as the mean direction of motion (the sensor may be mounted in any way),
then refined by two states. "auto" switches the constraint on when a drive that has turned shows one steady axis, and
off when the motion contradicts it.

Source: Dissanayake et al., The aiding of a low-cost strapdown inertial measurement unit using vehicle model
constraints (2001).
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import reset
from ...kernels.rotation import quat_rotate, quat_rotate_back
from ..records import HOP, SLIP
from .correction import assume, correct, row
from .covariance import variance
from .state import ARM, ATTITUDE, FREE, LAND, MOUNT_PITCH, MOUNT_YAW, STATES, VELOCITY

INTERVAL_S = 0.1
SPEED = 0.3  # m/s, below it the constraint says little
STRAIGHT = 0.3  # rad/s, in a sharper turn the direction of motion depends on where the sensor is
PLAIN = 0.5  # m/s, of a direction of motion; and its velocity known to a fifth
SIGMA = 0.1  # m/s
ARM_SIGMA = 1.5  # m
DRIFT, TYRE_DRIFT = 0.2, 0.005  # m, s^2/m: sideways speed in turns, per rate, and per rate times speed squared
SQUAT, SQUAT_S = math.radians(0.7), 1.5  # a body on springs pitches against the road as it brakes, for so long
GATE = 12.0
CONTRADICTION = 4.0  # mean normalised innovation squared
MEMORY = 0.02
MOUNT_SIGMA = math.radians(4.0)
FOUND = (12.0, math.radians(8.0), 0.85)  # windows, spread rad, resultant length of the courses: for auto
FOUND_LAND = (6.0, math.radians(15.0), 1.1)


@kernel
def dot_down(c: Any, u: Any) -> float:
    """Component of a body vector along the vertical."""
    return float(quat_rotate((c.q[0], c.q[1], c.q[2], c.q[3]), (u[0], u[1], u[2]))[2])


@kernel
def learn_axis(p: Any, c: Any) -> None:
    """Once per window: gather the direction of motion in the body, and begin to constrain when it is plain."""
    speed = math.sqrt(c.v[0] ** 2 + c.v[1] ** 2 + c.v[2] ** 2)
    sigma = math.sqrt(max(variance(c, VELOCITY), variance(c, VELOCITY + 1)))
    turning = abs(dot_down(c, c.rate))
    if p.vehicle == FREE or c.constrained or speed < PLAIN or sigma > 0.2 * speed or turning > STRAIGHT:
        return
    u = quat_rotate_back((c.q[0], c.q[1], c.q[2], c.q[3]), (c.v[0] / speed, c.v[1] / speed, c.v[2] / speed))
    sign = -1.0 if u[0] * c.axis[0] + u[1] * c.axis[1] + u[2] * c.axis[2] < 0.0 else 1.0
    for i in range(3):
        c.axis[i] = 0.98 * c.axis[i] + sign * u[i]
    for i in range(2):
        c.course[i] = 0.98 * c.course[i] + c.v[i] / speed
    c.axis_n = 0.98 * c.axis_n + 1.0
    c.axis_doubt = 0.98 * c.axis_doubt + 2.0 * (sigma / speed) ** 2
    n = math.sqrt(c.axis[0] ** 2 + c.axis[1] ** 2 + c.axis[2] ** 2)
    spread = math.sqrt(max(2.0 * (1.0 - n / c.axis_n) - c.axis_doubt / c.axis_n, 0.0))
    windows, widest, straight = FOUND_LAND if p.vehicle == LAND else FOUND
    if c.axis_n >= windows and spread < widest and math.hypot(c.course[0], c.course[1]) < straight * c.axis_n:
        begin(c, n)


@kernel
def begin(c: Any, n: float) -> None:
    """Constrain along the mean axis, whose sum has length `n`; the lateral axis is the level one across it."""
    down = quat_rotate_back((c.q[0], c.q[1], c.q[2], c.q[3]), (0.0, 0.0, 1.0))
    fx, fy, fz = c.axis[0] / n, c.axis[1] / n, c.axis[2] / n
    lx, ly, lz = down[1] * fz - down[2] * fy, down[2] * fx - down[0] * fz, down[0] * fy - down[1] * fx
    s = math.sqrt(lx * lx + ly * ly + lz * lz)
    if s < 0.5:  # motion is up or down: no land vehicle
        return
    c.forward[0], c.forward[1], c.forward[2] = fx, fy, fz
    c.lateral[0], c.lateral[1], c.lateral[2] = lx / s, ly / s, lz / s
    reset(c.P, STATES, MOUNT_PITCH, MOUNT_SIGMA**2)
    reset(c.P, STATES, MOUNT_YAW, MOUNT_SIGMA**2)
    reset(c.P, STATES, ARM, ARM_SIGMA**2)
    c.arm = 0.0
    c.constrained = 1
    c.contradiction = 1.0


@kernel
def stop(c: Any) -> None:
    """Give the constraint up and look for an axis anew."""
    c.constrained = 0
    c.axis_n = 0.0
    c.axis_doubt = 0.0
    for i in range(3):
        c.axis[i] = 0.0
    for i in range(2):
        c.course[i] = 0.0


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
    k = row(c, crossing(c, q, lateral, along, MOUNT_YAW), ARM, -turn)
    z = c.arm * turn - (lateral[0] * vb[0] + lateral[1] * vb[1] + lateral[2] * vb[2])
    sideways = abs(assume(c, SLIP, k, z, r, GATE))
    r += (SQUAT * along) ** 2 * 2.0 * SQUAT_S / INTERVAL_S
    k = crossing(c, q, vertical, along, MOUNT_PITCH)
    z = -(vertical[0] * vb[0] + vertical[1] * vb[1] + vertical[2] * vb[2])
    upwards = abs(assume(c, HOP, k, z, r, GATE))
    correct(c)
    c.contradiction += MEMORY * (min(max(sideways, upwards), 4.0 * GATE) - c.contradiction)
    if c.contradiction > CONTRADICTION and p.vehicle != LAND:
        stop(c)
