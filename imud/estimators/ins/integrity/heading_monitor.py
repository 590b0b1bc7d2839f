"""Is the heading that is navigated with the right one? The matching that found it goes on, and can say no.

A filter whose heading is wrong by much more than its sigma does not come back by itself: it explains the velocity
changes that it sees by tilt and biases. Here they are matched as in `alignment`, whatever the filter's covariance says.
"""

import math
from typing import Any

from ....compile.jit import kernel
from ..aiding.gnss_velocity import low_speed_variance, velocity_of
from ..aiding.non_holonomic import reset_nhc
from ..alignment.heading_posterior import set_wide_prior, solve_heading
from ..alignment.transitions import accept_fault_heading, accept_heading, start_navigation
from ..alignment.velocity_pairs import count_heading_fault, match_pair, vertical_bias_jacobian
from ..ekf import add_variance, decorrelate, innovation_variance, variance
from ..error_model import reset_turn_scale
from ..state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, HEADING_FAULTS

HEADING_FAULT_RAD = math.radians(10.0)
HEADING_FAULT_GATE = 16.0
REALIGNED_TILT = math.radians(1.0)
MAX_HEADING_SIGMA = math.radians(14.0)  # a heading no better known than that is better found anew


@kernel
def monitor_heading(p: Any, c: Any, b: Any, fix: Any) -> bool:
    """Take a fix at the core's time; False when the heading was wrong and no better one is known."""
    if c.alignment.heading_fault_count >= HEADING_FAULTS:
        return False
    before = b.weight
    match_pair(c, b, fix.lat, fix.lon, velocity_of(fix, 0), velocity_of(fix, 1), low_speed_variance(fix))
    if b.weight == before:
        return True
    bias = innovation_variance(c, vertical_bias_jacobian(c))
    set_wide_prior(c, b, p.accel_bias_sigma)
    found = solve_heading(c, b, bias)
    psi, sigma = found[0], found[1]
    known = variance(c, ATTITUDE + 2)
    wrong = abs(psi) > HEADING_FAULT_RAD and psi * psi > HEADING_FAULT_GATE * (sigma * sigma + known)
    count_heading_fault(c, wrong)
    if c.alignment.heading_fault_count >= HEADING_FAULTS:
        accept_fault_heading(c, psi, sigma)
        realign(p, c)
    elif known > MAX_HEADING_SIGMA**2 and accept_heading(c, found):
        realign(p, c)
    return True


@kernel
def realign(p: Any, c: Any) -> None:
    """Doubt what was learned with the wrong heading, and go on with the new one."""
    reset_nhc(c)
    for i in range(2):
        add_variance(c, ATTITUDE + i, REALIGNED_TILT**2)
    for i in range(3):
        decorrelate(c, ACCEL_BIAS + i, p.accel_bias_sigma**2)
        if c.alignment.heading_bias_gain == 0.0:
            decorrelate(c, GYRO_BIAS + i, p.gyro_bias_sigma**2)
    reset_turn_scale(p, c)
    start_navigation(p, c)
