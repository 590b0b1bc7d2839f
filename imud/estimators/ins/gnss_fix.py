"""One GNSS fix at the core's time: the order of alignment, position, velocity and integrity monitoring."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ..records import NEW_RECEIVER, POSITION_N
from .aiding.barometer import compare_heights
from .aiding.course_heading import head_along_course
from .aiding.external_aid import distrust_velocities
from .aiding.external_pose import distrust_poses
from .aiding.gnss_gate import ends_outage, reject_frozen
from .aiding.gnss_noise import count_fix, horizontal_sigma, set_gnss_noise, set_speed
from .aiding.gnss_position import fuse_gnss_position
from .aiding.gnss_reset import attitude_is_lost
from .aiding.gnss_time import reset_time_offsets, set_initial_time_offset
from .aiding.gnss_velocity import fuse_gnss_velocity
from .aiding.heading import distrust_compass, has_compass
from .aiding.heading_contradiction import clear_contradictions, contradicts_heading, decay_reset_score
from .aiding.lever_arm_prior import set_gnss_lever_arm, weigh_lever_arm
from .aiding.wheel_check import reject_by_wheels, wheels_contradict, wheels_reject, wheels_support
from .alignment.in_motion import align_with_fix, low_motion_speed, reset_to_fix
from .alignment.modes import GIVEN_HEADING_WRONG, HEADING_LOST, HEADING_WRONG, change_mode
from .alignment.velocity_pairs import restart_in_motion_alignment
from .ekf import add_variance, variance
from .fusion import correct_state, write_innovation
from .glr_tests.compass_offset import (
    biases_contradict_heading,
    correct_compass_offset,
    estimate_wide_boresight,
    explained_by_compass_offset,
    find_compass_offset,
    fixes_contradict_heading,
    is_unconfirmed,
)
from .glr_tests.gnss_drift import explained_by_drift, reset_drift
from .glr_tests.gyro_bias_step import (
    counts_positions,
    detect_gyro_bias_step,
    explained_by_gyro_bias_step,
    interrupt_gyro_bias_step,
    note_fix,
    reset_gyro_bias_step,
)
from .glr_tests.imu_bias_step import (
    allow_for_imu_bias_step,
    detect_imu_bias_step,
    explained_by_imu_bias_step,
    has_positions_alone,
    interrupt_imu_bias_step,
    least_residual,
)
from .glr_tests.lever_arm_error import detect_lever_arm_error, explained_by_lever_arm_error, reset_lever_arm_error
from .glr_tests.time_offset_step import (
    detect_time_offset_step,
    explained_by_time_offset_step,
    reset_time_offset_step,
    residual_of_time_offset_step,
)
from .glr_tests.velocity_drift import detect_velocity_drift, explained_by_velocity_drift
from .integrity.frozen_receiver import (
    note_fused_position,
    position_is_frozen,
    position_is_repeated,
    velocity_is_repeated,
)
from .integrity.heading_monitor import monitor_heading
from .integrity.reset_inflation import limit_inflation
from .process_noise import inflate_earlier_estimates
from .rest_gap import compare_place
from .state import ATTITUDE, COARSE_ALIGNMENT, FORCES, NAVIGATING, NEVER_NS, RATES, VELOCITY_TIME_OFFSET

if TYPE_CHECKING:
    from ..types import Fix, Innovation
    from .types import Core, HypothesisBank, Parameters


@kernel
def is_usable(fix: Fix) -> bool:
    """Whether the fix has a position that is no dead reckoning of the receiver (NMEA quality 6)."""
    known = math.isfinite(fix.lat) and math.isfinite(fix.lon) and abs(fix.lat) <= 0.5 * math.pi
    return known and fix.quality != 0 and fix.quality != 6


@kernel
def set_noise(p: Parameters, c: Core, fix: Fix, first: bool) -> None:
    """Before the fix is fused: set its noise; of the first fix also the variance of the time offset.

    Another receiver has another latency, which its velocities show: their time offset is open again. That of the
    positions has a floor of its variance; opened as far as at the start, it would take errors of the position for a
    latency, and bend velocity and heading (simulated cars).
    """
    if first:
        set_initial_time_offset(p, c, fix, horizontal_sigma(p, fix))
    elif fix.flags & NEW_RECEIVER != 0:
        add_variance(c, VELOCITY_TIME_OFFSET, p.tuning.velocity_time_offset_sigma**2)
    set_gnss_lever_arm(p, c, fix)
    set_gnss_noise(p, c, fix)


@kernel
def fuse_and_align(
    p: Parameters, c: Core, b: HypothesisBank, fix: Fix, age: float, innovations: list[Innovation]
) -> int:
    """Align with the fix while the heading is not known, and fuse its position and velocity; returns the rows."""
    head_along_course(p, c, fix)
    compare_place(p, c, fix)
    if c.alignment.mode == NAVIGATING and variance(c, ATTITUDE + 2) > p.tuning.max_valid_heading_sigma**2:
        change_mode(p, c, HEADING_LOST)
    if c.alignment.mode == NAVIGATING and not math.isfinite(c.gnss.speed):
        set_speed(c, low_motion_speed(p, c, fix.lat, fix.lon))
    rows = 0
    first = c.alignment.mode == COARSE_ALIGNMENT and c.gnss.last_used_ns == NEVER_NS  # a given position may be old
    if first:
        reset_to_fix(p, c, fix)
    if c.alignment.mode == COARSE_ALIGNMENT:
        align_with_fix(p, c, b, fix)
    after_outage = ends_outage(p, c)
    if after_outage:
        rows = fuse_gnss_velocity(p, c, fix, innovations, rows)
    if not first:
        rows = fuse_gnss_position(p, c, fix, age, innovations, rows)
    if not after_outage:
        rows = fuse_gnss_velocity(p, c, fix, innovations, rows)
    if c.alignment.mode == NAVIGATING:
        inflate_earlier_estimates(p, c)
    return rows


@kernel
def check_given_heading(p: Parameters, c: Core) -> bool:
    """Whether a compass or the user gave a wrong heading. False: it is wrong, and has to be found anew."""
    if c.alignment.mode == NAVIGATING and estimate_wide_boresight(p, c):
        correct_state(p, c)
        return True
    offset = find_compass_offset(p, c) if c.alignment.mode == NAVIGATING else 0.0
    if offset == 0.0:
        wrong = fixes_contradict_heading(p, c) or biases_contradict_heading(p, c)
        return c.alignment.mode != NAVIGATING or not wrong
    if not correct_compass_offset(p, c, offset):
        return False
    correct_state(p, c)
    distrust_compass(p, c)
    distrust_poses(c)
    restart_in_motion_alignment(c)
    return True


@kernel
def check_drift(p: Parameters, c: Core) -> None:
    """Whether the receiver drifts against wheels that support the estimate: then they reject it."""
    if c.alignment.mode == NAVIGATING and wheels_support(p, c) and not wheels_reject(p, c) and not is_unconfirmed(c):
        otherwise = max(
            explained_by_time_offset_step(c), explained_by_gyro_bias_step(p, c), explained_by_compass_offset(c)
        )
        if detect_velocity_drift(p, c, otherwise) > 0.0:
            correct_state(p, c)
            interrupt_imu_bias_step(c)
            reject_by_wheels(c)


@kernel
def explained_by_drift_beside_wheels(p: Parameters, c: Core) -> float:
    """What another cause has to explain more than, where wheels may show that the receiver drifts; else 0."""
    if not wheels_support(p, c):
        return 0.0
    return float(explained_by_velocity_drift(p, c) + p.tuning.likely_velocity_drift_chi2)


@kernel
def check_lever_arm(p: Parameters, c: Core) -> None:
    """Whether the lever arm is given right, or wrong; not while the receiver drifts."""
    if weigh_lever_arm(p, c):
        correct_state(p, c)
    if c.drift.detected != 0:
        reset_lever_arm_error(c)
        return
    otherwise = max(explained_by_time_offset_step(c), explained_by_gyro_bias_step(p, c), explained_by_drift(p, c))
    if detect_lever_arm_error(p, c, otherwise):
        correct_state(p, c)
        restart_in_motion_alignment(c)
        interrupt_imu_bias_step(c)


@kernel
def check_time_offset(p: Parameters, c: Core) -> None:
    """Whether the stamps have stepped; a drift, a wrong heading, a departure taken for rest look like that."""
    uncertain = is_unconfirmed(c) or variance(c, ATTITUDE + 2) > p.tuning.max_step_heading_sigma**2
    departing = 1e-9 * (c.nav.t_ns - c.gravity_monitor.last_rest_ns) < p.tuning.departure_s
    if wheels_contradict(p, c) or c.drift.detected != 0 or uncertain or departing:
        reset_time_offset_step(c)
    elif least_residual(p, c) < residual_of_time_offset_step(c):
        return
    elif c.alignment.mode == NAVIGATING and detect_time_offset_step(p, c, explained_by_drift_beside_wheels(p, c)):
        correct_state(p, c)
        clear_contradictions(c)
        restart_in_motion_alignment(c)
        reset_gyro_bias_step(c)
        interrupt_imu_bias_step(c)
        reset_lever_arm_error(c)


@kernel
def forget_drift_explained(p: Parameters, c: Core) -> None:
    """A step of the sensors' biases was found in positions alone: what they showed was no drift."""
    if has_positions_alone(p, c) and c.drift.detected == 0:
        reset_drift(c)


