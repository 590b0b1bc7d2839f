"""The two entries of the navigation filter: an inertial sample, and a fix."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from drivers.sample import NO_FORCE, NO_RATE, SUSPECT, UNTOLD

from ...compile.jit import kernel
from ...math.rotation import euler_of_quat, quat_of_euler, quat_of_gravity
from ..records import POSITION_N
from ..tuning import Tunable
from .aiding.gnss_gate import clear_contradictions, contradicts_heading, fade_reset_score, is_frozen, reject_frozen
from .aiding.gnss_noise import count_fix, horizontal_sigma, set_gnss_noise, set_speed
from .aiding.gnss_position import fuse_gnss_position, write_innovation
from .aiding.gnss_time import set_initial_time_offset
from .aiding.gnss_velocity import fuse_gnss_velocity
from .alignment.in_motion import align_with_fix, low_motion_speed, reset_to_fix
from .alignment.transitions import abort_navigation, restart_alignment, start_navigation
from .alignment.velocity_pairs import is_levelled
from .ekf import variance
from .error_model import reset_turn_scale
from .fusion import propagate_errors
from .fusion_horizon import (
    fit_acceleration,
    propagate_to_epoch,
    replay_to_newest,
    rewind_to,
    store_sample,
    store_snapshot,
)
from .integrity.heading_monitor import monitor_heading
from .mechanization import set_attitude
from .propagation import store_last_sample
from .solution import write_solution
from .state import ATTITUDE, COARSE_ALIGNMENT, NAVIGATING, NEVER_NS, PENDING_INNOVATIONS
from .stationarity import first_window

if TYPE_CHECKING:
    from .types import Core, Fix, Floats, HypothesisBank, Innovation, Parameters, Sample, Solution, State


TUNABLES = (
    Tunable("max_ahead_s", 1.0, "s", "A fix may be newer than the newest sample by this.", "Choice."),
    Tunable("max_age_s", 10.0, "s", "A fix may be older than the newest sample by this.", "Choice."),
    Tunable("max_rewind_miss_s", 1.0, "s", "A velocity later than that is not used.", "Choice."),
)


@kernel
def step(p: Parameters, s: State, sample: Sample, solution: Solution) -> None:
    """One inertial sample (body axes) in, one solution out. For a suspect sample the last good one is held."""
    w, f = s.last_w, s.last_f
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
    if s.sample_count == 0:
        if good and (sample.flags & UNTOLD) == 0:
            initialize(p, c, sample.t_ns, w, f, s.initial_rpy)
            store_sample(s, sample, w, f)
            c.imu.sample_count = 1
    elif sample.t_ns > s.imu_ring[(s.sample_count - 1) % len(s.imu_ring)].t_ns:
        store_sample(s, sample, w, f)
        replay_to_newest(p, s)
        collect_innovations(s)
    write_solution(p, c, solution)


@kernel
def collect_innovations(s: State) -> None:
    """Keep what the newest sample told. Samples that are integrated again after a late fix tell nothing new."""
    c = s.core[0]
    for k in range(c.scratch.innovation_count):
        if s.pending_count < PENDING_INNOVATIONS:
            s.pending_innovations[s.pending_count] = c.scratch.innovations[k]
            s.pending_count += 1
    c.scratch.innovation_count = 0


@kernel
def take_innovations(s: State, innovations: list[Innovation]) -> int:
    """Move the innovations of rest and constraints to `innovations`, oldest first; returns how many."""
    n: int = min(s.pending_count, len(innovations))
    for k in range(n):
        innovations[k] = s.pending_innovations[k]
    for k in range(n, s.pending_count):
        s.pending_innovations[k - n] = s.pending_innovations[k]
    s.pending_count -= n
    return n


@kernel
def initialize(p: Parameters, c: Core, t_ns: int, w: Floats, f: Floats, rpy: Floats) -> None:
    """Take the first sample: the attitude is that of rest, unless it was given."""
    c.imu.sample_ns = t_ns
    store_last_sample(c, t_ns, w, f)
    first_window(c, f)
    roll, pitch, yaw = rpy[0], rpy[1], rpy[2]
    if not (math.isfinite(roll) and math.isfinite(pitch)):
        if f[0] * f[0] + f[1] * f[1] + f[2] * f[2] > 1.0:
            roll, pitch, _ = euler_of_quat(quat_of_gravity(f[0], f[1], f[2]))
        else:
            roll, pitch = 0.0, 0.0
    set_attitude(c, quat_of_euler(roll, pitch, yaw if math.isfinite(yaw) else 0.0))
    reset_turn_scale(p, c)
    if c.gnss.fix_count > 0 and c.alignment.heading_sigma > 0.0 and is_levelled(p, c):
        start_navigation(p, c)


@kernel
def update(p: Parameters, s: State, fix: Fix, innovations: list[Innovation]) -> int:
    """One fix in, fused at its epoch less the latency found; returns the rows of innovations written."""
    c = s.core[0]
    usable = math.isfinite(fix.lat) and math.isfinite(fix.lon) and fix.quality != 0 and fix.quality != 6
    if s.sample_count == 0 or not usable or abs(fix.lat) > 0.5 * math.pi:
        return 0
    t_ns = min(fix.t_ns - int(1e9 * s.last_time_offset), c.nav.t_ns)
    ordered = fix.t_ns >= s.last_epoch_ns
    if ordered:
        t_ns = max(t_ns, s.last_fusion_ns)
    age = 1e-9 * (c.nav.t_ns - fix.t_ns)
    if not ordered or not -p.tuning.max_ahead_s < age < p.tuning.max_age_s:
        return write_innovation(innovations, 0, fix.t_ns, POSITION_N, math.nan, math.nan, False)
    snapped = s.snapshot_count
    if not rewind_to(s, t_ns):
        t_ns = c.nav.t_ns  # too late for that: fused now, with more noise
    propagate_to_epoch(p, s, t_ns, s.interpolated_w, s.interpolated_f)
    propagate_errors(p, c)
    if s.last_epoch_ns == NEVER_NS:
        set_initial_time_offset(p, c, fix, horizontal_sigma(p, fix))
    set_gnss_noise(p, c, fix)
    fit_acceleration(p, s, snapped)
    rows = fuse_gnss(p, c, s.bank[0], fix, c.nav.time_offset - 1e-9 * (fix.t_ns - c.nav.t_ns), innovations)
    s.last_epoch_ns = fix.t_ns
    s.last_time_offset = c.nav.time_offset
    s.last_fusion_ns = c.nav.t_ns
    store_snapshot(s)
    replay_to_newest(p, s)
    c.scratch.innovation_count = 0
    return rows


@kernel
def fuse_gnss(p: Parameters, c: Core, b: HypothesisBank, fix: Fix, late: float, innovations: list[Innovation]) -> int:
    """Take the fix at the time where the core is; it was true `late` s before that (what rewinding has left)."""
    if is_frozen(p, c, fix):
        reject_frozen(c)
        return write_innovation(innovations, 0, fix.t_ns, POSITION_N, math.nan, math.nan, False)
    set_speed(c, math.hypot(fix.v[0], fix.v[1]) if math.isfinite(fix.v[0]) else fix.speed)
    if c.alignment.mode == NAVIGATING and variance(c, ATTITUDE + 2) > p.tuning.max_valid_heading_sigma**2:
        abort_navigation(p, c)
    if c.alignment.mode == NAVIGATING and not math.isfinite(c.gnss.speed):
        set_speed(c, low_motion_speed(p, c, fix.lat, fix.lon))
    rows = 0
    first = c.alignment.mode == COARSE_ALIGNMENT and c.gnss.last_used_ns == NEVER_NS  # a given position may be old
    if first:
        reset_to_fix(p, c, fix)
    if c.alignment.mode == COARSE_ALIGNMENT:
        align_with_fix(p, c, b, fix)
    if not first:
        rows = fuse_gnss_position(p, c, fix, late, innovations, rows)
    if abs(late) < p.tuning.max_rewind_miss_s:
        rows = fuse_gnss_velocity(p, c, fix, late, innovations, rows)
    fade_reset_score(p, c)
    right = True
    if c.alignment.mode == NAVIGATING:
        right = monitor_heading(p, c, b, fix)
    if contradicts_heading(p, c) or not right:
        clear_contradictions(c)
        if c.alignment.mode == NAVIGATING:
            restart_alignment(p, c)
        reset_to_fix(p, c, fix)
    count_fix(c)
    return rows
