"""One sample further: the same code for new samples and for those integrated again after a late fix."""

from typing import Any

from drivers.sample import LIMITED_FORCE, LIMITED_RATE, NO_FORCE, NO_RATE
from drivers.sample import SATURATED as BEYOND_RANGE

from ...kernels.earth import gravity
from ...kernels.jit import kernel
from ...kernels.kalman import packed_index
from ...kernels.rotation import dcm_of_quat, quat_rotate_back
from ..records import AT_REST, SATURATED
from .aiding.non_holonomic import NHC_INTERVAL_S as CONSTRAINT_S
from .aiding.non_holonomic import find_forward_axis, fuse_nhc, reset_nhc
from .aiding.zero_velocity import fuse_rest
from .alignment.levelling import level_from_window
from .alignment.transitions import LOST_TILT, abort_navigation, restart_attitude, start_navigation
from .alignment.velocity_pairs import is_levelled, reset_pairs
from .error_model import COVARIANCE_INTERVAL_S, add_variance, propagate_covariance, variance
from .integrity.heading_monitor import MAX_HEADING_SIGMA
from .mechanization import integrate_strapdown
from .state import ATTITUDE, COARSE_ALIGNMENT, NAVIGATING, POSITION, STATES, VELOCITY
from .stationarity import VIBRATION_NOISE_SHARE, WINDOW_S, accumulate_window, classify_window, clear_window, detect_rest

GAP_STEP_S = 0.05
GAP_PERIODS = 2.5  # sample periods: a longer silence of the sensor hides something
GAP_S = 0.1  # and one longer than that is bridged
GAP_ACCEL, GAP_TURN = 2.0, 0.3  # m/s^2, rad/s: what may happen in a long one, even where the motion was smooth
RATE_OF_CHANGE_TIME_S = 1.0  # by when a fitful motion has taken another turn
LONGEST_GAP_S = 30.0
RATE_HOLD_S = 0.5  # the last rate is held
MAX_GYRO_OUTAGE_S = (
    1.0  # without rates, then the attitude is found anew: its sigma is beyond what a linear filter can use
)
NEAR_RANGE = 0.9  # of the fastest rate: that axis is at the end of its range, too
OVER_RANGE = 0.5  # of a reading at the end of the range, what may be beyond it
SMOOTHING_S = 0.2


@kernel
def mechanize(p: Any, c: Any, w: Any, f: Any, dt: float) -> None:
    """Integrate over dt, which is short; while levelling the velocity is what the fixes tell, not an integral."""
    v0, v1, v2 = c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2]
    integrate_strapdown(c, w, f, dt)
    a = min(1.0 / SMOOTHING_S, 1.0 / dt)
    c.imu.accel_n[0] += a * (c.nav.v_n[0] - v0 - dt * c.imu.accel_n[0])
    c.imu.accel_n[1] += a * (c.nav.v_n[1] - v1 - dt * c.imu.accel_n[1])
    c.imu.accel_n[2] += a * (c.nav.v_n[2] - v2 - dt * c.imu.accel_n[2])
    if c.alignment.mode == COARSE_ALIGNMENT:
        c.nav.v_n[0], c.nav.v_n[1], c.nav.v_n[2] = v0, v1, v2
    if c.imu.integration_time >= COVARIANCE_INTERVAL_S:
        propagate_covariance(p, c)


@kernel
def gap_variance(before: Any, after: Any, dt: float, fitful: float, jitter2: float, most: float) -> float:
    """Variance of the mean over a gap of dt s, about that of two readings: of a random walk tied at both ends.

    It has changed as fast as it did at its most fitful, or from one end to the other; the ends vibrate by `jitter2`.
    In a long gap it may have become anything: `most`, or what fitful motion is.
    """
    jump2 = 0.0
    for i in range(3):
        jump2 = max(jump2, (after[i] - before[i]) ** 2)
    return min(max(fitful * dt, jump2) / 12.0, max(fitful * RATE_OF_CHANGE_TIME_S, most**2)) + 0.5 * jitter2


