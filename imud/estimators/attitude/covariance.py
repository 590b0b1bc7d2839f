"""How the errors of the attitude filter grow over the gathered interval, and what small velocity and position tell.

No sensor sees velocity or position; that a body does not run away is the knowledge that levels it. Velocity is taken
to be zero with a noise as large as the motion is lively, position (leaking) to stay within a metre or two. Tilt, the
biases and the gyro's matrix follow through the covariance. Accelerometer and gyro noise grow with the motion.
"""

from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import measure, packed_index, reset, scale, shear, update
from ...kernels.rotation import euler_variances, quat_exp, quat_normalised, quat_product

from .state import (
    ACCEL_BIAS,
    ACCEL_SCALE,
    ATTITUDE,
    GYRO_BIAS,
    GYRO_MATRIX,
    LAG,
    POSITION,
    STATES,
    VELOCITY,
)
from .strapdown import LEAK_S

GYRO_MOTION = 4.2e-4  # sqrt(s): gyro noise in proportion to |w|
GYRO_MATRIX_PSD = 2.2e-5**2  # 1/s
ACCEL_MOTION = 0.02  # sqrt(s): accelerometer noise in proportion to the acceleration
VELOCITY_NOISE = 0.023  # m/s sqrt(s), of zero velocity in slow motion
VELOCITY_LIVELY = 1.49  # sqrt(s), of it in proportion to the liveliness
POSITION_NOISE = 2.9  # m sqrt(s)
REST_VELOCITY_NOISE = 0.09  # m/s sqrt(s)
START_VELOCITY_VAR = 0.1
START_POSITION_VAR = 0.1


@kernel
def variance(s: Any, i: int) -> float:
    """P[i, i]."""
    return float(s.P[packed_index(STATES, i, i)])


@kernel
def grow(s: Any, i: int, q: float) -> None:
    """P[i, i] += q."""
    s.P[packed_index(STATES, i, i)] += q


@kernel
def predict(p: Any, s: Any) -> None:
    """Propagate P over the gathered interval: position from velocity, velocity from attitude, attitude from gyro."""
    P, t = s.P, s.span
    for i in range(3):
        scale(P, STATES, POSITION + i, 1.0 - t / LEAK_S)
        shear(P, STATES, POSITION + i, VELOCITY + i, t)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        if j < 2:
            shear(P, STATES, VELOCITY + i, ATTITUDE + j, s.push[k])
        if k < 2:
            shear(P, STATES, VELOCITY + i, ATTITUDE + k, -s.push[j])
        shear(P, STATES, VELOCITY + i, LAG, s.sweep[i])
        for l in range(3):
            shear(P, STATES, VELOCITY + i, ACCEL_BIAS + l, -s.turn[3 * i + l])
            shear(P, STATES, VELOCITY + i, ACCEL_SCALE + l, -s.turn_force[3 * i + l])
    for i in range(3):
        for l in range(3):
            shear(P, STATES, ATTITUDE + i, GYRO_BIAS + l, -s.turn[3 * i + l])
        for l in range(9):
            shear(P, STATES, ATTITUDE + i, GYRO_MATRIX + l, -s.turn_rate[9 * i + l])
    add_noise(p, s)


@kernel
def add_noise(p: Any, s: Any) -> None:
    """Process noise of the gathered interval."""
    t = s.span
    attitude = p.gyro_psd * t + GYRO_MOTION**2 * s.spin + s.attitude_extra
    for i in range(3):
        grow(s, ATTITUDE + i, attitude)
        grow(s, GYRO_BIAS + i, p.gyro_bias_psd * t)
        grow(s, VELOCITY + i, p.accel_psd * t + s.velocity_extra)
        grow(s, ACCEL_BIAS + i, p.accel_bias_psd * t)
    for i in range(9):
        grow(s, GYRO_MATRIX + i, GYRO_MATRIX_PSD * t)
    k = 0
    for i in range(3):
        for j in range(i, 3):
            s.P[packed_index(STATES, VELOCITY + i, VELOCITY + j)] += ACCEL_MOTION**2 * s.motion[k]
            k += 1


