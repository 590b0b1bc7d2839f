"""The beginning: when is the heading that the fixes tell (`fix_matching`, `posterior`) known well enough?

And how navigation begins with it, and is given up again.
"""

import math
from typing import Any

from ....kernels.jit import kernel
from ....kernels.kalman import reset, shear, shear3
from ....kernels.rotation import quat_of_gravity, quat_rotate
from ..aiding.non_holonomic import reset_nhc, rotate_scatter
from ..ekf import gated_update, inject_error, innovation_variance, rotate_tilt_covariance
from ..error_model import add_variance, propagate_covariance, reset_turn_scale, variance
from ..integrity.gnss_drift import reset_drift
from ..mechanization import displace, rotate_attitude
from ..state import (
    ACCEL_BIAS,
    ATTITUDE,
    COARSE_ALIGNMENT,
    GYRO_BIAS,
    NAVIGATING,
    NEVER_NS,
    POSITION,
    STATES,
    TIME_OFFSET,
    VELOCITY,
)
from .heading_posterior import set_prior, solve_heading
from .velocity_pairs import reset_pairs, vertical_bias_jacobian

MAX_START_HEADING = (
    math.radians(10.0),
    math.radians(11.0),
)  # with a receiver that tells its velocity, and without: that cannot wait
HEADING_HORIZON_S = 10.0  # for which the heading has to stay known
MIN_HEADING_SIGMA = math.radians(3.0)
MOVING_TILT = math.radians(1.0)  # of a tilt found while the level frame turned by an unknown angle
LOST_TILT = math.radians(20.0)


@kernel
def rotate_to_north(c: Any, psi: float) -> None:
    """Turn the level frame by psi about down, and what is given in it: tilt errors, velocities in the body."""
    rotate_scatter(c, psi)
    rotate_attitude(c, 0.0, 0.0, psi)
    c.alignment.wander_azimuth -= psi
    rotate_tilt_covariance(c, psi)


@kernel
def find_heading(c: Any, b: Any) -> bool:
    """Turn the level frame to north when the pairs tell how; its sigma goes to c.alignment.heading_sigma."""
    bias_variance = innovation_variance(c, vertical_bias_jacobian(c))
    turned2 = bias_variance * (1e-9 * (c.nav.t_ns - c.alignment.origin_ns)) ** 2
    set_prior(c, b)
    if not accept_heading(c, solve_heading(c, b, bias_variance)):
        return False
    for i in range(2):
        add_variance(c, ATTITUDE + i, MOVING_TILT**2 * min(turned2, 1.0))
    return True


@kernel
def accept_heading(c: Any, found: Any) -> bool:
    """Turn to the heading that `solve` found, if that is good enough to navigate with."""
    psi, sigma, rate, rate_variance, together = found
    ready = MAX_START_HEADING[1] if c.alignment.mean_velocity[2] > 0.0 else MAX_START_HEADING[0]
    if sigma * sigma + rate_variance * HEADING_HORIZON_S**2 > ready**2:
        return False
    n = vertical_bias_jacobian(c)
    news = 1.0 / rate_variance - 1.0 / innovation_variance(
        c, n
    )  # beside what the filter knew, which `solve` has counted in
    if news > 0.0:
        gated_update(c, n, -rate / (rate_variance * news), 1.0 / news, 0.0)
    c.scratch.x[ATTITUDE + 2] = 0.0
    inject_error(c)
    rotate_to_north(c, psi)
    c.alignment.heading_sigma = max(sigma, MIN_HEADING_SIGMA)
    c.alignment.heading_bias_gain = together / rate_variance
    return True


@kernel
def transfer_lever_arm(p: Any, c: Any, sign: float) -> None:
    """From the antenna at the fixes' own time, which is followed while levelling, to the sensor now; back with -1.

    What the fixes' latency is not known by is no error there, as all comes from the same fixes. A place that a user
    gave, and no fix has told yet, is the sensor's all the time.
    """
    if c.gnss.last_used_ns == NEVER_NS:
        return
    arm = quat_rotate(
        (c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3]),
        (p.gnss_lever_arm[0], p.gnss_lever_arm[1], p.gnss_lever_arm[2]),
    )
    arm2 = p.gnss_lever_arm[0] ** 2 + p.gnss_lever_arm[1] ** 2 + p.gnss_lever_arm[2] ** 2
    late2 = variance(c, TIME_OFFSET)
    n, e, d = sign * arm[0], sign * arm[1], sign * arm[2]
    displace(c, -n, -e, -d)
    shear3(c.cov.P, STATES, POSITION, ATTITUDE, 0.0, -d, e)
    shear3(c.cov.P, STATES, POSITION + 1, ATTITUDE, d, 0.0, -n)
    shear3(c.cov.P, STATES, POSITION + 2, ATTITUDE, -e, n, 0.0)
    for i in range(3):
        shear(c.cov.P, STATES, POSITION + i, TIME_OFFSET, sign * c.nav.v_n[i])
        add_variance(c, VELOCITY + i, late2 * c.imu.accel_n[i] ** 2 + arm2 * c.imu.rate_b[i] ** 2)


@kernel
def start_navigation(p: Any, c: Any) -> None:
    """Begin to navigate, at the position and velocity in hand, with the heading in hand and its sigma."""
    propagate_covariance(p, c)
    drifted = c.alignment.heading_bias_gain**2 * innovation_variance(c, vertical_bias_jacobian(c))
    reset(c.cov.P, STATES, ATTITUDE + 2, max(c.alignment.heading_sigma**2 - drifted, MIN_HEADING_SIGMA**2))
    for k in range(vertical_bias_jacobian(c)):
        shear(c.cov.P, STATES, ATTITUDE + 2, c.scratch.columns[k], -c.alignment.heading_bias_gain * c.scratch.values[k])
    c.alignment.heading_bias_gain = 0.0
    if c.alignment.mode == COARSE_ALIGNMENT:
        transfer_lever_arm(p, c, 1.0)
    c.alignment.mode = NAVIGATING
    reset_drift(c)
    reset_pairs(c)


@kernel
def abort_navigation(p: Any, c: Any) -> None:
    """Back to levelling with the heading unknown, and all else as it is."""
    if c.alignment.mode == NAVIGATING:
        transfer_lever_arm(p, c, -1.0)
    c.alignment.mode = COARSE_ALIGNMENT
    c.alignment.heading_sigma = 0.0
    reset(c.cov.P, STATES, ATTITUDE + 2, math.pi**2)
    reset_drift(c)


@kernel
def restart_attitude(p: Any, c: Any) -> None:
    """Back to levelling: nothing is known of roll, pitch and heading."""
    abort_navigation(p, c)
    reset_nhc(c)
    reset_pairs(c)
    q = quat_of_gravity(c.imu.f[0], c.imu.f[1], c.imu.f[2] - 1e-3)
    c.nav.q_nb[0], c.nav.q_nb[1], c.nav.q_nb[2], c.nav.q_nb[3] = q
    for i in range(2):
        reset(c.cov.P, STATES, ATTITUDE + i, LOST_TILT**2)


@kernel
def restart_alignment(p: Any, c: Any) -> None:
    """Back to levelling: the heading was wrong, and what was learned with it."""
    restart_attitude(p, c)
    for i in range(3):
        c.nav.bg[i] = 0.0
        c.nav.ba[i] = 0.0
        c.nav.turn_scale[i] = 0.0
        reset(c.cov.P, STATES, GYRO_BIAS + i, p.gyro_bias_sigma**2)
        reset(c.cov.P, STATES, ACCEL_BIAS + i, p.accel_bias_sigma**2)
    reset_turn_scale(p, c)
