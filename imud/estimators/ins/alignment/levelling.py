"""Roll and pitch from the specific force, while the heading is unknown: at rest it is gravity, in motion nearly so.

Both are one measurement of a mean specific force, with the sigma of rest, of the acceleration that the receiver saw, or
of any vehicle; the gyro, whose bias is estimated at the same time, carries the attitude between.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ....compile.jit import kernel
from ....math.earth import gravity
from ...tuning import Tunable
from ..ekf import innovation_variance, set_jacobian
from ..fusion import correct_state, gated_update
from ..mechanization import ned_to_body, rotation_matrix
from ..state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("level_rest_sigma", 0.02, "m/s^2", "Sigma of the mean force at rest against gravity.", "Choice."),
    Tunable(
        "level_gnss_sigma", 0.3, "m/s^2", "Acceleration that a receiver's velocity does not show.", "Recorded drives."
    ),
    Tunable(
        "level_pair_age_s", 3.0, "s", "Age up to which pairs of fixes level the frame instead of windows.", "Choice."
    ),
    Tunable(
        "level_vertical_sigma",
        0.03,
        "m/s^2",
        "Floor of what the vertical force tells of the bias.",
        "Gravity times half the square of a tilt.",
    ),
    Tunable(
        "level_motion_sigma",
        1.5,
        "m/s^2",
        "Sigma of the mean force in motion; accelerations last several windows.",
        "Recorded drives.",
    ),
    Tunable("level_turn_speed", 20.0, "m/s", "Speed assumed for the centripetal force of a turn.", "Choice."),
)


@kernel
def tilt_jacobian(c: Core, k: int, m: Any, axis: int, gain: float, ago: float) -> int:
    """Row of the tilt about `axis` as it was `ago` s before now: the error of the gyro bias has turned it since."""
    for j in range(3):
        k = set_jacobian(c, k, GYRO_BIAS + j, gain * ago * m[3 * axis + j])
    return set_jacobian(c, k, ATTITUDE + axis, gain)


@kernel
def fuse_gravity(p: Parameters, c: Core, fx: float, fy: float, fz: float, ago: float, sigma: float, axes: int) -> None:
    """Fuse a mean specific force (level axes), which is -gravity but for accelerations of `sigma`, on `axes` axes.

    It is the mean about a time `ago` s in the past: the attitude error was another then, by the gyro bias.
    """
    m = rotation_matrix(c)
    for i in range(axes):
        # C f + phi x C f - C ba = (0, 0, -g); heading error has no part in it
        k = set_jacobian(c, 0, ACCEL_BIAS, -m[3 * i])
        k = set_jacobian(c, k, ACCEL_BIAS + 1, -m[3 * i + 1])
        k = set_jacobian(c, k, ACCEL_BIAS + 2, -m[3 * i + 2])
        if i == 0:
            k = tilt_jacobian(c, k, m, 1, fz, ago)
            z = -fx
        elif i == 1:
            k = tilt_jacobian(c, k, m, 0, -fz, ago)
            z = -fy
        else:
            k = set_jacobian(c, k, ATTITUDE, fy)
            k = set_jacobian(c, k, ATTITUDE + 1, -fx)
            z = -gravity(c.nav.lat, c.nav.height) - fz
            if innovation_variance(c, k) < p.tuning.level_vertical_sigma**2:
                continue
        gated_update(c, k, z, sigma * sigma, 0.0)
    correct_state(p, c)


@kernel
def level_from_window(p: Parameters, c: Core, resting: bool) -> None:
    """Fuse the mean specific force of a window (call at its end, before it is cleared)."""
    if (
        resting or 1e-9 * (c.nav.t_ns - c.alignment.pair_start_ns) > p.tuning.level_pair_age_s
    ):  # else the receiver's velocity tells more: level_between
        sigma = p.tuning.level_rest_sigma
        if not resting:
            down = ned_to_body(c, (0.0, 0.0, 1.0))
            turn = down[0] * c.imu.rate_b[0] + down[1] * c.imu.rate_b[1] + down[2] * c.imu.rate_b[2]
            sigma = math.hypot(p.tuning.level_motion_sigma, p.tuning.level_turn_speed * turn)
        fuse_gravity(
            p,
            c,
            c.stationarity.delta_v[0] / c.stationarity.duration,
            c.stationarity.delta_v[1] / c.stationarity.duration,
            c.stationarity.delta_v[2] / c.stationarity.duration,
            0.5 * c.stationarity.duration,
            sigma,
            3,
        )


@kernel
def level_from_velocity_change(p: Parameters, c: Core, an: float, ae: float, dt: float, pull: float) -> None:
    """Fuse the mean level specific force of the last `dt` s, which the receiver saw accelerate by `pull` m/s^2."""
    if not c.stationarity.at_rest:
        fuse_gravity(p, c, an, ae, -gravity(c.nav.lat, c.nav.height), 0.5 * dt, pull + p.tuning.level_gnss_sigma, 2)