@kernel
def extrapolate_gap(p: Any, c: Any, w: Any, f: Any, dt: float) -> None:
    """Integrate over a gap in the samples, holding what is known."""
    chunks = int(dt / GAP_STEP_S) + 1
    for i in range(3):
        c.imu.w[i] = 0.5 * (c.imu.w[i] + w[i])
        c.imu.f[i] = 0.5 * (c.imu.f[i] + f[i])
    for _ in range(chunks):
        mechanize(p, c, c.imu.w, c.imu.f, dt / chunks)
    propagate_covariance(p, c)
    c.stationarity.low_motion_count = 0
    c.stationarity.stationary_count = 0
    clear_window(c)
    reset_pairs(c)


@kernel
def propagate_to(p: Any, c: Any, t_ns: int, w: Any, f: Any) -> None:
    """Bring the core to time t_ns, at which the sensor shows (w, f)."""
    dt = 1e-9 * (t_ns - c.nav.t_ns)
    if dt <= 0.0:
        return
    dt = min(dt, LONGEST_GAP_S)
    turn2, accel2 = 0.0, 0.0
    if dt > GAP_PERIODS * p.period:
        turn2 = gap_variance(
            c.imu.w,
            w,
            dt,
            c.stationarity.max_rate_of_change[0],
            c.stationarity.vibration_gyro_psd / (VIBRATION_NOISE_SHARE * p.period),
            GAP_TURN,
        )
        accel2 = gap_variance(
            c.imu.f,
            f,
            dt,
            c.stationarity.max_rate_of_change[1],
            c.stationarity.vibration_accel_psd / (VIBRATION_NOISE_SHARE * p.period),
            GAP_ACCEL,
        )
    if dt > max(GAP_S, 5.0 * p.period):
        extrapolate_gap(p, c, w, f, dt)
    else:
        mechanize(p, c, w, f, dt)
    if turn2 > 0.0:
        for i in range(3):
            add_variance(c, POSITION + i, 0.25 * accel2 * dt**4)
            add_variance(c, VELOCITY + i, accel2 * dt**2)
            add_variance(c, ATTITUDE + i, turn2 * dt**2)
    c.nav.t_ns = t_ns
    for i in range(3):
        c.imu.w[i] = w[i]
        c.imu.f[i] = f[i]


@kernel
def end_window(p: Any, c: Any) -> None:
    """The end of a motion window: rest, level, and the vehicle's axis."""
    propagate_covariance(p, c)
    classify_window(p, c)
    resting = detect_rest(c)
    c.nav.flags = c.nav.flags | AT_REST if resting else c.nav.flags & ~AT_REST
    if c.alignment.mode == COARSE_ALIGNMENT:
        level_from_window(c, resting)  # before `rest` turns the attitude that the mean belongs to
    if resting:
        fuse_rest(p, c)
    if c.alignment.mode == COARSE_ALIGNMENT:
        if c.gnss.fix_count > 0 and c.alignment.heading_sigma > 0.0 and is_levelled(c):
            start_navigation(p, c)
    else:
        find_forward_axis(p, c)
    clear_window(c)


@kernel
def substitute_missing(c: Any, sample: Any) -> None:
    """What the sample does not show: soon no turn, and no acceleration. Nothing of that looks like rest."""
    if sample.flags & NO_RATE and sample.unseen_s > RATE_HOLD_S:
        for i in range(3):
            sample.w[i] = c.nav.bg[i]
    if sample.flags & NO_FORCE:
        weight = quat_rotate_back(
            (c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]), (0.0, 0.0, -gravity(c.nav.lat, c.nav.height))
        )
        for i in range(3):
            sample.f[i] = weight[i] + c.nav.ba[i]
    c.nav.flags &= ~AT_REST
    c.stationarity.low_motion_count = c.stationarity.stationary_count = 0


