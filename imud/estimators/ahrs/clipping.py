"""Rates beyond the gyro's range: what was cut off is bridged, and adds noise about that axis alone.

A rate that rises by a slope to the end of the range and falls again by another after the time T has, as a parabola
through both ends, turned by the mean slope times T^2 / 6 more than the gyro shows. That is added when the rate is back
in the range; it is wrong by a part of what the larger slope would make it. A rate that goes on as it was had not been
beyond. While the rate stays at the end, the rotation that may be missing is taken from the first slope; until it is
added all of it is missing: with the time T unknown, uniform on a logarithmic scale, twice the angle that it would be if
the rate came back now. A range that nobody knows yet is noticed after some flat steps: the time began with these, and
the slope is the one before them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers.sample import LIMITED_AXES

from ...compile.jit import kernel
from ...math.rotation import Vector, quat_rotate
from .attitude_step import add_clipping_variance
from .error_model import add_attitude_variance
from .sensor_axes import to_body_axes, to_sensor_axes
from .velocity_hypotheses import add_attitude_noise

if TYPE_CHECKING:
    from .types import Parameters, State


@kernel
def cut_off_angle(slope: float, rate: float, time: float) -> float:
    """Rotation, rad, beyond a range of `rate` rad/s; no more than the gyro shows."""
    return min(slope * time / 6.0, rate) * time


@kernel
def cut_off_variance(p: Parameters, slope: float, rate: float, time: float, dt: float) -> float:
    """Of that rotation, rad^2: it is wrong by a part of itself, and the time is one of whole samples."""
    angle = cut_off_angle(slope, rate, time)
    return p.tuning.clipping_error**2 * angle * angle + (slope * time * dt) ** 2 / 54.0


@kernel
def add_cut_off_variance(p: Parameters, s: State, i: int, variance: float) -> None:
    """The rotation about axis i of the sensor is uncertain by so much more, rad^2."""
    q, axes = s.nav.q_nb, p.sensor_axes
    add_attitude_variance(s, quat_rotate((q[0], q[1], q[2], q[3]), (axes[i], axes[3 + i], axes[6 + i])), variance)
    add_clipping_variance(s, variance)
    add_attitude_noise(s, variance)


@kernel
def least_return_slope(p: Parameters, slope: float, dt: float) -> float:
    """Least slope, rad/s^2, of a rate that comes back into a range that it left with `slope`: more than noise has."""
    return max(
        p.tuning.clipping_return_slope * slope, p.tuning.clipping_return_sigmas * math.sqrt(2.0 * p.gyro_psd / dt) / dt
    )


@kernel
def compensate_clipping(p: Parameters, s: State, w: Vector, dt: float, flags: int) -> Vector:
    """Rates w of the sample with what the samples before lack, and noise for it; by the axes of the sensor."""
    clip = s.clipping
    clip.missing_angle = 0.0
    clip.w[0], clip.w[1], clip.w[2] = to_sensor_axes(p, w)
    clip.last_w[0], clip.last_w[1], clip.last_w[2] = to_sensor_axes(p, (s.imu.w[0], s.imu.w[1], s.imu.w[2]))
    for i in range(3):
        last, rate, time = clip.last_w[i], clip.w[i], clip.time[i]
        slope = abs(rate - last) / dt
        if flags & (LIMITED_AXES << i):
            before = cut_off_variance(p, clip.slope[i], abs(rate), time, dt)
            if time == 0.0:
                clip.slope[i], clip.time[i] = max(slope, clip.last_slope[i]), clip.flat[i]
            clip.time[i] += dt
            after = cut_off_variance(p, clip.slope[i], abs(rate), clip.time[i], dt)
            add_cut_off_variance(p, s, i, after - before)
            clip.missing_angle += 2.0 * cut_off_angle(clip.slope[i], abs(rate), clip.time[i])
        else:
            if time > 0.0 and slope > least_return_slope(p, clip.slope[i], dt):  # else it had not been there
                angle = cut_off_angle(0.5 * (clip.slope[i] + slope), abs(last), time)
                clip.w[i] += (angle if last > 0.0 else -angle) / dt
                before = cut_off_variance(p, clip.slope[i], abs(last), time, dt)
                after = cut_off_variance(p, max(clip.slope[i], slope), abs(last), time, dt)
                add_cut_off_variance(p, s, i, after - before)
            clip.time[i] = 0.0
            if abs(rate - last) < p.tuning.flat_step * abs(rate):
                clip.flat[i] += dt
            else:
                clip.flat[i], clip.last_slope[i] = 0.0, max(slope, p.tuning.clipping_slope_kept * clip.last_slope[i])
    return to_body_axes(p, (clip.w[0], clip.w[1], clip.w[2]))
