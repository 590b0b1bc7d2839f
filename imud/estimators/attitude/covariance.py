"""How the errors of the attitude filter grow over the gathered interval, and how a measurement corrects them.

Accelerometer noise, gyro noise and the wandering of the gyro's bias grow with the motion, by densities found on
hand-held recordings with optical truth (BROAD). A knock or a vibration is over, or has turned round, before the next
sample: what of the force the change before did not announce is a velocity not resolved, and rotations come with it that
the gyro does not resolve either (a tap turned the BROAD sensor by half a degree unseen).

Yaw does not enter: whatever the heading, small velocity says the same, so the errors of velocity and place are counted
in axes that turn with the yaw error, and no measurement can seem to observe it.
"""

from typing import Any

from ...kernels.jit import kernel, unrolled
from ...kernels.kalman import measure, packed_index, scale, shear, shear3, update
from ...kernels.rotation import Vector, euler_variances, quat_exp, quat_normalised, quat_product
from .state import ACCEL_BIAS, ACCEL_SCALE, ATTITUDE, GYRO_BIAS, GYRO_MATRIX, LAG, PLACE, STATES, VELOCITY
from .strapdown import HOME_S


@kernel
def variance(s: Any, i: int) -> float:
    """P[i, i]."""
    return float(s.P[packed_index(STATES, i, i)])


@kernel
def grow(s: Any, i: int, q: float) -> None:
    """P[i, i] += q."""
    s.P[packed_index(STATES, i, i)] += q


@unrolled
def take_three(s: Any, i: int, j: int, rates: Any, k: int) -> None:
    """Error i loses of errors j to j + 2 what rates[k] and the two after it say."""
    shear3(s.P, STATES, i, j, -rates[k], -rates[k + 1], -rates[k + 2])


@kernel
def predict(p: Any, s: Any) -> None:
    """Propagate P over the gathered interval: place from velocity, velocity from attitude, attitude from gyro."""
    P = s.P
    for i in range(3):
        scale(P, STATES, PLACE + i, max(1.0 - s.span / HOME_S, 0.0))
        shear(P, STATES, PLACE + i, VELOCITY + i, s.span)
    shear(P, STATES, VELOCITY, ATTITUDE + 1, s.push[2])
    shear(P, STATES, VELOCITY + 1, ATTITUDE, -s.push[2])
    shear(P, STATES, VELOCITY + 2, ATTITUDE, s.push[1])
    shear(P, STATES, VELOCITY + 2, ATTITUDE + 1, -s.push[0])
    for i in range(3):
        shear(P, STATES, VELOCITY + i, LAG, s.sweep[i])
        take_three(s, VELOCITY + i, ACCEL_BIAS, s.turn, 3 * i)
        take_three(s, VELOCITY + i, ACCEL_SCALE, s.turn_force, 3 * i)
    for i in range(3):
        take_three(s, ATTITUDE + i, GYRO_BIAS, s.turn, 3 * i)
        for j in range(3):
            take_three(s, ATTITUDE + i, GYRO_MATRIX + 3 * j, s.turn_rate, 9 * i + 3 * j)
    add_noise(p, s)


@kernel
def add_noise(p: Any, s: Any) -> None:
    """Process noise of the gathered interval."""
    t, c = s.span, p.tuning
    bias = p.gyro_bias_psd * t + c.gyro_bias_walk_per_acceleration**2 * (s.motion[0] + s.motion[3] + s.motion[5])
    attitude = p.gyro_psd * t + c.gyro_noise_per_rate**2 * s.spin + s.attitude_extra
    for i in range(3):
        grow(s, ATTITUDE + i, attitude)
        grow(s, GYRO_BIAS + i, bias)
        grow(s, VELOCITY + i, p.accel_psd * t + s.velocity_extra)
        grow(s, ACCEL_BIAS + i, p.accel_bias_psd * t)
    k = 0
    for i in range(3):
        for j in range(i, 3):
            s.P[packed_index(STATES, VELOCITY + i, VELOCITY + j)] += c.accel_noise_per_acceleration**2 * s.motion[k]
            k += 1


@kernel
def shake(p: Any, s: Any, f: Vector, dt: float) -> None:
    """Noise of the attitude for what sample f, dt s after the last one, shows of knocks and vibration."""
    unannounced2 = 0.0
    for i in range(3):
        change = f[i] - s.f[i]
        unannounced2 += (change - s.f_change[i]) ** 2
        s.f_change[i] = change
    s.attitude_extra += p.tuning.shock_rotation**2 * unannounced2 * dt * dt


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
    s.columns[0], s.values[0] = i, 1.0
    innovation = measure(s.P, STATES, s.columns, s.values, 1, s.d) + r
    update(s.P, STATES, s.x, s.d, innovation, z - s.x[i], STATES)


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
        s.p[i] += x[PLACE + i]
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
