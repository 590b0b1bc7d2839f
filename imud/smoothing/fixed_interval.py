"""Fixed-interval smoother of the attitude filter: the modified Bryson-Frazier form, backward over its record.

The adjoint variables lambda (28) and Lambda (28 x 28) hold what the measurements after an instant show of the error
there. With x = 0 and P the filter's estimate of the error and its covariance,

    smoothed x = -P lambda            smoothed P = P - P Lambda P

Going back over a measurement of state i, with innovation y of variance s, d = P e_i before it, and k = d / s:

    lambda <- (I - k e_i')' lambda - e_i y / s
    Lambda <- (I - k e_i')' Lambda (I - k e_i') + e_i e_i' / s

over a transition Phi: lambda <- Phi' lambda, Lambda <- Phi' Lambda Phi; over a state that was made independent of the
others: its elements become zero. Process noise does not appear, so that whatever made the filter add variance needs no
record, and nothing is inverted. In exact arithmetic it is the Rauch-Tung-Striebel smoother.

Source: Bierman, Fixed interval smoothing with discrete measurements, Int. J. Control 18 (1973).
"""

from typing import Any

import numpy as np

from ..compile.entry import entry
from ..compile.jit import kernel
from ..estimators.ahrs.state import (
    ACCEL_BIAS,
    ACCEL_DELAY,
    ACCEL_SCALE,
    ATTITUDE,
    GYRO_BIAS,
    GYRO_MATRIX,
    POSITION,
    STATES,
    VELOCITY,
)
from ..math.arrays import Records
from ..math.kalman import packed_index

ESTIMATE = np.dtype(  # the smoothed error at the end of an interval: attitude, gyro bias, accelerometer bias
    [
        ("x", "<f8", (9,)),
        ("attitude_var", "<f8", (9,)),  # rad^2, 3 x 3
        ("bias_var", "<f8", (6,)),
    ],
    align=True,
)
ADJOINT = np.dtype(
    [
        ("position_decay_time_s", "<f8"),
        ("vector", "<f8", (STATES,)),  # lambda
        ("matrix", "<f8", (STATES * STATES,)),  # Lambda, by rows
        ("column", "<f8", (STATES,)),  # holds nothing between calls, nor does
        ("product", "<f8", (STATES,)),
    ],
    align=True,
)


def smoothed_estimates(intervals: Records, position_decay_time_s: float) -> Records:
    """ESTIMATE of each of the intervals (INTERVAL), in their order."""
    estimates, adjoint = np.zeros(len(intervals), ESTIMATE), np.zeros(1, ADJOINT)
    adjoint["position_decay_time_s"] = position_decay_time_s
    smooth_intervals(intervals, estimates, adjoint)
    return estimates


@entry
def smooth_intervals(intervals: Records, estimates: Records, adjoint: Records) -> None:
    """Fill the estimates, from the last to the first."""
    for back in range(len(intervals)):
        k = len(intervals) - 1 - back
        _estimate(intervals[k], adjoint[0], estimates[k])
        _undo_corrections(intervals[k].history, adjoint[0])
        _undo_transition(intervals[k].history, adjoint[0])


@kernel
def _estimate(row: Any, adjoint: Any, out: Any) -> None:
    for a in range(9):
        i = a if a < 6 else ACCEL_BIAS + a - 6
        for j in range(STATES):
            adjoint.column[j] = row.P[packed_index(STATES, i, j)]
        out.x[a] = 0.0
        for j in range(STATES):
            out.x[a] -= adjoint.column[j] * adjoint.vector[j]
            product = 0.0
            for m in range(STATES):
                product += adjoint.matrix[STATES * j + m] * adjoint.column[m]
            adjoint.product[j] = product
        if a < 3:
            for b in range(3):
                var = row.P[packed_index(STATES, a, b)]
                for j in range(STATES):
                    var -= row.P[packed_index(STATES, b, j)] * adjoint.product[j]
                out.attitude_var[3 * a + b] = var
        else:
            var = row.P[packed_index(STATES, i, i)]
            for j in range(STATES):
                var -= adjoint.column[j] * adjoint.product[j]
            out.bias_var[a - 3] = max(var, 0.0)


