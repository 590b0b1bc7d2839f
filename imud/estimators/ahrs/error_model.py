"""How the errors grow: transition and process noise of the covariance over one interval.

The transition is F integrated over the interval, applied as a product of elementary steps (`kalman.shear`). With C the
attitude, f the specific force, w the rate: position from velocity, velocity from attitude (C f)x, accelerometer bias
-C, scale -C diag(f) and delay C (f x w), attitude from gyro bias -C and gyro matrix -C [w' . .].

Accelerometer noise, gyro noise and the walk of the gyro bias grow with the motion, by densities found on hand-held
recordings with optical truth (BROAD).

Yaw does not enter: the errors of velocity and position are counted in axes that turn with the yaw error, so that no
pseudo-measurement can seem to observe it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel, unrolled
from ...math.kalman import packed_index, reset, scale, shear, shear3
from .history import record_age, record_reset, record_transition
from .state import ACCEL_BIAS, ACCEL_DELAY, ACCEL_SCALE, ATTITUDE, GYRO_BIAS, GYRO_MATRIX, POSITION, STATES, VELOCITY

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from ...math.rotation import Matrix, Vector
    from .types import Parameters, State


@kernel
def variance(s: State, i: int) -> float:
    """P[i, i]."""
    return float(s.cov.P[packed_index(STATES, i, i)])


@kernel
def add_variance(s: State, i: int, q: float) -> None:
    """P[i, i] += q."""
    s.cov.P[packed_index(STATES, i, i)] += q


@kernel
def add_attitude_variance(s: State, axis: Vector, q: float) -> None:
    """Add the variance q, rad^2, about a unit vector in NED."""
    for i in range(3):
        for j in range(i, 3):
            s.cov.P[packed_index(STATES, ATTITUDE + i, ATTITUDE + j)] += q * axis[i] * axis[j]


@kernel
def add_bias_variance(s: State, error: Vector) -> None:
    """Add a gyro bias error, rad/s, of this size and direction."""
    for i in range(3):
        for j in range(i, 3):
            s.cov.P[packed_index(STATES, GYRO_BIAS + i, GYRO_BIAS + j)] += error[i] * error[j]


@kernel
def reset_variance(s: State, i: int, variance: float) -> None:
    """Make error state i independent of the others, with this variance."""
    reset(s.cov.P, STATES, i, variance)
    record_reset(s, i)


@kernel
def replace_variance(s: State, i: int, variance_: float) -> None:
    """Give error state i this variance, with the same correlations; what comes later tells nothing of it before."""
    scale(s.cov.P, STATES, i, (variance_ / variance(s, i)) ** 0.5)
    record_reset(s, i)


@kernel
def couple_yaw_to_bias(s: State, times: Vector) -> None:
    """The error of yaw has been made, in these times, s, by that of the gyro bias, too."""
    shear3(s.cov.P, STATES, ATTITUDE + 2, GYRO_BIAS, times[0], times[1], times[2])


@kernel
def age_tilt(s: State, i: int, columns_of_c: Vector, time: float) -> None:
    """Tilt i is that of `time` ago: its error has grown with the gyro bias since. `columns_of_c`: row i of C."""
    for j in range(3):
        shear(s.cov.P, STATES, ATTITUDE + i, GYRO_BIAS + j, -time * columns_of_c[j])
    record_age(s, i, columns_of_c, time)


@kernel
def widen_bias(s: State, added: float, C: Matrix, tilt_s: float, yaw_s: float) -> None:
    """Add to the variances of the gyro bias; its error has turned the tilt for tilt_s and the yaw for yaw_s by then."""
    for i in range(3):
        time = yaw_s if i == 2 else tilt_s
        row = (time * C[3 * i], time * C[3 * i + 1], time * C[3 * i + 2])
        shear3(s.cov.P, STATES, ATTITUDE + i, GYRO_BIAS, row[0], row[1], row[2])
    for i in range(3):
        add_variance(s, GYRO_BIAS + i, added)
    for i in range(3):
        time = yaw_s if i == 2 else tilt_s
        row = (time * C[3 * i], time * C[3 * i + 1], time * C[3 * i + 2])
        shear3(s.cov.P, STATES, ATTITUDE + i, GYRO_BIAS, -row[0], -row[1], -row[2])


@unrolled
def couple(s: State, i: int, j: int, integrals: Reals, k: int) -> None:
    """Phi[i, j:j + 3] = -integrals[k:k + 3]."""
    shear3(s.cov.P, STATES, i, j, -integrals[k], -integrals[k + 1], -integrals[k + 2])


@kernel
def propagate_covariance(p: Parameters, s: State) -> None:
    """P <- Phi P Phi' + Q over the interval since the last call."""
    P, total = s.cov.P, s.integrals
    record_transition(s)
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
def add_process_noise(p: Parameters, s: State) -> None:
    """P += Q over the interval."""
    t, c, total = s.integrals.time, p.tuning, s.integrals
    a2 = total.a_outer_a[0] + total.a_outer_a[3] + total.a_outer_a[5]
    bias = p.gyro_bias_psd * t + c.gyro_bias_walk_per_acceleration**2 * a2
    accel_bias = p.accel_bias_psd * t
    if s.drag.per_mass > 0.0:
        accel_bias += c.accel_bias_walk_per_acceleration**2 * a2
    attitude = p.gyro_psd * t + c.gyro_noise_per_rate**2 * total.w2 + total.attitude_noise
    for i in range(3):
        add_variance(s, ATTITUDE + i, attitude)
        add_variance(s, GYRO_BIAS + i, bias)
        add_variance(s, VELOCITY + i, p.accel_psd * t + total.velocity_noise)
        add_variance(s, ACCEL_BIAS + i, accel_bias)
    k = 0
    for i in range(3):
        for j in range(i, 3):
            at = packed_index(STATES, VELOCITY + i, VELOCITY + j)
            s.cov.P[at] += c.accel_noise_per_acceleration**2 * total.a_outer_a[k]
            k += 1
