"""Attitude without GNSS or magnetometer: an error-state filter of 28 states on gyro and accelerometer alone.

Every sample is integrated; the covariance follows at about 20 Hz whatever the sample rate. The accelerometer is not
averaged: its integral, a velocity, is held to be about zero, which tells gravity from acceleration. Roll and pitch are
absolute. Yaw counts from the start, or from the heading that the user gives; nothing corrects it and its sigma grows.
HEADING_VALID is set only after a given heading, while that sigma is small.

Source: Solà, Quaternion kinematics for the error-state Kalman filter (2017), sec. 7 (global angular error).
"""

import math
from typing import Any

from drivers.sample import NO_FORCE, NO_RATE, SUSPECT
from drivers.sample import SATURATED as BEYOND_RANGE

from ...kernels.jit import kernel
from .. import Estimator
from ..records import AT_REST, ATTITUDE_VALID, HEADING_VALID, SATURATED
from .counts import examine
from .covariance import clear, correct, predict, report, shake
from .levelling import begin, doubt, hold, level, middle, resume, seek, seeks, unweighed
from .lost import loses
from .parameters import TUNABLES
from .rest import judge, restart, watch
from .setup import configure, start
from .staying import follow_travel, hold_near, hold_place, hold_still, leave
from .strapdown import advance, corrected_force, corrected_rate
from .truncation import restored

INTERVAL_S = 0.049  # of the covariance: 0.025 to 0.1 give the same errors, on hands (BROAD) and vehicles
LONG_GAP_S = 1.0  # after it the attitude is found anew
TRUSTED_TILT = math.radians(10.0)
TRUSTED_HEADING = math.radians(20.0)


@kernel
def settle(p: Any, s: Any) -> None:
    """One step of the covariance: propagate, take the pseudo-measurements, correct."""
    predict(p, s)
    if seeks(s):
        seek(s)
    elif s.levelled == 1 and not loses(p, s):
        hold_on(p, s)
        correct(s)
    clear(s)
    report(s)


@kernel
def hold_on(p: Any, s: Any) -> None:
    """Take the pseudo-measurements of rest or motion."""
    follow_travel(s)
    rested = s.resting == 1
    if judge(p, s):
        hold_still(p, s)
    else:
        if rested:
            leave(s)
        hold_near(s)
    hold_place(s)


@kernel
def take(p: Any, s: Any, sample: Any, dt: float) -> None:
    """One sample, dt s after the last one (dt < 0: the very first)."""
    w = (restored(s, sample.w[0], 0), restored(s, sample.w[1], 1), restored(s, sample.w[2], 2))
    f = (sample.f[0], sample.f[1], sample.f[2])
    good = sample.flags & (SUSPECT | NO_RATE) == 0 and math.isfinite(w[0] + w[1] + w[2])
    weighed = sample.flags & (SUSPECT | NO_FORCE) == 0 and math.isfinite(f[0] + f[1] + f[2])
    if not good:
        w = (s.w[0], s.w[1], s.w[2])
        hold(s, max(dt, 0.0), sample.unseen_s)
    if not weighed:
        f = unweighed(s, max(dt, 0.0)) if good else (s.f[0], s.f[1], s.f[2])
    if dt < 0.0:
        begin(s, w, f)
    elif dt > LONG_GAP_S or (good and s.held_s > LONG_GAP_S):
        resume(p, s, w, f, dt)
    else:
        shake(p, s, f, dt)
        if sample.flags & BEYOND_RANGE or dt > p.gap_s or s.held_s > 0.0:
            doubt(p, s, w, f, dt, sample.flags)
        if dt > p.gap_s:
            advance(s, middle(s.w, w), middle(s.f, f), dt)
        else:
            advance(s, w, f, dt)
        if good and weighed:
            watch(p, s, w, f, dt)
        else:
            restart(s, w, f)
        for i in range(3):
            s.w[i] = w[i]
            s.f[i] = f[i]
    if good:
        s.held_s = 0.0
        examine(s, (sample.w[0], sample.w[1], sample.w[2]))
    if s.levelled == 0 and weighed:
        level(s, f)
    if s.span >= INTERVAL_S:
        settle(p, s)


@kernel
def tell(s: Any, flags: int, out: Any) -> None:
    """Write a row of SOLUTION; what this filter does not know is NaN."""
    status = 0
    if s.levelled == 1 and s.sigma_tilt < TRUSTED_TILT and s.held_s < LONG_GAP_S:
        status |= ATTITUDE_VALID
        if s.heading == 1 and s.sigma_rpy[2] < TRUSTED_HEADING:
            status |= HEADING_VALID
    if s.resting == 1:
        status |= AT_REST
    if flags & BEYOND_RANGE != 0:
        status |= SATURATED
    out.t_ns = s.t_ns
    out.status = status
    out.lat = out.lon = out.height = math.nan
    w = corrected_rate(s, s.w[0] - s.bg[0], s.w[1] - s.bg[1], s.w[2] - s.bg[2])
    f = corrected_force(s, s.f[0], s.f[1], s.f[2])
    for i in range(4):
        out.q_nb[i] = s.q[i]
    for i in range(3):
        out.v[i] = out.sigma_p[i] = out.sigma_v[i] = math.nan
        out.w[i] = w[i]
        out.f[i] = f[i]
        out.bg[i] = s.bg[i]
        out.ba[i] = s.ba[i]
        out.sigma_rpy[i] = s.sigma_rpy[i]
        out.sigma_bg[i] = s.sigma_bg[i]
        out.sigma_ba[i] = s.sigma_ba[i]


@kernel
def step(p: Any, s: Any, sample: Any, solution: Any) -> None:
    """Take one sample (SAMPLE), write one row (SOLUTION). A sample that is not newer than the last is ignored."""
    dt = (sample.t_ns - s.t_ns) * 1e-9 if s.samples > 0 else -1.0
    if s.samples == 0 or dt > 0.0:
        s.t_ns = sample.t_ns
        s.samples += 1
        take(p, s, sample, dt)
    tell(s, sample.flags, solution)


ESTIMATOR = Estimator("attitude", configure, start, step, None, tunables=TUNABLES)
