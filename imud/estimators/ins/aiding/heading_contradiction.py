"""Whether the receiver's velocities, or resets to its positions, contradict the heading.

Velocities that are rejected one after the other, and for some seconds, come of a wrong heading; so do resets that come
again soon. A heading that only a compass gave is believed for less long.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ...tuning import Tunable
from ..glr_tests.compass_offset import is_unconfirmed
from .wheel_check import wheels_support

if TYPE_CHECKING:
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "max_velocity_rejects",
        8,
        "fixes",
        "Largest number of rejected velocities in a row with a right heading.",
        "Choice.",
    ),
    Tunable(
        "unconfirmed_velocity_rejects",
        3,
        "fixes",
        "Largest number of rejected velocities in a row with a given heading that motion has not confirmed.",
        "Choice.",
    ),
    Tunable(
        "min_velocity_reject_s",
        2.5,
        "s",
        "Least time of rejected velocities that contradict a heading.",
        "The receiver's positions need as long to show that its velocity is wrong.",
    ),
    Tunable("max_reset_score", 1.5, "", "Largest decaying count of resets with a right heading.", "Choice."),
    Tunable("reset_score_decay", 0.98, "per fix", "Decay of the count of resets.", "About fifty fixes.", high=0.9999),
)


@kernel
def count_velocity_rejects(c: Core, rejected: int) -> None:
    """Count fixes in a row with a rejected velocity; `rejected`: rejected components of the last one."""
    g = c.integrity
    g.velocity_reject_count = g.velocity_reject_count + 1 if rejected else 0
    if g.velocity_reject_count == 1:
        g.velocity_reject_ns = c.nav.t_ns


@kernel
def count_reset(c: Core, supported: bool) -> None:
    """Count a reset to rejected positions; not where something supports the velocity (`velocity_is_supported`)."""
    c.integrity.reset_score += 0.0 if supported else 1.0


@kernel
def contradicts_heading(p: Parameters, c: Core) -> bool:
    """Whether the number of rejected velocities, or of resets, means that the heading is wrong."""
    g = c.integrity
    most = p.tuning.max_velocity_rejects * (p.tuning.wheel_reject_factor if wheels_support(p, c) else 1.0)
    if is_unconfirmed(c):
        most = p.tuning.unconfirmed_velocity_rejects
    lasting = 1e-9 * (c.nav.t_ns - g.velocity_reject_ns) > p.tuning.min_velocity_reject_s
    return bool((g.velocity_reject_count > most and lasting) or g.reset_score > p.tuning.max_reset_score)


@kernel
def decay_reset_score(p: Parameters, c: Core) -> None:
    """Let the count of resets decay, once per fix."""
    c.integrity.reset_score *= p.tuning.reset_score_decay


@kernel
def clear_contradictions(c: Core) -> None:
    """Clear the counts of rejected velocities and of resets."""
    c.integrity.velocity_reject_count = 0
    c.integrity.reset_score = 0.0