@kernel
def check_gyro_bias(p: Parameters, c: Core) -> None:
    """Whether the gyro's bias has stepped; a compass shows such a turn by itself.

    Steps about other axes, or of the accelerometers, may explain as much.
    """
    if has_compass(p, c):
        reset_gyro_bias_step(c)
        return
    if c.time_offset_step.onset_ns == NEVER_NS:
        interrupt_gyro_bias_step(c)
        return
    otherwise = max(explained_by_time_offset_step(c), explained_by_lever_arm_error(p, c))
    otherwise = max(otherwise, explained_by_imu_bias_step(p, c) - p.tuning.imu_bias_step_excess)
    if counts_positions(p, c):
        otherwise = max(otherwise, explained_by_drift(p, c))
    otherwise = max(otherwise, explained_by_drift_beside_wheels(p, c))
    explained = explained_by_gyro_bias_step(p, c)
    if c.alignment.mode == NAVIGATING and detect_gyro_bias_step(p, c, otherwise):
        allow_for_imu_bias_step(p, c, RATES, explained)
        allow_for_imu_bias_step(p, c, FORCES, explained)
        correct_state(p, c)
        clear_contradictions(c)
        restart_in_motion_alignment(c)
        forget_drift_explained(p, c)
        interrupt_imu_bias_step(c)
        reset_lever_arm_error(c)


