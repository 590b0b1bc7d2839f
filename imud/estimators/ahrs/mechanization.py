"""The nominal state: strapdown equations for one sample, and what sets it from outside.

A sample is the mean rate and force over the period that ends with it, as sensors that filter before they decimate give
it (on recordings with optical truth, taking it for the value at that instant doubles the tilt error in fast motion).
The rotation vector of a step has the coning term dt^2/12 w0 x w1; forces are rotated with the attitude at mid-step.

Source: Bortz (1971); Savage, Strapdown inertial navigation integration algorithm design, parts 1 and 2 (1998).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Quaternion, Vector, quat_exp, quat_normalised, quat_product
from .integrals import integrate_force, integrate_rate

if TYPE_CHECKING:
    from .types import Nav, Parameters, State


@kernel
def compensate_rate(nav: Nav, x: float, y: float, z: float) -> Vector:
    """A rate already without its bias (x, y, z), less scale factors and misalignments."""
    m = nav.gyro_matrix
    return (
        x - (m[0] * x + m[1] * y + m[2] * z),
        y - (m[3] * x + m[4] * y + m[5] * z),
        z - (m[6] * x + m[7] * y + m[8] * z),
    )


@kernel
def compensate_force(nav: Nav, x: float, y: float, z: float) -> Vector:
    """Measured specific force less bias and scale factors."""
    b, m = nav.ba, nav.accel_scale
    return (1.0 - m[0]) * (x - b[0]), (1.0 - m[1]) * (y - b[1]), (1.0 - m[2]) * (z - b[2])


@kernel
def mechanize(p: Parameters, s: State, w: Vector, f: Vector, dt: float) -> None:
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
    integrate_force(s, middle, (w0, w1, w2), force, f_cross_w, dt)
    for i in range(3):
        nav.p_n[i] += (nav.v_n[i] - nav.p_n[i] / p.tuning.position_decay_time_s) * dt
        nav.v_n[i] += s.scratch.dv_n[i]
    integrate_rate(s, (r0, r1, r2), dt)


@kernel
def set_attitude(s: State, q: Quaternion) -> None:
    """Make q the attitude."""
    s.nav.q_nb[0], s.nav.q_nb[1], s.nav.q_nb[2], s.nav.q_nb[3] = q


@kernel
def clear_motion(s: State, i: int) -> None:
    """Count velocity and position along axis i from zero again."""
    s.nav.v_n[i] = s.nav.p_n[i] = 0.0


@kernel
def clear_biases(s: State) -> None:
    """Know no bias."""
    for i in range(3):
        s.nav.bg[i] = s.nav.ba[i] = 0.0


@kernel
def shift_gyro_bias(s: State, i: int, change: float) -> None:
    """Add a change to the gyro bias of axis i."""
    s.nav.bg[i] += change
