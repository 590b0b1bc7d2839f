"""The recent past, so that a late fix meets the state of its own epoch: samples in a ring, snapshots of the core.

To fuse at epoch t the core goes back to the last snapshot not after t, forward to t exactly, and after the fusion
forward again to the newest sample, with the code that new samples take; the snapshots on the way are renewed.
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.kalman import packed_index
from .advance import advance, carry
from .covariance import variance
from .state import LAG, LATENCY, NAVIGATING, RING, SNAPSHOT_NS, SNAPSHOTS, STATES

UNKNOWN_ACCEL = 2.0  # m/s^2


@kernel
def remember(s: Any, sample: Any, w: Any, f: Any) -> None:
    """Put a sample (body axes) into the ring, with (w, f) for what it shows."""
    r = s.ring[s.received % RING]
    r.t_ns = sample.t_ns
    r.flags = sample.flags
    r.unseen_s = sample.unseen_s
    for i in range(3):
        r.w[i] = w[i]
        r.f[i] = f[i]
    s.received += 1


@kernel
def snap(s: Any) -> None:
    """Keep a copy of the core."""
    s.snapshots[s.snapped % SNAPSHOTS] = s.core[0]
    s.snapped += 1


@kernel
def follow(p: Any, s: Any) -> None:
    """Bring the core up to the newest sample, with a snapshot whenever one is due."""
    c = s.core[0]
    while c.taken < s.received:
        advance(p, c, s.ring[c.taken % RING])
        if s.snapped == 0 or c.t_ns - s.snapshots[(s.snapped - 1) % SNAPSHOTS].t_ns >= SNAPSHOT_NS:
            snap(s)


@kernel
def rewind(s: Any, t_ns: int) -> bool:
    """Put the core back to the last snapshot not after t_ns; False when that is forgotten."""
    if s.core[0].t_ns <= t_ns:
        return True
    oldest = max(0, s.snapped - SNAPSHOTS)
    k = s.snapped - 1
    while k >= oldest and s.snapshots[k % SNAPSHOTS].t_ns > t_ns:
        k -= 1
    if k < oldest or s.snapshots[k % SNAPSHOTS].taken < s.received - RING:
        return False
    s.core[0] = s.snapshots[k % SNAPSHOTS]
    s.snapped = k + 1
    return True


@kernel
def velocity_at(s: Any, snapped: int, t_ns: int, axis: int) -> float:
    """Velocity at t_ns, between `snapped` snapshots and the core; NaN when it is forgotten or was not navigated."""
    k = snapped - 1
    oldest = max(0, snapped - SNAPSHOTS)
    after_ns, after = s.core[0].t_ns, s.core[0].v[axis]
    while k >= oldest and s.snapshots[k % SNAPSHOTS].t_ns > t_ns:
        after_ns, after = s.snapshots[k % SNAPSHOTS].t_ns, s.snapshots[k % SNAPSHOTS].v[axis]
        k -= 1
    if k < oldest or s.snapshots[k % SNAPSHOTS].phase != NAVIGATING:
        return math.nan
    before = s.snapshots[k % SNAPSHOTS]
    if before.t_ns == t_ns:
        return float(before.v[axis])
    share = (t_ns - before.t_ns) / (after_ns - before.t_ns)
    return float(before.v[axis] + share * (after - before.v[axis]))


@kernel
def trace_velocity(s: Any, snapped: int) -> None:
    """Straight line through the velocities about now, as long as the velocity's lateness is uncertain, either way.

    And its misfit: a parabola's, where that is shorter than what is between snapshots. What comes after now is known
    from the `snapped` snapshots that there were before the rewind; where there were none, the last moments must do.
    """
    c = s.core[0]
    late2 = variance(c, LATENCY) + 2.0 * c.P[packed_index(STATES, LATENCY, LAG)] + variance(c, LAG)
    span = max(math.sqrt(max(late2, 0.0)), 1e-9 * SNAPSHOT_NS)
    share = late2 / span**2
    newest_ns = max(c.t_ns, s.snapshots[(snapped - 1) % SNAPSHOTS].t_ns if snapped > 0 else c.t_ns)
    ahead = min(1e-9 * (newest_ns - c.t_ns), span)
    last_ns, span_ns = c.t_ns + int(1e9 * ahead), int(1e9 * span)
    for i in range(3):
        v0 = velocity_at(s, snapped, last_ns, i)
        v1 = velocity_at(s, snapped, last_ns - span_ns, i)
        v2 = velocity_at(s, snapped, last_ns - 2 * span_ns, i)
        known = math.isfinite(v0) and math.isfinite(v1) and math.isfinite(v2)
        curve = v0 - 2.0 * v1 + v2
        c.trend[i] = (v0 - v2 + (1.0 - ahead / span) * curve) / (2.0 * span) if known else 0.0
        c.bend[i] = 0.5 * share * curve if known else UNKNOWN_ACCEL * span


@kernel
def approach(p: Any, s: Any, t_ns: int, w: Any, f: Any) -> None:
    """Forward from a snapshot to t_ns exactly, not after the newest sample; (w, f) is room to interpolate there."""
    c = s.core[0]
    while c.taken < s.received and s.ring[c.taken % RING].t_ns <= t_ns:
        advance(p, c, s.ring[c.taken % RING])
    if c.t_ns >= t_ns or c.taken >= s.received:
        return
    r = s.ring[c.taken % RING]
    share = (t_ns - c.t_ns) / (r.t_ns - c.t_ns)
    for i in range(3):
        w[i] = c.w[i] + share * (r.w[i] - c.w[i])
        f[i] = c.f[i] + share * (r.f[i] - c.f[i])
    carry(p, c, t_ns, w, f)
