"""Beginnings: the first sample, roll and pitch from gravity, and going on after samples that are missing or false.

The first force is the vertical only if the body does not accelerate. Unless the first moment is quiet it is but a
guess: for SEEKING_S the mean force, in axes carried by the gyro, is put upright, whatever turn that takes; from then on
the filter corrects what is left. The less that force changed, the better its mean is known to be the vertical.

Source of the mean force in such axes: Laidig and Seel, VQF: Highly accurate IMU orientation estimation (2023).
"""

import math
from typing import Any

from drivers.sample import LIMITED_FORCE, LIMITED_RATE, SATURATED

from ...kernels.jit import kernel
from ...kernels.kalman import reset, shear
from ...kernels.rotation import (
    Vector,
    dcm_of_quat,
    euler_of_quat,
    quat_exp,
    quat_normalised,
    quat_of_euler,
    quat_of_gravity,
    quat_product,
    quat_rotate_back,
)
from .covariance import clear, grow, report, variance
from .rest import restart
from .state import ATTITUDE, GYRO_BIAS, STATES, VELOCITY
from .staying import forget_motion

START_TILT = 0.1  # rad
GIVEN_ANGLE = math.radians(1.0)  # of a roll, pitch or yaw given by the user
UNIFORM = math.pi / math.sqrt(3.0)  # rad, sigma of an angle of which nothing is known
SEEKING_S = 0.8
LASTING_S = 1.0  # for which an acceleration that is seen to change keeps about its direction
FIRST_VELOCITY_VAR = 1.0  # (m/s)^2, of a body that turns with it, or gains it meanwhile
FIRST_ENERGY = 0.3  # (m/s)^2 of it, in short motions
LIGHTEST, HEAVIEST = 0.5, 2.0  # of gravity, for a force that may show the vertical
GAP_RATE_PSD = 0.5**2  # (rad/s)^2/s: how fast a rate wanders unseen
GAP_FORCE_PSD = 3.0**2  # (m/s^2)^2/s
UNSEEN_RATE = 0.3  # rad/s
UNSEEN_FORCE_PSD = 10.0**2  # (m/s)^2/s
OVERRANGE = 0.2  # sqrt(s): noise of a saturated sensor as a part of its reading


@kernel
def begin(s: Any, w: Vector, f: Vector) -> None:
    """Take the first sample, or the first one after a long gap: running means start from it."""
    for i in range(3):
        s.w[i] = w[i]
        s.f[i] = f[i]
        s.f_change[i] = 0.0
    restart(s, w, f)
    s.contradicted_s = s.held_s = 0.0
    s.resting = 0


@kernel
def resume(p: Any, s: Any, w: Vector, f: Vector, dt: float) -> None:
    """After a long gap: tilt and heading unknown, biases as they were, a little older."""
    begin(s, w, f)
    clear(s)
    s.levelled = s.heading = 0
    for i in range(3):
        grow(s, GYRO_BIAS + i, p.gyro_bias_psd * dt)
        reset(s.P, STATES, ATTITUDE + i, UNIFORM**2)


@kernel
def level(s: Any, f: Vector) -> None:
    """Take roll and pitch from specific force f, or from the user, yaw as it is; forget velocity."""
    weight = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) / s.gravity
    if not LIGHTEST < weight < HEAVIEST:
        return
    _, _, yaw = euler_of_quat((s.q[0], s.q[1], s.q[2], s.q[3]))
    roll, pitch, _ = euler_of_quat(quat_of_gravity(f[0], f[1], f[2]))
    tilt2 = START_TILT**2 + (weight - 1.0) ** 2
    s.seeking, s.pull2 = 1, 0.0
    heading2 = variance(s, ATTITUDE + 2)
    g = s.given
    if math.isfinite(g[0]) and math.isfinite(g[1]):
        roll, pitch, tilt2 = g[0], g[1], GIVEN_ANGLE**2
        s.seeking = 0
    if math.isfinite(g[2]):
        yaw, heading2 = g[2], GIVEN_ANGLE**2
    q = quat_of_euler(roll, pitch, yaw)
    s.q[0], s.q[1], s.q[2], s.q[3] = q
    for i in range(3):
        reset(s.P, STATES, ATTITUDE + i, tilt2 if i < 2 else heading2)
        g[i] = math.nan
        s.pull[i] = s.gain[i] = 0.0
        forget_motion(s, i)
    s.pull_s = 0.0
    clear(s)
    s.levelled = 1
    report(s)


@kernel
def seeks(s: Any) -> bool:
    """Must the vertical be sought, or has all been quiet since the beginning?"""
    if s.pull_s == 0.0 and s.quiet_s > 0.5 * s.span:
        s.seeking = 0
    return bool(s.seeking == 1)


