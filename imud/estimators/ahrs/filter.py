"""The entry of the attitude filter, one inertial sample; and the order of things on one page."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers.sample import NO_FORCE, NO_RATE, POWER_ON, SATURATED, SUSPECT

from ...compile.jit import kernel
from .attitude_step import correct_attitude_step, rotate_gain
from .clipping import compensate_clipping
from .divergence import tilt_is_lost
from .drag import interrupt_drag, update_drag
from .ekf import inject_error, update_sigmas
from .error_model import propagate_covariance
from .history import record_hypotheses
from .integrals import reset_integrals
from .last_sample import set_outage, store_sample, update_mean_square_rate
from .levelling import (
    coarse_level,
    initialise_attitude,
    is_coarse,
    require_initialisation,
    restart_after_gap,
    restart_imu,
)
from .mechanization import mechanize
from .motion import update_scatter, update_travel
from .outages import (
    add_outage_noise,
    add_shock_noise,
    add_stamp_noise,
    between,
    force_without_acceleration,
    hold_invalid_axes,
    hold_rate,
)
from .power_on import reset_biases
from .pseudo_measurements import add_truncation_noise, fuse_stationary, fuse_zero_position, fuse_zero_velocity
from .quantization import update_quantization
from .queues import find_lost, follow_queue
from .sensor_axes import to_body_axes, to_sensor_axes
from .solution import write_solution
from .stamps import even_period, time_lost
from .state import ATTITUDE
from .stationarity import add_hidden_motion, detect_stationary, restart_means, update_means
from .truncation import compensate_truncation
from .variance_factor import restart_variance_factor, update_variance_factor
from .velocity_hypotheses import correct_yaw, follow_correction, follow_hypotheses, start_hypotheses, update_hypotheses

if TYPE_CHECKING:
    from ..types import Sample, Solution
    from .types import Parameters, State


@kernel
def step(p: Parameters, s: State, sample: Sample, solution: Solution) -> None:
    """Take one sample (SAMPLE), write one row (SOLUTION). A sample that is not newer than the last is ignored."""
    dt = (sample.t_ns - s.t_ns) * 1e-9 if s.sample_count > 0 else -1.0
    if s.sample_count == 0 or dt > 0.0:
        s.t_ns = sample.t_ns
        s.sample_count += 1
        process_sample(p, s, sample, dt)
    write_solution(p, s, sample.flags, solution)


@kernel
def process_sample(p: Parameters, s: State, sample: Sample, dt: float) -> None:
    """Integrate one sample, dt s after the last one (dt < 0: the first), and update the covariance when it is due.

    Of a sample that the health monitor does not believe, the last rates are held and the force assumed to be gravity.
    """
    c = p.tuning
    reading = to_sensor_axes(p, (sample.w[0], sample.w[1], sample.w[2]))
    w = to_body_axes(
        p,
        (
            compensate_truncation(s, reading[0], 0),
            compensate_truncation(s, reading[1], 1),
            compensate_truncation(s, reading[2], 2),
        ),
    )
    f = (sample.f[0], sample.f[1], sample.f[2])
    if sample.flags & POWER_ON and dt >= 0.0:
        reset_biases(p, s)
    has_rate = sample.flags & (SUSPECT | NO_RATE) == 0 and math.isfinite(w[0] + w[1] + w[2])
    has_force = sample.flags & (SUSPECT | NO_FORCE) == 0 and math.isfinite(f[0] + f[1] + f[2])
    if not has_rate:
        w = hold_invalid_axes(p, s, w, sample.flags, dt if sample.outage_s > c.steady_rate_s else 0.0)
        hold_rate(p, s, max(dt, 0.0), sample.outage_s)
    if not has_force:
        f = force_without_acceleration(p, s, max(dt, 0.0)) if has_rate else (s.imu.f[0], s.imu.f[1], s.imu.f[2])
    last_f = (s.imu.f[0], s.imu.f[1], s.imu.f[2])
    is_first = dt < 0.0 or dt > c.long_gap_s or (has_rate and s.imu.outage_s > c.long_gap_s)
    if dt < 0.0:
        restart_imu(s, w, f)
    elif is_first:
        restart_after_gap(p, s, w, f, dt)
    else:
        from_queue = s.stamps.waiting == 1 and s.stamps.late == 0
        dt = even_period(p, s, w, has_rate, dt)
        add_shock_noise(p, s, f, dt)
        lost_s = time_lost(p, s, dt)
        if sample.flags & SATURATED or lost_s > 0.0 or s.imu.outage_s > 0.0:
            add_outage_noise(p, s, w, f, dt, lost_s, sample.flags)
        if lost_s > 0.0:
            share = 0.5 * lost_s / dt
            if from_queue:
                find_lost(p, s, w, f, lost_s)
                share *= 2.0
            mechanize(p, s, between(s.imu.gap_w, w, share), between(s.imu.gap_f, f, share), dt)
        else:
            add_stamp_noise(s, w, f)
            mechanize(p, s, compensate_clipping(p, s, w, dt, sample.flags), f, dt)
        follow_queue(p, s, w, f)
        update_scatter(p, s, dt)
        if has_rate and has_force:
            update_means(p, s, w, f, dt)
        else:
            restart_means(s, w, f)
        store_sample(s, w, f)
    if has_rate:
        update_mean_square_rate(s, w, max(dt, 0.0) / c.velocity_scatter_time_s)
        set_outage(s, 0.0, 0.0)
        update_quantization(p, s, reading)
    if s.levelling.initialised == 0 and has_force:
        initialise_attitude(p, s, f, last_f, is_first)
        start_hypotheses(p, s)
    if s.integrals.time >= c.covariance_interval_s:
        update_covariance(p, s)


@kernel
def update_covariance(p: Parameters, s: State) -> None:
    """Propagate the covariance over the interval, fuse the pseudo-measurements, inject the error."""
    propagate_covariance(p, s)
    if is_coarse(p, s):
        coarse_level(p, s)
        start_hypotheses(p, s)
        restart_variance_factor(s)
    elif s.levelling.initialised == 1 and tilt_is_lost(p, s):
        require_initialisation(s)
        restart_variance_factor(s)
    elif s.levelling.initialised == 1 and correct_attitude_step(p, s):
        start_hypotheses(p, s)
        restart_variance_factor(s)
    elif s.levelling.initialised == 1:
        update_hypotheses(p, s)
        record_hypotheses(s)
        fuse_pseudo_measurements(p, s)
        update_variance_factor(p, s)
        rotate_gain(s, s.scratch.x[ATTITUDE], s.scratch.x[ATTITUDE + 1], s.scratch.x[ATTITUDE + 2])
        follow_correction(s)
        inject_error(s)
    reset_integrals(s)
    update_sigmas(s)


@kernel
def fuse_pseudo_measurements(p: Parameters, s: State) -> None:
    """Zero velocity and zero position, and at rest the mean rate as the gyro bias."""
    update_travel(p, s)
    was_stationary = s.stationarity.stationary == 1
    if detect_stationary(p, s):
        interrupt_drag(s)
        correct_yaw(s)
        fuse_stationary(p, s)
        fuse_zero_position(p, s)
    elif s.hypotheses.leading == 1:
        update_drag(p, s)
        follow_hypotheses(p, s)
    else:
        if was_stationary:
            add_truncation_noise(p, s)
            add_hidden_motion(s)
        update_drag(p, s)
        fuse_zero_velocity(p, s)
        fuse_zero_position(p, s)
