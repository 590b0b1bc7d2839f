"""A fix, at its epoch: how good it is, what it says against the estimate, and whether it may correct it.

A receiver's position error is almost purely correlated over tens of seconds, so it is mostly the wander state; the
white part is learned from the innovations. Position and velocity are gated.
"""

import math
from typing import Any

from ....kernels.earth import radii
from ....kernels.jit import kernel
from ....kernels.kalman import packed_index, reset
from ....kernels.rotation import quat_rotate
from ...records import AT_REST, POSITION_N, REJECTING, VELOCITY_N
from ..ekf import gated_update, inject_error, innovation, innovation_variance, kalman_update, set_jacobian
from ..error_model import add_variance, variance
from ..integrity.gnss_drift import detect_drift, reset_drift
from ..integrity.position_gate import POSITION_GATE, gate_height, gate_position
from ..integrity.time_tags import confirm_survey_epochs
from ..mechanization import bounded_cosine, wrap_angle
from ..state import ATTITUDE, GNSS_BIAS, NAVIGATING, POSITION, STATES, TIME_OFFSET, VELOCITY, VELOCITY_TIME_OFFSET

UERE = 2.0  # m per HDOP, horizontal
VERTICAL_RATIO = 2.2  # times the horizontal sigma
UNKNOWN_HDOP = 1.5
MIN_BIAS_SHARE = 0.3  # of what a receiver states of its error, where all that is seen of it is white
RTK_FIXED, RTK_FLOAT = 0.03, 0.4  # m, when nothing better is reported
VELOCITY_SIGMA_RANGE = (
    0.05,
    0.3,
)  # m/s, of what is learned: errors that last from fix to fix do not show in innovations
MIN_COURSE_SPEED = 0.5  # m/s, below it the course is noise
BIAS_FREE_GATE = 20.0  # of fix against position, whatever the wander state says: it never has jumped, only crept
NOISE_GAIN = 0.03
SECOND_ORDER_HEADING = 10.0  # m, m/s per rad^2 of heading variance: what the linear model leaves out
LATE_FIX_ACCEL = 1.0  # m/s^2, where a fix is too late for rewinding
LEVER_ARM_SIGMA, TURN_BETWEEN_FIXES_S = 0.03, 1.0  # m, of a lever arm taken by rule; s, of a turn between two fixes
TIME_OFFSET_FLOOR = 0.01  # s per metre of sigma
CONSTANT_ERROR_SHARE = 0.5  # of a receiver's error, outlasts any wait: no repetition takes it away


@kernel
def horizontal_sigma(fix: Any) -> float:
    """1 sigma of the position, m, from what the receiver reports."""
    if math.isfinite(fix.sigma[0]) and math.isfinite(fix.sigma[1]):
        return max(math.sqrt(0.5 * (fix.sigma[0] ** 2 + fix.sigma[1] ** 2)), 1e-3)
    hdop = fix.hdop if fix.hdop > 0.0 else UNKNOWN_HDOP
    unit = RTK_FIXED if fix.quality == 4 else (RTK_FLOAT if fix.quality == 5 else UERE)
    return unit * hdop


@kernel
def set_gnss_noise(c: Any, fix: Any) -> None:
    """Scale wander and white noise to the reported quality; another kind of solution has another wander."""
    h = horizontal_sigma(fix)
    v = max(fix.sigma[2], 1e-3) if math.isfinite(fix.sigma[2]) else VERTICAL_RATIO * h
    for k in range(2):
        sigma = h if k == 0 else v
        if not 0.5 * c.gnss.reported_sigma[k] < sigma < 2.0 * c.gnss.reported_sigma[k]:
            c.gnss.noise_var[k] = min(sigma, 0.03 + 0.5 * sigma) ** 2
            if math.isfinite(fix.sigma[2 * k]):
                c.gnss.noise_var[k] = min(c.gnss.noise_var[k], 0.5 * sigma * sigma)
            for i in range(2 * k, 2 + k):
                reset(c.cov.P, STATES, GNSS_BIAS + i, sigma * sigma)
                c.gnss.bias[i] = 0.0
            reset_drift(c)
        c.gnss.reported_sigma[k] = c.gnss.bias_sigma[k] = sigma
        if math.isfinite(fix.sigma[2 * k]):  # the receiver's own word is of the whole error
            c.gnss.bias_sigma[k] = math.sqrt(max(sigma * sigma - c.gnss.noise_var[k], (MIN_BIAS_SHARE * sigma) ** 2))
    floor = TIME_OFFSET_FLOOR * h
    q = max(0.0, floor * floor - variance(c, TIME_OFFSET))  # of positions, whose errors last: velocities tell the sum
    add_variance(c, TIME_OFFSET, q)
    add_variance(c, VELOCITY_TIME_OFFSET, q)
    c.cov.P[packed_index(STATES, TIME_OFFSET, VELOCITY_TIME_OFFSET)] -= q


