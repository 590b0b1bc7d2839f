"""A new connection to the sensor: after a power-on both biases are reset; the attitude is checked against gravity.

A bias changes from one switch-on to the next by the repeatability in the data sheet, which is the filter's initial
sigma. A sensor that was not connected may have been moved: after a longer gap its attitude is kept only if the first
specific force is vertical, within the tilt that a vehicle's acceleration causes. No sensor measures a rotation
about the vertical meanwhile: the heading's sigma grows with the length of the gap, and with it that of the forward axis
of a land vehicle, whose course is as it was. The heading's has this part until motion has confirmed it. Of a body that
was at rest before the gap, what it shows at rest afterwards decides (see `rest_gap`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ...compile.jit import kernel
from ...math.earth import STANDARD_GRAVITY
from ..tuning import Tunable
from .aiding.contradicted_bias import forget_contradiction
from .alignment.modes import ATTITUDE_LOST, change_mode
from .alignment.velocity_pairs import restart_in_motion_alignment
from .bias_changes import begin_warm_up
from .ekf import add_covariance, add_variance, decorrelate, variance
from .glr_tests.reset import reset_glr_tests
from .glr_tests.velocity_drift import reset_confirmations
from .mechanization import body_to_ned, clear_biases
from .rest_gap import add_turn, begin_rest_gap, vertical_in_ned
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, MOUNT_YAW
from .stationarity import clear_window, interrupt_rest

if TYPE_CHECKING:
    from .types import Core, Parameters

TUNABLES = (
    Tunable(
        "power_on_force_sigma",
        math.radians(3.0),
        "rad",
        "Sigma of the specific force's angle to the vertical, by an acceleration, after a gap.",
        "0.5 m/s^2.",
    ),
    Tunable(
        "reconnect_turn_rate",
        math.radians(3.0),
        "rad/s",
        "Sigma of the rotation of a sensor that was not connected, per second of the gap.",
        "Choice.",
    ),
    Tunable(
        "max_reconnect_turn",
        math.radians(20.0),
        "rad",
        "Largest sigma of the rotation in a gap, of a land vehicle under way: its motion soon shows a larger one.",
        "Choice.",
    ),
    Tunable(
        "power_on_tilt_gate",
        9.0,
        "NIS",
        "Gate of the specific force's angle to the vertical after a gap.",
        "Three sigma.",
    ),
)


@kernel
def reset_biases(p: Parameters, c: Core) -> None:
    """Reset both biases to their switch-on variances, and everything accumulated with the old ones."""
    clear_biases(c)
    for i in range(3):
        decorrelate(c, GYRO_BIAS + i, p.gyro_bias_sigma**2)
        decorrelate(c, ACCEL_BIAS + i, p.accel_bias_sigma**2)
    begin_warm_up(p, c)
    interrupt_rest(c)
    forget_contradiction(c)
    clear_window(c)
    restart_in_motion_alignment(c)
    reset_glr_tests(c)
    reset_confirmations(c)


@kernel
def check_attitude(p: Parameters, c: Core, gap_s: float, new_biases: bool) -> None:
    """Keep the attitude, with more variance, if the specific force is vertical in it; else restart the alignment.

    Under way the force may have as much of an acceleration as the vehicle has shown.
    """
    x, y, z = body_to_ned(c, (c.imu.f[0], c.imu.f[1], c.imu.f[2]))
    tilt = elementary.atan2(elementary.hypot(x, y), -z)
    tilt2, force2 = tilt * tilt, p.tuning.power_on_force_sigma**2
    accelerated2 = 0.0 if c.stationarity.at_rest else c.stationarity.level_accel2 / STANDARD_GRAVITY**2
    if tilt2 > p.tuning.power_on_tilt_gate * (
        variance(c, ATTITUDE) + variance(c, ATTITUDE + 1) + force2 + accelerated2
    ):
        change_mode(p, c, ATTITUDE_LOST)
        return
    for i in range(3):
        add_variance(c, ATTITUDE + i, tilt2 * force2 / (force2 + accelerated2))
    turned2 = (p.tuning.reconnect_turn_rate * gap_s) ** 2
    if c.stationarity.at_rest:
        begin_rest_gap(p, c, turned2, new_biases)
        return
    if c.nhc.enabled:
        turned2 = min(turned2, p.tuning.max_reconnect_turn**2)
        add_variance(c, MOUNT_YAW, turned2)
    add_turn(c, turned2)
    if c.nhc.enabled:
        axis = vertical_in_ned(c)
        for i in range(3):
            add_covariance(c, ATTITUDE + i, MOUNT_YAW, -turned2 * axis[i])
