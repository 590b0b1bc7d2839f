"""Rotations: unit quaternions q_nb (Hamilton, scalar first, body to navigation) and Euler angles ZYX, on plain scalars.

Source: Solà, Quaternion kinematics for the error-state Kalman filter (2017); Titterton and Weston (2004), ch. 3.
"""

import math

from imud.drivers import elementary

from ..compile.jit import kernel, unrolled

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]
Matrix = tuple[float, float, float, float, float, float, float, float, float]  # row by row
UNKNOWN_ANGLE = math.pi / math.sqrt(3.0)  # rad, sigma of an angle of which nothing is known
GIMBAL_LOCK_SINE = 1.0 - 1e-13  # sine of a pitch at which rounding decides what roll and yaw are


@kernel
def wrap_angle(angle: float) -> float:
    """The angle in [-pi, pi)."""
    if -math.pi <= angle < math.pi:
        return angle
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def dot(a: Vector, b: Vector) -> float:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def quat_product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a*b."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@kernel
def quat_normalised(q: Quaternion) -> Quaternion:
    """q scaled to unit length."""
    s = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * s, q[1] * s, q[2] * s, q[3] * s


@kernel
def quat_renormalised(q: Quaternion) -> Quaternion:
    """q, whose length is one but for rounding, scaled to that: Newton's step for the inverse root."""
    s = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * s, q[1] * s, q[2] * s, q[3] * s


@unrolled
def quat_exp(x: float, y: float, z: float) -> Quaternion:
    """Quaternion of the rotation vector (x, y, z), rad."""
    angle2 = x * x + y * y + z * z
    if angle2 < 1e-3:  # series: the next term is below 1e-19
        c = 1.0 - angle2 * (1.0 / 8.0 - angle2 * (1.0 / 384.0 - angle2 * (1.0 / 46080.0)))
        s = 0.5 - angle2 * (1.0 / 48.0 - angle2 * (1.0 / 3840.0 - angle2 * (1.0 / 645120.0)))
    else:
        angle = math.sqrt(angle2)
        c = elementary.cos(0.5 * angle)
        s = elementary.sin(0.5 * angle) / angle
    return c, s * x, s * y, s * z


@kernel
def quat_rotate(q: Quaternion, v: Vector) -> Vector:
    """v rotated by q: body to navigation for q_nb."""
    tx = 2.0 * (q[2] * v[2] - q[3] * v[1])
    ty = 2.0 * (q[3] * v[0] - q[1] * v[2])
    tz = 2.0 * (q[1] * v[1] - q[2] * v[0])
    return (
        v[0] + q[0] * tx + q[2] * tz - q[3] * ty,
        v[1] + q[0] * ty + q[3] * tx - q[1] * tz,
        v[2] + q[0] * tz + q[1] * ty - q[2] * tx,
    )


@kernel
def quat_rotate_back(q: Quaternion, v: Vector) -> Vector:
    """v rotated by the inverse of q: navigation to body for q_nb."""
    return quat_rotate((q[0], -q[1], -q[2], -q[3]), v)


@kernel
def dcm_of_quat(q: Quaternion) -> Matrix:
    """Rotation matrix C_nb by rows."""
    w, x, y, z = q
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@kernel
def quat_of_euler(roll: float, pitch: float, yaw: float) -> Quaternion:
    """q_nb of ZYX Euler angles, rad."""
    cr, sr = elementary.cos(0.5 * roll), elementary.sin(0.5 * roll)
    cp, sp = elementary.cos(0.5 * pitch), elementary.sin(0.5 * pitch)
    cy, sy = elementary.cos(0.5 * yaw), elementary.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


@kernel
def euler_of_quat(q: Quaternion) -> Vector:
    """Roll, pitch, yaw in rad; roll and yaw in (-pi, pi], pitch in [-pi/2, pi/2].

    With the nose straight up or down, where only roll and yaw together mean something, roll is 0.
    """
    w, x, y, z = q
    roll = elementary.atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    sine = 2.0 * (w * y - x * z)
    if abs(sine) > 1.0:  # by rounding; an unknown attitude stays NaN
        sine = math.copysign(1.0, sine)
    pitch = elementary.asin(sine)
    if abs(sine) > GIMBAL_LOCK_SINE:
        yaw = 2.0 * elementary.atan2(z, w)
        return 0.0, pitch, yaw - math.copysign(2.0 * math.pi, yaw) if abs(yaw) > math.pi else yaw
    yaw = elementary.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, yaw


@kernel
def quat_of_gravity(fx: float, fy: float, fz: float) -> Quaternion:
    """q_nb with yaw 0 of a body at rest that measures specific force (fx, fy, fz) != 0."""
    roll = elementary.atan2(-fy, -fz)
    pitch = elementary.atan2(fx, math.sqrt(fy * fy + fz * fz))
    return quat_of_euler(roll, pitch, 0.0)


@kernel
def euler_variances(q: Quaternion, p00: float, p01: float, p02: float, p11: float, p12: float, p22: float) -> Vector:
    """Variances of roll, pitch, yaw (rad^2) for a small navigation-frame rotation error with covariance p (NED).

    At pitch +-90 deg roll and yaw are not defined; their variances stop at that of a uniform angle, pi^2/3.
    """
    w, x, y, z = q
    sine = min(max(2.0 * (w * y - x * z), -1.0), 1.0)  # of pitch
    north, east = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)  # along the heading
    if abs(sine) > GIMBAL_LOCK_SINE:
        north, east = w * w - z * z, 2.0 * w * z
    level = 1.0 / (north * north + east * east)  # and away from the poles 1 / cos^2 pitch
    steep = 1.0 / max((1.0 - sine) * (1.0 + sine), 1e-12)
    limit = math.pi * math.pi / 3.0
    along = level * (north * north * p00 + 2.0 * north * east * p01 + east * east * p11)  # about the heading, level
    across = level * (east * east * p00 - 2.0 * north * east * p01 + north * north * p11)  # about the pitch axis
    vertical = p22 + 2.0 * sine * level * (north * p02 + east * p12) + sine * sine * steep * along
    return min(steep * along, limit), min(across, limit), min(vertical, limit)
