"""The variance that the solution states beyond P after fixes that contradicted the estimate were used.

Either the estimate or the receiver was wrong. If it was the receiver, whose positions drifted away before the reset,
its drift goes on, and the estimate follows it: the inflation of the velocity adds to that of the position. Both decay
as the GNSS bias does, but not while fixes are rejected, as these do not confirm the reset.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel

if TYPE_CHECKING:
    from ..types import Core, Parameters


@kernel
def inflate_position(c: Core, axis: int, variance: float) -> None:
    """Add `variance` (m^2) to the position inflation along an axis (0 north, 1 east, 2 down)."""
    c.integrity.position_inflation[axis] += variance


@kernel
def inflate_position_to(c: Core, axis: int, variance: float) -> None:
    """Make the position inflation along an axis at least `variance`, m^2."""
    c.integrity.position_inflation[axis] = max(c.integrity.position_inflation[axis], variance)


@kernel
def inflate_velocity(c: Core, axis: int, variance: float) -> None:
    """Add `variance` (m^2/s^2) to the velocity inflation along an axis (0 north, 1 east)."""
    c.integrity.velocity_inflation[axis] += variance


@kernel
def limit_inflation(p: Parameters, c: Core) -> None:
    """The heading has been found: the receiver's velocity changes as the force does, so it is no drift that goes on.

    Or the attitude has been lost, and with it what the estimate said of the position. What may be left is a position
    that is off by a jump: one that is off by far more, and does not move against the estimate, is rare.
    """
    for i in range(2):
        c.integrity.position_inflation[i] = min(c.integrity.position_inflation[i], p.tuning.jump_sigma**2)
        c.integrity.velocity_inflation[i] = 0.0


@kernel
def propagate_inflation(c: Core, dt: float, decay: float) -> None:
    """Propagate the inflation over dt, s; `decay`: that of the GNSS bias."""
    position, velocity = c.integrity.position_inflation, c.integrity.velocity_inflation
    if c.integrity.rejecting:
        decay = 1.0
    for i in range(3):
        if i < 2 and velocity[i] > 0.0:
            position[i] = (math.sqrt(position[i]) + math.sqrt(velocity[i]) * dt) ** 2
            velocity[i] *= decay * decay
        position[i] *= decay * decay
