"""Coarse alignment between fixes: the velocity stays that of the last one, and its variance has what the force shows.

In a level frame of unknown heading the specific force has changed the velocity by dz since the last fix, or rest. The
size of that change is known, its direction is not: a car that brakes to a standstill without a fix is off by all of its
speed. So each level component has at least the variance |dz|^2 / 2. The noise of an acceleration that is never measured
(`noise_density.velocity_psd`) covers what is shorter than its correlation time.

Source: the second moment of a vector of known length and unknown direction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ..ekf import add_variance
from ..state import COARSE_ALIGNMENT, VELOCITY
from .force_integrals import DELTA_V

if TYPE_CHECKING:
    from ..types import Core, Transition


@kernel
def add_velocity_change(c: Core, transition: Transition) -> None:
    """After an interval of the covariance: bring the level velocity's variance to that of its change since a fix."""
    a = c.alignment
    if c.alignment.mode != COARSE_ALIGNMENT:
        return
    z = (a.integrals[DELTA_V, 0], a.integrals[DELTA_V, 1])
    since_ns = max(c.gnss.last_used_ns, a.origin_ns)
    if a.velocity_known_ns != since_ns or c.stationarity.at_rest:
        a.velocity_known_ns, a.added_velocity_variance = since_ns, 0.0
        a.known_integral[0], a.known_integral[1] = z
    added = transition.velocity_psd * transition.interval
    changed2 = (z[0] - a.known_integral[0]) ** 2 + (z[1] - a.known_integral[1]) ** 2
    missing = max(0.0, 0.5 * changed2 - a.added_velocity_variance - added)
    for i in range(2):
        add_variance(c, VELOCITY + i, missing)
    a.added_velocity_variance += added + missing
