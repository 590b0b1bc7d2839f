"""Fusion of a fix: its noise, the start, innovations and gates of position, height and velocity."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.earth import MIN_COS, displaced, gravity, radii
from ...math.kalman import reset, shear
from ...math.rotation import wrap_angle
from ..records import POSITION_D, POSITION_E, POSITION_N, VELOCITY_E, VELOCITY_N
from .ekf import (
    add_variance,
    fuse,
    inject_error,
    innovation_variance,
    rate_around,
    set_jacobian,
    travelled_since,
    variance,
)
from .state import (
    DOWN,
    FIX_DOWN,
    FIX_EAST,
    FIX_NORTH,
    NORTH,
    SINK,
    SPEED,
    STATES,
    TIME_OFFSET,
    TRAVEL_DOWN,
    TRAVEL_EAST,
    TRAVEL_NORTH,
    TRAVEL_SPEED,
    TRAVEL_YAW,
    UNKNOWN_SPEED,
    WHITE_HORIZONTAL,
    WHITE_VELOCITY,
    WHITE_VERTICAL,
    YAW,
)

if TYPE_CHECKING:
    from ..types import Fix, Innovation
    from .types import RissParameters, RissState


@kernel
def velocity_of(fix: Fix) -> tuple[float, float]:
    """Velocity north and east, m/s; NaN: unknown."""
    if math.isfinite(fix.v[0] + fix.v[1]):
        return fix.v[0], fix.v[1]
    course = fix.course if math.isfinite(fix.course) or fix.speed > 0.0 else 0.0
    return fix.speed * elementary.cos(course), fix.speed * elementary.sin(course)


@kernel
def epoch_of(s: RissState, fix: Fix) -> int:
    """The instant at which the fix is valid, ns: its epoch less the estimated time offset."""
    return fix.t_ns - int(1e9 * s.x[TIME_OFFSET])


@kernel
def set_fix_noise(p: RissParameters, s: RissState, fix: Fix) -> None:
    """Set the variance of the receiver's correlated error: as it reports, else by its HDOP."""
    dop = fix.hdop if fix.hdop > 0.0 else 1.0
    for i in range(3):
        sigma = p.tuning.fix_sigma * dop * (2.0 if i == 2 else 1.0)
        if fix.sigma[i] > 0.0:
            sigma = fix.sigma[i]
        s.fix_var[i] = sigma * sigma


@kernel
def set_axis(s: RissState, i: int) -> None:
    """Set the position error along axis i to that of the fix: white noise, and the receiver's correlated error."""
    reset(s.P, STATES, NORTH + i, 0.0)
    reset(s.P, STATES, FIX_NORTH + i, s.fix_var[i])
    s.x[FIX_NORTH + i] = 0.0
    shear(s.P, STATES, NORTH + i, FIX_NORTH + i, -1.0)
    add_variance(s, NORTH + i, s.white_var[WHITE_VERTICAL if i == 2 else WHITE_HORIZONTAL])


@kernel
def set_position(p: RissParameters, s: RissState, fix: Fix, vn: float, ve: float) -> None:
    """Set the position to that of the fix plus the distance since, by the fix's velocity if it has one."""
    t_ns = epoch_of(s, fix)
    north, east = travelled_since(s, t_ns, TRAVEL_NORTH), travelled_since(s, t_ns, TRAVEL_EAST)
    rate_n, rate_e = rate_around(s, t_ns, TRAVEL_NORTH), rate_around(s, t_ns, TRAVEL_EAST)
    late_s, unknown2 = 1e-9 * (s.step_ns - t_ns), 0.0
    if math.isfinite(vn + ve):
        north, east = vn * late_s, ve * late_s
        rate_n, rate_e = vn, ve
        unknown2 = (0.5 * p.tuning.accel_sigma * late_s * late_s) ** 2
    s.lat, s.lon = displaced(fix.lat, fix.lon, s.height, north, east)
    for i in range(2):
        set_axis(s, i)
        add_variance(s, NORTH + i, unknown2)
        shear(s.P, STATES, NORTH + i, TIME_OFFSET, rate_n if i == 0 else rate_e)
    if s.has_height == 0 and math.isfinite(fix.height):
        s.height, s.has_height = fix.height - travelled_since(s, t_ns, TRAVEL_DOWN), 1
        set_axis(s, 2)
        s.gravity = gravity(fix.lat, fix.height)


