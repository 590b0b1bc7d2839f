"""How the errors grow between measurements: the covariance is propagated over what has gathered since the last time.

p' = v; v' = phi x f - C ba; phi' = -C (bg + s w_down); biases and mounting walk; the GNSS wander is Gauss-Markov.
Left out, being below a hundredth of what a MEMS sensor adds in minutes: Coriolis and frame rotation of the errors,
the change of gravity and of transport rate with them. Scale factors and misalignments have states (s) for turns about
the vertical only; else they act as noise that grows with the rate and with the force beyond gravity.

Source: Groves, Principles of GNSS, Inertial and Multisensor Integrated Navigation (2013), sec. 14.2.
"""

import math
from typing import Any

from ...kernels.earth import STANDARD_GRAVITY
from ...kernels.jit import kernel
from ...kernels.kalman import packed_index, reset, scale, shear, shear3
from ...kernels.rotation import dcm_of_quat, quat_rotate_back
from ..records import AT_REST
from .creep import carry_pull
from .matching import feel
from .state import (
    ACCEL_BIAS,
    ARM,
    ATTITUDE,
    GYRO_BIAS,
    LEVELLING,
    MOUNT_PITCH,
    MOUNT_YAW,
    POSITION,
    STATES,
    TURN_SCALE,
    VELOCITY,
    WANDER,
)
from .strapdown import rotate

INTERVAL_S = 0.0195  # the covariance follows at about 50 Hz
WANDER_S = 40.0  # time constant of the GNSS position error (four real receivers: 20 to 60 s)
FORCE_SCALE_S, RATE_SCALE_S = 0.2, 0.05  # how long a scale-factor error acts in one direction
SHAKEN_NOISE = 0.011  # (m/s)/sqrt(s), of an accelerometer on a vehicle under way, beyond its own
SHAKEN_WALK = 2e-3  # (m/s^2)/sqrt(s), vibration rectified into bias
MOUNT_WALK = math.radians(0.02) ** 2  # rad^2/s, load and suspension
ARM_WALK = 0.01**2  # m^2/s, where a vehicle turns about depends on load and ground
SECOND_ORDER_S = 1.0  # how long such an error of acceleration lasts
NOTABLE_TURN = 1e-3  # rad
UNEVEN = 0.5  # share of a gyro error in turns about the vertical that its states, constant factors, do not explain
ALIGNED = 0.35  # misalignment over scale factor (M-G350 sheet: 0.1 deg and 0.5 %)
SCALE_WALK = 5e-5**2  # 1/s, with temperature
LEVEL_ACCEL, LEVEL_ACCEL_S = 0.3, 1.0  # m/s^2, s: what is not felt of an acceleration in unknown direction; its time


@kernel
def variance(c: Any, i: int) -> float:
    """P[i, i]."""
    return float(c.P[packed_index(STATES, i, i)])


@kernel
def deviation(c: Any, i: int) -> float:
    """Square root of P[i, i]."""
    return math.sqrt(max(variance(c, i), 0.0))


@kernel
def grow(c: Any, i: int, q: float) -> None:
    """P[i, i] += q."""
    c.P[packed_index(STATES, i, i)] += q


@kernel
def couple(c: Any, dt: float) -> None:
    """Velocity errors from attitude and accelerometer bias, over `dt`."""
    m = dcm_of_quat((c.q[0], c.q[1], c.q[2], c.q[3]))
    fx, fy, fz = c.dv[0], c.dv[1], c.dv[2]
    if c.flags & AT_REST:  # known better than felt: no false knowledge of the heading from noise in fx, fy
        fx, fy, fz = 0.0, 0.0, -STANDARD_GRAVITY * dt
    shear3(c.P, STATES, VELOCITY, ATTITUDE, 0.0, fz, -fy)
    shear3(c.P, STATES, VELOCITY + 1, ATTITUDE, -fz, 0.0, fx)
    shear3(c.P, STATES, VELOCITY + 2, ATTITUDE, fy, -fx, 0.0)
    for i in range(3):
        k = 3 * i
        shear3(c.P, STATES, VELOCITY + i, ACCEL_BIAS, -m[k] * dt, -m[k + 1] * dt, -m[k + 2] * dt)


@kernel
def second_order(c: Any, accel2: float) -> float:
    """Velocity noise, m^2/s^3, for what a linear model of an uncertain heading leaves out of the acceleration.

    The acceleration itself is shortened by half the square of the heading's error, and that of a wrong tilt or bias
    points elsewhere by the heading's error.
    """
    heading2 = variance(c, ATTITUDE + 2)
    tilt2 = 0.5 * (variance(c, ATTITUDE) + variance(c, ATTITUDE + 1))
    return float((0.5 * heading2 * accel2 + STANDARD_GRAVITY**2 * tilt2) * heading2 * SECOND_ORDER_S)


