"""Samples that are missing, faulty or saturated: what is integrated instead, and the noise that this adds."""

from typing import Any

from drivers.sample import LIMITED_FORCE, LIMITED_RATE, SATURATED

from ...compile.jit import kernel
from ...math.rotation import Vector, quat_rotate_back


@kernel
def mean_reading(a: Any, b: Vector) -> Vector:
    """The mean of the readings on both sides of a gap: the best guess of the values in it."""
    return 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])


@kernel
def hold_rate(p: Any, s: Any, dt: float, fault_s: float) -> None:
    """Hold the last rate for dt more.

    `fault_s`: for how long the sensor has been at fault, 0: it is not. A fault is detected late, and even the last rate
    may be wrong.
    """
    c, total, before = p.tuning, s.integrals, s.imu.outage_s
    s.imu.outage_s += dt
    if fault_s > 0.0:
        total.attitude_noise += c.fault_rate_radps**2 * max(fault_s**2 - before**2, 0.0)
    if fault_s > s.imu.outage_s:
        total.attitude_noise += c.gap_rate_psd * (fault_s**3 - s.imu.outage_s**3) / 3.0
        total.velocity_noise += c.fault_force_psd * (fault_s - s.imu.outage_s)
        s.imu.outage_s = fault_s


@kernel
def force_without_acceleration(p: Any, s: Any, dt: float) -> Vector:
    """The specific force of a body that does not accelerate, instead of one not measured: it tells nothing of tilt."""
    nav = s.nav
    s.integrals.velocity_noise += p.tuning.fault_force_psd * dt
    q = (nav.q_nb[0], nav.q_nb[1], nav.q_nb[2], nav.q_nb[3])
    x, y, z = quat_rotate_back(q, (0.0, 0.0, -nav.gravity))
    return x + nav.ba[0], y + nav.ba[1], z + nav.ba[2]


@kernel
def add_outage_noise(p: Any, s: Any, w: Vector, f: Vector, dt: float, flags: int) -> None:
    """Noise for what was not measured: between samples far apart, while values are held, beyond the range.

    `flags` (of the sample) may name which sensor is saturated; if not, it may be either.
    """
    c, last, total = p.tuning, s.imu, s.integrals
    dw2 = df2 = w2 = f2 = 0.0
    for i in range(3):
        dw2 += (w[i] - last.w[i]) ** 2
        df2 += (f[i] - last.f[i]) ** 2
        w2 += w[i] * w[i]
        f2 += f[i] * f[i]
    if dt > p.gap_s:
        total.attitude_noise += (dw2 + c.gap_rate_psd * dt) * dt * dt / 12.0
        total.velocity_noise += (df2 + c.gap_force_psd * dt) * dt * dt / 12.0
    if last.outage_s > 0.0:
        total.attitude_noise += c.gap_rate_psd * last.outage_s * last.outage_s * dt
        total.velocity_noise += c.gap_force_psd * last.outage_s * last.outage_s * dt
    if flags & SATURATED:
        limited = flags & (LIMITED_RATE | LIMITED_FORCE)
        if limited != LIMITED_FORCE:
            total.attitude_noise += c.saturation_noise**2 * w2 * dt
        if limited != LIMITED_RATE:
            total.velocity_noise += c.saturation_noise**2 * f2 * dt
