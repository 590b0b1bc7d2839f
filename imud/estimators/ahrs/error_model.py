"""How the errors grow: transition and process noise of the covariance over one interval.

The transition is F integrated over the interval, applied as a product of elementary steps (`kalman.shear`). With C the
attitude, f the specific force, w the rate: position from velocity, velocity from attitude (C f)x, accelerometer bias
-C, scale -C diag(f) and delay C (f x w), attitude from gyro bias -C and gyro matrix -C [w' . .].

Accelerometer noise, gyro noise and the walk of the gyro bias grow with the motion, by densities found on hand-held
recordings with optical truth (BROAD). A shock or a vibration is over, or has reversed, before the next sample: what of
the force its last change did not announce is a velocity that is not resolved, and rotations come with it that the gyro
does not resolve either (a tap turned the BROAD sensor by half a degree unseen).

Yaw does not enter: the errors of velocity and position are counted in axes that turn with the yaw error, so that no
pseudo-measurement can seem to observe it.
"""

from typing import Any

from ...compile.jit import kernel, unrolled
from ...math.kalman import packed_index, scale, shear, shear3
from ...math.rotation import Vector
from .state import ACCEL_BIAS, ACCEL_DELAY, ACCEL_SCALE, ATTITUDE, GYRO_BIAS, GYRO_MATRIX, POSITION, STATES, VELOCITY


@kernel
def variance(s: Any, i: int) -> float:
    """P[i, i]."""
    return float(s.cov.P[packed_index(STATES, i, i)])


@kernel
def add_variance(s: Any, i: int, q: float) -> None:
    """P[i, i] += q."""
    s.cov.P[packed_index(STATES, i, i)] += q


@unrolled
def couple(s: Any, i: int, j: int, integrals: Any, k: int) -> None:
    """Phi[i, j:j + 3] = -integrals[k:k + 3]."""
    shear3(s.cov.P, STATES, i, j, -integrals[k], -integrals[k + 1], -integrals[k + 2])


@kernel
def propagate_covariance(p: Any, s: Any) -> None:
    """P <- Phi P Phi' + Q over the interval since the last call."""
    P, total = s.cov.P, s.integrals
    for i in range(3):
        scale(P, STATES, POSITION + i, max(1.0 - total.time / p.tuning.position_decay_time_s, 0.0))
        shear(P, STATES, POSITION + i, VELOCITY + i, total.time)
    shear(P, STATES, VELOCITY, ATTITUDE + 1, total.delta_v[2])
    shear(P, STATES, VELOCITY + 1, ATTITUDE, -total.delta_v[2])
    shear(P, STATES, VELOCITY + 2, ATTITUDE, total.delta_v[1])
    shear(P, STATES, VELOCITY + 2, ATTITUDE + 1, -total.delta_v[0])
    for i in range(3):
        shear(P, STATES, VELOCITY + i, ACCEL_DELAY, total.c_f_cross_w[i])
        couple(s, VELOCITY + i, ACCEL_BIAS, total.c, 3 * i)
        couple(s, VELOCITY + i, ACCEL_SCALE, total.c_diag_f, 3 * i)
    for i in range(3):
        couple(s, ATTITUDE + i, GYRO_BIAS, total.c, 3 * i)
        for j in range(3):
            couple(s, ATTITUDE + i, GYRO_MATRIX + 3 * j, total.c_outer_w, 9 * i + 3 * j)
    add_process_noise(p, s)


@kernel
def add_process_noise(p: Any, s: Any) -> None:
    """P += Q over the interval."""
    t, c, total = s.integrals.time, p.tuning, s.integrals
    a2 = total.a_outer_a[0] + total.a_outer_a[3] + total.a_outer_a[5]
    bias = p.gyro_bias_psd * t + c.gyro_bias_walk_per_acceleration**2 * a2
    attitude = p.gyro_psd * t + c.gyro_noise_per_rate**2 * total.w2 + total.attitude_noise
    for i in range(3):
        add_variance(s, ATTITUDE + i, attitude)
        add_variance(s, GYRO_BIAS + i, bias)
        add_variance(s, VELOCITY + i, p.accel_psd * t + total.velocity_noise)
        add_variance(s, ACCEL_BIAS + i, p.accel_bias_psd * t)
    k = 0
    for i in range(3):
        for j in range(i, 3):
            at = packed_index(STATES, VELOCITY + i, VELOCITY + j)
            s.cov.P[at] += c.accel_noise_per_acceleration**2 * total.a_outer_a[k]
            k += 1


@kernel
def add_shock_noise(p: Any, s: Any, f: Vector, dt: float) -> None:
    """Attitude noise from the change of the specific force (sample f, dt s after the last) that no trend announced."""
    unannounced2 = 0.0
    for i in range(3):
        change = f[i] - s.imu.f[i]
        unannounced2 += (change - s.imu.f_change[i]) ** 2
        s.imu.f_change[i] = change
    s.integrals.attitude_noise += p.tuning.shock_rotation**2 * unannounced2 * dt * dt


@kernel
def reset_integrals(s: Any) -> None:
    """Begin a new interval."""
    total = s.integrals
    total.time = total.w2 = total.attitude_noise = total.velocity_noise = 0.0
    for i in range(3):
        total.delta_v[i] = total.c_f_cross_w[i] = 0.0
    for i in range(6):
        total.a_outer_a[i] = 0.0
    for i in range(9):
        total.c[i] = total.c_diag_f[i] = 0.0
    for i in range(27):
        total.c_outer_w[i] = 0.0