@kernel
def check_imu_biases(p: Parameters, c: Core) -> None:
    """Whether the biases of the accelerometers or of the gyros have stepped.

    Wheels, and a receiver whose velocities and positions disagree, make innovations like that.
    """
    departing = 1e-9 * (c.nav.t_ns - c.gravity_monitor.last_rest_ns) < p.tuning.departure_s
    discrepancy = c.drift.detected != 0 or c.scratch.drift[0] != 0.0 or c.scratch.drift[1] != 0.0
    other_cause = wheels_support(p, c) or discrepancy or is_unconfirmed(c) or departing
    if c.alignment.mode != NAVIGATING or other_cause:
        interrupt_imu_bias_step(c)
        return
    otherwise = explained_by_lever_arm_error(p, c)
    if residual_of_time_offset_step(c) < least_residual(p, c):
        otherwise = max(otherwise, explained_by_time_offset_step(c))
    otherwise = max(otherwise, explained_by_gyro_bias_step(p, c), explained_by_drift(p, c))
    if detect_imu_bias_step(p, c, otherwise):
        correct_state(p, c)
        clear_contradictions(c)
        restart_in_motion_alignment(c)
        forget_drift_explained(p, c)
        reset_time_offset_step(c)
        reset_gyro_bias_step(c)
        reset_lever_arm_error(c)


@kernel
def find_heading_anew(p: Parameters, c: Core, fix: Fix) -> None:
    """The heading is wrong: begin with the fix, and what was learned with an unconfirmed heading anew."""
    clear_contradictions(c)
    if c.alignment.mode == NAVIGATING:
        given = is_unconfirmed(c)
        if given:
            reset_time_offsets(p, c, fix, horizontal_sigma(p, fix))
        distrust_compass(p, c)
        distrust_poses(c)
        distrust_velocities(c)
        change_mode(p, c, GIVEN_HEADING_WRONG if given else HEADING_WRONG)
    reset_to_fix(p, c, fix)


@kernel
def begin_anew(p: Parameters, c: Core, fix: Fix) -> None:
    """Begin anew at a fix, with nothing of what was found before: the receiver's velocity is late, or the tilt is lost.

    A compass gives its heading again.
    """
    clear_contradictions(c)
    if c.alignment.mode == NAVIGATING:
        change_mode(p, c, HEADING_WRONG)
    reset_time_offsets(p, c, fix, horizontal_sigma(p, fix))
    restart_in_motion_alignment(c)
    reset_to_fix(p, c, fix)


@kernel
def fuse_gnss(p: Parameters, c: Core, b: HypothesisBank, fix: Fix, age: float, innovations: list[Innovation]) -> int:
    """Fuse a fix at the core's time; it was true `age` s before. Returns the rows of innovations written.

    After the fix the tests of what it may show, each of which knows what the others would explain: a wrong heading that
    was given, a drift of the receiver, a step of its stamps, one of the sensors' biases, a wrong heading. Of a position
    that is frozen or repeated only a new velocity is used.
    """
    repeated = velocity_is_repeated(c, fix)
    frozen = position_is_frozen(p, c, fix)
    no_position = frozen or position_is_repeated(p, c)
    if not (no_position and repeated):
        set_speed(c, elementary.hypot(fix.v[0], fix.v[1]) if math.isfinite(fix.v[0]) else fix.speed)
    if no_position:
        if frozen:
            reject_frozen(c)
        rows = write_innovation(innovations, 0, fix.t_ns, POSITION_N, math.nan, math.nan, False)
        return rows if repeated else fuse_gnss_velocity(p, c, fix, innovations, rows)
    lat, lon = c.nav.lat, c.nav.lon
    rows = fuse_and_align(p, c, b, fix, age, innovations)
    compare_heights(p, c, fix)
    heading_ok = check_given_heading(p, c)
    check_drift(p, c)
    check_lever_arm(p, c)
    check_time_offset(p, c)
    check_gyro_bias(p, c)
    check_imu_biases(p, c)
    note_fix(c)
    decay_reset_score(p, c)
    if heading_ok and c.alignment.mode == NAVIGATING and not wheels_reject(p, c):
        heading_ok = monitor_heading(p, c, b, fix)
    if attitude_is_lost(p, c):
        begin_anew(p, c, fix)
        limit_inflation(p, c)
    elif contradicts_heading(p, c) or not heading_ok:
        find_heading_anew(p, c, fix)
    note_fused_position(p, c, lat, lon)
    count_fix(c)
    return rows
