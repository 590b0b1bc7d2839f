"""The entry points of the navigation filter: an inertial sample, a GNSS fix, a measurement of another aiding source."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers.sample import NO_FORCE, NO_RATE, SUSPECT, UNUSABLE

from ...compile.jit import kernel
from ...math.rotation import euler_of_quat, quat_of_euler, quat_of_gravity
from ..pending_innovations import move_innovations, store_innovation
from ..records import GNSS_FIX, POSITION_N
from ..tuning import Tunable
from .aiding.gnss_noise import horizontal_sigma
from .aiding.gnss_time import reset_time_offsets
from .aiding.source_age import learn_age
from .alignment.fix_age import forget_fix_age, is_fix_age_found, learn_fix_age, mean_square_error, use_fix_age
from .alignment.modes import HEADING_KNOWN, change_mode
from .alignment.velocity_pairs import is_levelled
from .bias_changes import begin_bias_changes
from .error_model import reset_gyro_scale
from .fusion import clear_innovations, propagate_errors, write_innovation
from .fusion_horizon import (
    fusion_time,
    insert_measurement,
    propagate_to_epoch,
    replay_to_newest,
    rewind_to,
    store_bank,
    store_sample,
    store_snapshot,
    store_snapshot_if_due,
)
from .glr_tests.compass_offset import open_compass_offset
from .gnss_fix import begin_anew, find_heading_anew, fuse_gnss, is_usable, set_noise
from .integrity.frozen_receiver import course_is_held, is_same_fix
from .integrity.velocity_discrepancy import (
    allow_for_discrepancy,
    compare_with_positions,
    is_unused,
    judge_discrepancy,
    remove_velocity,
)
from .integrity.velocity_lag import (
    FOUND_LATE,
    USED,
    detect_late_velocity,
    fit_time_offsets,
    learn_lag,
    restarts_filter,
)
from .mechanization import set_attitude
from .propagation import store_first_sample
from .solution import write_solution
from .sources import REJECTED_KIND, fuse_source
from .state import AIDING_RING, COARSE_ALIGNMENT, NEVER_NS
from .stationarity import first_window
from .velocity_epoch import find_velocity_epoch, keep_velocity_epoch

if TYPE_CHECKING:
    from ...math.arrays import Reals
    from ..types import Fix, Innovation, Measurement, Sample, Solution
    from .types import Core, Parameters, State, StoredMeasurement

TUNABLES = (
    Tunable(
        "max_ahead_s", 1.0, "s", "Largest time by which a measurement may be newer than the newest sample.", "Choice."
    ),
    Tunable(
        "coarse_max_ahead_s",
        0.3,
        "s",
        "As max_ahead_s, of a fix before the heading is known, beyond what is usual.",
        "Sensors whose samples come in blocks.",
    ),
    Tunable(
        "usual_ahead_share",
        0.2,
        "",
        "Weight of a fix in the mean time by which fixes are newer than the newest sample.",
        "Five fixes.",
        high=1.0,
    ),
    Tunable(
        "lost_time_offset_s",
        1.5,
        "s",
        "Least time offset that is wrong if fixes of that age are no longer stored.",
        "No receiver is so late.",
    ),
)


@kernel
def step(p: Parameters, s: State, sample: Sample, solution: Solution) -> None:
    """Process one inertial sample (body axes), write one solution. The last good sample replaces a suspect one."""
    w, f = s.last_w, s.last_f
    good = (sample.flags & SUSPECT) == 0
    for i in range(3):
        finite = math.isfinite(sample.w[i]) and math.isfinite(sample.f[i])
        good = good and (finite or (sample.flags & (NO_RATE | NO_FORCE)) != 0)
    with_rate, with_force = good and (sample.flags & NO_RATE) == 0, good and (sample.flags & NO_FORCE) == 0
    for i in range(3):  # stored in any case: a load cannot be forwarded from a masked store
        w[i] = sample.w[i] if with_rate else w[i]
        f[i] = sample.f[i] if with_force else f[i]
    c = s.core[0]
    if s.sample_count == 0:
        if good and (sample.flags & UNUSABLE) == 0:
            initialize(p, c, sample.t_ns, w, f, s.initial_rpy)
            store_sample(s, sample, w, f)
    elif sample.t_ns > s.imu_ring[(s.sample_count - 1) % len(s.imu_ring)].t_ns:
        store_sample(s, sample, w, f)
        replay_to_newest(p, s)
        collect_innovations(s)
    write_solution(p, c, solution)


@kernel
def collect_innovations(s: State) -> None:
    """Store the innovations of the newest sample; those of samples replayed after a late fix are not stored again."""
    c = s.core[0]
    for k in range(c.scratch.innovation_count):
        row = c.scratch.innovations[k]
        store_innovation(s.pending, row.t_ns, row.kind, row.value, row.variance, row.used)
    clear_innovations(c)


@kernel
def pending_innovations(s: State, innovations: list[Innovation]) -> int:
    """Move those of pseudo-measurements to `innovations`; returns how many."""
    return move_innovations(s.pending, innovations)


@kernel
def initialize(p: Parameters, c: Core, t_ns: int, w: Reals, f: Reals, rpy: Reals) -> None:
    """Initialize from the first sample (body axes): roll and pitch from gravity, unless rpy (rad) gives them."""
    store_first_sample(c, t_ns, w, f)
    first_window(c, f)
    begin_bias_changes(p, c, f)
    roll, pitch, yaw = rpy[0], rpy[1], rpy[2]
    if not (math.isfinite(roll) and math.isfinite(pitch)):
        if f[0] * f[0] + f[1] * f[1] + f[2] * f[2] > 1.0:
            roll, pitch, _ = euler_of_quat(quat_of_gravity(f[0], f[1], f[2]))
        else:
            roll, pitch = 0.0, 0.0
    set_attitude(c, quat_of_euler(roll, pitch, yaw if math.isfinite(yaw) else 0.0))
    reset_gyro_scale(p, c)
    if math.isfinite(yaw):
        open_compass_offset(c, True)
    if c.gnss.fix_count > 0 and c.alignment.heading_sigma > 0.0 and is_levelled(p, c):
        change_mode(p, c, HEADING_KNOWN)


@kernel
def update(p: Parameters, s: State, reported: Fix, innovations: list[Innovation]) -> int:
    """Fuse one fix at its epoch less the estimated time offset; returns the rows of innovations written.

    One that is older than the last one, or than the fusion horizon, is rejected, unless only a time offset beyond that
    makes it so; one that comes twice is used once. reported: as the receiver gave it; s.fix has what is used of it.
    """
    c, fix = s.core[0], s.fix
    if s.sample_count == 0 or not is_usable(reported) or is_same_fix(reported, fix, s.last_course):
        return 0
    s.course_repeats = s.course_repeats + 1 if reported.course == s.last_course else 0
    s.fix, s.last_course = reported, reported.course
    if course_is_held(p, reported, s.course_repeats):
        fix.course = math.nan
    too_new = is_too_new(p, s, 1e-9 * (fix.t_ns - c.nav.t_ns))
    if fix.t_ns >= s.last_epoch_ns and not too_new:
        compare_with_positions(p, c, s.velocity_discrepancy, fix)
        learn_lag(p, c, s.velocity_lag, s.velocity_discrepancy, fix)
        detect_late_velocity(p, s.velocity_lag)
        if s.velocity_lag.late == FOUND_LATE:
            forget_fix_age(s.fix_age)
        learn_fix_age(p, s, fix, s.velocity_lag.late == USED)
    found = is_fix_age_found(p, s.fix_age)
    if found:
        s.last_time_offset = s.fix_age.age
    t_ns, snapshots = fusion_time(s, fix), s.snapshot_count
    usable = fix.t_ns >= s.last_epoch_ns and not too_new
    if usable and not rewind_to(s, t_ns):
        t_ns, usable, snapshots = fix.t_ns, forget_time_offset(p, s, fix), s.snapshot_count
    if not usable:
        fix.t_ns = NEVER_NS  # if it comes again, it may be used
        return write_innovation(innovations, 0, reported.t_ns, POSITION_N, math.nan, math.nan, False)
    if found:
        use_fix_age(p, c, s.fix_age, fix)
    if s.velocity_lag.late == USED:
        fit_time_offsets(p, c, s.velocity_lag)
    c.scratch.fix_age_probability, c.scratch.fix_age_error2 = s.fix_age.probability, mean_square_error(c, s.fix_age)
    k = insert_measurement(s, t_ns, GNSS_FIX)
    e = s.aiding_ring[k % AIDING_RING]
    e.fix, e.restarts = fix, 1 if restarts_filter(s.velocity_lag) else 0
    judge_discrepancy(p, c, s.velocity_discrepancy, e)
    if s.velocity_lag.late != USED or is_unused(s.velocity_discrepancy):
        remove_velocity(e.fix)
    return fuse_from(p, s, k, snapshots, innovations)


@kernel
def is_too_new(p: Parameters, s: State, ahead: float) -> bool:
    """Whether a fix that is `ahead` s newer than the newest sample, as in a gap, cannot be fused at that sample.

    Before the heading is known nothing says in which direction the velocity has changed since: the velocities of a body
    that accelerates pass for its tilt. By how much fixes are ahead usually is the delay of the samples, and no gap.
    """
    usual = s.usual_ahead
    s.usual_ahead += p.tuning.usual_ahead_share * (min(max(ahead, 0.0), p.tuning.max_ahead_s) - usual)
    coarse = s.core[0].alignment.mode == COARSE_ALIGNMENT
    return bool(ahead >= p.tuning.max_ahead_s or (coarse and ahead >= p.tuning.coarse_max_ahead_s + usual))


@kernel
def forget_time_offset(p: Parameters, s: State, fix: Fix) -> bool:
    """Of a fix that is older than the fusion horizon: whether only a time offset made it so, which is then forgotten.

    With a time offset beyond the horizon no fix would be used again. Such an offset is wrong, or cannot be used, and so
    is what was estimated with it: time offset and heading are found anew from this fix on, and nothing older is kept.
    """
    if s.last_time_offset < p.tuning.lost_time_offset_s or not rewind_to(s, fix.t_ns):
        return False
    s.last_time_offset = 0.0
    set_noise(p, s.core[0], fix, False)
    reset_time_offsets(p, s.core[0], fix, horizontal_sigma(p, fix))
    find_heading_anew(p, s.core[0], fix)
    s.aiding_start, s.aiding_count, s.snapshot_count = s.core[0].nav.fused_count, 0, 0
    store_snapshot(s)
    return True


@kernel
def aid(p: Parameters, s: State, measurement: Measurement, innovations: list[Innovation]) -> int:
    """Fuse one measurement of another source at its epoch less its age; returns the rows of innovations written.

    Measurements may come in any order; one that is older than the fusion horizon is rejected.
    """
    c = s.core[0]
    age = 1e-9 * (c.nav.t_ns - measurement.t_ns)
    if s.sample_count == 0 or not math.isfinite(measurement.value[0]):
        return 0
    learn_age(p, s, measurement)
    source = s.source_ages[measurement.kind]
    t_ns, snapshots = min(measurement.t_ns - int(1e9 * source.age), c.nav.t_ns), s.snapshot_count
    if age < -p.tuning.max_ahead_s or not rewind_to(s, t_ns):
        kind = REJECTED_KIND[measurement.kind]
        return write_innovation(innovations, 0, measurement.t_ns, kind, math.nan, math.nan, False)
    k = insert_measurement(s, t_ns, measurement.kind)
    e = s.aiding_ring[k % AIDING_RING]
    e.measurement, e.age_variance = measurement, source.variance
    e.measurement.t_ns -= int(1e9 * source.age)
    return fuse_from(p, s, k, snapshots, innovations)


@kernel
def fuse_from(p: Parameters, s: State, new: int, snapshots: int, innovations: list[Innovation]) -> int:
    """From a rewound core: fuse each stored measurement at its epoch, most of them again, and replay the samples.

    new: number of the measurement that has not been fused before; only its innovations are written. snapshots: number
    of snapshots before the rewind.
    """
    c = s.core[0]
    rows = 0
    for k in range(c.nav.fused_count, s.aiding_start + s.aiding_count):
        e = s.aiding_ring[k % AIDING_RING]
        if e.kind == GNSS_FIX:
            e.t_ns = fusion_time(s, e.fix)
        propagate_to_epoch(p, s, e.t_ns, s.interpolated_w, s.interpolated_f)
        propagate_errors(p, c)
        if k == new:
            rows = fuse_stored(p, s, e, snapshots, True, innovations)
        else:
            fuse_stored(p, s, e, snapshots, False, innovations[len(innovations) :])
        c.nav.fused_count += 1
        if e.kind == GNSS_FIX:
            store_snapshot(s)
        else:
            store_snapshot_if_due(s)
    replay_to_newest(p, s)
    clear_innovations(c)
    return rows


@kernel
def fuse_stored(
    p: Parameters, s: State, e: StoredMeasurement, snapshots: int, first: bool, innovations: list[Innovation]
) -> int:
    """Fuse a stored measurement at the core's time, for the `first` time or again; returns the rows of innovations.

    Again, the velocities after a fix have its noise: an acceleration by them would give a time offset that is wrong and
    certain, so that of the first time is kept.
    """
    c = s.core[0]
    if e.kind != GNSS_FIX:
        c.scratch.age_variance = e.age_variance
        return fuse_source(p, c, e.measurement, innovations)
    store_bank(s, e)
    set_noise(p, c, e.fix, s.last_epoch_ns == NEVER_NS)
    if e.restarts:
        begin_anew(p, c, e.fix)
    allow_for_discrepancy(c, e)
    age = c.nav.time_offset - 1e-9 * (e.fix.t_ns - c.nav.t_ns)  # s, the part that rewinding did not cover
    if first:
        find_velocity_epoch(p, s, snapshots, age)
    keep_velocity_epoch(c, e, first)
    rows = fuse_gnss(p, c, s.bank[0], e.fix, age, innovations)
    s.last_epoch_ns = e.fix.t_ns
    s.last_time_offset = c.nav.time_offset
    s.last_fusion_ns = c.nav.t_ns
    return rows
