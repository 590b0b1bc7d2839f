"""Propagation of the core to a later time: the nominal state, and P once per covariance interval; gaps add variance.

A gap between two samples is integrated with the mean of the samples at its ends; what the body may have done meanwhile
is added to P, tilt and heading each by what the motion has shown before, and rest and alignment, which need every
sample, start again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Vector
from ..tuning import Tunable
from .aiding.course_heading import wait_for_course
from .alignment.velocity_pairs import restart_in_motion_alignment
from .ekf import add_variance
from .fusion import propagate_errors
from .glr_tests.compass_offset import open_compass_offset
from .mechanization import body_to_ned, integrate_strapdown, ned_to_body, set_velocity
from .state import ATTITUDE, COARSE_ALIGNMENT, NAVIGATING, VELOCITY
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
    Tunable(
        "long_gap_periods", 5.0, "periods", "As gap_s, in sample periods: the longer of the two holds.", "Slow sensors."
    ),
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
    p: Parameters, jump2: float, dt: float, rate_of_change: float, vibration2: float, most: float
) -> float:
    """Variance of the mean of a signal over a gap of dt s, about the mean of the two samples at its ends.

    The signal is a random walk between two known ends (Brownian bridge: dt / 12), with `rate_of_change` or the change
    between the ends, whichever is larger. vibration2: variance of the ends; most: sigma that bounds a long gap's.
    """
    longest = max(rate_of_change * p.tuning.rate_of_change_time_s, most**2)
    return min(max(rate_of_change * dt, jump2) / 12.0, longest) + 0.5 * vibration2


@kernel
def mean_rate(c: Core, w: Reals) -> Vector:
    """Mean of the rates at the ends of a gap, rad/s, body axes, without the bias; w: that of the sample after it."""
    bg, before = c.nav.bg, c.imu.w
    return (
        0.5 * (before[0] + w[0]) - bg[0],
        0.5 * (before[1] + w[1]) - bg[1],
        0.5 * (before[2] + w[2]) - bg[2],
    )


@kernel
def level_share(p: Parameters, dt: float) -> float:
    """Share of the mean level rate that a gap of dt s is integrated with: a body leans to and fro."""
    share = min(p.tuning.rate_of_change_time_s / dt, 1.0)
    return share * share


@kernel
def gap_variances(p: Parameters, c: Core, w: Reals, f: Reals, dt: float) -> tuple[float, float, float]:
    """What a gap of dt s until the sample (w, f; body axes) adds to the variances of tilt, heading and velocity."""
    s, psd, jump_f2 = c.stationarity, p.tuning.vibration_noise_share * p.period, 0.0
    turned = body_to_ned(c, (w[0] - c.imu.w[0], w[1] - c.imu.w[1], w[2] - c.imu.w[2]))
    for i in range(3):
        jump_f2 = max(jump_f2, (f[i] - c.imu.f[i]) ** 2)
    jump2, vibration2 = turned[0] ** 2 + turned[1] ** 2, s.vibration_gyro_psd / psd
    level = gap_variance(p, jump2, dt, s.level_rate_change2, vibration2, p.tuning.gap_turn)
    vertical = gap_variance(p, turned[2] ** 2, dt, s.vertical_rate_change2, vibration2, p.tuning.gap_turn)
    accel = gap_variance(p, jump_f2, dt, s.force_change2, s.vibration_accel_psd / psd, p.tuning.gap_accel)
    x, y, _ = body_to_ned(c, mean_rate(c, w))
    leaning2 = (level_share(p, dt) * dt) ** 2 * (x * x + y * y)
    accel = max(accel, 0.25 * s.level_accel2)
    return min(level * dt**2, s.tilt_range2 + leaning2), vertical * dt**2, accel * dt**2


@kernel
def add_gap_variance(c: Core, level: float, vertical: float, velocity: float) -> None:
    """Add variance to the attitude about level and vertical axes, rad^2, and to the velocity, m^2/s^2."""
    for i in range(3):
        add_variance(c, VELOCITY + i, velocity)
        add_variance(c, ATTITUDE + i, level if i < 2 else vertical)


@kernel
def extrapolate_gap(
    p: Parameters, c: Core, w: Reals, f: Reals, dt: float, variances: tuple[float, float, float]
) -> None:
    """Integrate over a gap of dt s with the mean of the samples at its ends; rest and alignment start again.

    A body leans to and fro: the level rates last no longer than `rate_of_change_time_s`. What the rates and forces may
    have been meanwhile is added in the middle: so much of the velocity's error is by the tilt's as if they had lasted.
    """
    steps = int(0.5 * dt / p.tuning.gap_step_s) + 1
    share = level_share(p, dt)
    x, y, z = body_to_ned(c, mean_rate(c, w))
    x, y, z = ned_to_body(c, (share * x, share * y, z))
    c.imu.w[0], c.imu.w[1], c.imu.w[2] = x + c.nav.bg[0], y + c.nav.bg[1], z + c.nav.bg[2]
    for i in range(3):
        c.imu.f[i] = 0.5 * (c.imu.f[i] + f[i])
    for half in range(2):
        for _ in range(steps):
            mechanize(p, c, c.imu.w, c.imu.f, 0.5 * dt / steps)
        propagate_errors(p, c)
        if half == 0:
            add_gap_variance(c, variances[0], variances[1], variances[2])
    interrupt_rest(c)
    clear_window(c)
    restart_in_motion_alignment(c)


@kernel
def require_heading_confirmation(p: Parameters, c: Core) -> None:
    """After a long gap under way motion has to confirm the heading; a land vehicle's is that of its next course."""
    wait_for_course(p, c)
    if c.alignment.mode == NAVIGATING and not c.stationarity.at_rest:
        open_compass_offset(c, True)


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
def propagate_to(p: Parameters, c: Core, t_ns: int, w: Reals, f: Reals) -> None:
    """Propagate the core to t_ns, later than now, at which the sample is (w, f; body axes); a gap adds variance."""
    dt = min(1e-9 * (t_ns - c.nav.t_ns), p.tuning.longest_gap_s)
    is_gap = dt > p.tuning.gap_periods * p.period
    variances = gap_variances(p, c, w, f, dt) if is_gap else (0.0, 0.0, 0.0)
    if dt > max(p.tuning.gap_s, p.tuning.long_gap_periods * p.period):
        extrapolate_gap(p, c, w, f, dt, variances)
    else:
        mechanize(p, c, w, f, dt)
        if is_gap:
            add_gap_variance(c, variances[0], variances[1], variances[2])
    store_last_sample(c, t_ns, w, f)
    if dt > p.tuning.max_gyro_outage_s:
        require_heading_confirmation(p, c)
