"""The two entries of the reduced inertial estimator, a sample and a fix, and the order of their steps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers.sample import NO_FORCE, NO_RATE, POWER_ON, SUSPECT

from ...compile.jit import kernel
from ...math.kalman import reset
from .ekf import propagate, store_travel
from .forces import detect_rest, fuse_device_tilt, fuse_forces, fuse_rest, level
from .solution import write_solution
from .state import ACCEL_BIAS_X, ACCEL_BIAS_Y, GYRO_BIAS, STATES

if TYPE_CHECKING:
    from ..types import Sample, Solution
    from .types import RissParameters, RissState

MAX_INTERVAL_S = 1.0  # s, of one propagation; the rate at the end of a longer gap is not used for the gap
MAX_INTERVALS = 1000  # of a gap, however long it is


@kernel
def accumulate_sample(s: RissState, sample: Sample) -> None:
    """Add a sample to the sums of the step."""
    w, f, down = sample.w[2], sample.f, sample.down
    if sample.flags & (SUSPECT | NO_RATE) == 0 and math.isfinite(w):
        s.w_sum += w
        s.rate_count += 1
    if sample.flags & (SUSPECT | NO_FORCE) == 0 and math.isfinite(f[0] + f[1] + f[2]):
        change = 0.0
        for i in range(3):
            s.f_sum[i] += f[i]
            if i < 2:
                change += 0.25 * (f[i] - s.f_last[i]) ** 2  # mean variance of x and y, by differences
            s.f_last[i] = f[i]
        s.force_count += 1
        s.force_scatter += 0.02 * (change - s.force_scatter)
    s.count += 1
    for i in range(3):
        s.down_sum[i] += down[i]
    s.outage_s = sample.outage_s if sample.flags & NO_RATE != 0 else 0.0


@kernel
def reset_biases(p: RissParameters, s: RissState) -> None:
    """Reset the biases to their switch-on variances: the sensor may have been switched on."""
    reset(s.P, STATES, ACCEL_BIAS_X, p.accel_bias_var)
    reset(s.P, STATES, ACCEL_BIAS_Y, p.accel_bias_var)
    reset(s.P, STATES, GYRO_BIAS, p.gyro_bias_var)


@kernel
def process_step(p: RissParameters, s: RissState) -> None:
    """End a step: propagate by the mean rate, then fuse the mean forces, or the device's own tilt, and rest."""
    T = (s.t_ns - s.step_ns) * 1e-9
    if T > MAX_INTERVAL_S:  # the rate at the end of a gap is not that in the gap
        s.rate_count, s.w_sum = 0, 0.0
    rate = s.w_sum / s.rate_count if s.rate_count > 0 else s.x[GYRO_BIAS]
    unmeasured_s = max(s.outage_s, T) if s.rate_count == 0 else 0.0
    left, longest = T, max(MAX_INTERVAL_S, T / MAX_INTERVALS)
    while left > 0.0:
        part = min(left, longest)
        propagate(p, s, rate, max(unmeasured_s - left + part, 0.0), part)
        left -= part
    s.step_ns = s.t_ns
    if s.force_count > 0:
        f = (s.f_sum[0] / s.force_count, s.f_sum[1] / s.force_count, s.f_sum[2] / s.force_count)
        if s.levelled == 0 and f[0] * f[0] + f[1] * f[1] + f[2] * f[2] > 1.0:
            level(s, f)
        fuse_forces(p, s, f, rate, min(T, p.tuning.step_s))
        detect_rest(p, s, f, min(T, p.tuning.step_s))
    else:
        s.rest_since_ns = s.resting = 0
        down = (s.down_sum[0] / s.count, s.down_sum[1] / s.count, s.down_sum[2] / s.count)
        if down[2] > 0.1:
            fuse_device_tilt(p, s, down, T)
    if s.resting == 1 and s.rate_count > 0:
        fuse_rest(p, s, rate, T)
    store_travel(s)
    s.count = s.force_count = s.rate_count = 0
    s.w_sum = 0.0
    for i in range(3):
        s.f_sum[i] = s.down_sum[i] = 0.0


@kernel
def step(p: RissParameters, s: RissState, sample: Sample, solution: Solution) -> None:
    """Process one sample (SAMPLE), write one row (SOLUTION). A sample that is not newer than the last is ignored."""
    if s.started == 0:
        s.started = 1
        s.t_ns = s.step_ns = sample.t_ns
        store_travel(s)
        for i in range(3):
            s.f_last[i] = sample.f[i] if math.isfinite(sample.f[i]) else 0.0
    elif sample.t_ns > s.t_ns:
        if sample.flags & POWER_ON != 0:
            reset_biases(p, s)
        s.t_ns = sample.t_ns
        accumulate_sample(s, sample)
        if (s.t_ns - s.step_ns) * 1e-9 >= 0.99 * p.tuning.step_s:
            process_step(p, s)
    write_solution(p, s, sample, solution)