@kernel
def position_offset(c: Any, fix: Any, out: Any) -> None:
    """out <- the way in m (NED) from the estimate to the fix; down is NaN without a height."""
    meridian, prime_vertical = radii(c.nav.lat)
    out[0] = (fix.lat - c.nav.lat) * (meridian + c.nav.height)
    out[1] = wrap_angle(fix.lon - c.nav.lon) * (prime_vertical + c.nav.height) * bounded_cosine(c.nav.lat)
    out[2] = -(fix.height - c.nav.height)


@kernel
def position_jacobian(c: Any, lever: Any, i: int) -> int:
    """Row of the antenna's position along axis i, from IMU position, attitude, wander and latency."""
    k = set_jacobian(c, 0, POSITION + i, 1.0)
    j, m = (i + 1) % 3, (i + 2) % 3
    k = set_jacobian(c, k, ATTITUDE + j, lever[m])
    k = set_jacobian(c, k, ATTITUDE + m, -lever[j])
    k = set_jacobian(c, k, GNSS_BIAS + i, 1.0)
    return set_jacobian(c, k, TIME_OFFSET, -c.nav.v_n[i] if c.alignment.mode == NAVIGATING else 0.0)


@kernel
def write_innovation(innovations: Any, n: int, t_ns: int, kind: int, z: float, s: float, used: bool) -> int:
    """Write one row, if there is room; returns the rows written so far."""
    if n < len(innovations):
        r = innovations[n]
        r.t_ns, r.kind, r.value, r.variance, r.used = t_ns, kind, z, s, 1 if used else 0
        n += 1
    return n


@kernel
def lever_arm_n(p: Any, c: Any, body: Any) -> tuple[float, float, float]:
    """A vector of the lever arm (`body`) in NED; none while levelling, where it is the antenna that is followed."""
    if c.alignment.mode != NAVIGATING:
        return 0.0, 0.0, 0.0
    return quat_rotate((c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]), body)


@kernel
def second_order_error(c: Any) -> float:
    """What the linear model leaves out, m or m/s, where an uncertain heading has a part in it."""
    return float(SECOND_ORDER_HEADING * variance(c, ATTITUDE + 2)) if c.alignment.mode == NAVIGATING else 0.0


@kernel
def lever_arm_rate_variance(c: Any) -> float:
    """Square of the antenna's velocity, m^2/s^2, that an error of the lever arm has made up in the present turn."""
    return float(LEVER_ARM_SIGMA**2 * (c.imu.rate_b[0] ** 2 + c.imu.rate_b[1] ** 2 + c.imu.rate_b[2] ** 2))


