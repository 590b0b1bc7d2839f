"""Readings that end at a range which no data sheet declares: found from plateaus.

A gyro or an accelerometer that reaches the end of its range rises steeply, then stays flat. Smooth motion does not: the
steps of a sinusoid between samples become small one after another, and if two samples suffice for that, then it does
not stay flat for four. So two steep rises with plateaus right behind them, both at the largest reading, are a range.
Later readings near it are at the end of the range; a reading well beyond it shows that it was none.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.jit import kernel

if TYPE_CHECKING:
    from .types import Clipping

STEEP, FLAT = 0.02, 0.005  # of the reading: a step between samples that rises to a plateau, and one within it
KINK = 2  # samples in which the one becomes the other
PLATEAU = 4  # flat steps
LARGEST = 0.97  # of the largest reading: what may be a range
AT_THE_END, BEYOND = 0.98, 1.05  # of the plateau: readings at the end of the range, and such as show that it is none
LEAST_RATE, LEAST_FORCE = 2.0, 15.0  # rad/s, m/s^2: no gyro or accelerometer has a smaller range

CLIPPING = np.dtype(
    [
        ("floor", "<f8", (6,)),  # readings below are within every range
        ("range", "<f8", (6, 2)),  # learned, of negative and positive readings; infinite: none
        ("plateau", "<f8", (6, 2)),  # the newest one
        ("largest", "<f8", (6,)),
        ("rising", "<i8", (6,)),  # samples for which a steep rise still counts
        ("flat", "<i8", (6,)),  # flat steps since
    ],
    align=True,
)


def new_clipping() -> Any:
    """A record (array of one CLIPPING)."""
    c = np.zeros(1, CLIPPING)
    c["floor"] = np.repeat((LEAST_RATE, LEAST_FORCE), 3)
    c["range"] = math.inf
    return c


@kernel
def is_clipped(c: Clipping, i: int, value: float, step: float) -> bool:
    """Whether the reading `value` of axis i, `step` more than the one before, is at the end of a learned range."""
    size, side = abs(value), 1 if value > 0.0 else 0
    rise = step if value > 0.0 else -step
    if abs(step) < FLAT * size:
        c.flat[i] += 1
        if c.flat[i] == PLATEAU and c.rising[i] > 0 and size >= LARGEST * c.largest[i]:
            if abs(size - c.plateau[i, side]) < (1.0 - LARGEST) * size:
                c.range[i, side] = size
            c.plateau[i, side], c.rising[i] = size, 0
    else:
        c.flat[i] = 0
        c.rising[i] = KINK if rise > STEEP * size else c.rising[i] - 1
    c.largest[i] = max(c.largest[i], size)
    if size > BEYOND * c.range[i, side]:
        c.range[i, side] = math.inf
    return bool(size >= AT_THE_END * c.range[i, side])
