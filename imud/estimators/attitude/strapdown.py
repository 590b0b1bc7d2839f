"""Strapdown integration of one sample, and what the covariance needs to know of it.

A sample is the mean rate and force over the period that ends with it, as sensors that filter before they decimate give
it (on recordings with optical truth, taking it for the value at that instant doubles the tilt error in fast motion).
The rotation vector of a step gets the coning term dt^2/12 w0 x w1; forces are turned with the attitude at mid-step.

Source: Bortz (1971); Savage, Strapdown inertial navigation integration algorithm design, parts 1 and 2 (1998).
"""

from typing import Any

from ...kernels.jit import kernel
from ...kernels.rotation import Quaternion, Vector, dcm_of_quat, quat_exp, quat_normalised, quat_product

LIVELY_S = 1.0  # over which the velocity's liveliness is judged
HOME_S = 10.0  # in which a new place becomes home
DISTANCE_S = 2.5  # over which the distance from home is judged


@kernel
def corrected_rate(s: Any, x: float, y: float, z: float) -> Vector:
    """Rate without its bias (x, y, z), less scale factors and misalignments."""
    m = s.gm
    return (
        x - (m[0] * x + m[1] * y + m[2] * z),
        y - (m[3] * x + m[4] * y + m[5] * z),
        z - (m[6] * x + m[7] * y + m[8] * z),
    )


@kernel
def corrected_force(s: Any, x: float, y: float, z: float) -> Vector:
    """Measured specific force less bias and scale factors."""
    b, m = s.ba, s.sa
    return (1.0 - m[0]) * (x - b[0]), (1.0 - m[1]) * (y - b[1]), (1.0 - m[2]) * (z - b[2])


@kernel
def advance(s: Any, w: Vector, f: Vector, dt: float) -> None:
    """Integrate from the last sample (in s.w, s.f) to this one (measured rate w, force f), dt s later."""
    w0, w1, w2 = w[0] - s.bg[0], w[1] - s.bg[1], w[2] - s.bg[2]
    d0, d1, d2 = w[0] - s.w[0], w[1] - s.w[1], w[2] - s.w[2]
    r0, r1, r2 = corrected_rate(s, w0, w1, w2)
    k = dt * dt / 24.0
    half_turn = quat_exp(
        0.5 * r0 * dt + k * (r1 * d2 - r2 * d1),
        0.5 * r1 * dt + k * (r2 * d0 - r0 * d2),
        0.5 * r2 * dt + k * (r0 * d1 - r1 * d0),
    )
    middle = quat_product((s.q[0], s.q[1], s.q[2], s.q[3]), half_turn)
    q = quat_normalised(quat_product(middle, half_turn))
    s.q[0], s.q[1], s.q[2], s.q[3] = q
    force = corrected_force(s, f[0], f[1], f[2])
    sweep = (force[1] * r2 - force[2] * r1, force[2] * r0 - force[0] * r2, force[0] * r1 - force[1] * r0)
    force = (force[0] + s.lag * sweep[0], force[1] + s.lag * sweep[1], force[2] + s.lag * sweep[2])
    gather(s, middle, (w0, w1, w2), force, sweep, dt)
    s.spin += (r0 * r0 + r1 * r1 + r2 * r2) * dt
    s.span += dt


@kernel
def gather(s: Any, q: Quaternion, w: Vector, f: Vector, sweep: Vector, dt: float) -> None:
    """Integrate velocity, and add this step to the integrals that make the covariance's transition."""
    C = dcm_of_quat(q)
    turn, turn_rate, turn_force = s.turn, s.turn_rate, s.turn_force
    for i in range(3):
        push = 0.0
        for j in range(3):
            k = 3 * i + j
            c = C[k] * dt
            turn[k] += c
            turn_force[k] += c * f[j]
            turn_rate[3 * k] += c * w[0]
            turn_rate[3 * k + 1] += c * w[1]
            turn_rate[3 * k + 2] += c * w[2]
            push += c * f[j]
            s.sweep[i] += c * sweep[j]
        s.push[i] += push
        dv = push if i < 2 else push + s.gravity * dt
        s.a[i] = dv / dt
        s.p[i] += (s.v[i] - s.p[i] / HOME_S) * dt
        s.v[i] += dv
    a, v, motion = s.a, s.v, s.motion
    motion[0] += a[0] * a[0] * dt
    motion[1] += a[0] * a[1] * dt
    motion[2] += a[0] * a[2] * dt
    motion[3] += a[1] * a[1] * dt
    motion[4] += a[1] * a[2] * dt
    motion[5] += a[2] * a[2] * dt
    fade, fade_far = dt / (LIVELY_S + dt), dt / (DISTANCE_S + dt)
    for i in range(3):
        s.v_mean[i] += fade * (v[i] - s.v_mean[i])
        s.v_energy[i] += fade * ((v[i] - s.v_mean[i]) ** 2 - s.v_energy[i])
        s.p_energy[i] += fade_far * (s.p[i] * s.p[i] - s.p_energy[i])
