"""The lever arm l of another sensor, from the IMU, in the body: C_nb l in position, C_nb (w x l) in velocity."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Vector, quat_rotate
from .mechanization import body_to_ned, rotation_matrix

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from .types import Core, Imu, Nav


@kernel
def arm_velocity_b(c: Core, arm: Reals) -> Vector:
    """w x l: velocity of a point relative to the IMU, m/s, body."""
    x, y, z = c.imu.w[0] - c.nav.bg[0], c.imu.w[1] - c.nav.bg[1], c.imu.w[2] - c.nav.bg[2]
    return y * arm[2] - z * arm[1], z * arm[0] - x * arm[2], x * arm[1] - y * arm[0]


@kernel
def antenna_position(c: Core) -> Vector:
    """C_nb l: position of the antenna relative to the IMU, m, NED."""
    arm = c.nav.gnss_lever_arm
    return body_to_ned(c, (arm[0], arm[1], arm[2]))


@kernel
def antenna_velocity(c: Core) -> Vector:
    """C_nb (w x l): velocity of the antenna relative to the IMU, m/s, NED."""
    return body_to_ned(c, arm_velocity_b(c, c.nav.gnss_lever_arm))


@kernel
def velocity_of_point(n: Nav, u: Imu, arm: Reals) -> Vector:
    """v + C_nb (w x l): velocity of a point at a stored state n, with its sample u, m/s, NED."""
    x, y, z = u.w[0] - n.bg[0], u.w[1] - n.bg[1], u.w[2] - n.bg[2]
    v = quat_rotate(
        (n.q_nb[0], n.q_nb[1], n.q_nb[2], n.q_nb[3]),
        (y * arm[2] - z * arm[1], z * arm[0] - x * arm[2], x * arm[1] - y * arm[0]),
    )
    return n.v_n[0] + v[0], n.v_n[1] + v[1], n.v_n[2] + v[2]


@kernel
def arm_position_row(c: Core, i: int) -> Vector:
    """Component i of C_nb l by l: how the lever arm changes the position of its point."""
    C_nb = rotation_matrix(c)
    return C_nb[3 * i], C_nb[3 * i + 1], C_nb[3 * i + 2]


@kernel
def arm_velocity_row(c: Core, i: int) -> Vector:
    """Component i of C_nb (w x l) by l: how the lever arm changes the velocity of its point."""
    x, y, z = arm_position_row(c, i)
    wx, wy, wz = c.imu.w[0] - c.nav.bg[0], c.imu.w[1] - c.nav.bg[1], c.imu.w[2] - c.nav.bg[2]
    return y * wz - z * wy, z * wx - x * wz, x * wy - y * wx


@kernel
def attitude_row(v: Vector, i: int) -> Vector:
    """Component i of phi x v by the attitude error phi: how the attitude error changes v = C_nb x."""
    if i == 0:
        return 0.0, v[2], -v[1]
    if i == 1:
        return -v[2], 0.0, v[0]
    return v[1], -v[0], 0.0


@kernel
def gyro_bias_row(c: Core, arm: Reals, i: int) -> Vector:
    """Component i of C_nb (l x bias) by the error of the gyro bias: how it changes the velocity of a point."""
    x, y, z = arm_position_row(c, i)
    return y * arm[2] - z * arm[1], z * arm[0] - x * arm[2], x * arm[1] - y * arm[0]
