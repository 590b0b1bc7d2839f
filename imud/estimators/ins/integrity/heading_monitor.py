"""The heading monitor: the in-motion alignment continues during navigation and is compared with the heading.

A filter whose heading is wrong by much more than its sigma does not converge: it explains the velocity changes of the
receiver by tilt and biases. The alignment estimates the heading with wide priors of tilt and accelerometer bias, so
that the filter's P of these cannot make both wrong together.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..aiding.external_pose import distrust_poses
from ..aiding.gnss_velocity import low_speed_variance, velocity_of
from ..aiding.heading import distrust_compass
from ..aiding.non_holonomic import reset_nhc
from ..alignment.heading_acceptance import accept_heading, rotate_to_heading
from ..alignment.heading_posterior import set_wide_prior, solve_heading
from ..alignment.modes import HEADING_KNOWN, change_mode
from ..alignment.velocity_pairs import count_heading_fault, match_pair, vertical_bias_jacobian
from ..ekf import add_variance, decorrelate, innovation_variance, variance
from ..error_model import reset_gyro_scale
from ..glr_tests.compass_offset import is_measured
from ..state import ACCEL_BIAS, ATTITUDE, GYRO_BIAS

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import Core, HypothesisBank, Parameters


TUNABLES = (
    Tunable("heading_fault_angle", math.radians(10.0), "rad", "Smallest heading error that is a fault.", "Choice."),
    Tunable(
        "heading_fault_gate",
        16.0,
        "NIS",
        "Gate of the difference between the heading and that of the alignment.",
        "Four sigma.",
    ),
    Tunable(
        "heading_faults",
        3,
        "pairs",
        "Number of contradicting pairs of fixes in a row that prove a wrong heading.",
        "Choice.",
    ),
    Tunable(
        "heading_inflation",
        math.radians(20.0),
        "rad",
        "Sigma added to a contradicted heading where the alignment has no better one.",
        "Choice.",
    ),
    Tunable(
        "realigned_tilt",
        math.radians(1.0),
        "rad",
        "Sigma of the tilt error that was learned with a wrong heading.",
        "Choice.",
    ),
    Tunable(
        "max_heading_sigma",
        math.radians(14.0),
        "rad",
        "Heading sigma from which the alignment's heading is taken; after damaged readings it is found anew.",
        "Choice.",
    ),
)


@kernel
def monitor_heading(p: Parameters, c: Core, b: HypothesisBank, fix: Fix) -> bool:
    """After a fix, compare the heading with that of the alignment, and correct or inflate it if it is contradicted.

    False: it is wrong, and was learned with a compass or a pose that is: it has to be found anew.
    """
    before = b.weight
    match_pair(p, c, b, fix.lat, fix.lon, velocity_of(p, fix, 0), velocity_of(p, fix, 1), low_speed_variance(p, fix))
    if b.weight == before:
        return True
    bias = innovation_variance(c, vertical_bias_jacobian(c))
    set_wide_prior(p, c, b.prior, p.accel_bias_sigma)
    found = solve_heading(p, c, b, bias)
    psi, sigma = found[0], found[1]
    known = variance(c, ATTITUDE + 2)
    wrong = abs(psi) > p.tuning.heading_fault_angle and psi * psi > p.tuning.heading_fault_gate * (
        sigma * sigma + known
    )
    count_heading_fault(c, wrong)
    if c.alignment.heading_fault_count >= p.tuning.heading_faults:
        if is_measured(c):
            return False
        distrust_compass(p, c)
        distrust_poses(c)
        if sigma < p.tuning.max_start_heading:
            rotate_to_heading(p, c, psi, sigma)
            realign(p, c)
        else:
            inflate_heading(p, c)
    elif known > p.tuning.max_heading_sigma**2 and accept_heading(p, c, found):
        realign(p, c)
    return True


@kernel
def inflate_heading(p: Parameters, c: Core) -> None:
    """The heading is contradicted, but no better one is known: inflate its variance, and let the next fixes decide.

    They confirm a right heading within seconds; a wrong one is contradicted again, until its sigma is too large.
    """
    add_variance(c, ATTITUDE + 2, p.tuning.heading_inflation**2)
    count_heading_fault(c, False)


@kernel
def realign(p: Parameters, c: Core) -> None:
    """Reset the states learned with the wrong heading, and continue with the new heading."""
    reset_nhc(p, c)
    for i in range(2):
        add_variance(c, ATTITUDE + i, p.tuning.realigned_tilt**2)
    for i in range(3):
        decorrelate(c, ACCEL_BIAS + i, p.accel_bias_sigma**2)
        if c.alignment.heading_bias_gain == 0.0:
            decorrelate(c, GYRO_BIAS + i, p.gyro_bias_sigma**2)
    reset_gyro_scale(p, c)
    change_mode(p, c, HEADING_KNOWN)
