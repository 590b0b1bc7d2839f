"""What a power-on of the sensor leaves of an estimate: all but the biases, if the sensor is still mounted as before.

A sensor's bias changes from one switch-on to the next by the repeatability in its data sheet, which is the standard
deviation with which the filter starts. And who unplugs a sensor may move it: after more than a moment its attitude is
kept only if the first specific force is along the vertical, up to what a vehicle's acceleration may turn it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ..tuning import Tunable
from .alignment.transitions import restart_attitude
from .alignment.velocity_pairs import reset_pairs
from .ekf import add_variance, decorrelate, variance
from .mechanization import body_to_ned, clear_biases
from .observers.gnss_drift import reset_drift
from .state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS
from .stationarity import clear_window, interrupt_rest

if TYPE_CHECKING:
    from .types import Core, Parameters

TUNABLES = (
    Tunable(
        "power_on_force_sigma",
        math.radians(3.0),
        "rad",
        "Tilt of the specific force at a power-on, by an acceleration.",
        "0.5 m/s^2.",
    ),
    Tunable(
        "power_on_heading_sigma",
        math.radians(3.0),
        "rad",
        "Turn of a sensor that may have been moved, but was not tilted.",
        "Choice.",
    ),
    Tunable("power_on_tilt_gate", 9.0, "NIS", "Gate of the tilt at a power-on.", "Three sigma."),
)


@kernel
def reopen_biases(p: Parameters, c: Core) -> None:
    """Put both biases back to what is known of them at switch-on; what was gathered with the old ones is dropped."""
    clear_biases(c)
    for i in range(3):
        decorrelate(c, GYRO_BIAS + i, p.gyro_bias_sigma**2)
        decorrelate(c, ACCEL_BIAS + i, p.accel_bias_sigma**2)
    interrupt_rest(c)
    clear_window(c)
    reset_pairs(c)
    reset_drift(c)


@kernel
def check_tilt(p: Parameters, c: Core) -> None:
    """Keep the attitude, a little less sure, if the specific force is about vertical in it; else find it anew."""
    x, y, z = body_to_ned(c, (c.imu.f[0], c.imu.f[1], c.imu.f[2]))
    tilt = math.atan2(math.hypot(x, y), -z)
    tilt2 = tilt * tilt
    if tilt2 > p.tuning.power_on_tilt_gate * (
        variance(c, ATTITUDE) + variance(c, ATTITUDE + 1) + p.tuning.power_on_force_sigma**2
    ):
        restart_attitude(p, c)
        return
    for i in range(3):
        add_variance(c, ATTITUDE + i, tilt2)
    add_variance(c, ATTITUDE + 2, p.tuning.power_on_heading_sigma**2)
