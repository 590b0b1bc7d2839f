"""The beginning: when is the heading that the fixes tell (`fix_matching`, `posterior`) known well enough?

And how navigation begins with it, and is given up again.
"""

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
from ..mechanization import body_to_ned, clear_sensor_errors, displace, rotate_attitude, set_attitude
from ..observers.gnss_drift import reset_drift
from ..observers.heading_integrals import rotate_level_frame
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
        "lost_tilt", math.radians(20.0), "rad", "Tilt sigma beyond which the attitude is found anew.", "Linearization."
    ),
)


@kernel
def rotate_to_north(c: Core, psi: float) -> None:
    """Turn the level frame by psi about down, and what is given in it: tilt errors, velocities in the body."""
    rotate_scatter(c, psi)
    rotate_attitude(c, 0.0, 0.0, psi)
    rotate_level_frame(c, psi)
    rotate_tilt_covariance(c, psi)


@kernel
def find_heading(p: Parameters, c: Core, b: HypothesisBank) -> bool:
    """Turn the level frame to north when the pairs tell how; its sigma goes to c.alignment.heading_sigma."""
    bias_variance = innovation_variance(c, vertical_bias_jacobian(c))
    turned2 = bias_variance * (1e-9 * (c.nav.t_ns - c.alignment.origin_ns)) ** 2
    set_prior(c, b)
    if not accept_heading(p, c, solve_heading(p, c, b, bias_variance)):
        return False
    for i in range(2):
        add_variance(c, ATTITUDE + i, p.tuning.moving_tilt**2 * min(turned2, 1.0))
    return True


@kernel
def accept_heading(p: Parameters, c: Core, found: Any) -> bool:
    """Turn to the heading that `solve` found, if that is good enough to navigate with."""
    psi, sigma, rate, rate_variance, together = found
    ready = p.tuning.max_start_heading_positions if c.alignment.mean_velocity[2] > 0.0 else p.tuning.max_start_heading
    if sigma * sigma + rate_variance * p.tuning.heading_horizon_s**2 > ready**2:
        return False
    n = vertical_bias_jacobian(c)
    # beside what the filter knew, which the solution has counted in
    news = 1.0 / rate_variance - 1.0 / innovation_variance(c, n)
    if news > 0.0:
        gated_update(c, n, -rate / (rate_variance * news), 1.0 / news, 0.0)
    cancel_correction(c, ATTITUDE + 2)
    correct_state(p, c)
    rotate_to_north(c, psi)
    c.alignment.heading_sigma = max(sigma, p.tuning.min_heading_sigma)
    c.alignment.heading_bias_gain = together / rate_variance
    return True


@kernel
def transfer_lever_arm(p: Parameters, c: Core, sign: float) -> None:
    """From the antenna at the fixes' own time, which is followed while levelling, to the sensor now; back with -1.

    What the fixes' latency is not known by is no error there, as all comes from the same fixes. A place that a user
    gave, and no fix has told yet, is the sensor's all the time.
    """
    if c.gnss.last_used_ns == NEVER_NS:
        return
    body = p.gnss_lever_arm
    arm = body_to_ned(c, (body[0], body[1], body[2]))
    arm2 = body[0] ** 2 + body[1] ** 2 + body[2] ** 2
    late2 = variance(c, TIME_OFFSET)
    n, e, d = sign * arm[0], sign * arm[1], sign * arm[2]
    displace(c, -n, -e, -d)
    combine3(c, POSITION, ATTITUDE, 0.0, -d, e)
    combine3(c, POSITION + 1, ATTITUDE, d, 0.0, -n)
    combine3(c, POSITION + 2, ATTITUDE, -e, n, 0.0)
    for i in range(3):
        combine(c, POSITION + i, TIME_OFFSET, sign * c.nav.v_n[i])
        add_variance(c, VELOCITY + i, late2 * c.imu.accel_n[i] ** 2 + arm2 * c.imu.rate_b[i] ** 2)


@kernel
def start_navigation(p: Parameters, c: Core) -> None:
    """Begin to navigate, at the position and velocity in hand, with the heading in hand and its sigma."""
    propagate_errors(p, c)
    drifted = c.alignment.heading_bias_gain**2 * innovation_variance(c, vertical_bias_jacobian(c))
    decorrelate(c, ATTITUDE + 2, max(c.alignment.heading_sigma**2 - drifted, p.tuning.min_heading_sigma**2))
    for k in range(vertical_bias_jacobian(c)):
        combine(c, ATTITUDE + 2, c.scratch.columns[k], -c.alignment.heading_bias_gain * c.scratch.values[k])
    c.alignment.heading_bias_gain = 0.0
    if c.alignment.mode == COARSE_ALIGNMENT:
        transfer_lever_arm(p, c, 1.0)
    c.alignment.mode = NAVIGATING
    reset_drift(c)
    reset_pairs(c)


@kernel
def rotate_to_heading(p: Parameters, c: Core, psi: float, sigma: float) -> None:
    """Turn by psi to a heading that something else than pairs tells; its sigma is at least that of a start."""
    c.alignment.heading_sigma = max(sigma, p.tuning.min_heading_sigma)
    rotate_to_north(c, psi)


@kernel
def abort_navigation(p: Parameters, c: Core) -> None:
    """Back to levelling with the heading unknown, and all else as it is."""
    if c.alignment.mode == NAVIGATING:
        transfer_lever_arm(p, c, -1.0)
    c.alignment.mode = COARSE_ALIGNMENT
    c.alignment.heading_sigma = 0.0
    decorrelate(c, ATTITUDE + 2, math.pi**2)
    reset_drift(c)


@kernel
def restart_attitude(p: Parameters, c: Core) -> None:
    """Back to levelling: nothing is known of roll, pitch and heading."""
    abort_navigation(p, c)
    reset_nhc(c)
    reset_pairs(c)
    set_attitude(c, quat_of_gravity(c.imu.f[0], c.imu.f[1], c.imu.f[2] - 1e-3))
    for i in range(2):
        decorrelate(c, ATTITUDE + i, p.tuning.lost_tilt**2)


@kernel
def restart_alignment(p: Parameters, c: Core) -> None:
    """Back to levelling: the heading was wrong, and what was learned with it."""
    restart_attitude(p, c)
    clear_sensor_errors(c)
    for i in range(3):
        decorrelate(c, GYRO_BIAS + i, p.gyro_bias_sigma**2)
        decorrelate(c, ACCEL_BIAS + i, p.accel_bias_sigma**2)
    reset_turn_scale(p, c)
