"""The boresight of the heading source: a constant angle by which its headings are off, as an error state of its own.

Two antennas, or a compass, are mounted by eye, and a settings file has the angle for which they were meant. A heading
that starts navigation is off by that angle, and so is the yaw; course and accelerations show it later. So the boresight
b is estimated with its covariance with the error states x. P is the covariance of x as without it; beside P are

    C = cov(x, b) and M = var(b):    C <- T C (T: the transition matrix),    M <- M + q dt,

and at a scalar update of Jacobian h, and B = 1 for a heading, else 0, with innovation z of variance s,

    d = P h + C B,    e = h C + M B,    x += d z / s,    b += e z / s,
    P <- P - d d' / s,    C <- C - d e / s,    M <- M - e e / s.

That is the Kalman filter of (x, b). Without a heading source M is 0, and nothing of it is computed. A boresight of more
than some sigmas is no boresight: see `glr_tests.compass_offset`.

Source: Schmidt, Application of state-space methods to navigation problems (1966); Bierman (1977), sec. VIII.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ..tuning import Tunable
from .ekf import add_variance
from .error_model import apply_transition
from .state import ATTITUDE, COMPASS_AXIS, COMPASS_FAULT, NAVIGATING, STATES

if TYPE_CHECKING:
    from .types import Core, Parameters, Transition

TUNABLES = (
    Tunable(
        "unknown_boresight_sigma",
        math.radians(3.0),
        "rad",
        "Sigma of a boresight of which the settings do not say it, or that motion has contradicted.",
        "Choice: mounting by eye.",
    ),
    Tunable(
        "heading_boresight_psd",
        math.radians(0.02) ** 2,
        "rad^2/s",
        "Random walk of that angle, by load, bending and iron.",
        "As mount_psd.",
    ),
)


@kernel
def prior_variance(p: Parameters, c: Core) -> float:
    """Variance of the boresight before it is estimated, rad^2: that of the settings, unless motion contradicted it."""
    sigma = p.heading_boresight_sigma if p.heading_boresight_sigma > 0.0 else p.tuning.unknown_boresight_sigma
    return float(max(sigma * sigma, c.heading_aid.boresight_prior))


@kernel
def begin_boresight(p: Parameters, c: Core) -> None:
    """A heading comes: its boresight is estimated from now on."""
    g = c.heading_aid
    if g.boresight_variance == 0.0:
        g.boresight_variance = g.boresight_prior = prior_variance(p, c)


@kernel
def widen_boresight_prior(p: Parameters, c: Core) -> float:
    """Motion contradicts the boresight that was stated: nothing is known of it. Returns the added variance, rad^2."""
    g = c.heading_aid
    before = g.boresight_prior
    g.boresight_prior = max(before, p.tuning.unknown_boresight_sigma**2)
    return float(g.boresight_prior - before)


@kernel
def forget_boresight(p: Parameters, c: Core) -> None:
    """The headings are not used any more; what they have done to the error states is in P."""
    g = c.heading_aid
    widen_boresight_prior(p, c)
    g.boresight = g.boresight_variance = 0.0
    for i in range(STATES):
        c.cov.boresight[i, 0] = 0.0


@kernel
def share_boresight(c: Core) -> None:
    """The yaw has just been set to a heading: it has the error of the boresight."""
    g = c.heading_aid
    for i in range(STATES):
        c.cov.boresight[i, 0] = 0.0
    c.cov.boresight[ATTITUDE + 2, 0] = -g.boresight_variance
    add_variance(c, ATTITUDE + 2, g.boresight_variance)


@kernel
def widen_boresight(c: Core, v: float, d: float, variance: float) -> None:
    """Add v d, of a headings' offset d of this variance, rad^2; its effect on the states is the fault's."""
    g = c.heading_aid
    g.boresight += v * d
    g.boresight_variance += v * v * variance
    for i in range(STATES):
        c.cov.boresight[i, 0] -= v * variance * c.faults.sensitivity[i, COMPASS_FAULT]


@kernel
def add_boresight_variance(c: Core, variance: float) -> None:
    """While headings are used: the boresight is known less well by this variance, rad^2."""
    g = c.heading_aid
    if g.boresight_variance > 0.0:
        g.boresight_variance += variance


@kernel
def set_opened_variance(c: Core, variance: float) -> None:
    """So much of the headings' deviation, rad^2, P has; none when the heading is anew that of a compass."""
    c.heading_aid.opened_variance = variance


@kernel
def widen_unused_boresight(p: Parameters, c: Core) -> None:
    """No heading has been used, so that nothing is correlated with the boresight: nothing is known of it."""
    c.heading_aid.boresight_variance += widen_boresight_prior(p, c)


@kernel
def propagate_boresight(p: Parameters, c: Core, transition: Transition) -> None:
    """C and M over the interval of a transition."""
    g = c.heading_aid
    if g.boresight_variance > 0.0 and c.alignment.mode == NAVIGATING:
        apply_transition(c.cov.boresight, 1, transition)
        g.boresight_variance += p.tuning.heading_boresight_psd * transition.interval


@kernel
def covariance_with_boresight(c: Core, length: int, axis: int) -> float:
    """e, of the boresight with the innovation; axis: see `fusion.fuse`, the Jacobian has `length` elements."""
    if c.heading_aid.boresight_variance == 0.0:
        return 0.0
    e = c.heading_aid.boresight_variance if axis == COMPASS_AXIS else 0.0
    for k in range(length):
        e += c.scratch.values[k] * c.cov.boresight[c.scratch.columns[k], 0]
    return float(e)


@kernel
def add_boresight(c: Core, length: int) -> float:
    """Add C of a heading to P h in scratch.d; returns what the boresight adds to the heading's variance."""
    g = c.heading_aid
    for i in range(STATES):
        c.scratch.d[i] += c.cov.boresight[i, 0]
    return float(2.0 * covariance_with_boresight(c, length, COMPASS_AXIS) - g.boresight_variance)


@kernel
def update_boresight(c: Core, z: float, s: float, e: float) -> None:
    """b, C and M by an innovation z of variance s; e: see above, d is in scratch.d."""
    g = c.heading_aid
    if g.boresight_variance == 0.0:
        return
    g.boresight += e / s * z
    for i in range(STATES):
        c.cov.boresight[i, 0] -= e / s * c.scratch.d[i]
    g.boresight_variance = max(g.boresight_variance - e * e / s, 1e-12)
