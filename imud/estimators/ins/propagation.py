"""Propagation by one sample: the same code for new samples and for those replayed after a late measurement.

In this order: a gap in the samples is bridged, or ends the estimate; damaged, missing and clipped readings are
replaced, with noise for what they hide; the nominal state and the covariance propagate. At the end of a window of half
a second the body is found at rest or not, the gyro bias is checked against gravity, and the assumed measurements that
are due (no velocity, no turn, no slip) are fused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers.sample import LIMITED_FORCE, LIMITED_RATE, NO_FORCE, NO_RATE, POWER_ON, RECONNECTED
from imud.drivers.sample import SATURATED as BEYOND_RANGE

from ...compile.jit import kernel
from ...math.earth import gravity
from ..tuning import Tunable
from .aiding.non_holonomic import find_forward_axis, fuse_nhc, is_due, reset_nhc
from .aiding.zero_velocity import fuse_rest
from .alignment.levelling import level_from_window
from .alignment.modes import ATTITUDE_LOST, HEADING_KNOWN, HEADING_LOST, change_mode
from .alignment.velocity_pairs import flag_heading, is_levelled, reset_pairs
from .ekf import add_covariance, add_variance, variance
from .fusion import propagate_errors
from .integrity.gravity_monitor import monitor_gravity
from .mechanization import integrate_strapdown, ned_to_body, rotation_matrix, set_velocity
from .power_on import check_attitude, reopen_biases
from .rest import detect_rest, withdraw_rest
from .state import ATTITUDE, COARSE_ALIGNMENT, NAVIGATING, POSITION, VELOCITY
from .stationarity import accumulate_force, accumulate_window, classify_window, clear_window, interrupt_rest

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from .types import Core, Parameters, StoredSample


TUNABLES = (
    Tunable("gap_step_s", 0.05, "s", "Integration step over a gap.", "Choice."),
    Tunable(
        "gap_periods", 2.5, "periods", "A longer gap between samples adds variance.", "One lost sample makes 2 periods."
    ),
    Tunable("gap_s", 0.1, "s", "A longer gap is extrapolated.", "Choice."),
    Tunable("gap_accel", 2.0, "m/s^2", "Acceleration that a long gap may hide.", "A vehicle's."),
    Tunable("gap_turn", 0.3, "rad/s", "Rate that a long gap may hide.", "A vehicle's."),
    Tunable(
        "rate_of_change_time_s", 1.0, "s", "Longest time over which the rate of change is extrapolated.", "Choice."
    ),
    Tunable("longest_gap_s", 30.0, "s", "Longest gap that is integrated.", "Choice."),
    Tunable("rate_hold_s", 0.5, "s", "The last rate is held so long.", "Choice."),
    Tunable(
        "max_gyro_outage_s", 1.0, "s", "After a longer time without rates the alignment starts again.", "Linearization."
    ),
    Tunable("near_range", 0.9, "", "Share of the largest rate from which an axis counts as saturated, too.", "Choice."),
    Tunable("over_range", 0.5, "", "Share of a clipped reading that may be beyond it.", "Choice."),
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
    reset_pairs(c)


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
def propagate_to(p: Parameters, c: Core, t_ns: int, w: Reals, f: Reals) -> None:
    """Propagate the core to t_ns, at which the sample is (w, f; body axes); a gap adds variance."""
    dt = 1e-9 * (t_ns - c.nav.t_ns)
    if dt <= 0.0:
        return
    dt = min(dt, p.tuning.longest_gap_s)
    turn2, accel2 = 0.0, 0.0
    if dt > p.tuning.gap_periods * p.period:
        s, psd = c.stationarity, p.tuning.vibration_noise_share * p.period
        turn2 = gap_variance(p, c.imu.w, w, dt, s.max_rate_of_change[0], s.vibration_gyro_psd / psd, p.tuning.gap_turn)
        accel2 = gap_variance(
            p, c.imu.f, f, dt, s.max_rate_of_change[1], s.vibration_accel_psd / psd, p.tuning.gap_accel
        )
    if dt > max(p.tuning.gap_s, 5.0 * p.period):
        extrapolate_gap(p, c, w, f, dt)
    else:
        mechanize(p, c, w, f, dt)
    if turn2 > 0.0:
        for i in range(3):
            add_variance(c, POSITION + i, 0.25 * accel2 * dt**4)
            add_variance(c, VELOCITY + i, accel2 * dt**2)
            add_variance(c, ATTITUDE + i, turn2 * dt**2)
    store_last_sample(c, t_ns, w, f)


@kernel
def end_window(p: Parameters, c: Core) -> None:
    """At the end of a stationarity window: detect rest, level, fuse rest, look for the forward axis."""
    propagate_errors(p, c)
    classify_window(p, c)
    monitor_gravity(p, c)
    at_rest = detect_rest(p, c)
    if c.alignment.mode == COARSE_ALIGNMENT:
        level_from_window(p, c, at_rest)  # before the update at rest changes the attitude of the mean force
    if at_rest and fuse_rest(p, c):
        flag_heading(p, c)
    if c.alignment.mode == COARSE_ALIGNMENT:
        if c.gnss.fix_count > 0 and c.alignment.heading_sigma > 0.0 and is_levelled(p, c):
            change_mode(p, c, HEADING_KNOWN)
    else:
        find_forward_axis(p, c)
    clear_window(c)


@kernel
def substitute_missing(p: Parameters, c: Core, sample: StoredSample) -> None:
    """Replace missing rates (held, later zero) and forces (no acceleration) of a sample; such a sample ends a rest."""
    if sample.flags & NO_RATE and sample.outage_s > p.tuning.rate_hold_s:
        for i in range(3):
            sample.w[i] = c.nav.bg[i]
    if sample.flags & NO_FORCE:
        weight = ned_to_body(c, (0.0, 0.0, -gravity(c.nav.lat, c.nav.height)))
        for i in range(3):
            sample.f[i] = weight[i] + c.nav.ba[i]
    withdraw_rest(c)


@kernel
def inflate_attitude(p: Parameters, c: Core, sample: StoredSample, fastest: float, q: float) -> None:
    """Add the variance q (rad^2) to the attitude about the body axes whose rate is missing or saturated.

    fastest: rad/s, largest rate of the three axes. An attitude that is too uncertain starts the alignment again.
    """
    m = rotation_matrix(c)
    for axis in range(3):
        if sample.flags & NO_RATE or abs(c.imu.w[axis]) > p.tuning.near_range * fastest:
            for i in range(3):
                for k in range(i, 3):
                    add_covariance(c, ATTITUDE + i, ATTITUDE + k, q * m[3 * i + axis] * m[3 * k + axis])
    reset_pairs(c)
    if c.alignment.mode == NAVIGATING and variance(c, ATTITUDE + 2) > p.tuning.max_heading_sigma**2:
        change_mode(p, c, HEADING_LOST)  # neither fixes nor the vehicle's constraint can correct such a heading
        reset_nhc(c)
    if max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1)) > p.tuning.lost_tilt**2:
        change_mode(p, c, ATTITUDE_LOST)


@kernel
def inflate_covariance(p: Parameters, c: Core, sample: StoredSample, dt: float) -> None:
    """Add variance for missing and clipped rates and forces, for the duration of the outage; dt: s of this sample."""
    c.imu.saturated = 1 if sample.flags & BEYOND_RANGE else 0
    if sample.flags == 0:
        c.imu.outage_s[0] = c.imu.outage_s[1] = 0.0
        return
    fastest = max(abs(c.imu.w[0]), abs(c.imu.w[1]), abs(c.imu.w[2]))
    largest = max(abs(c.imu.f[0]), abs(c.imu.f[1]), abs(c.imu.f[2]))
    turn = (
        p.tuning.gap_turn
        if sample.flags & NO_RATE
        else p.tuning.over_range * fastest
        if sample.flags & LIMITED_RATE
        else 0.0
    )
    accel = (
        p.tuning.gap_accel
        if sample.flags & NO_FORCE
        else p.tuning.over_range * largest
        if sample.flags & LIMITED_FORCE
        else 0.0
    )
    for k in range(2):
        before, most = c.imu.outage_s[k], turn if k == 0 else accel
        now = max(before + dt, sample.outage_s) if most > 0.0 else 0.0
        c.imu.outage_s[k] = now
        if most > 0.0 and k == 0:
            inflate_attitude(p, c, sample, fastest, most**2 * (now**2 - before**2))
        for i in range(3):
            if most > 0.0 and k == 1:
                add_variance(c, VELOCITY + i, most**2 * (now**2 - before**2))
                add_variance(c, POSITION + i, 0.25 * most**2 * (now**4 - before**4))


@kernel
def process_sample(p: Parameters, c: Core, sample: StoredSample) -> None:
    """Process one stored sample (body axes): propagate, then window end and constraint where they are due."""
    dt = 1e-9 * (sample.t_ns - c.nav.t_ns)
    gap_s = 1e-9 * (sample.t_ns - c.imu.sample_ns)
    c.imu.sample_ns = sample.t_ns
    c.imu.sample_count += 1
    if dt <= 0.0:
        return
    incomplete = sample.flags & (NO_RATE | NO_FORCE) != 0
    if incomplete:
        substitute_missing(p, c, sample)
    if sample.flags & POWER_ON:
        for i in range(3):
            c.imu.w[i] -= c.nav.bg[i]  # the last sample without the old biases, for the gap that follows it
            c.imu.f[i] -= c.nav.ba[i]
        reopen_biases(p, c)
    accumulate_window(c, sample.w, sample.f)
    propagate_to(p, c, sample.t_ns, sample.w, sample.f)
    if sample.flags & (POWER_ON | RECONNECTED) and gap_s > p.tuning.max_gyro_outage_s:
        check_attitude(p, c, gap_s)
    inflate_covariance(p, c, sample, dt)
    if incomplete:
        clear_window(c)
    if c.imu.outage_s[0] > p.tuning.max_gyro_outage_s and sample.flags & NO_RATE:
        change_mode(p, c, ATTITUDE_LOST)
    share = min(dt * (1.0 / p.tuning.smoothing_s), 1.0)
    for i in range(3):
        c.imu.rate_b[i] += share * (c.imu.w[i] - c.nav.bg[i] - c.imu.rate_b[i])
    if c.stationarity.duration >= p.tuning.rest_window_s and c.stationarity.sample_count > 3:
        end_window(p, c)
    if is_due(p, c, dt) and c.alignment.mode == NAVIGATING and c.imu.outage_s[0] == 0.0:
        propagate_errors(p, c)
        fuse_nhc(p, c)