@kernel
def inflate_attitude(p: Any, c: Any, sample: Any, worst: float, q: float) -> None:
    """Let the attitude's variance grow by q about the axes that show no rate, or the end of their range."""
    m = dcm_of_quat((c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]))
    for axis in range(3):
        if sample.flags & NO_RATE or abs(c.imu.w[axis]) > NEAR_RANGE * worst:
            for i in range(3):
                for k in range(i, 3):
                    c.cov.P[packed_index(STATES, ATTITUDE + i, ATTITUDE + k)] += q * m[3 * i + axis] * m[3 * k + axis]
    reset_pairs(c)
    if c.alignment.mode == NAVIGATING and variance(c, ATTITUDE + 2) > MAX_HEADING_SIGMA**2:
        abort_navigation(p, c)  # neither fixes nor the vehicle's constraint can correct such a heading
        reset_nhc(c)
    if max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1)) > LOST_TILT**2:
        restart_attitude(p, c)


@kernel
def inflate_covariance(p: Any, c: Any, sample: Any, dt: float) -> None:
    """Let grow what a sample does not show, or only the beginning of, for as long as that lasts."""
    c.nav.flags = c.nav.flags | SATURATED if sample.flags & BEYOND_RANGE else c.nav.flags & ~SATURATED
    if sample.flags == 0:
        c.imu.outage_s[0] = c.imu.outage_s[1] = 0.0
        return
    worst_w = max(abs(c.imu.w[0]), abs(c.imu.w[1]), abs(c.imu.w[2]))
    worst_f = max(abs(c.imu.f[0]), abs(c.imu.f[1]), abs(c.imu.f[2]))
    turn = GAP_TURN if sample.flags & NO_RATE else OVER_RANGE * worst_w if sample.flags & LIMITED_RATE else 0.0
    accel = GAP_ACCEL if sample.flags & NO_FORCE else OVER_RANGE * worst_f if sample.flags & LIMITED_FORCE else 0.0
    for k in range(2):
        before, most = c.imu.outage_s[k], turn if k == 0 else accel
        now = max(before + dt, sample.unseen_s) if most > 0.0 else 0.0
        c.imu.outage_s[k] = now
        if most > 0.0 and k == 0:
            inflate_attitude(p, c, sample, worst_w, most**2 * (now**2 - before**2))
        for i in range(3):
            if most > 0.0 and k == 1:
                add_variance(c, VELOCITY + i, most**2 * (now**2 - before**2))
                add_variance(c, POSITION + i, 0.25 * most**2 * (now**4 - before**4))


@kernel
def process_sample(p: Any, c: Any, sample: Any) -> None:
    """Take one kept sample (body axes) and whatever becomes due with it."""
    dt = 1e-9 * (sample.t_ns - c.nav.t_ns)
    c.imu.sample_count += 1
    if dt <= 0.0:
        return
    blind = sample.flags & (NO_RATE | NO_FORCE) != 0
    if blind:
        substitute_missing(c, sample)
    accumulate_window(c, sample.w, sample.f)
    propagate_to(p, c, sample.t_ns, sample.w, sample.f)
    inflate_covariance(p, c, sample, dt)
    if blind:
        clear_window(c)
    if c.imu.outage_s[0] > MAX_GYRO_OUTAGE_S and sample.flags & NO_RATE:
        restart_attitude(p, c)
    share = min(dt * (1.0 / SMOOTHING_S), 1.0)
    for i in range(3):
        c.imu.rate_b[i] += share * (c.imu.w[i] - c.nav.bg[i] - c.imu.rate_b[i])
    if c.stationarity.duration >= WINDOW_S and c.stationarity.sample_count > 3:
        end_window(p, c)
    c.nhc.since_update += dt
    seen = c.imu.outage_s[0] == 0.0
    if c.nhc.enabled and c.alignment.mode == NAVIGATING and seen and c.nhc.since_update >= CONSTRAINT_S:
        propagate_covariance(p, c)
        fuse_nhc(p, c)
