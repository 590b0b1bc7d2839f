"""A fix, at its epoch: how good it is, what it says against the estimate, and whether it may correct it.

A receiver's position error is almost purely correlated over tens of seconds, so it is mostly the wander state; the
white part is learned from the innovations. Position and velocity are gated.
"""

import math
from typing import Any

from ...kernels.earth import radii
from ...kernels.jit import kernel
from ...kernels.kalman import packed_index, reset
from ...kernels.rotation import quat_rotate
from ..records import AT_REST, POSITION_N, REJECTING, VELOCITY_N
from .admission import GATE, admit, admit_height
from .correction import absorb, correct, predicted, residual, row, take
from .covariance import grow, variance
from .creep import forget_creep, look_for_creep
from .stamps import confirm_stamp
from .state import ATTITUDE, LAG, LATENCY, NAVIGATING, POSITION, STATES, VELOCITY, WANDER
from .strapdown import cosine, wrapped

UERE = 2.0  # m per HDOP, horizontal
VERTICAL = 2.2  # times the horizontal sigma
UNKNOWN_HDOP = 1.5
LEAST_WANDER = 0.3  # of what a receiver states of its error, where all that is seen of it is white
RTK_FIXED, RTK_FLOAT = 0.03, 0.4  # m, when nothing better is reported
SPEED_SIGMA = (0.05, 0.3)  # m/s, of what is learned: errors that last from fix to fix do not show in innovations
COURSE_SPEED = 0.5  # m/s, below it the course is noise
ASTRAY_GATE = 20.0  # of fix against position, whatever the wander state says: it never has jumped, only crept
LEARNING = 0.03
SECOND_ORDER = 10.0  # m, m/s per rad^2 of heading variance: what the linear model leaves out
STALE_ACCEL = 1.0  # m/s^2, where a fix is too late for rewinding
LEVER_SIGMA, SWING_S = 0.03, 1.0  # m, of a lever arm taken by rule; s, of a turn between two fixes
LATENCY_FLOOR = 0.01  # s per metre of sigma
LASTING = 0.5  # of a receiver's error, outlasts any wait: no repetition takes it away


@kernel
def horizontal_sigma(fix: Any) -> float:
    """1 sigma of the position, m, from what the receiver reports."""
    if math.isfinite(fix.sigma[0]) and math.isfinite(fix.sigma[1]):
        return max(math.sqrt(0.5 * (fix.sigma[0] ** 2 + fix.sigma[1] ** 2)), 1e-3)
    hdop = fix.hdop if fix.hdop > 0.0 else UNKNOWN_HDOP
    unit = RTK_FIXED if fix.quality == 4 else (RTK_FLOAT if fix.quality == 5 else UERE)
    return unit * hdop


@kernel
def grade(c: Any, fix: Any) -> None:
    """Scale wander and white noise to the reported quality; another kind of solution has another wander."""
    h = horizontal_sigma(fix)
    v = max(fix.sigma[2], 1e-3) if math.isfinite(fix.sigma[2]) else VERTICAL * h
    for k in range(2):
        sigma = h if k == 0 else v
        if not 0.5 * c.reported[k] < sigma < 2.0 * c.reported[k]:
            c.white[k] = min(sigma, 0.03 + 0.5 * sigma) ** 2
            if math.isfinite(fix.sigma[2 * k]):
                c.white[k] = min(c.white[k], 0.5 * sigma * sigma)
            for i in range(2 * k, 2 + k):
                reset(c.P, STATES, WANDER + i, sigma * sigma)
                c.wander[i] = 0.0
            forget_creep(c)
        c.reported[k] = c.wandering[k] = sigma
        if math.isfinite(fix.sigma[2 * k]):  # the receiver's own word is of the whole error
            c.wandering[k] = math.sqrt(max(sigma * sigma - c.white[k], (LEAST_WANDER * sigma) ** 2))
    floor = LATENCY_FLOOR * h
    q = max(0.0, floor * floor - variance(c, LATENCY))  # of positions, whose errors last: velocities tell the sum
    grow(c, LATENCY, q)
    grow(c, LAG, q)
    c.P[packed_index(STATES, LATENCY, LAG)] -= q


