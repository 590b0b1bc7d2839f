"""Left and right wheel of an axle: their mean is a speed, their difference a yaw rate, and a slip of one of them shows.

z = (left - right) / ((1 + scale) b) - u_z' (w - b_g), with b the track width and u_z the vehicle's vertical axis: right
turns are positive. A measurement has value[0]: their mean, and value[1]: left less right, m/s, both signed or not.

What lasts: wheels of unequal radius seem to turn in proportion to the speed, and the track width is wrong by some
percent. Such an error is taken to last for good, so that many readings know little more of the gyro's bias than one.
*Slip.* Where the difference contradicts the gyro, one wheel slips: the speed is then that of the wheel which agrees
better with the estimate, and is gated as always.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ....math.rotation import Vector, dot
from ...records import DIFFERENCE_VALUE, SPEED_VALUE, WHEEL_YAW_RATE
from ...tuning import Tunable
from ..ekf import set_jacobian, set_jacobian3
from ..fusion import correlated_update, write_innovation
from ..state import GYRO_BIAS, MOUNT_PITCH, ODOMETER_SCALE, OTHER_AXIS
from ..vehicle_axes import forward_axis, vertical_axis
from .external_aid import others_of_error

if TYPE_CHECKING:
    from ...types import Innovation, Measurement
    from ..types import Core, Parameters

TUNABLES = (
    Tunable(
        "track_width_error", 0.02, "", "Sigma of the track width, as a share of it.", "Where a tyre touches the road."
    ),
    Tunable(
        "wheel_radius_difference",
        0.005,
        "",
        "Sigma of the difference between the radii of the two wheels, as a share.",
        "Pressure and wear: 2 mm.",
    ),
    Tunable(
        "wheel_difference_s",
        3600.0,
        "s",
        "Correlation time of the errors of track width and radii.",
        "For good; loads change.",
    ),
    Tunable(
        "wheel_rate_sigma",
        0.02,
        "rad/s",
        "Sigma of the white error of the yaw rate by two wheels.",
        "Vibration; turns begin within 30 ms.",
    ),
)


@kernel
def tells_yaw_rate(p: Parameters, c: Core, m: Measurement) -> bool:
    """Whether a reading is of two wheels whose distance, and whose direction of motion, is known."""
    return bool(math.isfinite(m.value[DIFFERENCE_VALUE]) and p.track_width > 0.0 and c.odometer.direction != 0.0)


@kernel
def least_of_both(z: float, contradiction: float) -> float:
    """Of the innovations of the mean, z, and of either wheel, m/s, the one nearest to zero: the other wheel slips."""
    left, right = z + 0.5 * contradiction, z - 0.5 * contradiction
    nearer = z if abs(z) <= abs(left) else left
    return nearer if abs(nearer) <= abs(right) else right


@kernel
def fuse_yaw_rate(
    p: Parameters, c: Core, m: Measurement, w: Vector, noise: Vector, dt: float, innovations: list[Innovation]
) -> float:
    """Gate and fuse the difference of two wheels, and write its innovation; a sign of the speed must be known.

    w: rate of the body, rad/s. noise: variance of a single speed, (m/s)^2, that part of it which slip makes, and how
    many others share slip. dt: time since the last reading, s. Returns the contradiction as a difference of speed, m/s;
    0: there is none.
    """
    base = p.track_width * (1.0 + c.nav.odometer_scale)
    u = vertical_axis(c)
    rate = dot(u, w)
    measured, speed = c.odometer.direction * m.value[DIFFERENCE_VALUE] / base, m.value[SPEED_VALUE]
    z = measured - rate
    lasting = (p.tuning.track_width_error * rate) ** 2 + (p.tuning.wheel_radius_difference * speed / base) ** 2
    r = 2.0 * noise[0] / base**2 + p.gyro_psd / p.period + p.tuning.wheel_rate_sigma**2 + lasting
    others = others_of_error(dt, p.tuning.wheel_difference_s)
    shared = others * lasting + noise[2] * 2.0 * noise[1] / base**2
    length = set_jacobian3(c, 0, GYRO_BIAS, (-u[0], -u[1], -u[2]))
    length = set_jacobian(c, length, ODOMETER_SCALE, measured / (1.0 + c.nav.odometer_scale))
    length = set_jacobian(c, length, MOUNT_PITCH, dot(forward_axis(c), w))  # e_z <- e_z + pitch e_x
    z, s, nis = correlated_update(c, length, z, r, shared, p.tuning.odometer_gate, OTHER_AXIS)
    write_innovation(innovations, 0, m.t_ns, WHEEL_YAW_RATE, z, s, nis >= 0.0)
    return 0.0 if nis >= 0.0 else z * base
