"""What became of the errors in one covariance interval, recorded for the smoother; the daemon's filter records nothing.

The order is that of the filter: the transition, scalar measurements, the ageing of the tilt (`error_model.age_tilt`).
Before each of them, error states may have been made independent of the others. What only adds variance needs no record.
Who reads it clears it (`clear`), before the next interval ends.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from .state import STATES

if TYPE_CHECKING:
    from ...math.rotation import Vector
    from .types import State


@kernel
def record_transition(s: State) -> None:
    """The interval ends: its integrals, and the attitude before any correction."""
    history, total = s.history, s.integrals
    if history.enabled == 0:
        return
    history.intervals += 1
    history.count = 0
    history.time = total.time
    for i in range(4):
        history.q_before[i] = s.nav.q_nb[i]
    for i in range(3):
        history.delta_v[i] = total.delta_v[i]
        history.c_f_cross_w[i] = total.c_f_cross_w[i]
    for i in range(9):
        history.c[i] = total.c[i]
        history.c_diag_f[i] = total.c_diag_f[i]
    for i in range(27):
        history.c_outer_w[i] = total.c_outer_w[i]


@kernel
def record_measurement(s: State, i: int, innovation: float, innovation_var: float) -> None:
    """State i has been measured; s.scratch.ph holds P h'."""
    history = s.history
    if history.enabled == 0:
        return
    k = history.count
    history.state[k], history.innovation[k], history.innovation_var[k] = i, innovation, innovation_var
    for j in range(STATES):
        history.ph[STATES * k + j] = s.scratch.ph[j]
    history.count = k + 1


@kernel
def record_reset(s: State, i: int) -> None:
    """State i has been made independent of the others."""
    history = s.history
    if history.enabled == 1:
        history.reset_states[history.count + 1] |= 1 << i


@kernel
def record_age(s: State, i: int, columns_of_c: Vector, time: float) -> None:
    """Tilt i has got the error of the gyro bias over this time."""
    if s.history.enabled == 1:
        for j in range(3):
            s.history.age[3 * i + j] = -time * columns_of_c[j]


@kernel
def record_coarse(s: State) -> None:
    """Roll and pitch have been levelled by the force since coarse levelling began."""
    s.history.coarse = s.history.enabled


@kernel
def record_restart(s: State) -> None:
    """Roll and pitch have been initialised."""
    if s.history.enabled == 1:
        s.history.restart_ns = s.t_ns


@kernel
def record_wrong_tilt(s: State, seconds: float) -> None:
    """The tilt has been levelled after it was wrong for so long."""
    if s.history.enabled == 1:
        s.history.wrong_tilt_s = seconds


@kernel
def record_yaw_corrected(s: State) -> None:
    """The correction of the yaw that was left for the first rest is made."""
    s.history.yaw_corrected = s.history.enabled


@kernel
def record_hypotheses(s: State) -> None:
    """What the hypotheses of how the body moves say of the tilt error, and what they have left of the yaw."""
    if s.history.enabled == 1:
        s.history.left_yaw = s.hypotheses.yaw_correction
        s.history.possible_tilt_var = s.hypotheses.possible_tilt_error**2
