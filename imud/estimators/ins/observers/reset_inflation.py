"""What is added to the stated variance of the position after a reset to fixes that contradicted it."""

from typing import Any

from ....compile.jit import kernel


@kernel
def inflate_position(c: Any, axis: int, variance: float) -> None:
    """State more variance (m^2) of the position along an axis than P has."""
    c.integrity.position_inflation[axis] += variance


@kernel
def fade_inflation(c: Any, decay: float) -> None:
    """It fades as the receiver's correlated error does, by `decay` over the interval."""
    for i in range(3):
        c.integrity.position_inflation[i] *= decay * decay
