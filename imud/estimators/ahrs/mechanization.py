"""Strapdown equations for one sample, and the integrals that make the transition of the covariance.

A sample is the mean rate and force over the period that ends with it, as sensors that filter before they decimate give
it (on recordings with optical truth, taking it for the value at that instant doubles the tilt error in fast motion).
The rotation vector of a step has the coning term dt^2/12 w0 x w1; forces are rotated with the attitude at mid-step.

Source: Bortz (1971); Savage, Strapdown inertial navigation integration algorithm design, parts 1 and 2 (1998).
"""

from typing import Any

from ...compile.jit import kernel
from ...math.rotation import Quaternion, Vector, dcm_of_quat, quat_exp, quat_normalised, quat_product
from .motion import update_scatter


@kernel
def compensate_rate(nav: Any, x: float, y: float, z: float) -> Vector:
    """A rate already without its bias (x, y, z), less scale factors and misalignments."""
    m = nav.gyro_matrix
    return (
        x - (m[0] * x + m[1] * y + m[2] * z),
        y - (m[3] * x + m[4] * y + m[5] * z),
        z - (m[6] * x + m[7] * y + m[8] * z),
    )


@kernel
def compensate_force(nav: Any, x: float, y: float, z: float) -> Vector:
    """Measured specific force less bias and scale factors."""
    b, m = nav.ba, nav.accel_scale
    return (1.0 - m[0]) * (x - b[0]), (1.0 - m[1]) * (y - b[1]), (1.0 - m[2]) * (z - b[2])


@kernel
def mechanize(p: Any, s: Any, w: Vector, f: Vector, dt: float) -> None:
    """Integrate from the last sample (s.imu) to this one (measured rate w, force f), dt s later."""
    nav, last = s.nav, s.imu
    w0, w1, w2 = w[0] - nav.bg[0], w[1] - nav.bg[1], w[2] - nav.bg[2]
    d0, d1, d2 = w[0] - last.w[0], w[1] - last.w[1], w[2] - last.w[2]
    r0, r1, r2 = compensate_rate(nav, w0, w1, w2)
    k = dt * dt / 24.0
    half_step = quat_exp(
        0.5 * r0 * dt + k * (r1 * d2 - r2 * d1),
        0.5 * r1 * dt + k * (r2 * d0 - r0 * d2),
        0.5 * r2 * dt + k * (r0 * d1 - r1 * d0),
    )
    middle = quat_product((nav.q_nb[0], nav.q_nb[1], nav.q_nb[2], nav.q_nb[3]), half_step)
    q = quat_normalised(quat_product(middle, half_step))
    nav.q_nb[0], nav.q_nb[1], nav.q_nb[2], nav.q_nb[3] = q
    g = compensate_force(nav, f[0], f[1], f[2])
    f_cross_w = (g[1] * r2 - g[2] * r1, g[2] * r0 - g[0] * r2, g[0] * r1 - g[1] * r0)
    delay = nav.accel_delay
    force = (g[0] + delay * f_cross_w[0], g[1] + delay * f_cross_w[1], g[2] + delay * f_cross_w[2])
    integrate(p, s, middle, (w0, w1, w2), force, f_cross_w, dt)
    update_scatter(p, s, dt)
    s.integrals.w2 += (r0 * r0 + r1 * r1 + r2 * r2) * dt
    s.integrals.time += dt


@kernel
def integrate(p: Any, s: Any, q: Quaternion, w: Vector, f: Vector, f_cross_w: Vector, dt: float) -> None:
    """Integrate velocity and position, and add this step to the integrals of the covariance interval."""
    nav, total, a = s.nav, s.integrals, s.scratch.a_n
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
        dv = delta_v if i < 2 else delta_v + nav.gravity * dt
        a[i] = dv / dt
        nav.p_n[i] += (nav.v_n[i] - nav.p_n[i] / p.tuning.position_decay_time_s) * dt
        nav.v_n[i] += dv
    k = 0
    for i in range(3):
        for j in range(i, 3):
            total.a_outer_a[k] += a[i] * a[j] * dt
            k += 1
