"""Propagation of the core to a later time: the nominal state, and P once per covariance interval; gaps add variance.

A gap between two samples is integrated with the mean of the samples at its ends; what the body may have done meanwhile
is added to P, and rest and alignment, which need every sample, start again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ..tuning import Tunable
from .alignment.velocity_pairs import restart_in_motion_alignment
from .ekf import add_variance
from .fusion import propagate_errors
from .mechanization import integrate_strapdown, set_velocity
from .state import ATTITUDE, COARSE_ALIGNMENT, POSITION, VELOCITY
from .stationarity import accumulate_force, clear_window, interrupt_rest

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from .types import Core, Parameters


TUNABLES = (
    Tunable("gap_step_s", 0.05, "s", "Integration step over a gap.", "Choice."),
    Tunable(
        "gap_periods",
        2.5,
        "periods",
        "Gap between samples, in sample periods, beyond which variance is added.",
        "One lost sample makes 2 periods.",
    ),
    Tunable("gap_s", 0.1, "s", "Gap between samples beyond which the motion is extrapolated.", "Choice."),
    Tunable("gap_accel", 2.0, "m/s^2", "Acceleration that a long gap may hide.", "A vehicle's."),
    Tunable("gap_turn", 0.3, "rad/s", "Rate that a long gap may hide.", "A vehicle's."),
    Tunable(
        "rate_of_change_time_s", 1.0, "s", "Longest time over which the rate of change is extrapolated.", "Choice."
    ),
    Tunable("longest_gap_s", 30.0, "s", "Longest gap that is integrated.", "Choice."),
    Tunable("smoothing_s", 0.2, "s", "Time constant of the smoothed rate and acceleration.", "Choice."),
)


@kernel
def mechanize(p: Parameters, c: Core, w: Reals, f: Reals, dt: float) -> None:
    """Integrate one sample (w, f; body axes) over a short dt, s; in coarse alignment the velocity is not integrated."""
    v0, v1, v2 = c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2]
    accumulate_force(c, integrate_strapdown(c, w, f, dt), dt)
    v, accel, a = c.nav.v_n, c.imu.accel_n, min(1.0 / p.tuning.smoothing_s, 1.0 / dt)
    accel[0] += a * (v[0] - v0 - dt * accel[0])
    accel[1] += a * (v[1] - v1 - dt * accel[1])
    accel[2] += a * (v[2] - v2 - dt * accel[2])
    if c.alignment.mode == COARSE_ALIGNMENT:
        set_velocity(c, 0, v0)
        set_velocity(c, 1, v1)
        set_velocity(c, 2, v2)
    if c.imu.integration_time >= p.tuning.covariance_interval_s:
        propagate_errors(p, c)


@kernel
def gap_variance(
    p: Parameters, before: Reals, after: Reals, dt: float, rate_of_change: float, vibration2: float, most: float
) -> float:
    """Variance of the mean of a signal over a gap of dt s, about the mean of the two samples at its ends.

    The signal is a random walk between two known ends (Brownian bridge: dt / 12), with `rate_of_change` or the change
    between the ends, whichever is larger. vibration2: variance of the ends; most: sigma that bounds a long gap's.
    """
    jump2 = 0.0
    for i in range(3):
        jump2 = max(jump2, (after[i] - before[i]) ** 2)
    longest = max(rate_of_change * p.tuning.rate_of_change_time_s, most**2)
    return min(max(rate_of_change * dt, jump2) / 12.0, longest) + 0.5 * vibration2


@kernel
def extrapolate_gap(p: Parameters, c: Core, w: Reals, f: Reals, dt: float) -> None:
    """Integrate over a gap of dt s with the mean of the samples at its ends; rest and alignment start again."""
    steps = int(dt / p.tuning.gap_step_s) + 1
    for i in range(3):
        c.imu.w[i] = 0.5 * (c.imu.w[i] + w[i])
        c.imu.f[i] = 0.5 * (c.imu.f[i] + f[i])
    for _ in range(steps):
        mechanize(p, c, c.imu.w, c.imu.f, dt / steps)
    propagate_errors(p, c)
    interrupt_rest(c)
    clear_window(c)
    restart_in_motion_alignment(c)


@kernel
def store_last_sample(c: Core, t_ns: int, w: Reals, f: Reals) -> None:
    """Store the core's time and the sample (w, f; body axes) at that time."""
    c.nav.t_ns = t_ns
    for i in range(3):
        c.imu.w[i] = w[i]
        c.imu.f[i] = f[i]


@kernel
def store_first_sample(c: Core, t_ns: int, w: Reals, f: Reals) -> None:
    """The core begins at the first sample."""
    c.imu.sample_count = 1
    c.imu.sample_ns = t_ns
    store_last_sample(c, t_ns, w, f)


@kernel
def count_sample(c: Core, t_ns: int) -> float:
    """Count the sample of this time; returns how long after the one before it is, s."""
    interval_s = 1e-9 * (t_ns - c.imu.sample_ns)
    c.imu.sample_ns = t_ns
    c.imu.sample_count += 1
    return interval_s


@kernel
def subtract_biases(c: Core) -> None:
    """Take the biases from the last sample, for the gap that follows it: they are about to be reset."""
    for i in range(3):
        c.imu.w[i] -= c.nav.bg[i]
        c.imu.f[i] -= c.nav.ba[i]


@kernel
def propagate_to(p: Parameters, c: Core, t_ns: int, w: Reals, f: Reals) -> None:
    """Propagate the core to t_ns, at which the sample is (w, f; body axes); a gap adds variance."""
    dt = 1e-9 * (t_ns - c.nav.t_ns)
    if dt <= 0.0:
        return
    dt = min(dt, p.tuning.longest_gap_s)
    rate_variance, accel_variance = 0.0, 0.0
    if dt > p.tuning.gap_periods * p.period:
        s, psd = c.stationarity, p.tuning.vibration_noise_share * p.period
        rate_variance = gap_variance(
            p, c.imu.w, w, dt, s.max_rate_of_change[0], s.vibration_gyro_psd / psd, p.tuning.gap_turn
        )
        accel_variance = gap_variance(
            p, c.imu.f, f, dt, s.max_rate_of_change[1], s.vibration_accel_psd / psd, p.tuning.gap_accel
        )
    if dt > max(p.tuning.gap_s, 5.0 * p.period):
        extrapolate_gap(p, c, w, f, dt)
    else:
        mechanize(p, c, w, f, dt)
    if rate_variance > 0.0:
        for i in range(3):
            add_variance(c, POSITION + i, 0.25 * accel_variance * dt**4)
            add_variance(c, VELOCITY + i, accel_variance * dt**2)
            add_variance(c, ATTITUDE + i, rate_variance * dt**2)
    store_last_sample(c, t_ns, w, f)
