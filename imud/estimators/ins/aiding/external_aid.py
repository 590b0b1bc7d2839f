"""What aiding sources have in common: repetition, and how many share an error."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ....compile.jit import kernel
from ..state import NEVER_NS

if TYPE_CHECKING:
    from ...types import Measurement
    from ..types import Core, ExternalAid


@kernel
def is_new(g: ExternalAid, m: Measurement) -> bool:
    """Whether a measurement differs from the one before; stores its values."""
    new = False
    for i in range(4):
        known = math.isfinite(m.value[i]) or math.isfinite(g.last_value[i])
        new = new or (known and m.value[i] != g.last_value[i])
        g.last_value[i] = m.value[i]
    return new


@kernel
def time_since_last(g: ExternalAid, m: Measurement) -> float:
    """Time since the measurement before, s, very long for the first; stores the epoch."""
    dt = 1e-9 * (m.t_ns - g.last_ns) if g.last_ns != NEVER_NS else 1e6
    g.last_ns = m.t_ns
    return max(dt, 1e-3)


@kernel
def others_of_error(dt: float, correlation_s: float) -> float:
    """How many measurements beside one, `dt` s apart, share an error of that correlation time."""
    return max(2.0 * correlation_s / dt, 1.0) - 1.0


@kernel
def distrust_velocities(c: Core) -> None:
    """The estimate with which external velocities have agreed may be wrong: they have to agree anew to be used."""
    c.external_velocity.used_share = c.body_velocity.used_share = 0.0
