"""Innovations that the steps of an estimator make: they stay in its state until they are asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..compile.jit import kernel
from .records import PENDING_MAX

if TYPE_CHECKING:
    from .types import Innovation, PendingInnovations


@kernel
def store_innovation(pending: PendingInnovations, t_ns: int, kind: int, z: float, s: float, used: int) -> None:
    """Add an innovation z of variance s, fused (used 1) or not, unless PENDING_MAX of them have not been asked for."""
    if pending.count < PENDING_MAX:
        row = pending.rows[pending.count]
        row.t_ns, row.kind, row.value, row.variance, row.used = t_ns, kind, z, s, used
        pending.count += 1


@kernel
def move_innovations(pending: PendingInnovations, innovations: list[Innovation]) -> int:
    """Move as many as there is room for to `innovations`, oldest first; returns how many."""
    n: int = min(pending.count, len(innovations))
    for k in range(n):
        innovations[k] = pending.rows[k]
    for k in range(n, pending.count):
        pending.rows[k - n] = pending.rows[k]
    pending.count -= n
    return n