@kernel
def seek(s: Any) -> None:
    """Put the mean force since the beginning upright, and begin again from there."""
    push2 = 0.0
    for i in range(3):
        s.pull[i] += s.push[i]
        push2 += s.push[i] ** 2
    s.pull_s += s.span
    s.pull2 += push2 / s.span
    turn_upright(s)
    t = s.pull_s
    changing2 = max(s.pull2 / t - (s.pull[2] / t) ** 2, 0.0)  # (m/s^2)^2
    turning2 = s.spin / s.span + (START_TILT * s.gravity) ** 2 / FIRST_VELOCITY_VAR  # (rad/s)^2
    mean2 = FIRST_VELOCITY_VAR / (t * t + 1.0 / turning2) + changing2 * LASTING_S / (t + LASTING_S)
    C = dcm_of_quat((s.q[0], s.q[1], s.q[2], s.q[3]))
    for i in range(3):
        forget_motion(s, i)
        reset(s.P, STATES, VELOCITY + i, FIRST_VELOCITY_VAR)
        s.v_energy[i] = FIRST_ENERGY
        if i < 2:
            reset(s.P, STATES, ATTITUDE + i, min(mean2 / s.gravity**2, UNIFORM**2))
            for j in range(3):  # the mean is that of half the time ago
                shear(s.P, STATES, ATTITUDE + i, GYRO_BIAS + j, -0.5 * t * C[3 * i + j])
    if t > SEEKING_S:
        s.seeking = 0


@kernel
def turn_upright(s: Any) -> None:
    """Turn the attitude about a level axis so that the gathered force shows upward."""
    x, y, z = s.pull[0], s.pull[1], s.pull[2]
    level = math.hypot(x, y)
    angle = math.atan2(level, -z)
    k = angle / level if level > 0.0 else 0.0
    q = quat_product(quat_exp(-k * y, k * x, 0.0), (s.q[0], s.q[1], s.q[2], s.q[3]))
    s.q[0], s.q[1], s.q[2], s.q[3] = quat_normalised(q)
    s.pull[0], s.pull[1], s.pull[2] = 0.0, 0.0, -math.hypot(level, z)


@kernel
def middle(a: Any, b: Vector) -> Vector:
    """What lies between two readings is best guessed as their mean."""
    return 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])


@kernel
def hold(s: Any, dt: float, unseen_s: float) -> None:
    """Go on with the last rate, for dt more.

    `unseen_s`: for how long, if the sensor is at fault; that is found out late, and even the last rate may be false.
    """
    before = s.held_s
    s.held_s += dt
    if unseen_s > 0.0:
        s.attitude_extra += UNSEEN_RATE**2 * max(unseen_s**2 - before**2, 0.0)
    if unseen_s > s.held_s:
        s.attitude_extra += GAP_RATE_PSD * (unseen_s**3 - s.held_s**3) / 3.0
        s.velocity_extra += UNSEEN_FORCE_PSD * (unseen_s - s.held_s)
        s.held_s = unseen_s


@kernel
def unweighed(s: Any, dt: float) -> Vector:
    """The force that a body would show that does not accelerate, for one that is not seen; it tells nothing of tilt."""
    s.velocity_extra += UNSEEN_FORCE_PSD * dt
    x, y, z = quat_rotate_back((s.q[0], s.q[1], s.q[2], s.q[3]), (0.0, 0.0, -s.gravity))
    return x + s.ba[0], y + s.ba[1], z + s.ba[2]


@kernel
def doubt(p: Any, s: Any, w: Vector, f: Vector, dt: float, flags: int) -> None:
    """Noise for what was not measured: between samples far apart, while values are held, beyond the range.

    `flags` (of the sample) may name which sensor is at the end of its range; if not, it may be either.
    """
    dw2 = df2 = w2 = f2 = 0.0
    for i in range(3):
        dw2 += (w[i] - s.w[i]) ** 2
        df2 += (f[i] - s.f[i]) ** 2
        w2 += w[i] * w[i]
        f2 += f[i] * f[i]
    if dt > p.gap_s:
        s.attitude_extra += (dw2 + GAP_RATE_PSD * dt) * dt * dt / 12.0
        s.velocity_extra += (df2 + GAP_FORCE_PSD * dt) * dt * dt / 12.0
    if s.held_s > 0.0:
        s.attitude_extra += GAP_RATE_PSD * s.held_s * s.held_s * dt
        s.velocity_extra += GAP_FORCE_PSD * s.held_s * s.held_s * dt
    if flags & SATURATED:
        named = flags & (LIMITED_RATE | LIMITED_FORCE)
        if named != LIMITED_FORCE:
            s.attitude_extra += OVERRANGE**2 * w2 * dt
        if named != LIMITED_RATE:
            s.velocity_extra += OVERRANGE**2 * f2 * dt
