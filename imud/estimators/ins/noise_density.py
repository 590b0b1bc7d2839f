"""Process noise Q: the densities of what is added to the variances of velocity and attitude, and why.

| of | beside the sensor's own noise |
|---|---|
| velocity | vibration, learned and measured; scale factors times the acceleration; second-order terms of the heading |
| attitude | vibration, learned and measured; what is left of scale factors times the rate |

In coarse alignment the heading is unknown, so the acceleration is not integrated: its square, times a correlation time,
is the noise of the velocity. The part of vibration is learned (`process_noise`). Densities of the other states are
constants in `error_model` and in the files of the aiding sources that they belong to.

Source: Groves (2013), sec. 14.2.6.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.earth import STANDARD_GRAVITY
from ..tuning import Tunable
from .ekf import variance
from .state import ATTITUDE, ATTITUDE_NOISE, COARSE_ALIGNMENT, VELOCITY_NOISE

if TYPE_CHECKING:
    from .types import Core, Parameters


TUNABLES = (
    Tunable(
        "accel_scale_time_s", 0.2, "s", "How long an accelerometer's scale error acts in one direction.", "Choice."
    ),
    Tunable("gyro_scale_time_s", 0.05, "s", "How long a gyro's scale error acts in one direction.", "Choice."),
    Tunable("second_order_time_s", 1.0, "s", "Correlation time of the errors of the linear model.", "Choice."),
    Tunable(
        "nonlinear_scale_share",
        0.5,
        "",
        "Share of a gyro's error in turns that constant factors do not explain.",
        "Recorded drives.",
        high=1.0,
    ),
    Tunable(
        "alignment_accel",
        0.3,
        "m/s^2",
        "Acceleration that is not measured while the heading is unknown.",
        "Recorded drives.",
    ),
    Tunable(
        "alignment_accel_time_s",
        1.0,
        "s",
        "Correlation time of the acceleration that is not measured while the heading is unknown.",
        "1 Hz receivers.",
    ),
)


@kernel
def second_order_psd(p: Parameters, c: Core, accel2: float) -> float:
    """Velocity noise, m^2/s^3, for second-order effects of an uncertain heading; accel2: squared acceleration.

    A heading error reduces the acceleration by half its square, and rotates the acceleration that a tilt error causes.
    """
    heading2 = variance(c, ATTITUDE + 2)
    tilt2 = 0.5 * (variance(c, ATTITUDE) + variance(c, ATTITUDE + 1))
    return float((0.5 * heading2 * accel2 + STANDARD_GRAVITY**2 * tilt2) * heading2 * p.tuning.second_order_time_s)


@kernel
def accelerometer_psd(p: Parameters, c: Core) -> float:
    """White noise of the accelerometers, m^2/s^3: the sensor's and that of vibration."""
    learned = c.process_noise.psd[VELOCITY_NOISE] * c.stationarity.vibration_level
    return float(p.accel_psd + learned + c.stationarity.vibration_accel_psd)


@kernel
def velocity_psd(p: Parameters, c: Core) -> float:
    """Q of the velocity, m^2/s^3: sensor noise, vibration, scale factors, and second-order effects of the heading."""
    a = c.imu.accel_n
    accel2 = a[0] ** 2 + a[1] ** 2 + a[2] ** 2
    if c.alignment.mode == COARSE_ALIGNMENT:
        return (
            (p.tuning.alignment_accel**2 + accel2) * p.tuning.alignment_accel_time_s
            if not c.stationarity.at_rest
            else 0.0
        )
    q = accelerometer_psd(p, c) + p.accel_scale**2 * accel2 * p.tuning.accel_scale_time_s
    return float(q + second_order_psd(p, c, accel2))


@kernel
def attitude_psd(p: Parameters, c: Core, turn_rate: float) -> float:
    """Q of the attitude, rad^2/s, at a smoothed `turn_rate`, rad/s, about the vertical."""
    w = c.imu.rate_b
    rate2 = w[0] ** 2 + w[1] ** 2 + w[2] ** 2 - (1.0 - p.tuning.nonlinear_scale_share) * turn_rate * turn_rate
    floor = c.stationarity.gyro_noise_floor
    gyro_psd = max(p.gyro_psd, floor * floor * p.period / 3.0)  # the smallest deviation is that of noise
    return float(
        gyro_psd
        + c.process_noise.psd[ATTITUDE_NOISE] * c.stationarity.attitude_noise_level  # learned
        + c.stationarity.vibration_gyro_psd
        + p.gyro_scale**2 * rate2 * p.tuning.gyro_scale_time_s
    )
