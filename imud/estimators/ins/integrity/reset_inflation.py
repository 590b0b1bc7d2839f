"""The position variance that the solution states beyond P after a reset to fixes that contradicted the estimate."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....compile.jit import kernel

if TYPE_CHECKING:
    from ..types import Core


@kernel
def inflate_position(c: Core, axis: int, variance: float) -> None:
    """Add `variance` (m^2) to the position inflation along an axis (0 north, 1 east, 2 down)."""
    c.integrity.position_inflation[axis] += variance


@kernel
def fade_inflation(c: Core, decay: float) -> None:
    """Let the position inflation decay as the variance of the GNSS bias does; `decay`: that of the bias itself."""
    for i in range(3):
        c.integrity.position_inflation[i] *= decay * decay
