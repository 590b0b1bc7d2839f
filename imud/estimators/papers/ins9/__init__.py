"""Prasanna's INS filter: position, velocity and acceleration per axis, on distances dead reckoned from the sensor.

Source: Prasanna, Vehicle Localisation Using GPS and IMU (2009), "INS Kalman Filter": acceleration free of gravity is
integrated to velocity and distance; the distances are the measurements of a nine-state filter, Q = 0.7, R = 0.2. The
filter smooths its own dead reckoning and cannot know better than that; the sigmas add what dead reckoning does not
know, from the sensor's noise. His integrated program, which ties the INS to GPS, is the `navigation` estimator.

What is built instead of the print:
- the gain lacks the inverse, and the predicted P is updated: as in `gps_track`;
- acc = macc + 9.8 sin(angle) holds for small angles: gravity is removed with the full rotation, which is the device's
  own tilt where it gives one, else the gyros' from the rest at the start;
- biases: his means at standstill, taken over the first REST_S, which must be at rest: the mean rate is the gyro's
  bias, the mean force is gravity in size and direction;
- G = columns of ones: a discrete Wiener process of the acceleration, [dt^2 / 2, dt, 1] per axis (Bar-Shalom, Li and
  Kirubarajan, sec. 6.3.3), its variance Q per second, so that it does not depend on the sample rate.
Q in (m/s^2)^2/s and R in m^2 are `ins9` in the settings. The axes share one covariance. Position needs an origin: the
user's, or the first fix; without a given yaw the track is turned by an unknown angle, which its sigma includes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers.sample import UNUSABLE

from ....compile.jit import kernel
from ....math.earth import displaced
from ....math.kalman import measure, shear, update
from ... import Estimator
from .reckoning import average_rest, dead_reckon, propagate_errors
from .solution import reckoning_variance, write_solution
from .state import ACCELERATION, DISTANCE, REST_S, SPEED, STATES, configure, start

if TYPE_CHECKING:
    from ...types import Fix, Innovation, Sample, Solution
    from ..types import Ins9Parameters, Ins9State

__all__ = ["ESTIMATOR", "REST_S", "configure", "reckoning_variance", "start", "step"]
ORIGIN_SIGMA = 5.0  # m, of an origin whose source does not say


@kernel
def smooth_distances(p: Ins9Parameters, s: Ins9State, T: float) -> None:
    """The nine-state filter over T s with the reckoned distances as its measurements."""
    shear(s.P, STATES, DISTANCE, SPEED, T)
    shear(s.P, STATES, DISTANCE, ACCELERATION, 0.5 * T * T)
    shear(s.P, STATES, SPEED, ACCELERATION, T)
    G = (0.5 * T * T, T, 1.0)
    at = 0
    for i in range(STATES):
        for j in range(i, STATES):
            s.P[at] += p.acceleration_walk * T * G[i] * G[j]
            at += 1
    s.variance = measure(s.P, STATES, s.column, s.one, 1, s.d) + p.distance_var
    for i in range(3):
        s.p[i] += T * s.v[i] + 0.5 * T * T * s.a[i]
        s.v[i] += T * s.a[i]
        s.predicted[i] = s.p[i]
        z = s.reckoned_p[i] - s.p[i]
        s.innovation[i] = z
        s.p[i] += s.d[DISTANCE] / s.variance * z
        s.v[i] += s.d[SPEED] / s.variance * z
        s.a[i] += s.d[ACCELERATION] / s.variance * z
    update(s.P, STATES, s.x, s.d, s.variance, 0.0)


@kernel
def step(p: Ins9Parameters, s: Ins9State, sample: Sample, solution: Solution) -> None:
    """Take one sample (SAMPLE), write one row (SOLUTION). Bad samples are left out."""
    w, f = sample.w, sample.f
    good = sample.flags & UNUSABLE == 0 and math.isfinite(f[0] + f[1] + f[2] + w[0] + w[1] + w[2])
    if good and (s.samples == 0 or sample.t_ns > s.t_ns):
        T = (sample.t_ns - s.t_ns) * 1e-9 if s.samples > 0 else 0.0
        s.t_ns = sample.t_ns
        if s.samples == 0:
            s.first_sample_ns = s.t_ns
        s.samples += 1
        if s.t_ns - s.first_sample_ns <= REST_S * 1e9:
            average_rest(s, sample)
        else:
            s.moving_s += T
            propagate_errors(s, sample, T)
            dead_reckon(s, sample, T)
            smooth_distances(p, s, T)
    write_solution(p, s, sample, solution)


@kernel
def set_origin(p: Ins9Parameters, s: Ins9State, fix: Fix, innovations: list[Innovation]) -> int:
    """Take the first fix for the origin, less the way gone since. No innovation: nothing was predicted."""
    usable = math.isfinite(fix.lat + fix.lon) and fix.quality != 0 and fix.quality != 6
    if usable and not math.isfinite(s.origin[0]):
        s.origin[0], s.origin[1] = displaced(fix.lat, fix.lon, 0.0, -s.p[0], -s.p[1])
        s.origin[2] = (fix.height if math.isfinite(fix.height) else 0.0) + s.p[2]
        for i in range(3):
            s.origin_var[i] = (fix.sigma[i] if math.isfinite(fix.sigma[i]) else ORIGIN_SIGMA) ** 2
        if not math.isfinite(fix.height):
            s.origin_var[2] = math.nan
    return 0


ESTIMATOR = Estimator("ins9", configure, start, step, set_origin, needs_gyros=False)
