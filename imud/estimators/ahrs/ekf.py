"""The error-state Kalman filter: a scalar measurement of one state, injection of the error, standard deviations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.kalman import measure, packed_index, update
from ...math.rotation import euler_variances, quat_exp, quat_normalised, quat_product
from .error_model import variance
from .history import record_measurement
from .motion import shift_mean_velocity
from .state import ACCEL_BIAS, ACCEL_DELAY, ACCEL_SCALE, ATTITUDE, GYRO_BIAS, GYRO_MATRIX, POSITION, STATES, VELOCITY
from .variance_factor import expect_correction

if TYPE_CHECKING:
    from .types import State


@kernel
def fuse_state(s: State, i: int, z: float, r: float) -> None:
    """Kalman update with the error of state i measured as z, noise variance r: the row of H is e_i'."""
    t = s.scratch
    t.columns[0], t.values[0] = i, 1.0
    innovation_variance = measure(s.cov.P, STATES, t.columns, t.values, 1, t.ph) + r
    innovation = z - t.x[i]
    update(s.cov.P, STATES, t.x, t.ph, innovation_variance, innovation)
    expect_correction(s, innovation_variance)
    record_measurement(s, i, innovation, innovation_variance)


@kernel
def inject_error(s: State) -> None:
    """Add the error estimate to the nominal state, and clear it."""
    x, nav = s.scratch.x, s.nav
    turn = quat_exp(x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2])
    q = quat_normalised(quat_product(turn, (nav.q_nb[0], nav.q_nb[1], nav.q_nb[2], nav.q_nb[3])))
    nav.q_nb[0], nav.q_nb[1], nav.q_nb[2], nav.q_nb[3] = q
    for i in range(3):
        nav.bg[i] += x[GYRO_BIAS + i]
        nav.v_n[i] += x[VELOCITY + i]
        shift_mean_velocity(s, i, x[VELOCITY + i])
        nav.p_n[i] += x[POSITION + i]
        nav.ba[i] += x[ACCEL_BIAS + i]
        nav.accel_scale[i] += x[ACCEL_SCALE + i]
    for i in range(9):
        nav.gyro_matrix[i] += x[GYRO_MATRIX + i]
    nav.accel_delay += x[ACCEL_DELAY]
    for i in range(STATES):
        x[i] = 0.0


@kernel
def update_sigmas(s: State) -> None:
    """Standard deviations for the solution."""
    P, cov, q = s.cov.P, s.cov, s.nav.q_nb
    north, east = s.variance_factor.tilt_scale[0], s.variance_factor.tilt_scale[1]
    variances = euler_variances(
        (q[0], q[1], q[2], q[3]),
        north * north * P[packed_index(STATES, 0, 0)],
        north * east * P[packed_index(STATES, 0, 1)],
        north * P[packed_index(STATES, 0, 2)],
        east * east * P[packed_index(STATES, 1, 1)],
        east * P[packed_index(STATES, 1, 2)],
        P[packed_index(STATES, 2, 2)],
    )
    cov.sigma_tilt = max(P[packed_index(STATES, 0, 0)], P[packed_index(STATES, 1, 1)]) ** 0.5
    for i in range(3):
        cov.sigma_rpy[i] = max(variances[i], 0.0) ** 0.5
        cov.sigma_bg[i] = variance(s, GYRO_BIAS + i) ** 0.5
        cov.sigma_ba[i] = variance(s, ACCEL_BIAS + i) ** 0.5


@kernel
def inflate_sigma_tilt(s: State, tilt: float) -> None:
    """Until the next interval: tilt may be wrong by so much more, rad."""
    s.cov.sigma_tilt += tilt
