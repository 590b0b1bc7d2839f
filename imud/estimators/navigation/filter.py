"""The two entries of the navigation filter: an inertial sample, and a fix."""

import math
from typing import Any

from drivers.sample import NO_FORCE, NO_RATE, SUSPECT, UNTOLD

from ...kernels.jit import kernel
from ...kernels.rotation import euler_of_quat, quat_of_euler, quat_of_gravity
from ..records import POSITION_N, REJECTING
from .acquisition import acquire, calm_speed, place
from .admission import stuck
from .alignment import disengage, engage, forget_heading
from .covariance import doubt_turn_scale, predict, variance
from .fix_matching import levelled
from .gnss import fuse_position, fuse_velocity, grade, horizontal_sigma, report
from .history import approach, follow, remember, rewind, snap, trace_velocity
from .solution import HEADING_LIMIT, write
from .stamps import trust_stamp
from .state import ATTITUDE, LEVELLING, NAVIGATING, NEVER_NS, UNREAD
from .supervision import supervise

CONTRARY = 8  # fixes in a row with a velocity that contradicts: the heading is wrong
LOST = 1.5
AHEAD_S, OLDEST_S = 1.0, 10.0  # a fix may be newer or older than the newest sample by this
STALE_S = 1.0


@kernel
def step(p: Any, s: Any, sample: Any, solution: Any) -> None:
    """One inertial sample (body axes) in, one solution out. For a suspect sample the last good one is held."""
    w, f = s.w, s.f
    good = (sample.flags & SUSPECT) == 0
    for i in range(3):
        finite = math.isfinite(sample.w[i]) and math.isfinite(sample.f[i])
        good = good and (finite or (sample.flags & (NO_RATE | NO_FORCE)) != 0)
    for i in range(3):
        if good and (sample.flags & NO_RATE) == 0:
            w[i] = sample.w[i]
        if good and (sample.flags & NO_FORCE) == 0:
            f[i] = sample.f[i]
    c = s.core[0]
    if s.received == 0:
        if good and (sample.flags & UNTOLD) == 0:
            begin(p, c, sample.t_ns, w, f, s.initial_rpy)
            remember(s, sample, w, f)
            c.taken = 1
    elif sample.t_ns > s.ring[(s.received - 1) % len(s.ring)].t_ns:
        remember(s, sample, w, f)
        follow(p, s)
        gather(s)
    write(c, solution)


@kernel
def gather(s: Any) -> None:
    """Keep what the newest sample told. Samples that are integrated again after a late fix tell nothing new."""
    c = s.core[0]
    for k in range(c.telling):
        if s.waiting < UNREAD:
            s.unread[s.waiting] = c.told[k]
            s.waiting += 1
    c.telling = 0


@kernel
def told(s: Any, innovations: Any) -> int:
    """Move the innovations of rest and constraints to `innovations`, oldest first; returns how many."""
    n: int = min(s.waiting, len(innovations))
    for k in range(n):
        innovations[k] = s.unread[k]
    for k in range(n, s.waiting):
        s.unread[k - n] = s.unread[k]
    s.waiting -= n
    return n


@kernel
def begin(p: Any, c: Any, t_ns: int, w: Any, f: Any, rpy: Any) -> None:
    """Take the first sample: the attitude is that of rest, unless it was given."""
    c.t_ns = t_ns
    for i in range(3):
        c.w[i] = w[i]
        c.f[i] = c.mean_f[i] = f[i]
    roll, pitch, yaw = rpy[0], rpy[1], rpy[2]
    if not (math.isfinite(roll) and math.isfinite(pitch)):
        if f[0] * f[0] + f[1] * f[1] + f[2] * f[2] > 1.0:
            roll, pitch, _ = euler_of_quat(quat_of_gravity(f[0], f[1], f[2]))
        else:
            roll, pitch = 0.0, 0.0
    c.q[0], c.q[1], c.q[2], c.q[3] = quat_of_euler(roll, pitch, yaw if math.isfinite(yaw) else 0.0)
    doubt_turn_scale(p, c)
    if c.fixes > 0 and c.heading_sigma > 0.0 and levelled(c):
        engage(p, c)


@kernel
def update(p: Any, s: Any, fix: Any, innovations: Any) -> int:
    """One fix in, fused at its epoch less the latency found; returns the rows of innovations written."""
    c = s.core[0]
    usable = math.isfinite(fix.lat) and math.isfinite(fix.lon) and fix.quality != 0 and fix.quality != 6
    if s.received == 0 or not usable or abs(fix.lat) > 0.5 * math.pi:
        return 0
    t_ns = min(fix.t_ns - int(1e9 * s.latency), c.t_ns)
    ordered = fix.t_ns >= s.stamp_ns
    if ordered:
        t_ns = max(t_ns, s.fused_ns)
    age = 1e-9 * (c.t_ns - fix.t_ns)
    if not ordered or not -AHEAD_S < age < OLDEST_S:
        return report(innovations, 0, fix.t_ns, POSITION_N, math.nan, math.nan, False)
    snapped = s.snapped
    if not rewind(s, t_ns):
        t_ns = c.t_ns  # too late for that: fused now, with more noise
    approach(p, s, t_ns, s.between_w, s.between_f)
    predict(p, c)
    if s.stamp_ns == NEVER_NS:
        trust_stamp(p, c, fix, horizontal_sigma(fix))
    grade(c, fix)
    trace_velocity(s, snapped)
    rows = fuse(p, c, s.bank[0], fix, c.latency - 1e-9 * (fix.t_ns - c.t_ns), innovations)
    s.stamp_ns = fix.t_ns
    s.latency = c.latency
    s.fused_ns = c.t_ns
    snap(s)
    follow(p, s)
    c.telling = 0
    return rows


@kernel
def fuse(p: Any, c: Any, b: Any, fix: Any, late: float, innovations: Any) -> int:
    """Take the fix at the time where the core is; it was true `late` s before that (what rewinding has left)."""
    if stuck(c, fix):
        c.flags |= REJECTING
        return report(innovations, 0, fix.t_ns, POSITION_N, math.nan, math.nan, False)
    c.fix_speed = math.hypot(fix.v[0], fix.v[1]) if math.isfinite(fix.v[0]) else fix.speed
    if c.phase == NAVIGATING and variance(c, ATTITUDE + 2) > HEADING_LIMIT**2:
        disengage(p, c)
    if c.phase == NAVIGATING and not math.isfinite(c.fix_speed):
        c.fix_speed = calm_speed(c, fix.lat, fix.lon)
    rows = 0
    first = c.phase == LEVELLING and c.fix_ns == NEVER_NS  # a position that was given may be an old one
    if first:
        place(p, c, fix)
    if c.phase == LEVELLING:
        acquire(p, c, b, fix)
    if not first:
        rows = fuse_position(p, c, fix, late, innovations, rows)
    if abs(late) < STALE_S:
        rows = fuse_velocity(p, c, fix, late, innovations, rows)
    c.lost *= 0.98
    right = True
    if c.phase == NAVIGATING:
        right = supervise(p, c, b, fix)
    if c.contrary > CONTRARY or c.lost > LOST or not right:
        c.contrary = 0
        c.lost = 0.0
        if c.phase == NAVIGATING:
            forget_heading(p, c)
        place(p, c, fix)
    c.fixes += 1
    return rows