@kernel
def offset(c: Any, fix: Any, out: Any) -> None:
    """out <- the way in m (NED) from the estimate to the fix; down is NaN without a height."""
    meridian, prime_vertical = radii(c.lat)
    out[0] = (fix.lat - c.lat) * (meridian + c.height)
    out[1] = wrapped(fix.lon - c.lon) * (prime_vertical + c.height) * cosine(c.lat)
    out[2] = -(fix.height - c.height)


@kernel
def position_row(c: Any, lever: Any, i: int) -> int:
    """Row of the antenna's position along axis i, from IMU position, attitude, wander and latency."""
    k = row(c, 0, POSITION + i, 1.0)
    j, m = (i + 1) % 3, (i + 2) % 3
    k = row(c, k, ATTITUDE + j, lever[m])
    k = row(c, k, ATTITUDE + m, -lever[j])
    k = row(c, k, WANDER + i, 1.0)
    return row(c, k, LATENCY, -c.v[i] if c.phase == NAVIGATING else 0.0)


@kernel
def report(innovations: Any, n: int, t_ns: int, kind: int, z: float, s: float, used: bool) -> int:
    """Write one row, if there is room; returns the rows written so far."""
    if n < len(innovations):
        r = innovations[n]
        r.t_ns, r.kind, r.value, r.variance, r.used = t_ns, kind, z, s, 1 if used else 0
        n += 1
    return n


@kernel
def level_arm(p: Any, c: Any, body: Any) -> tuple[float, float, float]:
    """A vector of the lever arm (`body`) in NED; none while levelling, where it is the antenna that is followed."""
    if c.phase != NAVIGATING:
        return 0.0, 0.0, 0.0
    return quat_rotate((c.q[0], c.q[1], c.q[2], c.q[3]), body)


@kernel
def bent(c: Any) -> float:
    """What the linear model leaves out, m or m/s, where an uncertain heading has a part in it."""
    return float(SECOND_ORDER * variance(c, ATTITUDE + 2)) if c.phase == NAVIGATING else 0.0


@kernel
def swing2(c: Any) -> float:
    """Square of the antenna's velocity, m^2/s^2, that an error of the lever arm has made up in the present turn."""
    return float(LEVER_SIGMA**2 * (c.rate[0] ** 2 + c.rate[1] ** 2 + c.rate[2] ** 2))