@kernel
def doubt_turn_scale(p: Any, c: Any) -> None:
    """Nothing is known of what turns show: along the vertical a scale factor, across it axes out of line."""
    down = quat_rotate_back((c.q[0], c.q[1], c.q[2], c.q[3]), (0.0, 0.0, 1.0))
    along, across = p.gyro_scale**2, (ALIGNED * p.gyro_scale) ** 2
    for i in range(3):
        reset(c.P, STATES, TURN_SCALE + i, across)
    for i in range(3):
        for k in range(i, 3):
            c.P[packed_index(STATES, TURN_SCALE + i, TURN_SCALE + k)] += (along - across) * down[i] * down[k]


@kernel
def take_back(c: Any, m: Any) -> float:
    """Turn back by what the gyro has shown too much of a turn, once that is notable; returns the angle of the turn.

    What the body turned through, not a smoothed rate times the time: a wrong axis shows as a tilt and an accelerometer
    bias, both fixed in the body, and nothing tells the three apart unless the turn lags behind the body.
    """
    angle: float = c.owed
    if abs(angle) < NOTABLE_TURN:
        return 0.0
    a, b, d = c.turn_scale[0] * angle, c.turn_scale[1] * angle, c.turn_scale[2] * angle
    rotate(c, -m[0] * a - m[1] * b - m[2] * d, -m[3] * a - m[4] * b - m[5] * d, -m[6] * a - m[7] * b - m[8] * d)
    for i in range(3):
        k = 3 * i
        shear3(c.P, STATES, ATTITUDE + i, TURN_SCALE, -m[k] * angle, -m[k + 1] * angle, -m[k + 2] * angle)
    c.owed = 0.0
    return angle


@kernel
def predict(p: Any, c: Any) -> None:
    """Propagate P over the gathered interval and start a new one."""
    dt = c.gathered
    if dt <= 0.0:
        return
    for i in range(3):
        shear(c.P, STATES, POSITION + i, VELOCITY + i, dt)
    accel2 = c.accel[0] ** 2 + c.accel[1] ** 2 + c.accel[2] ** 2
    qv = p.accel_psd + SHAKEN_NOISE**2 * c.shaking + c.vibration_accel + p.accel_scale**2 * accel2 * FORCE_SCALE_S
    if c.phase == LEVELLING:
        qv = (LEVEL_ACCEL**2 + accel2) * LEVEL_ACCEL_S if not c.flags & AT_REST else 0.0
    else:
        qv += second_order(c, accel2)
        couple(c, dt)
    m = dcm_of_quat((c.q[0], c.q[1], c.q[2], c.q[3]))
    for i in range(3):
        k = 3 * i
        shear3(c.P, STATES, ATTITUDE + i, GYRO_BIAS, -m[k] * dt, -m[k + 1] * dt, -m[k + 2] * dt)
    angle = m[6] * c.turned[0] + m[7] * c.turned[1] + m[8] * c.turned[2]
    feel(c, angle, dt)
    c.owed += angle
    angle = take_back(c, m)
    turn = m[6] * c.rate[0] + m[7] * c.rate[1] + m[8] * c.rate[2]
    rate2 = c.rate[0] ** 2 + c.rate[1] ** 2 + c.rate[2] ** 2 - (1.0 - UNEVEN) * turn * turn
    gyro_psd = max(p.gyro_psd, c.floor * c.floor * p.period / 3.0)  # its quietest is all noise
    qa = gyro_psd + c.vibration_gyro + p.gyro_scale**2 * rate2 * RATE_SCALE_S
    decay = math.exp(-dt / WANDER_S)
    carry_pull(c, m, angle, dt, decay)
    for i in range(3):
        scale(c.P, STATES, WANDER + i, decay)
        c.wander[i] *= decay
        c.doubt[i] *= decay * decay
        sigma = c.wandering[0] if i < 2 else c.wandering[1]
        grow(c, WANDER + i, sigma * sigma * (1.0 - decay * decay))
        grow(c, VELOCITY + i, qv * dt)
        grow(c, ATTITUDE + i, qa * dt)
        grow(c, GYRO_BIAS + i, p.gyro_walk * dt)
        grow(c, ACCEL_BIAS + i, (p.accel_walk + SHAKEN_WALK**2 * c.shaking) * dt)
        grow(c, TURN_SCALE + i, SCALE_WALK * dt)
        c.excess[i] = c.turn_scale[i] * turn
        c.dv[i] = c.turned[i] = 0.0
    grow(c, MOUNT_PITCH, MOUNT_WALK * dt)
    grow(c, MOUNT_YAW, MOUNT_WALK * dt)
    grow(c, ARM, ARM_WALK * dt)
    c.gathered = 0.0
