"""One sample further: the same code for new samples and for those that are replayed after a late measurement."""

from typing import Any

from drivers.sample import LIMITED_FORCE, LIMITED_RATE, NO_FORCE, NO_RATE, POWER_ON
from drivers.sample import SATURATED as BEYOND_RANGE

from ...compile.jit import kernel
from ...math.earth import gravity
from .aiding.non_holonomic import find_forward_axis, fuse_nhc, is_due, reset_nhc
from .aiding.zero_velocity import fuse_rest
from .alignment.levelling import level_from_window
from .alignment.transitions import LOST_TILT, abort_navigation, restart_attitude, start_navigation
from .alignment.velocity_pairs import flag_heading, is_levelled, reset_pairs
from .ekf import add_covariance, add_variance, variance
from .error_model import COVARIANCE_INTERVAL_S
from .fusion import propagate_errors
from .integrity.heading_monitor import MAX_HEADING_SIGMA
from .mechanization import integrate_strapdown, ned_to_body, rotation_matrix, set_velocity
from .power_on import check_tilt, reopen_biases
from .state import ATTITUDE, COARSE_ALIGNMENT, NAVIGATING, POSITION, VELOCITY
from .stationarity import (
    VIBRATION_NOISE_SHARE,
    WINDOW_S,
    accumulate_force,
    accumulate_window,
    classify_window,
    clear_window,
    detect_rest,
    interrupt_rest,
    withdraw_rest,
)

GAP_STEP_S = 0.05
GAP_PERIODS = 2.5  # sample periods: a longer silence of the sensor hides something
GAP_S = 0.1  # and one longer than that is extrapolated
GAP_ACCEL, GAP_TURN = 2.0, 0.3  # m/s^2, rad/s: what may happen in a long one, even where the motion was smooth
RATE_OF_CHANGE_TIME_S = 1.0  # after that a motion that changes much has taken another turn
LONGEST_GAP_S = 30.0
RATE_HOLD_S = 0.5  # the last rate is held
MAX_GYRO_OUTAGE_S = 1.0  # then the attitude is found anew: its sigma is beyond what a linear filter can use
NEAR_RANGE = 0.9  # of the fastest rate: that axis is at the end of its range, too
OVER_RANGE = 0.5  # of a reading at the end of the range, what may be beyond it
SMOOTHING_S = 0.2


@kernel
def mechanize(p: Any, c: Any, w: Any, f: Any, dt: float) -> None:
    """Integrate over dt, which is short; during coarse alignment the velocity is the receiver's, not an integral."""
    v0, v1, v2 = c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2]
    accumulate_force(c, integrate_strapdown(c, w, f, dt), dt)
    v, accel, a = c.nav.v_n, c.imu.accel_n, min(1.0 / SMOOTHING_S, 1.0 / dt)
    accel[0] += a * (v[0] - v0 - dt * accel[0])
    accel[1] += a * (v[1] - v1 - dt * accel[1])
    accel[2] += a * (v[2] - v2 - dt * accel[2])
    if c.alignment.mode == COARSE_ALIGNMENT:
        set_velocity(c, 0, v0)
        set_velocity(c, 1, v1)
        set_velocity(c, 2, v2)
    if c.imu.integration_time >= COVARIANCE_INTERVAL_S:
        propagate_errors(p, c)


@kernel
def gap_variance(before: Any, after: Any, dt: float, rate_of_change: float, jitter2: float, most: float) -> float:
    """Variance of the mean over a gap of dt s, about that of two readings: of a random walk tied at both ends.

    It has changed as fast as it did at its fastest, or from one end to the other; the ends vibrate by `jitter2`.
    In a long gap it may have become anything: `most`, or what a motion that changes so fast is.
    """
    jump2 = 0.0
    for i in range(3):
        jump2 = max(jump2, (after[i] - before[i]) ** 2)
    longest = max(rate_of_change * RATE_OF_CHANGE_TIME_S, most**2)
    return min(max(rate_of_change * dt, jump2) / 12.0, longest) + 0.5 * jitter2


@kernel
def extrapolate_gap(p: Any, c: Any, w: Any, f: Any, dt: float) -> None:
    """Integrate over a gap in the samples, holding what is known."""
    steps = int(dt / GAP_STEP_S) + 1
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
def store_last_sample(c: Any, t_ns: int, w: Any, f: Any) -> None:
    """The core is at t_ns, and the sensor shows (w, f) there."""
    c.nav.t_ns = t_ns
    for i in range(3):
        c.imu.w[i] = w[i]
        c.imu.f[i] = f[i]


@kernel
def propagate_to(p: Any, c: Any, t_ns: int, w: Any, f: Any) -> None:
    """Bring the core to time t_ns, at which the sensor shows (w, f)."""
    dt = 1e-9 * (t_ns - c.nav.t_ns)
    if dt <= 0.0:
        return
    dt = min(dt, LONGEST_GAP_S)
    turn2, accel2 = 0.0, 0.0
    if dt > GAP_PERIODS * p.period:
        s, psd = c.stationarity, VIBRATION_NOISE_SHARE * p.period
        turn2 = gap_variance(c.imu.w, w, dt, s.max_rate_of_change[0], s.vibration_gyro_psd / psd, GAP_TURN)
        accel2 = gap_variance(c.imu.f, f, dt, s.max_rate_of_change[1], s.vibration_accel_psd / psd, GAP_ACCEL)
    if dt > max(GAP_S, 5.0 * p.period):
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
def end_window(p: Any, c: Any) -> None:
    """The end of a stationarity window: rest, level, and the vehicle's axis."""
    propagate_errors(p, c)
    classify_window(p, c)
    resting = detect_rest(c)
    if c.alignment.mode == COARSE_ALIGNMENT:
        level_from_window(c, resting)  # before rest turns the attitude that the mean force belongs to
    if resting and fuse_rest(p, c):
        flag_heading(c)
    if c.alignment.mode == COARSE_ALIGNMENT:
        if c.gnss.fix_count > 0 and c.alignment.heading_sigma > 0.0 and is_levelled(c):
            start_navigation(p, c)
    else:
        find_forward_axis(p, c)
    clear_window(c)