@kernel
def clear(s: Any) -> None:
    """Begin a new interval."""
    s.span = s.spin = s.attitude_extra = s.velocity_extra = 0.0
    for i in range(3):
        s.push[i] = s.sweep[i] = 0.0
    for i in range(6):
        s.motion[i] = 0.0
    for i in range(9):
        s.turn[i] = s.turn_force[i] = 0.0
    for i in range(27):
        s.turn_rate[i] = 0.0


@kernel
def observe(s: Any, i: int, z: float, r: float) -> None:
    """Take the error of state i as measured to be z with variance r."""
    s.column[0] = i
    innovation = measure(s.P, STATES, s.column, s.one, 1, s.d) + r
    update(s.P, STATES, s.x, s.d, innovation, z - s.x[i], STATES)


@kernel
def hold_still(p: Any, s: Any) -> None:
    """At rest: the mean rate is the gyro bias, velocity is zero."""
    for i in range(3):
        observe(s, GYRO_BIAS + i, s.w_mean[i] - s.bg[i], p.rest_rate_psd / s.span)
    for i in range(3):
        observe(s, VELOCITY + i, -s.v[i], REST_VELOCITY_NOISE**2 / s.span)
        observe(s, POSITION + i, -s.p[i], POSITION_NOISE**2 / s.span)


@kernel
def hold_near(s: Any) -> None:
    """In motion: velocity is about zero, the livelier the less surely, and position within metres."""
    e = s.v_energy
    for i in range(3):
        lively = 0.5 * (e[0] + e[1] + e[2]) + 1.5 * e[i]
        observe(s, VELOCITY + i, -s.v[i], (VELOCITY_NOISE**2 + VELOCITY_LIVELY**2 * lively) / s.span)
    for i in range(3):
        observe(s, POSITION + i, -s.p[i], POSITION_NOISE**2 / s.span)


@kernel
def forget_motion(s: Any) -> None:
    """Without weight nothing is known of velocity, and nothing learned from it."""
    for i in range(3):
        s.v[i] = s.p[i] = s.v_mean[i] = s.v_energy[i] = 0.0
        reset(s.P, STATES, VELOCITY + i, START_VELOCITY_VAR)
        reset(s.P, STATES, POSITION + i, START_POSITION_VAR)


@kernel
def correct(s: Any) -> None:
    """Carry the gathered error estimate over into the nominal state and clear it."""
    x = s.x
    turn = quat_exp(x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2])
    q = quat_normalised(quat_product(turn, (s.q[0], s.q[1], s.q[2], s.q[3])))
    s.q[0], s.q[1], s.q[2], s.q[3] = q
    for i in range(3):
        s.bg[i] += x[GYRO_BIAS + i]
        s.v[i] += x[VELOCITY + i]
        s.v_mean[i] += x[VELOCITY + i]
        s.p[i] += x[POSITION + i]
        s.ba[i] += x[ACCEL_BIAS + i]
        s.sa[i] += x[ACCEL_SCALE + i]
    for i in range(9):
        s.gm[i] += x[GYRO_MATRIX + i]
    s.lag += x[LAG]
    for i in range(STATES):
        x[i] = 0.0


@kernel
def report(s: Any) -> None:
    """Standard deviations for the solution."""
    P = s.P
    variances = euler_variances(
        (s.q[0], s.q[1], s.q[2], s.q[3]),
        P[packed_index(STATES, 0, 0)],
        P[packed_index(STATES, 0, 1)],
        P[packed_index(STATES, 0, 2)],
        P[packed_index(STATES, 1, 1)],
        P[packed_index(STATES, 1, 2)],
        P[packed_index(STATES, 2, 2)],
    )
    s.sigma_tilt = max(P[packed_index(STATES, 0, 0)], P[packed_index(STATES, 1, 1)]) ** 0.5
    for i in range(3):
        s.sigma_rpy[i] = max(variances[i], 0.0) ** 0.5
        s.sigma_bg[i] = variance(s, GYRO_BIAS + i) ** 0.5
        s.sigma_ba[i] = variance(s, ACCEL_BIAS + i) ** 0.5
