"""The antenna when its velocity was that of a fix, which is a little before the time at which the fix is fused.

Stored in `velocity_epoch` of the scratch: the acceleration, which shows an error of the time offsets; the change of the
velocity since then; and how the lever arm changes the velocity, as a body that swings turns otherwise by now. Found
from the velocities and rates of the snapshots, before and after the core's time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ...compile.jit import kernel
from ...math.rotation import Vector
from ..tuning import Tunable
from .ekf import covariance, variance
from .lever_arm import arm_velocity_row, velocity_of_point
from .noise_density import velocity_psd
from .state import HORIZONTAL, NAVIGATING, SNAPSHOT_NS, SNAPSHOTS, TIME_OFFSET, VELOCITY_TIME_OFFSET

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from .types import Core, Parameters, State, StoredMeasurement


TUNABLES = (
    Tunable("unknown_accel", 2.0, "m/s^2", "Acceleration where the velocity's history is not known.", "Choice."),
    Tunable("accel_window_s", 0.4, "s", "Longest time over which the acceleration at a fix is fitted.", "Choice."),
    Tunable(
        "accel_window_before_s",
        1.6,
        "s",
        "Longest time over which the acceleration at a fix is fitted to the velocities before it alone.",
        "Simulated flights.",
    ),
    Tunable(
        "accel_window_gate",
        9.0,
        "",
        "Squared curvature of the velocities, over its variance by noise, from which the time of the fit is halved.",
        "Three sigma.",
    ),
)


@kernel
def velocity_at(s: State, snapshot_count: int, t_ns: int, arm: Reals) -> Vector:
    """Velocity of the point `arm`, m, body, at t_ns, m/s, NED; NaN if it is not stored.

    Interpolated between snapshots and core. snapshot_count: number of snapshots before the rewind. NaN also where the
    mode was not navigation.
    """
    c = s.core[0]
    k = snapshot_count - 1
    oldest = max(0, snapshot_count - SNAPSHOTS)
    after_ns, after = c.nav.t_ns, velocity_of_point(c.nav, c.imu, arm)
    while k >= oldest and s.snapshots[k % SNAPSHOTS].nav.t_ns > t_ns:
        k -= 1
    if k < oldest or s.snapshots[k % SNAPSHOTS].alignment.mode != NAVIGATING:
        return math.nan, math.nan, math.nan
    if k + 1 < snapshot_count:
        later = s.snapshots[(k + 1) % SNAPSHOTS]
        after_ns, after = later.nav.t_ns, velocity_of_point(later.nav, later.imu, arm)
    earlier = s.snapshots[k % SNAPSHOTS]
    before = velocity_of_point(earlier.nav, earlier.imu, arm)
    if earlier.nav.t_ns == t_ns:
        return before
    share = (t_ns - earlier.nav.t_ns) / (after_ns - earlier.nav.t_ns)
    return (
        before[0] + share * (after[0] - before[0]),
        before[1] + share * (after[1] - before[1]),
        before[2] + share * (after[2] - before[2]),
    )


@kernel
def find_velocity_epoch(p: Parameters, s: State, snapshot_count: int, age: float) -> None:
    """Before a fix is fused: scratch.velocity_epoch <- the antenna when its velocity was that of the fix.

    age: by which the position of the fix was true before the core's time, s. Velocities after the core's time are those
    of the `snapshot_count` snapshots before the rewind.
    """
    c = s.core[0]
    lag = age + c.nav.velocity_time_offset
    then_ns, newest_ns = c.nav.t_ns - int(1e9 * lag), c.nav.t_ns
    if snapshot_count > 0:
        newest_ns = max(newest_ns, s.snapshots[(snapshot_count - 1) % SNAPSHOTS].nav.t_ns)
    fit_acceleration(p, s, snapshot_count, then_ns, newest_ns)
    now = velocity_at(s, snapshot_count, c.nav.t_ns, c.nav.gnss_lever_arm)
    then = velocity_at(s, snapshot_count, then_ns, c.nav.gnss_lever_arm)
    e = c.scratch.velocity_epoch
    for i in range(3):
        changed = now[i] - then[i]
        usable = math.isfinite(changed) and then_ns <= newest_ns
        e.change[i] = changed if usable else lag * e.acceleration[i]
    differentiate_by_lever_arm(s, snapshot_count, min(then_ns, newest_ns))


@kernel
def fit_acceleration(p: Parameters, s: State, snapshot_count: int, then_ns: int, newest_ns: int) -> None:
    """scratch.velocity_epoch.acceleration <- that of the antenna at then_ns; second_order <- what it leaves out.

    It is the slope of a straight line over the longest time, up to `accel_window_s`, over which noise explains all that
    the velocities differ from it: the noise of a shorter one is that of the velocity's error, and gives a wrong time
    offset that is certain (errors in variables). Where possible the velocity of the fix is in the middle of the line:
    noise before it changes the slope and the velocity's error in the same sense, noise after it in the opposite one.
    Positions of centimetres have corrected the velocity of the noise before it; where no wheels do so besides, the line
    ends at the fix, and may be longer. With such positions a slope of no more than twice the mean square of its own
    noise shows no time offset.

    newest_ns: time of the newest velocity of the `snapshot_count` snapshots before the rewind.
    """
    c = s.core[0]
    time_offset_var = (
        variance(c, TIME_OFFSET)
        + 2.0 * covariance(c, TIME_OFFSET, VELOCITY_TIME_OFFSET)
        + variance(c, VELOCITY_TIME_OFFSET)
    )
    least = max(math.sqrt(max(time_offset_var, 0.0)), 1e-9 * SNAPSHOT_NS)
    precise = c.gnss.reported_sigma[HORIZONTAL] < p.tuning.survey_sigma
    before_only = precise and not c.nhc.enabled
    window = p.tuning.accel_window_before_s if before_only else p.tuning.accel_window_s
    span, psd, arm = max(0.5 * window, least), velocity_psd(p, c), c.nav.gnss_lever_arm
    while True:
        span_ns = int(1e9 * span)
        last_ns = min(newest_ns, then_ns if before_only else then_ns + span_ns)
        v0 = velocity_at(s, snapshot_count, last_ns, arm)
        v1 = velocity_at(s, snapshot_count, last_ns - span_ns, arm)
        v2 = velocity_at(s, snapshot_count, last_ns - 2 * span_ns, arm)
        most = 0.0
        for i in range(3):
            most = max(most, (v0[i] - 2.0 * v1[i] + v2[i]) ** 2)
        if not most > p.tuning.accel_window_gate * 2.0 * psd * span or span <= least:
            break
        span = max(0.5 * span, least)
    share = time_offset_var / span**2
    length2 = ((v0[0] - v2[0]) ** 2 + (v0[1] - v2[1]) ** 2 + (v0[2] - v2[2]) ** 2) / (2.0 * span)
    noise = p.tuning.level_force_gate * 3.0 * psd if precise else 0.0
    known_share = 1.0 - noise / length2 if length2 > noise else 0.0
    e = c.scratch.velocity_epoch
    for i in range(3):
        known = math.isfinite(v0[i]) and math.isfinite(v1[i]) and math.isfinite(v2[i])
        curve = v0[i] - 2.0 * v1[i] + v2[i]
        e.acceleration[i] = known_share * (v0[i] - v2[i]) / (2.0 * span) if known else 0.0
        e.second_order[i] = 0.5 * share * curve if known else p.tuning.unknown_accel * span


@kernel
def differentiate_by_lever_arm(s: State, snapshot_count: int, t_ns: int) -> None:
    """scratch.velocity_epoch.by_lever_arm <- C_nb [w x] at t_ns, rad/s; that of the core's time if it is not stored."""
    c = s.core[0]
    arm = np.empty(3)
    arm[0] = arm[1] = arm[2] = 0.0
    of_sensor = velocity_at(s, snapshot_count, t_ns, arm)
    for j in range(3):
        arm[j] = 1.0
        of_point = velocity_at(s, snapshot_count, t_ns, arm)
        arm[j] = 0.0
        for i in range(3):
            now, then = arm_velocity_row(c, i)[j], of_point[i] - of_sensor[i]
            c.scratch.velocity_epoch.by_lever_arm[i, j] = then if math.isfinite(then) else now


@kernel
def keep_velocity_epoch(c: Core, e: StoredMeasurement, first: bool) -> None:
    """Store what was found of a fix when it is fused first; else restore it."""
    if first:
        e.velocity_epoch = c.scratch.velocity_epoch
    else:
        c.scratch.velocity_epoch = e.velocity_epoch