@kernel
def substitute_missing(c: Any, sample: Any) -> None:
    """Put into the sample what it does not show: soon no turn, and no acceleration. Nothing of that looks like rest."""
    if sample.flags & NO_RATE and sample.unseen_s > RATE_HOLD_S:
        for i in range(3):
            sample.w[i] = c.nav.bg[i]
    if sample.flags & NO_FORCE:
        weight = ned_to_body(c, (0.0, 0.0, -gravity(c.nav.lat, c.nav.height)))
        for i in range(3):
            sample.f[i] = weight[i] + c.nav.ba[i]
    withdraw_rest(c)


@kernel
def inflate_attitude(p: Any, c: Any, sample: Any, fastest: float, q: float) -> None:
    """Add the variance q to the attitude about the axes that show no rate, or the end of their range."""
    m = rotation_matrix(c)
    for axis in range(3):
        if sample.flags & NO_RATE or abs(c.imu.w[axis]) > NEAR_RANGE * fastest:
            for i in range(3):
                for k in range(i, 3):
                    add_covariance(c, ATTITUDE + i, ATTITUDE + k, q * m[3 * i + axis] * m[3 * k + axis])
    reset_pairs(c)
    if c.alignment.mode == NAVIGATING and variance(c, ATTITUDE + 2) > MAX_HEADING_SIGMA**2:
        abort_navigation(p, c)  # neither fixes nor the vehicle's constraint can correct such a heading
        reset_nhc(c)
    if max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1)) > LOST_TILT**2:
        restart_attitude(p, c)


@kernel
def inflate_covariance(p: Any, c: Any, sample: Any, dt: float) -> None:
    """Add the variance of what a sample does not show, or only the beginning of, for as long as that lasts."""
    c.imu.saturated = 1 if sample.flags & BEYOND_RANGE else 0
    if sample.flags == 0:
        c.imu.outage_s[0] = c.imu.outage_s[1] = 0.0
        return
    fastest = max(abs(c.imu.w[0]), abs(c.imu.w[1]), abs(c.imu.w[2]))
    largest = max(abs(c.imu.f[0]), abs(c.imu.f[1]), abs(c.imu.f[2]))
    turn = GAP_TURN if sample.flags & NO_RATE else OVER_RANGE * fastest if sample.flags & LIMITED_RATE else 0.0
    accel = GAP_ACCEL if sample.flags & NO_FORCE else OVER_RANGE * largest if sample.flags & LIMITED_FORCE else 0.0
    for k in range(2):
        before, most = c.imu.outage_s[k], turn if k == 0 else accel
        now = max(before + dt, sample.unseen_s) if most > 0.0 else 0.0
        c.imu.outage_s[k] = now
        if most > 0.0 and k == 0:
            inflate_attitude(p, c, sample, fastest, most**2 * (now**2 - before**2))
        for i in range(3):
            if most > 0.0 and k == 1:
                add_variance(c, VELOCITY + i, most**2 * (now**2 - before**2))
                add_variance(c, POSITION + i, 0.25 * most**2 * (now**4 - before**4))


@kernel
def process_sample(p: Any, c: Any, sample: Any) -> None:
    """Take one stored sample (body axes) and whatever becomes due with it."""
    dt = 1e-9 * (sample.t_ns - c.nav.t_ns)
    away_s = 1e-9 * (sample.t_ns - c.imu.sample_ns)
    c.imu.sample_ns = sample.t_ns
    c.imu.sample_count += 1
    if dt <= 0.0:
        return
    incomplete = sample.flags & (NO_RATE | NO_FORCE) != 0
    if incomplete:
        substitute_missing(c, sample)
    if sample.flags & POWER_ON:
        for i in range(3):
            c.imu.w[i] -= c.nav.bg[i]  # the last sample as this sensor would show it, for the gap that follows it
            c.imu.f[i] -= c.nav.ba[i]
        reopen_biases(p, c)
    accumulate_window(c, sample.w, sample.f)
    propagate_to(p, c, sample.t_ns, sample.w, sample.f)
    if sample.flags & POWER_ON and away_s > MAX_GYRO_OUTAGE_S:
        check_tilt(p, c)
    inflate_covariance(p, c, sample, dt)
    if incomplete:
        clear_window(c)
    if c.imu.outage_s[0] > MAX_GYRO_OUTAGE_S and sample.flags & NO_RATE:
        restart_attitude(p, c)
    share = min(dt * (1.0 / SMOOTHING_S), 1.0)
    for i in range(3):
        c.imu.rate_b[i] += share * (c.imu.w[i] - c.nav.bg[i] - c.imu.rate_b[i])
    if c.stationarity.duration >= WINDOW_S and c.stationarity.sample_count > 3:
        end_window(p, c)
    if is_due(c, dt) and c.alignment.mode == NAVIGATING and c.imu.outage_s[0] == 0.0:
        propagate_errors(p, c)
        fuse_nhc(p, c)
