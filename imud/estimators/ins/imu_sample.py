"""One IMU sample: the order of its steps, the same for new samples and for those replayed after a late measurement.

Damaged readings are replaced; nominal state and covariance propagate, with noise for what damaged readings hide. At the
end of a window of half a second the gyro bias is checked against gravity, the body is found at rest or not, and the
pseudo-measurements that are due (ZUPT, ZARU, NHC) are fused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers.sample import LIMITED_FORCE, NO_FORCE, NO_RATE, POWER_ON, RECONNECTED

from ...compile.jit import kernel
from ..tuning import Tunable
from .aiding.contradicted_bias import watch_bias
from .aiding.course_heading import waits_for_course
from .aiding.forward_axis_search import find_forward_axis
from .aiding.non_holonomic import enable_nhc, fuse_nhc, is_due, observe_heave
from .aiding.zero_velocity import fuse_rest
from .alignment.fixed_gravity import measure_fixed_gravity
from .alignment.levelling import level_from_window
from .alignment.modes import ATTITUDE_LOST, HEADING_KNOWN, change_mode
from .alignment.velocity_pairs import is_levelled, restart_in_motion_alignment
from .bias_changes import add_bias_changes
from .damaged_readings import add_held_variance, inflate_covariance, substitute_missing
from .fusion import propagate_errors
from .glr_tests.gyro_bias_step import reset_gyro_bias_step
from .glr_tests.imu_bias_step import interrupt_imu_bias_step
from .integrity.gravity_monitor import monitor_gravity
from .power_on import check_attitude, reset_biases
from .propagation import count_sample, propagate_to
from .rest import detect_rest
from .rest_gap import judge_rest_gap, keep_place
from .state import COARSE_ALIGNMENT, NAVIGATING, RATES
from .stationarity import accumulate_window, classify_window, clear_window

if TYPE_CHECKING:
    from .types import Core, Parameters, StoredSample


TUNABLES = (
    Tunable(
        "max_gyro_outage_s", 1.0, "s", "Outage of the rates after which the alignment starts again.", "Linearization."
    ),
)


@kernel
def end_window(p: Parameters, c: Core) -> None:
    """At the end of a stationarity window: monitor gravity, detect rest, level, fuse rest, begin to navigate once the
    heading is known, look for the forward axis.
    """
    propagate_errors(p, c)
    classify_window(p, c)
    add_bias_changes(p, c)
    monitor_gravity(p, c)
    measure_fixed_gravity(p, c)
    at_rest = detect_rest(p, c)
    judge_rest_gap(p, c)
    if c.alignment.mode == COARSE_ALIGNMENT:
        level_from_window(p, c, at_rest)  # before the update at rest changes the attitude of the mean force
    if watch_bias(p, c, at_rest):
        restart_in_motion_alignment(c)
        reset_gyro_bias_step(c)
        interrupt_imu_bias_step(c)
    if at_rest:
        fuse_rest(p, c)
    if c.alignment.mode == COARSE_ALIGNMENT:
        if c.gnss.fix_count > 0 and c.alignment.heading_sigma > 0.0 and is_levelled(p, c):
            change_mode(p, c, HEADING_KNOWN)
    elif find_forward_axis(p, c):
        enable_nhc(p, c)
    clear_window(c)


@kernel
def process_sample(p: Parameters, c: Core, sample: StoredSample) -> None:
    """Process one stored sample (body axes): propagate, then window end and constraint where they are due."""
    dt = 1e-9 * (sample.t_ns - c.nav.t_ns)
    gap_s = count_sample(c, sample.t_ns)
    incomplete = sample.flags & (NO_RATE | NO_FORCE) != 0
    if incomplete:
        substitute_missing(p, c, sample)
    accumulate_window(c, sample.w, sample.f)
    reconnected = sample.flags & (POWER_ON | RECONNECTED) != 0 and gap_s > p.tuning.max_gyro_outage_s
    if reconnected:
        keep_place(c)
    add_held_variance(p, c, sample, dt)
    propagate_to(p, c, sample.t_ns, sample.w, sample.f)
    if sample.flags & POWER_ON:  # the biases of the time before are those of the gap
        reset_biases(p, c)
    if reconnected:
        check_attitude(p, c, gap_s, sample.flags & POWER_ON != 0)
    inflate_covariance(p, c, sample, dt)
    if incomplete or sample.flags & LIMITED_FORCE:  # its mean force shows no direction of gravity
        clear_window(c)
    if c.imu.outage_s[RATES] > p.tuning.max_gyro_outage_s and sample.flags & NO_RATE:
        change_mode(p, c, ATTITUDE_LOST)
    share = min(dt * (1.0 / p.tuning.smoothing_s), 1.0)
    for i in range(3):
        c.imu.rate_b[i] += share * (c.imu.w[i] - c.nav.bg[i] - c.imu.rate_b[i])
    if c.stationarity.duration >= p.tuning.rest_window_s and c.stationarity.sample_count > 3:
        end_window(p, c)
    if is_due(p, c, dt) and c.alignment.mode == NAVIGATING and c.imu.outage_s[RATES] == 0.0:
        if c.nhc.enabled and not waits_for_course(p, c):
            propagate_errors(p, c)
            fuse_nhc(p, c)
        elif not c.nhc.enabled:
            observe_heave(p, c)
