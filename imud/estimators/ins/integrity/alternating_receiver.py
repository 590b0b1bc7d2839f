"""A receiver whose positions alternate between places, as with a spoofer or a defect: which of them is right?

The estimate began at one of the places, by chance, and the gate rejects the others. What shows it is that positions are
rejected and used by turns, and not few of them: a receiver with outliers returns as often, but most positions are used,
and one that drifts or jumps once returns once, when the filter is reset to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable("alternation_memory_s", 50.0, "s", "Time in which the counts of positions fade.", "Choice: some returns."),
    Tunable("max_returns", 1.5, "", "Largest decaying count of returns without alternation.", "Choice."),
    Tunable(
        "max_reject_share", 0.3, "", "Largest share of rejected positions of a receiver that alternates.", "Choice."
    ),
)


@kernel
def count_position(p: Parameters, c: Core, used: bool, after_rejects: bool) -> None:
    """Count a position. after_rejects: the one before was rejected."""
    g = c.integrity
    decay = elementary.exp(-1e-9 * (c.nav.t_ns - g.position_ns) / p.tuning.alternation_memory_s)
    g.position_ns = c.nav.t_ns
    g.position_uses = decay * g.position_uses + (1.0 if used else 0.0)
    g.position_rejects = decay * g.position_rejects + (0.0 if used else 1.0)
    g.position_returns = decay * g.position_returns + (1.0 if used and after_rejects else 0.0)


@kernel
def count_height(p: Parameters, c: Core, used: bool) -> float:
    """Count a height; returns the share of the last ones that were rejected."""
    g = c.integrity
    decay = elementary.exp(-1e-9 * (c.nav.t_ns - g.height_ns) / p.tuning.alternation_memory_s)
    g.height_ns = c.nav.t_ns
    g.height_uses = decay * g.height_uses + (1.0 if used else 0.0)
    g.height_rejects = decay * g.height_rejects + (0.0 if used else 1.0)
    return float(g.height_rejects / (g.height_uses + g.height_rejects))


@kernel
def reject_share(c: Core) -> float:
    """Share of the last positions that were rejected."""
    g = c.integrity
    return float(g.position_rejects / max(g.position_uses + g.position_rejects, 1e-9))


@kernel
def share_of_few(p: Parameters, c: Core) -> float:
    """Share of the last positions that were rejected, with one that is not counted yet; 0 where many were used.

    Few are so many that a single rejected one is more than `max_reject_share` of them.
    """
    decay = elementary.exp(-1e-9 * (c.nav.t_ns - c.integrity.position_ns) / p.tuning.alternation_memory_s)
    uses, rejects = decay * c.integrity.position_uses, decay * c.integrity.position_rejects + 1.0
    return float(rejects / (uses + rejects) if p.tuning.max_reject_share * (uses + 1.0) < 1.0 else 0.0)


@kernel
def is_alternating(p: Parameters, c: Core) -> bool:
    """Whether the receiver's positions are so often elsewhere that nothing tells which are right."""
    g = c.integrity
    share = p.tuning.max_reject_share * (g.position_uses + g.position_rejects)
    return bool(g.position_returns > p.tuning.max_returns and g.position_rejects > share)
