"""What the receiver says, made independent: innovations of a small filter of position, velocity and wander.

Fixes share the receiver's wander, and the vehicle's unknown place and velocity at the start. A Kalman filter of a
vehicle that moves on as it moved knows of these, and its innovations are independent, as far as what was felt
explains the rest. It is linear: fed with integrals of what was felt instead of fixes, it leaves of them what the same
innovations would be. So one covariance serves the receiver's words and all integrals of `matching`, and how far apart
two fixes have to be for their noise needs no rule.

Source: Kailath, An innovations approach to least-squares estimation, part I (1968).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ....compile.jit import kernel
from ...tuning import Tunable
from ..state import HYPOTHESES

if TYPE_CHECKING:
    from ..types import HypothesisBank, Parameters


TUNABLES = (
    Tunable(
        "unmodelled_accel_psd",
        0.05**2,
        "m^2/s^3",
        "Acceleration that the IMU does not show: scale, sway, vibration.",
        "Recorded drives.",
    ),
    Tunable("whitening_position_sigma", 1e4, "m", "Position before the first fix.", "Uninformative."),
    Tunable("whitening_speed_sigma", 1e2, "m/s", "Velocity before the first fix.", "Uninformative."),
)
PLACE, SPEED, BIAS = 0, 1, 2  # states


@kernel
def reset_whitening(p: Parameters, b: HypothesisBank, wander: float) -> None:
    """Nothing is known of place and velocity; the receiver's position wanders by `wander` m."""
    P = b.whitening_P
    P[:] = 0.0
    P[PLACE, PLACE], P[SPEED, SPEED], P[BIAS, BIAS] = (
        p.tuning.whitening_position_sigma**2,
        p.tuning.whitening_speed_sigma**2,
        wander**2,
    )
    b.whitening_state[:] = 0.0


@kernel
def predict_whitening(p: Parameters, b: HypothesisBank, wander: float, dt: float) -> None:
    """Predict over `dt` s."""
    P, x = b.whitening_P, b.whitening_state
    decay = math.exp(-dt / p.tuning.gnss_bias_time_s)
    for k in range(HYPOTHESES):
        for j in range(5):
            for i in range(2):
                x[k, PLACE, j, i] += dt * x[k, SPEED, j, i]
                x[k, BIAS, j, i] *= decay
    P[0, 0] += dt * (2.0 * P[0, 1] + dt * P[1, 1]) + p.tuning.unmodelled_accel_psd * dt**3 / 3.0
    P[0, 1] += dt * P[1, 1] + p.tuning.unmodelled_accel_psd * dt * dt / 2.0
    P[0, 2] = decay * (P[0, 2] + dt * P[1, 2])
    P[1, 1] += p.tuning.unmodelled_accel_psd * dt
    P[1, 2] *= decay
    P[2, 2] = decay * decay * P[2, 2] + wander**2 * (1.0 - decay * decay)
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@kernel
def whitened_variance(b: HypothesisBank, place: bool, r: float) -> float:
    """Variance of the innovation of a place (else a velocity) of variance r."""
    P = b.whitening_P
    return float(P[0, 0] + 2.0 * P[0, 2] + P[2, 2] + r if place else P[1, 1] + r)


@kernel
def whitened_innovations(b: HypothesisBank, k: int, place: bool, told: Any) -> None:
    """b.innovations <- innovations of a place (m, else a velocity), and of the integrals of hypothesis k."""
    x, integrals = b.whitening_state[k], b.double_integrals[k] if place else b.integrals[k]
    for j in range(5):
        for i in range(2):
            value = integrals[j - 1, i] if j > 0 else told[i]
            b.innovations[j, i] = value - (x[PLACE, j, i] + x[BIAS, j, i] if place else x[SPEED, j, i])


@kernel
def whitening_gains(b: HypothesisBank, place: bool) -> Any:
    """Covariance of place, speed and error with an innovation."""
    P = b.whitening_P
    if place:
        return P[0, 0] + P[0, 2], P[1, 0] + P[1, 2], P[2, 0] + P[2, 2]
    return P[0, 1], P[1, 1], P[2, 1]


@kernel
def update_hypothesis(b: HypothesisBank, k: int, place: bool, s: float) -> None:
    """Let hypothesis k follow the innovations in b.innovations, of variance s."""
    x, d = b.whitening_state[k], whitening_gains(b, place)
    for j in range(5):
        for i in range(2):
            gain = b.innovations[j, i] / s
            x[PLACE, j, i] += d[0] * gain
            x[SPEED, j, i] += d[1] * gain
            x[BIAS, j, i] += d[2] * gain


@kernel
def update_whitening(b: HypothesisBank, place: bool, s: float) -> None:
    """The covariance after an innovation of variance s."""
    P, d = b.whitening_P, whitening_gains(b, place)
    P[0, 0] -= d[0] * d[0] / s
    P[0, 1] -= d[0] * d[1] / s
    P[0, 2] -= d[0] * d[2] / s
    P[1, 1] -= d[1] * d[1] / s
    P[1, 2] -= d[1] * d[2] / s
    P[2, 2] -= d[2] * d[2] / s
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@kernel
def unobserved_velocity(b: HypothesisBank, k: int, axis: int, column: int) -> float:
    """What of an integral of hypothesis k, now, the fixes followed so far do not show in the velocity."""
    return float(b.integrals[k, column, axis] - b.whitening_state[k, SPEED, 1 + column, axis])
