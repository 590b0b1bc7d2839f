"""What is added to the stated variance of the position after a reset to fixes that contradicted it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....compile.jit import kernel

if TYPE_CHECKING:
    from ..types import Core


@kernel
def inflate_position(c: Core, axis: int, variance: float) -> None:
    """State more variance (m^2) of the position along an axis than P has."""
    c.integrity.position_inflation[axis] += variance


@kernel
def fade_inflation(c: Core, decay: float) -> None:
    """It fades as the receiver's correlated error does, by `decay` over the interval."""
    for i in range(3):
        c.integrity.position_inflation[i] *= decay * decay
