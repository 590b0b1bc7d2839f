"""What is integrated over a covariance interval: the elements of the transition, and noise beyond the sensor's own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Quaternion, Vector, dcm_of_quat

if TYPE_CHECKING:
    from .types import Integrals, State


@kernel
def integrate_force(s: State, q: Quaternion, w: Vector, f: Vector, f_cross_w: Vector, dt: float) -> None:
    """Add the step of dt at attitude q, rate w less its bias, specific force f; s.scratch.dv_n is the change of
    velocity, without gravity."""
    total, dv, a = s.integrals, s.scratch.dv_n, s.scratch.a_n
    C = dcm_of_quat(q)
    for i in range(3):
        delta_v = 0.0
        for j in range(3):
            k = 3 * i + j
            c = C[k] * dt
            total.c[k] += c
            total.c_diag_f[k] += c * f[j]
            total.c_outer_w[3 * k] += c * w[0]
            total.c_outer_w[3 * k + 1] += c * w[1]
            total.c_outer_w[3 * k + 2] += c * w[2]
            delta_v += c * f[j]
            total.c_f_cross_w[i] += c * f_cross_w[j]
        total.delta_v[i] += delta_v
        dv[i] = delta_v if i < 2 else delta_v + s.nav.gravity * dt
        a[i] = dv[i] / dt
    k = 0
    for i in range(3):
        for j in range(i, 3):
            total.a_outer_a[k] += a[i] * a[j] * dt
            k += 1


@kernel
def turn_about_vertical(total: Integrals) -> float:
    """Rotation about down, rad: the integral of C[2, k] w[k]."""
    return float(total.c_outer_w[18] + total.c_outer_w[22] + total.c_outer_w[26])


@kernel
def turn_across_vertical2(total: Integrals) -> float:
    """The square of the rotation about north and east, rad^2: the integrals of C[i, k] w[k]."""
    north = total.c_outer_w[0] + total.c_outer_w[4] + total.c_outer_w[8]
    east = total.c_outer_w[9] + total.c_outer_w[13] + total.c_outer_w[17]
    return float(north * north + east * east)


@kernel
def integrate_rate(s: State, w: Vector, dt: float) -> None:
    """Add the time, and the square of the compensated rate."""
    s.integrals.w2 += (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) * dt
    s.integrals.time += dt


@kernel
def add_noise(s: State, attitude: float, velocity: float) -> None:
    """Add variances, rad^2 and (m/s)^2, that the covariance gets at the end of the interval."""
    s.integrals.attitude_noise += attitude
    s.integrals.velocity_noise += velocity


@kernel
def reset_integrals(s: State) -> None:
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
