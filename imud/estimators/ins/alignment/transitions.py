"""Transitions between coarse alignment and navigation: accept a heading, start navigation, go back to alignment."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ....compile.jit import kernel
from ....math.rotation import quat_of_gravity
from ...tuning import Tunable
from ..aiding.non_holonomic import reset_nhc, rotate_scatter
from ..ekf import (
    add_variance,
    cancel_correction,
    combine,
    combine3,
    decorrelate,
    innovation_variance,
    rotate_tilt_covariance,
    variance,
)
from ..error_model import reset_turn_scale
from ..fusion import correct_state, gated_update, propagate_errors
from ..lever_arm import antenna_position, antenna_velocity, attitude_row, gyro_bias_row
from ..mechanization import clear_sensor_errors, displace, rotate_attitude, set_attitude, set_velocity
from ..observers.gnss_drift import reset_drift
from ..observers.heading_integrals import rotate_level_frame
from ..observers.process_noise import clear_learning
from ..state import (
    ACCEL_BIAS,
    ATTITUDE,
    COARSE_ALIGNMENT,
    GYRO_BIAS,
    NAVIGATING,
    NEVER_NS,
    POSITION,
    TIME_OFFSET,
    VELOCITY,
)
from .heading_posterior import set_prior, solve_heading
from .velocity_pairs import reset_pairs, vertical_bias_jacobian

if TYPE_CHECKING:
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable(
        "max_start_heading_positions",
        math.radians(11.0),
        "rad",
        "Heading sigma to start with, without a receiver's velocity.",
        "Simulated and recorded starts.",
    ),
    Tunable(
        "max_start_heading",
        math.radians(10.0),
        "rad",
        "Heading sigma to start navigation with.",
        "Simulated and recorded starts.",
    ),
    Tunable("heading_horizon_s", 10.0, "s", "Time for which the heading has to stay known.", "Choice."),
    Tunable(
        "min_heading_sigma",
        math.radians(3.0),
        "rad",
        "Smallest heading sigma to start with.",
        "Linearization errors of alignment.",
    ),
    Tunable(
        "moving_tilt",
        math.radians(1.0),
        "rad",
        "Tilt error found while the level frame turned by an unknown angle.",
        "Choice.",
    ),
    Tunable(
        "lost_tilt", math.radians(20.0), "rad", "Tilt sigma from which the alignment starts again.", "Linearization."
    ),
)


@kernel
def rotate_to_north(c: Core, psi: float) -> None:
    """Rotate the level frame by psi (rad, about down), with the tilt errors and the velocity scatter given in it."""
    rotate_scatter(c, psi)
    rotate_attitude(c, 0.0, 0.0, psi)
    rotate_level_frame(c, psi)
    rotate_tilt_covariance(c, psi)


@kernel
def find_heading(p: Parameters, c: Core, b: HypothesisBank) -> bool:
    """Rotate the level frame to north if its heading is known well enough; its sigma: alignment.heading_sigma."""
    bias_variance = innovation_variance(c, vertical_bias_jacobian(c))
    rotation2 = bias_variance * (1e-9 * (c.nav.t_ns - c.alignment.origin_ns)) ** 2
    set_prior(c, b)
    if not accept_heading(p, c, solve_heading(p, c, b, bias_variance)):
        return False
    for i in range(2):
        add_variance(c, ATTITUDE + i, p.tuning.moving_tilt**2 * min(rotation2, 1.0))
    return True


@kernel
def accept_heading(p: Parameters, c: Core, found: Any) -> bool:
    """Rotate to the heading that `solve_heading` found, if its sigma is small enough; fuse its drift rate, too."""
    psi, sigma, rate, rate_variance, covariance = found
    ready = p.tuning.max_start_heading_positions if c.alignment.mean_velocity[2] > 0.0 else p.tuning.max_start_heading
    if sigma * sigma + rate_variance * p.tuning.heading_horizon_s**2 > ready**2:
        return False
    n = vertical_bias_jacobian(c)
    # the posterior contains the filter's own variance as its prior: only the information beyond it is fused
    information = 1.0 / rate_variance - 1.0 / innovation_variance(c, n)
    if information > 0.0:
        gated_update(c, n, -rate / (rate_variance * information), 1.0 / information, 0.0)
    cancel_correction(c, ATTITUDE + 2)
    correct_state(p, c)
    rotate_to_north(c, psi)
    c.alignment.heading_sigma = max(sigma, p.tuning.min_heading_sigma)
    c.alignment.heading_bias_gain = covariance / rate_variance
    return True


@kernel
def transfer_lever_arm(p: Parameters, c: Core, sign: float) -> None:
    """Move position and velocity from the antenna at the epoch of the fixes to the IMU now (sign 1), or back (-1).

    During coarse alignment they are the antenna's and the time offset is no error of it, because all of it comes
    from fixes. A position given by the user, before any fix, is that of the IMU.
    """
    if c.gnss.last_used_ns == NEVER_NS:
        return
    arm, antenna, late2 = antenna_position(p, c), antenna_velocity(p, c), variance(c, TIME_OFFSET)
    displace(c, -sign * arm[0], -sign * arm[1], -sign * arm[2])
    for i in range(3):
        of_imu = c.nav.v_n[i] - (antenna[i] if sign > 0.0 else 0.0)
        set_velocity(c, i, c.nav.v_n[i] - sign * antenna[i])
        row = attitude_row(arm, i)
        combine3(c, POSITION + i, ATTITUDE, -sign * row[0], -sign * row[1], -sign * row[2])
        row = attitude_row(antenna, i)
        combine3(c, VELOCITY + i, ATTITUDE, -sign * row[0], -sign * row[1], -sign * row[2])
        row = gyro_bias_row(p, c, i)
        combine3(c, VELOCITY + i, GYRO_BIAS, -sign * row[0], -sign * row[1], -sign * row[2])
        combine(c, POSITION + i, TIME_OFFSET, sign * of_imu)
        add_variance(c, VELOCITY + i, late2 * c.imu.accel_n[i] ** 2)


@kernel
def start_navigation(p: Parameters, c: Core) -> None:
    """Start navigation with the present position, velocity and heading, and the sigma alignment.heading_sigma.

    An error of the vertical gyro bias has turned the heading by heading_bias_gain times itself: the two are correlated.
    """
    propagate_errors(p, c)
    bias_part = c.alignment.heading_bias_gain**2 * innovation_variance(c, vertical_bias_jacobian(c))
    decorrelate(c, ATTITUDE + 2, max(c.alignment.heading_sigma**2 - bias_part, p.tuning.min_heading_sigma**2))
    for k in range(vertical_bias_jacobian(c)):
        combine(c, ATTITUDE + 2, c.scratch.columns[k], -c.alignment.heading_bias_gain * c.scratch.values[k])
    c.alignment.heading_bias_gain = 0.0
    if c.alignment.mode == COARSE_ALIGNMENT:
        transfer_lever_arm(p, c, 1.0)
    c.alignment.mode = NAVIGATING
    clear_learning(c)
    reset_drift(c)
    reset_pairs(c)


@kernel
def rotate_to_heading(p: Parameters, c: Core, psi: float, sigma: float) -> None:
    """Rotate by psi (rad) to a given heading; its sigma is at least min_heading_sigma."""
    c.alignment.heading_sigma = max(sigma, p.tuning.min_heading_sigma)
    rotate_to_north(c, psi)


@kernel
def abort_navigation(p: Parameters, c: Core) -> None:
    """Go back to coarse alignment: the heading is unknown, everything else is kept."""
    if c.alignment.mode == NAVIGATING:
        transfer_lever_arm(p, c, -1.0)
    c.alignment.mode = COARSE_ALIGNMENT
    c.alignment.heading_sigma = 0.0
    decorrelate(c, ATTITUDE + 2, math.pi**2)
    reset_drift(c)


@kernel
def restart_attitude(p: Parameters, c: Core) -> None:
    """Go back to coarse alignment: roll, pitch and heading are unknown."""
    abort_navigation(p, c)
    reset_nhc(c)
    reset_pairs(c)
    set_attitude(c, quat_of_gravity(c.imu.f[0], c.imu.f[1], c.imu.f[2] - 1e-3))
    for i in range(2):
        decorrelate(c, ATTITUDE + i, p.tuning.lost_tilt**2)


@kernel
def restart_alignment(p: Parameters, c: Core) -> None:
    """Go back to coarse alignment: the heading was wrong, so attitude, biases and turn_scale are cleared."""
    restart_attitude(p, c)
    clear_sensor_errors(c)
    for i in range(3):
        decorrelate(c, GYRO_BIAS + i, p.gyro_bias_sigma**2)
        decorrelate(c, ACCEL_BIAS + i, p.accel_bias_sigma**2)
    reset_turn_scale(p, c)
