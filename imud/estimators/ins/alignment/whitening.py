"""Whitening of the fixes: independent innovations of a small Kalman filter of position, velocity and GNSS bias.

Successive fixes share the receiver's correlated error and the unknown position and velocity at the origin. The small
filter has a state for each of them and predicts a constant velocity, so its innovations are independent, as far as the
integrals of specific force explain the acceleration. The filter is linear: applied to the integrals instead of the
fixes it gives the regressors that belong to the innovations of the fixes. So one covariance whitens the fixes and all
integrals of the alignment, and no rule is needed for the least time between two fixes.

Source: Kailath, An innovations approach to least-squares estimation, part I (1968).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable
from ..state import HYPOTHESES

if TYPE_CHECKING:
    from ..types import HypothesisBank, Parameters
    from .force_integrals import Complex


TUNABLES = (
    Tunable(
        "unmodelled_accel_psd",
        0.05**2,
        "m^2/s^3",
        "Acceleration that the IMU does not show: scale factors, sway, vibration.",
        "Recorded drives.",
    ),
    Tunable("whitening_position_sigma", 1e4, "m", "Sigma of the position before the first fix.", "Uninformative."),
    Tunable("whitening_speed_sigma", 1e2, "m/s", "Sigma of the velocity before the first fix.", "Uninformative."),
)
POSITION_STATE, VELOCITY_STATE, BIAS_STATE = 0, 1, 2  # m, m/s, m; complex numbers, north + i east


@kernel
def reset_whitening(p: Parameters, b: HypothesisBank, bias_sigma: float) -> None:
    """Position and velocity are unknown; the GNSS bias has the sigma `bias_sigma` m."""
    P = b.whitening_P
    P[:] = 0.0
    P[POSITION_STATE, POSITION_STATE], P[VELOCITY_STATE, VELOCITY_STATE], P[BIAS_STATE, BIAS_STATE] = (
        p.tuning.whitening_position_sigma**2,
        p.tuning.whitening_speed_sigma**2,
        bias_sigma**2,
    )
    b.whitening_state[:] = 0.0


@kernel
def predict_whitening(p: Parameters, b: HypothesisBank, bias_sigma: float, learned_psd: float, dt: float) -> None:
    """Predict states and covariance over `dt` s; `bias_sigma` m: steady-state sigma of the GNSS bias.

    learned_psd: m^2/s^3, process noise of the velocity that the drive has shown.
    """
    psd = p.tuning.unmodelled_accel_psd + learned_psd
    P, state = b.whitening_P, b.whitening_state
    decay = elementary.exp(-dt / p.tuning.gnss_bias_time_s)
    for k in range(HYPOTHESES):
        for j in range(5):
            for i in range(2):
                state[k, POSITION_STATE, j, i] += dt * state[k, VELOCITY_STATE, j, i]
                state[k, BIAS_STATE, j, i] *= decay
    P[0, 0] += dt * (2.0 * P[0, 1] + dt * P[1, 1]) + psd * dt**3 / 3.0
    P[0, 1] += dt * P[1, 1] + psd * dt * dt / 2.0
    P[0, 2] = decay * (P[0, 2] + dt * P[1, 2])
    P[1, 1] += psd * dt
    P[1, 2] *= decay
    P[2, 2] = decay * decay * P[2, 2] + bias_sigma**2 * (1.0 - decay * decay)
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@kernel
def whitened_variance(b: HypothesisBank, is_position: bool, r: float) -> float:
    """Innovation variance of a position (else a velocity) of variance r; m^2, or m^2/s^2."""
    P = b.whitening_P
    return float(P[0, 0] + 2.0 * P[0, 2] + P[2, 2] + r if is_position else P[1, 1] + r)


@kernel
def whitened_innovations(b: HypothesisBank, k: int, is_position: bool, measured: Complex, antenna: Complex) -> None:
    """b.innovations <- those of a measured position (m; else velocity, m/s) and of the integrals of hypothesis k.

    antenna: position or velocity of the antenna relative to the IMU, whose motion the integrals are.
    """
    state, integrals = b.whitening_state[k], b.double_integrals[k] if is_position else b.integrals[k]
    for j in range(5):
        for i in range(2):
            value = integrals[j - 1, i] + (antenna[i] if j == 1 else 0.0) if j > 0 else measured[i]
            b.innovations[j, i] = value - (
                state[POSITION_STATE, j, i] + state[BIAS_STATE, j, i] if is_position else state[VELOCITY_STATE, j, i]
            )


@kernel
def whitening_gains(b: HypothesisBank, is_position: bool) -> Any:
    """Covariances of position, velocity and GNSS bias with the innovation: P h."""
    P = b.whitening_P
    if is_position:
        return P[0, 0] + P[0, 2], P[1, 0] + P[1, 2], P[2, 0] + P[2, 2]
    return P[0, 1], P[1, 1], P[2, 1]


@kernel
def update_hypothesis(b: HypothesisBank, k: int, is_position: bool, s: float) -> None:
    """Update the states of hypothesis k with the innovations in b.innovations, of variance s."""
    state, d = b.whitening_state[k], whitening_gains(b, is_position)
    for j in range(5):
        for i in range(2):
            gain = b.innovations[j, i] / s
            state[POSITION_STATE, j, i] += d[0] * gain
            state[VELOCITY_STATE, j, i] += d[1] * gain
            state[BIAS_STATE, j, i] += d[2] * gain


@kernel
def update_whitening(b: HypothesisBank, is_position: bool, s: float) -> None:
    """Update the covariance with an innovation of variance s; it is common to all hypotheses."""
    P, d = b.whitening_P, whitening_gains(b, is_position)
    P[0, 0] -= d[0] * d[0] / s
    P[0, 1] -= d[0] * d[1] / s
    P[0, 2] -= d[0] * d[2] / s
    P[1, 1] -= d[1] * d[1] / s
    P[1, 2] -= d[1] * d[2] / s
    P[2, 2] -= d[2] * d[2] / s
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@kernel
def unobserved_velocity(b: HypothesisBank, k: int, axis: int, column: int) -> float:
    """The part of an integral of hypothesis k that the whitening filter's velocity does not contain yet."""
    return float(b.integrals[k, column, axis] - b.whitening_state[k, VELOCITY_STATE, 1 + column, axis])