@kernel
def _undo_corrections(history: Any, adjoint: Any) -> None:
    for i in range(2):
        for j in range(3):
            _undo_gain(adjoint, ATTITUDE + i, GYRO_BIAS + j, history.age[3 * i + j])
    _undo_reset(adjoint, history.reset_states[history.count + 1])
    for back in range(history.count):
        k = history.count - 1 - back
        _undo_measurement(history, adjoint, k)
        _undo_reset(adjoint, history.reset_states[k + 1])


@kernel
def _undo_measurement(history: Any, adjoint: Any, k: int) -> None:
    i, s = history.state[k], history.innovation_var[k]
    seen = informed = 0.0  # k' lambda, k' Lambda k
    for j in range(STATES):
        gain = history.ph[STATES * k + j] / s
        seen += gain * adjoint.vector[j]
        product = 0.0
        for m in range(STATES):
            product += adjoint.matrix[STATES * j + m] * history.ph[STATES * k + m] / s
        adjoint.product[j] = product
        informed += gain * product
    adjoint.vector[i] -= seen + history.innovation[k] / s
    for j in range(STATES):
        adjoint.matrix[STATES * i + j] -= adjoint.product[j]
        adjoint.matrix[STATES * j + i] -= adjoint.product[j]
    adjoint.matrix[STATES * i + i] += informed + 1.0 / s


@kernel
def _undo_reset(adjoint: Any, states: int) -> None:
    """states: bits of those that were made independent of the others."""
    if states == 0:
        return
    for i in range(STATES):
        if states & (1 << i):
            adjoint.vector[i] = 0.0
            for j in range(STATES):
                adjoint.matrix[STATES * i + j] = adjoint.matrix[STATES * j + i] = 0.0


@kernel
def _undo_gain(adjoint: Any, i: int, j: int, a: float) -> None:
    """State i had gained `a` times state j."""
    if a != 0.0:
        adjoint.vector[j] += a * adjoint.vector[i]
        for k in range(STATES):
            adjoint.matrix[STATES * j + k] += a * adjoint.matrix[STATES * i + k]
        for k in range(STATES):
            adjoint.matrix[STATES * k + j] += a * adjoint.matrix[STATES * k + i]


@kernel
def _undo_transition(history: Any, adjoint: Any) -> None:
    """The steps of `error_model.propagate_covariance`, last to first."""
    dv = history.delta_v
    for i in range(3):
        for j in range(3):
            for k in range(3):
                _undo_gain(adjoint, ATTITUDE + i, GYRO_MATRIX + 3 * j + k, -history.c_outer_w[9 * i + 3 * j + k])
            _undo_gain(adjoint, ATTITUDE + i, GYRO_BIAS + j, -history.c[3 * i + j])
    for i in range(3):
        for j in range(3):
            _undo_gain(adjoint, VELOCITY + i, ACCEL_SCALE + j, -history.c_diag_f[3 * i + j])
            _undo_gain(adjoint, VELOCITY + i, ACCEL_BIAS + j, -history.c[3 * i + j])
        _undo_gain(adjoint, VELOCITY + i, ACCEL_DELAY, history.c_f_cross_w[i])
    _undo_gain(adjoint, VELOCITY, ATTITUDE + 1, dv[2])
    _undo_gain(adjoint, VELOCITY + 1, ATTITUDE, -dv[2])
    _undo_gain(adjoint, VELOCITY + 2, ATTITUDE, dv[1])
    _undo_gain(adjoint, VELOCITY + 2, ATTITUDE + 1, -dv[0])
    decay = max(1.0 - history.time / adjoint.position_decay_time_s, 0.0)
    for i in range(3):
        _undo_gain(adjoint, POSITION + i, VELOCITY + i, history.time)
        adjoint.vector[POSITION + i] *= decay
        for k in range(STATES):
            adjoint.matrix[STATES * (POSITION + i) + k] *= decay
        for k in range(STATES):
            adjoint.matrix[STATES * k + POSITION + i] *= decay
    _undo_reset(adjoint, history.reset_states[0])
