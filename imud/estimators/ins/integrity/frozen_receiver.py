"""A frozen receiver: it repeats a position, or a velocity, to the last digit although the vehicle moves.

Where the position is frozen and the velocity is not, the velocity is still used. So it is where a receiver that
reports more often than it measures repeats a position once or twice. A fix that comes twice, as over two lines of a
receiver, says nothing new. Slow, many receivers hold the course, while the speed goes on.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import variance
from ..mechanization import ned_difference
from ..state import HORIZONTAL, NAVIGATING, VELOCITY

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "frozen_min_m",
        1.0,
        "m",
        "Least distance of the estimate that changes the last digit of any receiver's position.",
        "GGA with four decimals of a minute: 0.19 m.",
    ),
    Tunable(
        "repeated_s",
        1.5,
        "s",
        "Time for which a repeated position is not used, unless the vehicle is at rest.",
        "Receivers that report more often than they measure: 1 Hz.",
    ),
    Tunable(
        "max_held_course_speed",
        2.0,
        "m/s",
        "Speed below which a course that repeats to the last digit is held.",
        "The noise of a slow receiver's course is degrees.",
    ),
    Tunable("held_course_repeats", 2, "fixes", "Repetitions in a row by which a course is held.", "Choice."),
)


@kernel
def position_is_frozen(p: Parameters, c: Core, fix: Fix) -> bool:
    """Whether the receiver repeats a position to the last digit although the vehicle has moved; call for each fix.

    Many receivers hold the position at rest, and release it late. A frozen position counts as frozen until it changes,
    even if the estimate becomes uncertain. Not so one that the estimate rejected when it was new, where the receiver
    had hardly moved before, or came back from an outage: the estimate may be wrong, and the vehicle stand.
    """
    g = c.integrity
    if fix.lat != g.last_lat or fix.lon != g.last_lon:
        north, east = ned_difference(c, g.last_lat, g.last_lon, fix.lat, fix.lon)
        stands = elementary.hypot(north, east) < p.tuning.frozen_min_m
        outage_s = 1e-9 * (c.nav.t_ns - c.gnss.last_used_ns)
        returns = g.reject_count[HORIZONTAL] == 0 and outage_s > p.tuning.coasting_s
        g.may_stand = 1 if stands or returns else 0
        g.last_lat, g.last_lon = fix.lat, fix.lon
        g.unchanged_lat, g.unchanged_lon = c.nav.lat, c.nav.lon
        g.unchanged_since_ns = c.nav.t_ns
        g.frozen = 0
        return False
    if c.alignment.mode == NAVIGATING and g.frozen == 0 and g.may_stand == 0:
        north, east = ned_difference(c, g.unchanged_lat, g.unchanged_lon, c.nav.lat, c.nav.lon)
        moving_s = 1e-9 * (c.nav.t_ns - max(g.unchanged_since_ns, c.gravity_monitor.last_rest_ns))
        sigma = math.sqrt(max(variance(c, VELOCITY), variance(c, VELOCITY + 1))) * moving_s
        if elementary.hypot(north, east) - p.tuning.limit_sigmas * sigma > p.tuning.frozen_min_m:
            g.frozen, g.unchanged_since_ns = 1, c.nav.t_ns
    return bool(g.frozen != 0 and 1e-9 * (c.nav.t_ns - g.unchanged_since_ns) < p.tuning.max_reject_s)


@kernel
def note_fused_position(p: Parameters, c: Core, lat: float, lon: float) -> None:
    """Call after a fix that may be new, before which the estimate was at (lat, lon), rad.

    Where a new one sets the estimate to another place, that is no motion; one that is used does not contradict it.
    """
    g = c.integrity
    if g.unchanged_since_ns != c.nav.t_ns:
        return
    north, east = ned_difference(c, lat, lon, c.nav.lat, c.nav.lon)
    if elementary.hypot(north, east) > p.tuning.frozen_min_m:
        g.unchanged_lat, g.unchanged_lon = c.nav.lat, c.nav.lon
    if g.reject_count[HORIZONTAL] == 0:
        g.may_stand = 0


@kernel
def position_is_repeated(p: Parameters, c: Core) -> bool:
    """After `position_is_frozen`: whether the position is that of the fix before and says nothing new.

    Some receivers report more often than they measure. Not at rest, where a right position may be the same again; nor
    for long, as the vehicle may stand without being known to.
    """
    unchanged_s = 1e-9 * (c.nav.t_ns - c.integrity.unchanged_since_ns)
    return bool(c.stationarity.at_rest == 0 and 0.0 < unchanged_s <= p.tuning.repeated_s)


@kernel
def is_repeated(now: float, last: float) -> bool:
    """Whether a number is the last one again, or none."""
    return bool(now == last or not math.isfinite(now))


@kernel
def velocity_is_repeated(c: Core, fix: Fix) -> bool:
    """Whether the velocity is that of the fix before to the last digit, or not reported; call for each fix."""
    g = c.integrity
    repeated = is_repeated(fix.speed, g.last_speed) and is_repeated(fix.course, g.last_course)
    for i in range(2):
        repeated = repeated and is_repeated(fix.v[i], g.last_velocity[i])
        g.last_velocity[i] = fix.v[i]
    g.last_speed, g.last_course = fix.speed, fix.course
    return repeated


@kernel
def is_same_fix(fix: Fix, last: Fix, last_course: float) -> bool:
    """Whether the fix is the last one again: its epoch, and all that it reports of position and velocity.

    last_course: rad, as that was reported.
    """
    same = fix.t_ns == last.t_ns and fix.lat == last.lat and fix.lon == last.lon
    same = same and is_repeated(fix.height, last.height) and is_repeated(fix.speed, last.speed)
    same = same and is_repeated(fix.course, last_course)
    for i in range(3):
        same = same and is_repeated(fix.v[i], last.v[i])
    return bool(same)


@kernel
def course_is_held(p: Parameters, fix: Fix, repeats: int) -> bool:
    """Whether the receiver holds its course, as it is slow: the velocity then has a direction of before.

    repeats: fixes in a row, with this one, that have repeated it; one may be by chance, as courses have few digits.
    """
    slow = fix.speed < p.tuning.max_held_course_speed and not math.isfinite(fix.v[0])
    return bool(slow and repeats >= p.tuning.held_course_repeats)