@kernel
def set_heading(p: RissParameters, s: RissState, fix: Fix, vn: float, ve: float) -> None:
    """Set the heading to the course of a fast vehicle, or to that which the user gave; position and speed follow."""
    speed = math.sqrt(vn * vn + ve * ve)
    given = math.isfinite(s.initial_yaw)
    if not (speed > p.tuning.align_speed or given):
        return
    yaw = s.initial_yaw if given else elementary.atan2(ve, vn)
    sigma2 = p.tuning.initial_yaw_sigma**2
    if not given:
        sigma2 = (s.white_var[WHITE_VELOCITY] + p.tuning.lateral_sigma**2) / speed**2
    t_ns = epoch_of(s, fix)
    s.x[YAW] = wrap_angle(yaw + (0.0 if given else travelled_since(s, t_ns, TRAVEL_YAW)))
    reset(s.P, STATES, YAW, sigma2)
    shear(s.P, STATES, YAW, TIME_OFFSET, 0.0 if given else rate_around(s, t_ns, TRAVEL_YAW))
    s.initial_yaw = math.nan
    s.aligned = 1
    set_position(p, s, fix, vn, ve)
    if given:
        speed = vn * elementary.cos(yaw) + ve * elementary.sin(yaw)
    if math.isfinite(speed):
        s.x[SPEED] = speed + travelled_since(s, t_ns, TRAVEL_SPEED)
        reset(s.P, STATES, SPEED, s.white_var[WHITE_VELOCITY] + (0.5 * p.tuning.accel_sigma) ** 2)
        shear(s.P, STATES, SPEED, TIME_OFFSET, rate_around(s, t_ns, TRAVEL_SPEED))


@kernel
def write_innovation(row: Innovation, fix: Fix, kind: int, value: float, total: float, used: bool) -> None:
    """Write a row of INNOVATION."""
    row.t_ns, row.kind, row.value, row.variance = fix.t_ns, kind, value, total
    row.used = 1 if used else 0


@kernel
def learn_white_noise(p: RissParameters, s: RissState, i: int, z: float, total: float) -> None:
    """Adapt white variance i to an innovation z of variance `total`; it counts as half to twice the sigma so far."""
    explained = total - s.white_var[i]
    seen = min(max(z * z - explained, 0.25 * s.white_var[i]), 4.0 * s.white_var[i])
    s.white_var[i] += (seen - s.white_var[i]) / p.tuning.learning_fixes
    least = p.tuning.min_white_velocity if i == WHITE_VELOCITY else p.tuning.min_white_position
    least = p.tuning.min_white_height if i == WHITE_VERTICAL else least
    s.white_var[i] = max(s.white_var[i], least**2)


@kernel
def position_jacobian(s: RissState, i: int, rate: float) -> int:
    """Set the Jacobian of a fix along axis i (0: north, 1: east), where the vehicle moves at `rate` m/s."""
    n = set_jacobian(s, set_jacobian(s, 0, NORTH + i, 1.0), FIX_NORTH + i, 1.0)
    return set_jacobian(s, n, TIME_OFFSET, -rate)


@kernel
def fuse_position(p: RissParameters, s: RissState, fix: Fix, innovations: list[Innovation]) -> int:
    """Gate and fuse the horizontal position, both axes together; returns the rows of innovations."""
    meridian, prime_vertical = radii(s.lat)
    cy, sy = elementary.cos(s.x[YAW]), elementary.sin(s.x[YAW])
    arm, t_ns = p.gnss_lever_arm, epoch_of(s, fix)
    lever_n, lever_e = arm[0] * cy - arm[1] * sy, arm[0] * sy + arm[1] * cy
    z_n = (fix.lat - s.lat) * (meridian + s.height) + travelled_since(s, t_ns, TRAVEL_NORTH) - lever_n - s.x[FIX_NORTH]
    radius = (prime_vertical + s.height) * max(elementary.cos(s.lat), MIN_COS)
    z_e = wrap_angle(fix.lon - s.lon) * radius + travelled_since(s, t_ns, TRAVEL_EAST) - lever_e - s.x[FIX_EAST]
    nis = 0.0
    for i in range(2):
        z = z_n if i == 0 else z_e
        n = position_jacobian(s, i, rate_around(s, t_ns, i))
        nis += z * z / innovation_variance(s, n, s.white_var[WHITE_HORIZONTAL])
    used = nis < p.tuning.gate
    s.reject_count = 0 if used else s.reject_count + 1
    for i in range(2):
        z = z_n if i == 0 else z_e
        n = position_jacobian(s, i, rate_around(s, t_ns, i))
        left = z - s.dx[NORTH + i] - s.dx[FIX_NORTH + i] + s.dx[TIME_OFFSET] * rate_around(s, t_ns, i)
        total = (
            fuse(s, n, z, s.white_var[WHITE_HORIZONTAL])
            if used
            else innovation_variance(s, n, s.white_var[WHITE_HORIZONTAL])
        )
        write_innovation(innovations[i], fix, POSITION_N if i == 0 else POSITION_E, left, total, used)
        if used:
            learn_white_noise(p, s, WHITE_HORIZONTAL, left, total)
    return 2


@kernel
def fuse_height(p: RissParameters, s: RissState, fix: Fix, row: Innovation) -> None:
    """Gate and fuse the height; writes its innovation to `row`."""
    z = s.height - fix.height + travelled_since(s, epoch_of(s, fix), TRAVEL_DOWN) - p.gnss_lever_arm[2] - s.x[FIX_DOWN]
    n = set_jacobian(s, set_jacobian(s, 0, DOWN, 1.0), FIX_DOWN, 1.0)
    total = innovation_variance(s, n, s.white_var[WHITE_VERTICAL])
    used = z * z < 0.5 * p.tuning.gate * total
    write_innovation(row, fix, POSITION_D, z - s.dx[DOWN] - s.dx[FIX_DOWN], total, used)
    if used:
        fuse(s, n, z, s.white_var[WHITE_VERTICAL])
        learn_white_noise(p, s, WHITE_VERTICAL, z, total)
    else:
        add_variance(s, SINK, p.tuning.rejected_sink_variance)
        add_variance(s, DOWN, p.tuning.rejected_height_share * total)


