"""The solution of `ins9`: its states, and with their own sigmas what dead reckoning does not know."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.earth import EARTH_RATE_RADPS, displaced
from ....math.rotation import UNKNOWN_ANGLE
from ...blank_solution import blank
from ...records import AT_REST, ATTITUDE_VALID, COASTING, HEADING_VALID, HEIGHT_VALID, POSITION_VALID
from .state import DEVICE, EARTH, RATE_ERROR, SCALE_ERROR

if TYPE_CHECKING:
    from ....math.arrays import Reals
    from ...types import Sample, Solution
    from ..types import Ins9Parameters, Ins9State

GIVEN_HEADING_SIGMA = math.radians(5.0)
DEVICE_TILT_SIGMA = math.radians(1.0)  # of a device that does not say how good its own is
VALID_ANGLE = math.radians(20.0)
EARTH_VAR = EARTH_RATE_RADPS * EARTH_RATE_RADPS


@kernel
def tilt_variance(p: Ins9Parameters, s: Ins9State, by: Reals) -> float:
    """Sum of the tilting sources' variances times the squares of `by`."""
    rate = p.gyro_psd / max(s.rest_s, 1e-3)
    gyros = rate * by[RATE_ERROR] ** 2 + p.gyro_scale_var * by[SCALE_ERROR] ** 2 + EARTH_VAR * by[EARTH] ** 2
    return float(gyros + (DEVICE_TILT_SIGMA * by[DEVICE]) ** 2)


@kernel
def reckoning_variance(p: Ins9Parameters, s: Ins9State, axis: int) -> tuple[float, float]:
    """What dead reckoning does not know of one axis (NED): variances of distance and velocity.

    The mean force at rest, white noise, bias walk, the rotated bias; and what tilts, which only the level axes measure.
    """
    t = s.moving_s
    force = p.accel_psd / max(s.rest_s, 1e-3)
    distance = force * t**4 / 4 + p.accel_psd * t**3 / 3 + p.accel_bias_psd * t**5 / 20
    velocity = force * t**2 + p.accel_psd * t + p.accel_bias_psd * t**3 / 3
    for j in range(3):
        distance += p.accel_bias_var * s.distance_by_bias[3 * axis + j] ** 2
        velocity += p.accel_bias_var * s.velocity_by_bias[3 * axis + j] ** 2
    if axis < 2:
        g2 = s.gravity * s.gravity
        distance += tilt_variance(p, s, s.distance_by) + g2 * (p.gyro_psd * t**5 / 20 + p.gyro_bias_psd * t**7 / 252)
        velocity += tilt_variance(p, s, s.velocity_by) + g2 * (p.gyro_psd * t**3 / 3 + p.gyro_bias_psd * t**5 / 20)
    return distance, velocity


@kernel
def write_position(p: Ins9Parameters, s: Ins9State, heading_var: float, tilt_var: float, out: Solution) -> None:
    """Position and velocity relative to the origin; errors of scale, heading and tilt are a part of the way gone."""
    out.lat, out.lon = displaced(s.origin[0], s.origin[1], s.origin[2], s.p[0], s.p[1])
    if math.isfinite(s.origin_var[2]):
        out.status |= HEIGHT_VALID
        out.height = s.origin[2] - s.p[2]
    turned = min(heading_var, 2.0)  # mean square chord of an unknown turn, per square of the way
    way2, speed2 = s.p[0] ** 2 + s.p[1] ** 2, s.v[0] ** 2 + s.v[1] ** 2
    for i in range(3):
        distance_var, velocity_var = reckoning_variance(p, s, i)
        wrong = p.accel_scale_var + (turned if i < 2 else tilt_var)
        out.v[i] = s.v[i]
        out.sigma_p[i] = math.sqrt(s.P[0] + distance_var + s.origin_var[i] + wrong * way2)
        out.sigma_v[i] = math.sqrt(s.P[3] + velocity_var + wrong * speed2)


@kernel
def write_solution(p: Ins9Parameters, s: Ins9State, sample: Sample, out: Solution) -> None:
    """Write a row of SOLUTION."""
    blank(out, s.t_ns, sample)
    if s.samples == 0:
        return
    drift = tilt_variance(p, s, s.tilt_by) + p.gyro_psd * s.moving_s + p.gyro_bias_psd * s.moving_s**3 / 3.0
    level_var = (p.accel_bias_var + p.accel_psd / max(s.rest_s, 1e-3)) / (s.gravity * s.gravity)
    known = math.isfinite(s.initial_yaw)
    heading_var = min((GIVEN_HEADING_SIGMA**2 if known else UNKNOWN_ANGLE**2) + drift, UNKNOWN_ANGLE**2)
    out.sigma_rpy[0] = out.sigma_rpy[1] = min(math.sqrt(level_var + drift), UNKNOWN_ANGLE)
    out.sigma_rpy[2] = math.sqrt(heading_var)
    out.status |= AT_REST if s.moving_s == 0.0 else COASTING
    if out.sigma_rpy[0] < VALID_ANGLE:
        out.status |= ATTITUDE_VALID
    if known and out.sigma_rpy[2] < VALID_ANGLE:
        out.status |= HEADING_VALID
    for i in range(4):
        out.q_nb[i] = s.q[i]
    for i in range(3):
        out.w[i] = sample.w[i] - s.bg[i]
        out.bg[i] = s.bg[i]
        out.sigma_bg[i] = math.sqrt(p.gyro_psd / max(s.rest_s, 1e-3) + p.gyro_bias_psd * s.moving_s + EARTH_VAR / 3.0)
    if math.isfinite(s.origin[0]):
        out.status |= POSITION_VALID
        write_position(p, s, heading_var, level_var, out)
