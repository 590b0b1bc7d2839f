"""What the receiver says, made independent: innovations of a small filter of position, velocity and wander.

Fixes share the receiver's wander, and the vehicle's unknown place and velocity at the start. A Kalman filter of a
vehicle that moves on as it moved knows of these, and its innovations are independent, as far as what was felt
explains the rest. It is linear: fed with integrals of what was felt instead of fixes, it leaves of them what the same
innovations would be. So one covariance serves the receiver's words and all integrals of `matching`, and how far apart
two fixes have to be for their noise needs no rule.

Source: Kailath, An innovations approach to least-squares estimation, part I (1968).
"""

import math
from typing import Any

from ...kernels.jit import kernel
from .covariance import WANDER_S
from .state import RATES

UNFELT_PSD = 0.05**2  # m^2/s^3, of accelerations that were not felt, or not as they were: scale, sway, vibration
ANYWHERE, ANY_SPEED = 1e4, 1e2  # m, m/s
PLACE, SPEED, ERROR = 0, 1, 2  # states


@kernel
def restart(b: Any, wander: float) -> None:
    """Nothing is known of place and velocity; the receiver's position wanders by `wander` m."""
    P = b.whitener
    P[:] = 0.0
    P[PLACE, PLACE], P[SPEED, SPEED], P[ERROR, ERROR] = ANYWHERE**2, ANY_SPEED**2, wander**2
    b.followed[:] = 0.0


@kernel
def let_pass(b: Any, wander: float, dt: float) -> None:
    """Predict over `dt` s."""
    P, x = b.whitener, b.followed
    decay = math.exp(-dt / WANDER_S)
    for k in range(RATES):
        for j in range(5):
            for i in range(2):
                x[k, PLACE, j, i] += dt * x[k, SPEED, j, i]
                x[k, ERROR, j, i] *= decay
    P[0, 0] += dt * (2.0 * P[0, 1] + dt * P[1, 1]) + UNFELT_PSD * dt**3 / 3.0
    P[0, 1] += dt * P[1, 1] + UNFELT_PSD * dt * dt / 2.0
    P[0, 2] = decay * (P[0, 2] + dt * P[1, 2])
    P[1, 1] += UNFELT_PSD * dt
    P[1, 2] *= decay
    P[2, 2] = decay * decay * P[2, 2] + wander**2 * (1.0 - decay * decay)
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@kernel
def expected(b: Any, place: bool, r: float) -> float:
    """Variance of the innovation of a place (else a velocity) of variance r."""
    P = b.whitener
    return float(P[0, 0] + 2.0 * P[0, 2] + P[2, 2] + r if place else P[1, 1] + r)


@kernel
def innovate(b: Any, k: int, place: bool, told: Any) -> None:
    """b.left <- innovations of a place (m, else a velocity), and of the integrals of hypothesis k."""
    x, integrals = b.followed[k], b.twice[k] if place else b.running[k]
    for j in range(5):
        for i in range(2):
            value = integrals[j - 1, i] if j > 0 else told[i]
            b.left[j, i] = value - (x[PLACE, j, i] + x[ERROR, j, i] if place else x[SPEED, j, i])


@kernel
def gains(b: Any, place: bool) -> Any:
    """Covariance of place, speed and error with an innovation."""
    P = b.whitener
    if place:
        return P[0, 0] + P[0, 2], P[1, 0] + P[1, 2], P[2, 0] + P[2, 2]
    return P[0, 1], P[1, 1], P[2, 1]


@kernel
def follow(b: Any, k: int, place: bool, s: float) -> None:
    """Let hypothesis k follow the innovations in b.left, of variance s."""
    x, d = b.followed[k], gains(b, place)
    for j in range(5):
        for i in range(2):
            gain = b.left[j, i] / s
            x[PLACE, j, i] += d[0] * gain
            x[SPEED, j, i] += d[1] * gain
            x[ERROR, j, i] += d[2] * gain


@kernel
def update(b: Any, place: bool, s: float) -> None:
    """The covariance after an innovation of variance s."""
    P, d = b.whitener, gains(b, place)
    P[0, 0] -= d[0] * d[0] / s
    P[0, 1] -= d[0] * d[1] / s
    P[0, 2] -= d[0] * d[2] / s
    P[1, 1] -= d[1] * d[1] / s
    P[1, 2] -= d[1] * d[2] / s
    P[2, 2] -= d[2] * d[2] / s
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@kernel
def velocity(b: Any, k: int, axis: int, column: int) -> float:
    """What of an integral of hypothesis k, now, the fixes followed so far do not show in the velocity."""
    return float(b.running[k, column, axis] - b.followed[k, SPEED, 1 + column, axis])
