"""Samples that are missing, faulty or saturated: what is integrated instead, and the noise that this adds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers.sample import LIMITED_AXES, LIMITED_FORCE, LIMITED_RATE, NO_RATE_AXES, SATURATED, SUSPECT

from ...compile.jit import kernel
from ...math.rotation import Vector, quat_rotate_back
from .integrals import add_noise
from .last_sample import set_outage, update_force_change
from .sensor_axes import to_body_axes, to_sensor_axes
from .stamps import stamp_variance

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from .types import Parameters, State


@kernel
def between(a: Reals, b: Vector, share: float) -> Vector:
    """Reading b with this share of reading a.

    Half and half is the best guess of the values in a gap between them; the last period is that of b alone.
    """
    kept = 1.0 - share
    return share * a[0] + kept * b[0], share * a[1] + kept * b[1], share * a[2] + kept * b[2]


@kernel
def hold_invalid_axes(p: Parameters, s: State, w: Vector, flags: int, fault_s: float) -> Vector:
    """The rates w, with those of invalid axes of the sensor replaced by the last ones.

    fault_s: time since the last sample where a fault of the sensor lasts for more than `steady_rate_s`, else 0. For so
    long they return to zero, as the rates of most bodies do; for single samples that are missing they do not.
    """
    last, bg, kept = s.imu.w, s.nav.bg, max(1.0 - fault_s / p.tuning.held_rate_time_s, 0.0)
    held = (bg[0] + kept * (last[0] - bg[0]), bg[1] + kept * (last[1] - bg[1]), bg[2] + kept * (last[2] - bg[2]))
    axes = flags // NO_RATE_AXES & 7
    if flags & SUSPECT or axes == 0:
        return held
    before, now = to_sensor_axes(p, held), to_sensor_axes(p, w)
    return to_body_axes(
        p,
        (
            before[0] if axes & 1 else now[0],
            before[1] if axes & 2 else now[1],
            before[2] if axes & 4 else now[2],
        ),
    )


@kernel
def hold_rate(p: Parameters, s: State, dt: float, fault_s: float) -> None:
    """Hold the last rate for dt more.

    fault_s: duration of the sensor's fault so far, 0: it has none. A fault is detected late, so that even the last rate
    may be wrong, by as much as the body's recent rates.
    """
    c, before = p.tuning, s.imu.outage_s
    held_s = before + dt
    if fault_s > 0.0:
        add_noise(s, (c.fault_rate_radps**2 + s.imu.rate2) * max(fault_s**2 - before**2, 0.0), 0.0)
    if fault_s > held_s:
        attitude = c.gap_rate_psd * (fault_s**3 - held_s**3) / 3.0
        add_noise(s, attitude, c.fault_force_psd * (fault_s - held_s))
    set_outage(s, max(held_s, fault_s), fault_s)


@kernel
def force_without_acceleration(p: Parameters, s: State, dt: float) -> Vector:
    """The specific force of a body without acceleration, m/s^2, in place of a missing one; adds its noise to P."""
    nav = s.nav
    add_noise(s, 0.0, p.tuning.fault_force_psd * dt)
    q = (nav.q_nb[0], nav.q_nb[1], nav.q_nb[2], nav.q_nb[3])
    x, y, z = quat_rotate_back(q, (0.0, 0.0, -nav.gravity))
    return x + nav.ba[0], y + nav.ba[1], z + nav.ba[2]


@kernel
def add_outage_noise(p: Parameters, s: State, w: Vector, f: Vector, dt: float, lost_s: float, flags: int) -> None:
    """Add noise for motion that was not measured: in gaps, while values are held, and beyond the range.

    lost_s: of the time dt since the last sample that for which samples are missing. `flags` (of the sample) may name
    which sensor is saturated; if not, it may be either.
    """
    c, last = p.tuning, s.imu
    dw2 = df2 = w2 = f2 = 0.0
    for i in range(3):
        dw2 += (w[i] - last.w[i]) ** 2
        df2 += (f[i] - last.f[i]) ** 2
        w2 += w[i] * w[i]
        f2 += f[i] * f[i]
    if lost_s > 0.0:
        part, gap_dw2, gap_df2 = lost_s * lost_s / 12.0, 0.0, 0.0
        for i in range(3):
            gap_dw2 += (w[i] - last.gap_w[i]) ** 2
            gap_df2 += (f[i] - last.gap_f[i]) ** 2
        add_noise(s, (gap_dw2 + c.gap_rate_psd * lost_s) * part, (gap_df2 + c.gap_force_psd * lost_s) * part)
    if last.outage_s > 0.0:
        held2 = last.outage_s * last.outage_s
        share = 1.0 / 3.0 if last.fault_s == 0.0 else 0.0  # of a fault `hold_rate` has added how wrong rates may be
        add_noise(s, (c.gap_rate_psd * dt + share * dw2) * held2, (c.gap_force_psd * dt + share * df2) * held2)
    if flags & SATURATED:
        limited = flags & (LIMITED_RATE | LIMITED_FORCE)
        if limited != LIMITED_FORCE and flags & (7 * LIMITED_AXES) == 0:  # else `clipping` adds it
            add_noise(s, c.saturation_noise**2 * w2 * dt, 0.0)
        if limited != LIMITED_RATE:
            add_noise(s, 0.0, c.saturation_noise**2 * f2 * dt)


@kernel
def add_stamp_noise(s: State, w: Vector, f: Vector) -> None:
    """Noise from stamps that scatter: a sample that seems longer, and the next one shorter, counts for too much.

    Of the errors of the stamps, which nothing else shows, remain in the sum those times the change of the reading.
    """
    dw2 = df2 = 0.0
    for i in range(3):
        dw2 += (w[i] - s.imu.w[i]) ** 2
        df2 += (f[i] - s.imu.f[i]) ** 2
    variance = stamp_variance(s)
    add_noise(s, variance * dw2, variance * df2)


@kernel
def add_shock_noise(p: Parameters, s: State, f: Vector, dt: float) -> None:
    """Attitude noise from the change of the specific force (sample f, dt s after the last) that no trend announced.

    A shock is over, or a vibration has reversed, before the next sample. So a force that differs from the linear trend
    is a velocity change that is not resolved; with it comes a rotation that the gyro does not resolve (a tap turned the
    BROAD sensor by half a degree, which the gyro did not show).
    """
    add_noise(s, p.tuning.shock_rotation**2 * update_force_change(s, f) * dt * dt, 0.0)
