"""Acceptance of a heading that was found in motion or given: the level frame is rotated to north."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..aiding.forward_axis_search import rotate_scatter
from ..ekf import (
    add_correction,
    add_variance,
    cancel_correction,
    innovation_variance,
    rotate_tilt_covariance,
)
from ..fusion import NO_GATE, correct_state, gated_update
from ..mechanization import rotate_attitude, rotation_matrix
from ..state import ATTITUDE, GYRO_BIAS, HYPOTHESES
from .fixed_gravity import widen_along
from .force_integrals import rotate_level_frame
from .heading_posterior import set_prior, solve_heading
from .hypothesis_bank import frame_rate
from .modes import set_heading_accuracy
from .velocity_pairs import restart_in_motion_alignment, vertical_bias_jacobian

if TYPE_CHECKING:
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable(
        "max_start_heading_positions",
        math.radians(11.0),
        "rad",
        "Largest heading sigma to start navigation with, without a receiver's velocity.",
        "Simulated and recorded starts.",
    ),
    Tunable(
        "max_start_heading",
        math.radians(10.0),
        "rad",
        "Largest heading sigma to start navigation with.",
        "Simulated and recorded starts.",
    ),
    Tunable(
        "heading_horizon_s", 10.0, "s", "Time over which the heading must stay known to start navigation.", "Choice."
    ),
    Tunable(
        "moving_tilt",
        math.radians(1.0),
        "rad",
        "Sigma of the tilt found while the level frame rotated by an unknown angle.",
        "Choice.",
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
    """Rotate the level frame to north if its heading is known well enough; its sigma: alignment.heading_sigma.

    Where the vertical gyro bias has been measured beyond all hypotheses since the origin, the bank begins anew.
    """
    if abs(c.alignment.bias_correction) >= frame_rate(p, HYPOTHESES - 1):
        restart_in_motion_alignment(c)
        return False
    bias_variance = innovation_variance(c, vertical_bias_jacobian(c))
    rotation2 = bias_variance * (1e-9 * (c.nav.t_ns - c.alignment.origin_ns)) ** 2
    set_prior(c, b.prior)
    found = solve_heading(p, c, b, bias_variance)
    if not accept_heading(p, c, found):
        if found[3] == 0.0 and found[2] != 0.0:
            shift_frame_rates(p, c, found[2])
        return False
    for i in range(2):
        add_variance(c, ATTITUDE + i, p.tuning.moving_tilt**2 * min(rotation2, 1.0))
    return True


@kernel
def shift_frame_rates(p: Parameters, c: Core, rate: float) -> None:
    """Begin anew with other hypotheses: the likeliest was the outermost, beyond the prediction by `rate` (rad/s).

    Within one step of the prediction the hypotheses need only be newer; else the bias is one of the worst parts'.
    """
    if abs(rate) > p.tuning.frame_rate_step:
        C_nb = rotation_matrix(c)
        for i in range(3):
            add_correction(c, GYRO_BIAS + i, -rate * C_nb[6 + i])
        correct_state(p, c)
        widen_along(p, c, (C_nb[6], C_nb[7], C_nb[8]))
    restart_in_motion_alignment(c)


@kernel
def accept_heading(p: Parameters, c: Core, found: tuple[float, float, float, float, float]) -> bool:
    """Rotate to the heading that `solve_heading` found, if its sigma is small enough; fuse its frame rate, too."""
    psi, sigma, rate, rate_variance, covariance = found
    ready = p.tuning.max_start_heading_positions if c.alignment.mean_velocity_s > 0.0 else p.tuning.max_start_heading
    if sigma * sigma + rate_variance * p.tuning.heading_horizon_s**2 > ready**2:
        return False
    length = vertical_bias_jacobian(c)
    # the posterior contains the filter's own variance as its prior: only the information beyond it is fused
    information = 1.0 / rate_variance - 1.0 / innovation_variance(c, length)
    if information > 0.0:
        gated_update(c, length, -rate / (rate_variance * information), 1.0 / information, NO_GATE)
    cancel_correction(c, ATTITUDE + 2)
    correct_state(p, c)
    rotate_to_north(c, psi)
    set_heading_accuracy(p, c, sigma, covariance / rate_variance)
    return True


@kernel
def rotate_to_heading(p: Parameters, c: Core, psi: float, sigma: float) -> None:
    """Rotate by psi (rad) to a given heading; its sigma is at least min_heading_sigma."""
    set_heading_accuracy(p, c, sigma, 0.0)
    rotate_to_north(c, psi)
