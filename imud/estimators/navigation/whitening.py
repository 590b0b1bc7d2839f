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

UNFELT_PSD = 0.05**2  # m^2/s^3, of accelerations that were not felt, or not as they were: scale, sway, vibration
ANYWHERE, ANY_SPEED = 1e4, 1e2  # m, m/s
PLACE, SPEED, ERROR = 0, 1, 2  # states


@kernel
def restart(c: Any) -> None:
    """Nothing is known of place and velocity."""
    P = c.whitener
    P[:] = 0.0
    P[PLACE, PLACE], P[SPEED, SPEED], P[ERROR, ERROR] = ANYWHERE**2, ANY_SPEED**2, c.reported[0] ** 2
    c.followed[:] = 0.0
    c.refusals = 0


@kernel
def let_pass(c: Any, dt: float) -> None:
    """Predict over `dt` s."""
    P, x = c.whitener, c.followed
    decay = math.exp(-dt / WANDER_S)
    for k in range(len(c.left)):
        for i in range(2):
            x[PLACE, k, i] += dt * x[SPEED, k, i]
            x[ERROR, k, i] *= decay
    P[0, 0] += dt * (2.0 * P[0, 1] + dt * P[1, 1]) + UNFELT_PSD * dt**3 / 3.0
    P[0, 1] += dt * P[1, 1] + UNFELT_PSD * dt * dt / 2.0
    P[0, 2] = decay * (P[0, 2] + dt * P[1, 2])
    P[1, 1] += UNFELT_PSD * dt
    P[1, 2] *= decay
    P[2, 2] = decay * decay * P[2, 2] + c.reported[0] ** 2 * (1.0 - decay * decay)
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@kernel
def innovate(c: Any, place: bool, north: float, east: float, integrals: Any, r: float) -> float:
    """c.left <- innovations of a place (m, else a velocity) of variance r, and of the integrals; returns theirs."""
    x = c.followed
    for k in range(len(c.left)):
        for i in range(2):
            told = integrals[k - 1, i] if k > 0 else north if i == 0 else east
            c.left[k, i] = told - (x[PLACE, k, i] + x[ERROR, k, i] if place else x[SPEED, k, i])
    P = c.whitener
    if place:
        return float(P[0, 0] + 2.0 * P[0, 2] + P[2, 2] + r)
    return float(P[1, 1] + r)


@kernel
def learn(c: Any, place: bool, s: float) -> None:
    """Take the innovations in c.left, of variance s."""
    P, x = c.whitener, c.followed
    d0, d1, d2 = P[0, 1], P[1, 1], P[2, 1]
    if place:
        d0, d1, d2 = P[0, 0] + P[0, 2], P[1, 0] + P[1, 2], P[2, 0] + P[2, 2]
    for k in range(len(c.left)):
        for i in range(2):
            gain = c.left[k, i] / s
            x[PLACE, k, i] += d0 * gain
            x[SPEED, k, i] += d1 * gain
            x[ERROR, k, i] += d2 * gain
    P[0, 0] -= d0 * d0 / s
    P[0, 1] -= d0 * d1 / s
    P[0, 2] -= d0 * d2 / s
    P[1, 1] -= d1 * d1 / s
    P[1, 2] -= d1 * d2 / s
    P[2, 2] -= d2 * d2 / s
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]


@kernel
def velocity(c: Any, axis: int, column: int) -> float:
    """What of a running integral, now, the fixes followed so far do not show in the velocity."""
    return float(c.running[column, axis] - c.followed[SPEED, 1 + column, axis])
