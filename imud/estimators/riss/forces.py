"""The measurements of each step: longitudinal and lateral specific force, else the device's own tilt; and rest."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from .ekf import fuse, inject_error, pitch_of, roll_of, set_jacobian, variance
from .state import (
    ACCEL,
    ACCEL_BIAS_X,
    ACCEL_BIAS_Y,
    GYRO_BIAS,
    GYRO_SCALE,
    LEAN,
    PITCH,
    ROLL,
    SINK,
    SPEED,
    SQUAT,
)

if TYPE_CHECKING:
    from .types import RissParameters, RissState

REST_SPEED, REST_ACCEL = 0.03, 0.03  # m/s, m/s^2, 1 sigma at rest


@kernel
def level(s: RissState, f: tuple[float, float, float]) -> None:
    """Initialize roll and pitch by a specific force."""
    s.x[ROLL] = elementary.atan2(-f[1], -f[2])
    s.x[PITCH] = elementary.atan2(f[0], math.sqrt(f[1] * f[1] + f[2] * f[2]))
    s.levelled = 1


@kernel
def fuse_forces(p: RissParameters, s: RissState, f: tuple[float, float, float], rate: float, T: float) -> None:
    """Fuse the mean specific forces f_x and f_y of a step of T s; rate: the mean measured yaw rate."""
    x = s.x
    noise = p.accel_psd / T + p.tuning.force_sigma**2 + s.force_scatter
    roll, pitch = roll_of(s), pitch_of(s)
    sr, cr, sp, cp = elementary.sin(roll), elementary.cos(roll), elementary.sin(pitch), elementary.cos(pitch)
    g, a, across = s.gravity, x[ACCEL], x[SPEED] * s.yaw_rate
    by_pitch = g * cp - a * sp
    n = set_jacobian(s, 0, ACCEL, cp + by_pitch * x[SQUAT])
    n = set_jacobian(s, n, PITCH, by_pitch)
    n = set_jacobian(s, n, SQUAT, by_pitch * a)
    n = set_jacobian(s, n, ACCEL_BIAS_X, 1.0)
    fuse(s, n, f[0] - (a * cp + g * sp + x[ACCEL_BIAS_X]), noise)
    by_roll = -across * sr + (a * sp - g * cp) * cr
    by_across = cr - by_roll * x[LEAN]
    by_rate = by_across * x[SPEED] * cr / max(cp, 0.1)
    n = set_jacobian(s, 0, SPEED, s.yaw_rate * by_across)
    n = set_jacobian(s, n, ROLL, by_roll)
    n = set_jacobian(s, n, PITCH, (a * cp + g * sp) * sr)
    n = set_jacobian(s, n, LEAN, -by_roll * across)
    n = set_jacobian(s, n, ACCEL_BIAS_Y, 1.0)
    n = set_jacobian(s, n, GYRO_BIAS, -by_rate)
    n = set_jacobian(s, n, GYRO_SCALE, -by_rate * rate)
    predicted = across * cr + (a * sp - g * cp) * sr + x[ACCEL_BIAS_Y]
    # second-order term of the product of speed and yaw rate, which the Jacobian does not contain
    both = variance(s, SPEED) * (variance(s, GYRO_BIAS) + rate * rate * variance(s, GYRO_SCALE))
    fuse(s, n, f[1] - predicted, noise + both)
    inject_error(s)


@kernel
def fuse_device_tilt(p: RissParameters, s: RissState, down: tuple[float, float, float], T: float) -> None:
    """Fuse the vertical that the device has computed itself, where its forces are not valid.

    It is the direction of a force, so it contains accelerations, which are correlated over several steps: the noise
    variance of each step of T s is multiplied by their number.
    """
    x = s.x
    correlated_steps = max(p.tuning.accel_time_s / T, 1.0)
    along_var = (p.tuning.accel_sigma**2 + p.accel_bias_var) / s.gravity**2
    pitch = elementary.atan2(-down[0], math.sqrt(down[1] ** 2 + down[2] ** 2))
    fuse(s, set_jacobian(s, 0, PITCH, 1.0), pitch - x[PITCH], along_var * correlated_steps)
    across = x[SPEED] * s.yaw_rate
    across_var = variance(s, SPEED) * s.yaw_rate**2 + 0.25 * across * across + p.accel_bias_var
    roll = elementary.atan2(down[1], down[2]) + across / s.gravity
    roll_var = (across_var + p.tuning.force_sigma**2) / s.gravity**2
    fuse(s, set_jacobian(s, 0, ROLL, 1.0), roll - x[ROLL], roll_var * correlated_steps)
    inject_error(s)


@kernel
def detect_rest(p: RissParameters, s: RissState, f: tuple[float, float, float], T: float) -> None:
    """Detect rest: for rest_s the receiver was slow, the vehicle did not turn, and the specific forces did not change.

    Without a receiver no rest is detected.
    """
    slow = s.last_slow_ns > 0 and s.step_ns - s.last_slow_ns < p.tuning.coasting_s * 1e9
    turning = abs(s.yaw_rate) > p.tuning.rest_rate + 3.0 * math.sqrt(variance(s, GYRO_BIAS))
    noise = math.sqrt(p.accel_psd / T + s.force_scatter / s.force_count)
    accelerated = noise > p.tuning.rest_force  # in vibration the start of the vehicle would be noticed too late
    for i in range(2):
        accelerated = accelerated or abs(f[i] - s.rest_f[i]) > p.tuning.rest_force + 3.0 * noise
    if turning or accelerated or not slow:
        s.rest_since_ns = 0
        s.rest_f[0], s.rest_f[1] = f[0], f[1]
    elif s.rest_since_ns == 0:
        s.rest_since_ns = s.step_ns
    for i in range(2):
        s.rest_f[i] += min(T / p.tuning.rest_s, 1.0) * (f[i] - s.rest_f[i])
    s.resting = 1 if s.rest_since_ns > 0 and s.step_ns - s.rest_since_ns > p.tuning.rest_s * 1e9 else 0


@kernel
def fuse_rest(p: RissParameters, s: RissState, rate: float, T: float) -> None:
    """Fuse zero speed, acceleration and yaw rate."""
    x = s.x
    # disturbances of a rest are correlated over half a second, so the variance is that of all steps in it
    correlated_steps = 0.5 / T
    n = set_jacobian(s, 0, SPEED, 1.0)
    fuse(s, n, -x[SPEED], REST_SPEED**2 * correlated_steps)
    n = set_jacobian(s, 0, ACCEL, 1.0)
    fuse(s, n, -x[ACCEL], REST_ACCEL**2 * correlated_steps)
    n = set_jacobian(s, 0, SINK, 1.0)
    fuse(s, n, -x[SINK], REST_SPEED**2 * correlated_steps)
    n = set_jacobian(s, 0, GYRO_BIAS, 1.0)
    n = set_jacobian(s, n, GYRO_SCALE, rate)
    fuse(s, n, rate * (1.0 - x[GYRO_SCALE]) - x[GYRO_BIAS], p.gyro_psd / T)
    inject_error(s)