@kernel
def fuse_velocity(
    p: RissParameters, s: RissState, fix: Fix, vn: float, ve: float, innovations: list[Innovation], at: int
) -> int:
    """Gate and fuse the longitudinal and, above course_speed, the lateral velocity; returns the rows of innovations.

    The longitudinal innovation is written as VELOCITY_N, the lateral one as VELOCITY_E.
    """
    t_ns = epoch_of(s, fix)
    yaw, u = s.x[YAW] - travelled_since(s, t_ns, TRAVEL_YAW), s.x[SPEED] - travelled_since(s, t_ns, TRAVEL_SPEED)
    yaw_rate, accel = rate_around(s, t_ns, TRAVEL_YAW), rate_around(s, t_ns, TRAVEL_SPEED)
    cy, sy = elementary.cos(yaw), elementary.sin(yaw)
    along, across = vn * cy + ve * sy, ve * cy - vn * sy
    if s.aligned == 0:
        along = math.sqrt(vn * vn + ve * ve)
    z = along - u + p.gnss_lever_arm[1] * yaw_rate
    n = set_jacobian(s, set_jacobian(s, 0, SPEED, 1.0), TIME_OFFSET, -accel)
    noise = (
        s.white_var[WHITE_VELOCITY] + (0.5 * p.tuning.lateral_sigma) ** 2 + (accel * p.tuning.velocity_time_sigma) ** 2
    )
    total = innovation_variance(s, n, noise)
    used = z * z < p.tuning.gate * total
    write_innovation(innovations[at], fix, VELOCITY_N, z, total, used)
    if used:
        fuse(s, n, z, noise)
        learn_white_noise(p, s, WHITE_VELOCITY, z, total)
    else:
        add_variance(s, SPEED, total)
    if s.aligned == 0 or abs(u) < p.tuning.course_speed:
        return 1
    z = across - p.gnss_lever_arm[0] * yaw_rate
    n = set_jacobian(s, set_jacobian(s, 0, YAW, u), TIME_OFFSET, -u * yaw_rate)
    noise = s.white_var[WHITE_VELOCITY] + p.tuning.lateral_sigma**2 + variance(s, SPEED) * variance(s, YAW)
    noise += (u * yaw_rate * p.tuning.velocity_time_sigma) ** 2
    total = innovation_variance(s, n, noise)
    used = z * z < p.tuning.gate * total
    write_innovation(innovations[at + 1], fix, VELOCITY_E, z, total, used)
    if used:
        fuse(s, n, z, noise)
    else:
        add_variance(s, YAW, total / (u * u))
    return 2


@kernel
def fuse_fix(p: RissParameters, s: RissState, fix: Fix, innovations: list[Innovation]) -> int:
    """Fuse one fix; returns the rows of innovations written."""
    late_s = (s.step_ns - fix.t_ns) * 1e-9
    usable = math.isfinite(fix.lat + fix.lon) and fix.quality != 0 and fix.quality != 6 and s.started == 1
    if not usable or late_s > p.tuning.max_late_s or (s.fix_count > 0 and fix.t_ns <= s.fix_ns):
        return 0
    set_fix_noise(p, s, fix)
    vn, ve = velocity_of(fix)
    moving = math.isfinite(vn + ve)
    if moving:
        slow = vn * vn + ve * ve < p.tuning.rest_speed**2
        s.last_slow_ns = fix.t_ns if slow else 0
    rows = 0
    if s.aligned == 1 and s.reject_count >= p.tuning.rejected_limit:
        s.aligned = s.reject_count = 0
        reset(s.P, STATES, SPEED, UNKNOWN_SPEED**2)
        s.x[TIME_OFFSET] = 0.0
        reset(s.P, STATES, TIME_OFFSET, p.tuning.time_offset_sigma**2)
        s.has_height = 0
    if s.aligned == 1 and variance(s, YAW) > p.tuning.max_heading_sigma**2:
        s.aligned = 0  # too uncertain for first-order updates: the course initializes the heading again
        reset(s.P, STATES, SPEED, UNKNOWN_SPEED**2)
    if s.aligned == 1:
        rows = fuse_position(p, s, fix, innovations)
    else:
        set_position(p, s, fix, vn, ve)
    if s.has_height == 1 and math.isfinite(fix.height) and s.fix_count > 0:
        fuse_height(p, s, fix, innovations[rows])
        rows += 1
    if moving:
        rows += fuse_velocity(p, s, fix, vn, ve, innovations, rows)
    inject_error(s)
    if s.aligned == 0:
        s.v[0], s.v[1] = (vn, ve) if moving else (0.0, 0.0)
        set_heading(p, s, fix, vn, ve)
    s.fix_count += 1
    s.fix_ns = fix.t_ns
    return rows