@kernel
def doubt_place(p: Any, c: Any) -> None:
    """The position is never known better than what lasts of the receiver's error, and no better than the lever arm."""
    arm2 = p.lever[0] ** 2 + p.lever[1] ** 2 + p.lever[2] ** 2 if c.phase != NAVIGATING else 0.0
    for i in range(3):
        grow(c, POSITION + i, max(0.0, (LASTING * c.reported[i // 2]) ** 2 + arm2 - variance(c, POSITION + i)))


@kernel
def strangeness(c: Any, lever: Any, extra: float, first: int, last: int) -> float:
    """The worst normalised residual squared of axes first to last - 1, to be held against GATE."""
    worst = 0.0
    for i in range(first, last):
        r = c.white[i // 2] + extra
        s = predicted(c, position_row(c, lever, i)) + r
        wandered = variance(c, POSITION + i) + c.reported[i // 2] ** 2 + r
        strayed = (c.z[i] + c.wander[i]) ** 2 / wandered  # a wander state that has run away is no excuse
        worst = max(worst, c.z[i] ** 2 / s, strayed * (GATE / ASTRAY_GATE))
    return worst


@kernel
def fuse_position(p: Any, c: Any, fix: Any, late: float, innovations: Any, n: int) -> int:
    """Gate and take the position; the fix was true `late` s before the core's time. Height has no veto."""
    z = c.z
    offset(c, fix, z)
    lever = level_arm(p, c, (p.lever[0], p.lever[1], p.lever[2]))
    extra = bent(c) ** 2 + (0.5 * STALE_ACCEL * late * late) ** 2
    extra += swing2(c) * SWING_S**2
    for i in range(3):
        z[i] += late * c.v[i] - lever[i] - c.wander[i]
    level = admit(c, fix, strangeness(c, lever, extra, 0, 2))
    height = level and admit_height(c, strangeness(c, lever, extra, 2, 3))
    for i in range(3):
        if not math.isfinite(z[i]):
            continue
        accepted = level if i < 2 else height
        r = c.white[i // 2] + extra
        m = position_row(c, lever, i)
        s = predicted(c, m) + r
        left = residual(c, m, z[i])
        n = report(innovations, n, fix.t_ns, POSITION_N + i, left, s, accepted)
        if accepted:
            nis = left * left / s
            absorb(c, m, left, s, i if i < 2 else -1)
            least, most = (0.3 * min(c.reported[i // 2], 0.3)) ** 2, (2.0 * c.reported[i // 2]) ** 2
            if c.phase == NAVIGATING or c.flags & AT_REST:  # else innovations tell of accelerations
                c.white[i // 2] = min(max(c.white[i // 2] + LEARNING * (min(nis, 9.0) - 1.0) * s, least), most)
    if level:
        correct(c)
        c.fix_ns = c.t_ns
        confirm_stamp(c)
        if c.phase == NAVIGATING and look_for_creep(c):
            correct(c)
        doubt_place(p, c)
    refused = c.rejected[0] > 0 or c.rejected[1] > 0
    c.flags = c.flags | REJECTING if refused else c.flags & ~REJECTING
    return n


@kernel
def velocity_of(fix: Any, axis: int) -> float:
    """North, east or down velocity of a fix, m/s; NaN where it says nothing."""
    if math.isfinite(fix.v[axis]):
        return float(fix.v[axis])
    if axis == 2 or not math.isfinite(fix.speed):
        return math.nan
    if fix.speed < COURSE_SPEED:
        return 0.0
    return float(fix.speed) * (math.cos(fix.course) if axis == 0 else math.sin(fix.course))


@kernel
def slowness2(fix: Any) -> float:
    """Variance, m^2/s^2, of a component of the velocity where only the speed is believed."""
    return 0.0 if math.isfinite(fix.v[0]) or not fix.speed < COURSE_SPEED else float(0.5 * fix.speed**2)


@kernel
def fuse_velocity(p: Any, c: Any, fix: Any, late: float, innovations: Any, n: int) -> int:
    """Gate and take the velocity, component by component."""
    w = (c.w[0] - c.bg[0], c.w[1] - c.bg[1], c.w[2] - c.bg[2])
    swung = (
        w[1] * p.lever[2] - w[2] * p.lever[1],
        w[2] * p.lever[0] - w[0] * p.lever[2],
        w[0] * p.lever[1] - w[1] * p.lever[0],
    )
    arm = level_arm(p, c, swung)
    slow = fix.speed if not math.isfinite(fix.v[0]) and fix.speed < COURSE_SPEED else 0.0
    late_too = 1.0 if c.phase == NAVIGATING else 0.0  # while levelling it is followed at the fixes' own time
    rejected = 0
    for i in range(3):
        received = velocity_of(fix, i)
        if not math.isfinite(received):
            continue
        trend, bend = late_too * c.trend[i], late_too * c.bend[i]
        z = received - c.v[i] - arm[i] + (late + c.lag) * trend
        r = c.white_speed + bent(c) ** 2 + slow * slow + swing2(c) + bend**2
        m = row(c, 0, VELOCITY + i, 1.0)
        m = row(c, m, LATENCY, -trend)
        m = row(c, m, LAG, -trend)
        s = predicted(c, m) + r
        left = residual(c, m, z)
        nis = take(c, m, z, r, GATE)
        used = nis >= 0.0
        if used and slow == 0.0:
            share = c.white_speed / s
            white = c.white_speed + LEARNING * share * (min(nis, 9.0) - 1.0) * s
            c.white_speed = min(max(white, SPEED_SIGMA[0] ** 2), SPEED_SIGMA[1] ** 2)
        n = report(innovations, n, fix.t_ns, VELOCITY_N + i, left, s, used)
        rejected += 0 if used else 1
    c.contrary = c.contrary + 1 if rejected else 0
    correct(c)
    return n
