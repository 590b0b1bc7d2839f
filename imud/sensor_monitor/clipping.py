"""Readings that end at a range which no data sheet declares: found from plateaus.

A gyro or an accelerometer that reaches the end of its range rises in two steps or more (with one it is a shock), then
stays flat at once. Smooth motion does not: the steps of a sinusoid between samples become small one after another, and
if two samples suffice for a step to become `KINK_RATIO` times smaller, then it does not stay so small for four. One
such plateau at the largest reading counts as clipped while it lasts, but not for long: a machine may begin to turn at a
constant rate. Two of them are a range. Later readings near it are at the end of the range; a reading well beyond it
shows that it was none.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.jit import kernel

if TYPE_CHECKING:
    from .types import Clipping

STEEP, FLAT = 0.01, 0.005  # of the reading: a step between samples that rises to a plateau, and one within it
KINK, KINK_RATIO = 2, 4.0  # samples in which the one becomes the other; and how many times smaller, at least
PLATEAU = 4  # flat steps
LARGEST = 0.97  # of the largest reading: what may be a range
AT_THE_END, BEYOND = 0.98, 1.05  # of the plateau: readings at the end of the range, and such as show that it is none
SINGLE_S = 1.0  # for which a single plateau counts: hands turn no longer
LEAST_RATE, LEAST_FORCE = 2.0, 15.0  # rad/s, m/s^2: no gyro or accelerometer has a smaller range

CLIPPING = np.dtype(
    [
        ("floor", "<f8", (6,)),  # readings below are within every range
        ("range", "<f8", (6, 2)),  # learned, of negative and positive readings; infinite: none
        ("plateau", "<f8", (6, 2)),  # the newest one
        ("largest", "<f8", (6,)),
        ("rising", "<i8", (6,)),  # samples for which a steep rise still counts
        ("steep", "<f8", (6,)),  # the newest step if it is a steep rise, else 0
        ("rise", "<f8", (6,)),  # the smaller one of the last two
        ("flat", "<i8", (6,)),  # flat steps since
        ("single", "<i8", (6,)),  # 1: they are a plateau
        ("single_samples", "<i8"),  # in SINGLE_S
    ],
    align=True,
)


def new_clipping(rate_hz: float) -> Any:
    """A record (array of one CLIPPING)."""
    c = np.zeros(1, CLIPPING)
    c["single_samples"] = round(SINGLE_S * rate_hz)
    c["floor"] = np.repeat((LEAST_RATE, LEAST_FORCE), 3)
    c["range"] = math.inf
    return c


@kernel
def is_clipped(c: Clipping, i: int, value: float, step: float) -> bool:
    """Whether the reading `value` of axis i, `step` more than the one before, is at the end of a learned range."""
    size, side = abs(value), 1 if value > 0.0 else 0
    rise = step if value > 0.0 else -step
    if abs(step) < min(FLAT * size, c.rise[i] / KINK_RATIO):
        c.flat[i] += 1
        if c.flat[i] == PLATEAU and c.rising[i] > 0 and size >= LARGEST * c.largest[i]:
            if abs(size - c.plateau[i, side]) < (1.0 - LARGEST) * size:
                c.range[i, side] = size
            c.plateau[i, side], c.rising[i], c.single[i] = size, 0, 1
    else:
        c.flat[i] = c.single[i] = 0
        c.rising[i] -= 1
        steep = rise if rise > STEEP * size else 0.0
        if min(steep, c.steep[i]) > 0.0:
            c.rising[i], c.rise[i] = KINK, min(steep, c.steep[i])
        c.steep[i] = steep
    c.largest[i] = max(c.largest[i], size)
    if size > BEYOND * c.range[i, side]:
        c.range[i, side] = math.inf
    return bool(size >= AT_THE_END * c.range[i, side] or (c.single[i] == 1 and c.flat[i] < c.single_samples))