@kernel
def limit_position_confidence(p: Any, c: Any) -> None:
    """The position is never known better than what lasts of the receiver's error, and no better than the lever arm."""
    arm2 = (
        p.gnss_lever_arm[0] ** 2 + p.gnss_lever_arm[1] ** 2 + p.gnss_lever_arm[2] ** 2
        if c.alignment.mode != NAVIGATING
        else 0.0
    )
    for i in range(3):
        add_variance(
            c,
            POSITION + i,
            max(0.0, (CONSTANT_ERROR_SHARE * c.gnss.reported_sigma[i // 2]) ** 2 + arm2 - variance(c, POSITION + i)),
        )


@kernel
def max_nis(c: Any, lever: Any, extra: float, first: int, last: int) -> float:
    """The worst normalised residual squared of axes first to last - 1, to be held against GATE."""
    worst = 0.0
    for i in range(first, last):
        r = c.gnss.noise_var[i // 2] + extra
        s = innovation_variance(c, position_jacobian(c, lever, i)) + r
        wandered = variance(c, POSITION + i) + c.gnss.reported_sigma[i // 2] ** 2 + r
        strayed = (
            c.scratch.position_innovation[i] + c.gnss.bias[i]
        ) ** 2 / wandered  # a wander state that has run away is no excuse
        worst = max(worst, c.scratch.position_innovation[i] ** 2 / s, strayed * (POSITION_GATE / BIAS_FREE_GATE))
    return worst


@kernel
def fuse_gnss_position(p: Any, c: Any, fix: Any, late: float, innovations: Any, n: int) -> int:
    """Gate and take the position; the fix was true `late` s before the core's time. Height has no veto."""
    z = c.scratch.position_innovation
    position_offset(c, fix, z)
    lever = lever_arm_n(p, c, (p.gnss_lever_arm[0], p.gnss_lever_arm[1], p.gnss_lever_arm[2]))
    extra = second_order_error(c) ** 2 + (0.5 * LATE_FIX_ACCEL * late * late) ** 2
    extra += lever_arm_rate_variance(c) * TURN_BETWEEN_FIXES_S**2
    for i in range(3):
        z[i] += late * c.nav.v_n[i] - lever[i] - c.gnss.bias[i]
    level = gate_position(c, fix, max_nis(c, lever, extra, 0, 2))
    height = level and gate_height(c, max_nis(c, lever, extra, 2, 3))
    for i in range(3):
        if not math.isfinite(z[i]):
            continue
        accepted = level if i < 2 else height
        r = c.gnss.noise_var[i // 2] + extra
        m = position_jacobian(c, lever, i)
        s = innovation_variance(c, m) + r
        left = innovation(c, m, z[i])
        n = write_innovation(innovations, n, fix.t_ns, POSITION_N + i, left, s, accepted)
        if accepted:
            nis = left * left / s
            kalman_update(c, m, left, s, i if i < 2 else -1)
            least, most = (
                (0.3 * min(c.gnss.reported_sigma[i // 2], 0.3)) ** 2,
                (2.0 * c.gnss.reported_sigma[i // 2]) ** 2,
            )
            if c.alignment.mode == NAVIGATING or c.nav.flags & AT_REST:  # else innovations tell of accelerations
                c.gnss.noise_var[i // 2] = min(
                    max(c.gnss.noise_var[i // 2] + NOISE_GAIN * (min(nis, 9.0) - 1.0) * s, least), most
                )
    if level:
        inject_error(c)
        c.gnss.last_used_ns = c.nav.t_ns
        confirm_survey_epochs(c)
        if c.alignment.mode == NAVIGATING and detect_drift(c):
            inject_error(c)
        limit_position_confidence(p, c)
    refused = c.integrity.reject_count[0] > 0 or c.integrity.reject_count[1] > 0
    c.nav.flags = c.nav.flags | REJECTING if refused else c.nav.flags & ~REJECTING
    return n


@kernel
def velocity_of(fix: Any, axis: int) -> float:
    """North, east or down velocity of a fix, m/s; NaN where it says nothing."""
    if math.isfinite(fix.v[axis]):
        return float(fix.v[axis])
    if axis == 2 or not math.isfinite(fix.speed):
        return math.nan
    if fix.speed < MIN_COURSE_SPEED:
        return 0.0
    return float(fix.speed) * (math.cos(fix.course) if axis == 0 else math.sin(fix.course))


@kernel
def low_speed_variance(fix: Any) -> float:
    """Variance, m^2/s^2, of a component of the velocity where only the speed is believed."""
    return 0.0 if math.isfinite(fix.v[0]) or not fix.speed < MIN_COURSE_SPEED else float(0.5 * fix.speed**2)


@kernel
def fuse_gnss_velocity(p: Any, c: Any, fix: Any, late: float, innovations: Any, n: int) -> int:
    """Gate and take the velocity, component by component."""
    w = (c.imu.w[0] - c.nav.bg[0], c.imu.w[1] - c.nav.bg[1], c.imu.w[2] - c.nav.bg[2])
    swung = (
        w[1] * p.gnss_lever_arm[2] - w[2] * p.gnss_lever_arm[1],
        w[2] * p.gnss_lever_arm[0] - w[0] * p.gnss_lever_arm[2],
        w[0] * p.gnss_lever_arm[1] - w[1] * p.gnss_lever_arm[0],
    )
    arm = lever_arm_n(p, c, swung)
    slow = fix.speed if not math.isfinite(fix.v[0]) and fix.speed < MIN_COURSE_SPEED else 0.0
    late_too = 1.0 if c.alignment.mode == NAVIGATING else 0.0  # while levelling it is followed at the fixes' own time
    rejected = 0
    for i in range(3):
        received = velocity_of(fix, i)
        if not math.isfinite(received):
            continue
        trend, bend = late_too * c.scratch.accel_fit[i], late_too * c.scratch.accel_fit_error[i]
        z = received - c.nav.v_n[i] - arm[i] + (late + c.gnss.velocity_time_offset) * trend
        r = c.gnss.velocity_noise_var + second_order_error(c) ** 2 + slow * slow + lever_arm_rate_variance(c) + bend**2
        m = set_jacobian(c, 0, VELOCITY + i, 1.0)
        m = set_jacobian(c, m, TIME_OFFSET, -trend)
        m = set_jacobian(c, m, VELOCITY_TIME_OFFSET, -trend)
        s = innovation_variance(c, m) + r
        left = innovation(c, m, z)
        nis = gated_update(c, m, z, r, POSITION_GATE)
        used = nis >= 0.0
        if used and slow == 0.0:
            share = c.gnss.velocity_noise_var / s
            white = c.gnss.velocity_noise_var + NOISE_GAIN * share * (min(nis, 9.0) - 1.0) * s
            c.gnss.velocity_noise_var = min(max(white, VELOCITY_SIGMA_RANGE[0] ** 2), VELOCITY_SIGMA_RANGE[1] ** 2)
        n = write_innovation(innovations, n, fix.t_ns, VELOCITY_N + i, left, s, used)
        rejected += 0 if used else 1
    c.integrity.velocity_reject_count = c.integrity.velocity_reject_count + 1 if rejected else 0
    inject_error(c)
    return n
