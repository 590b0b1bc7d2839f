"""Finds the range of a sensor whose data sheet does not declare it, from plateaus of its readings.

The readings of a gyro or an accelerometer that reaches the end of its range rise in two steps or more (a single step
is a shock), then stay constant at once. Smooth motion does not: the steps of a sinusoid between samples become small
gradually, and if a step becomes KINK_RATIO times smaller within two samples, it does not stay so small for four. One
such plateau at the largest reading counts as clipped while it lasts, for SINGLE_S at most, since a machine may begin to
turn at a constant rate. A second plateau at the same reading is a range. Later readings near it are at the end of the
range, or where its readings are exactly the same, those; two readings well beyond show that it was not the range.

What is at the end of a range has lost its noise. Where that is known, the second differences near the largest reading
are compared with it: steps are smooth or not, and what they show together is a random walk. So a machine that turns at
one rate, again and again, has not reached the end of a range, and a plateau is found however slowly it is reached. An
axis that is frozen has no noise either, but repeats any reading, not the largest.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.jit import kernel

if TYPE_CHECKING:
    from .types import Clipping

STEEP, FLAT = 0.01, 0.005  # steps between samples, as shares of the reading: before a plateau, and within it
KINK, KINK_RATIO = 2, 4.0  # samples from the steep step to the flat one; least ratio of the two steps
PLATEAU = 4  # flat steps that make a plateau
NEAR_LARGEST = 0.97  # a plateau from this share of the largest reading on may be a range
RANGE_END = 0.98  # readings from this share of a plateau on are at the end of the range
BEYOND = 1.07  # times the least reading at the end of a range: one that shows that it is none
SMOOTH = 0.25  # a second difference below this share of the mean one of the noise shows none; of noise one of six is
SMOOTH_KINK, SMOOTH_PLATEAU, NOISY = 2, 8, -4  # smooth less other steps: behind a steep rise, a slow one; of no plateau
FINE = 4.0  # resolutions of noise from which two equal readings in a row count twice
SINGLE_S = 1.0  # longest time for which a single plateau counts: hands do not turn for longer
MIN_RANGE_RATE, MIN_RANGE_FORCE = 2.0, 15.0  # rad/s, m/s^2: no gyro or accelerometer has a smaller range

CLIPPING = np.dtype(
    [
        ("floor", "<f8", (6,)),  # smaller readings are within the range of every sensor
        ("range", "<f8", (6, 2)),  # least reading at the end of the range, negative and positive; infinite: none
        ("plateau", "<f8", (6, 2)),  # reading of the newest plateau
        ("largest", "<f8", (6, 2)),  # largest reading seen of either sign: calibrated, the ends are not symmetric
        ("rising", "<i8", (6,)),  # samples for which a steep rise still counts
        ("steep", "<f8", (6,)),  # the newest step if it is a steep rise, else 0
        ("rise", "<f8", (6,)),  # the smaller of the last two steep steps
        ("flat", "<i8", (6,)),  # flat steps since then
        ("smooth", "<i8", (6,)),  # smooth steps less other ones, near the largest reading
        ("single", "<i8", (6,)),  # 1: these are a plateau
        ("single_samples", "<i8"),  # samples in SINGLE_S
    ],
    align=True,
)


def new_clipping(rate_hz: float) -> Any:
    """A record (array of one CLIPPING)."""
    c = np.zeros(1, CLIPPING)
    c["single_samples"] = round(SINGLE_S * rate_hz)
    c["floor"] = np.repeat((MIN_RANGE_RATE, MIN_RANGE_FORCE), 3)
    c["range"] = c["rise"] = math.inf
    return c


@kernel
def at_range_end(c: Clipping, i: int, size: float, side: int) -> bool:
    """Whether a reading of this size and sign is at the end of a learned range, or in a single plateau."""
    return bool(size >= c.range[i, side] or (c.single[i] == 1 and c.flat[i] < c.single_samples))


@kernel
def is_clipped(
    c: Clipping, i: int, value: float, step: float, bend: float, noise: float, lsbs: float, repeated: bool
) -> bool:
    """Whether the reading `value` of axis i is at the end of a learned range.

    step, bend: its difference from the one before, and that difference's own; noise: the largest mean |bend| that its
    noise may have, 0: not known; lsbs: the least, in resolutions, 0: so small that it may repeat readings.
    repeated: the whole sample repeats the one before, as of a sensor that is polled faster than it measures.
    """
    size, side = abs(value), 1 if value > 0.0 else 0
    if repeated:
        return at_range_end(c, i, size, side)
    rise = step if value > 0.0 else -step
    if size - rise <= c.floor[i]:  # the reading before was not examined: the rise begins here
        c.steep[i], c.rising[i], c.flat[i], c.single[i] = 0.0, 0, 0, 0
    is_near = size >= NEAR_LARGEST * c.largest[i, side]
    if noise > 0.0 and is_near and c.flat[i] > 1 and abs(step) < STEEP * size:
        more = -1 if abs(bend) > SMOOTH * noise else 2 if step == 0.0 and lsbs > FINE else 1
        c.smooth[i] = max(min(c.smooth[i] + more, SMOOTH_PLATEAU), NOISY)
    if abs(step) < min(FLAT * size, c.rise[i] / KINK_RATIO):
        c.flat[i] += 1
        kink = c.rising[i] > 0 and (noise == 0.0 or c.smooth[i] >= SMOOTH_KINK)
        slow = lsbs > 0.0 and c.smooth[i] == SMOOTH_PLATEAU and c.single[i] == 0
        if is_near and c.flat[i] >= PLATEAU and (kink or slow):
            if abs(size - c.plateau[i, side]) < (1.0 - NEAR_LARGEST) * size:
                c.range[i, side] = size if step == 0.0 else RANGE_END * size
            c.plateau[i, side], c.rising[i], c.single[i] = size, 0, 1
    else:
        c.flat[i] = c.single[i] = 0
        c.rising[i] -= 1
        steep = rise if rise > STEEP * size else 0.0
        if min(steep, c.steep[i]) > 0.0:
            c.rising[i], c.rise[i] = KINK, min(steep, c.steep[i])
        c.steep[i] = steep
    sustained = min(size, abs(value - step))  # a single larger reading is damage
    c.largest[i, side] = max(c.largest[i, side], sustained)
    if sustained > BEYOND * c.range[i, side] or c.smooth[i] == NOISY:
        c.range[i, side], c.plateau[i, side], c.single[i] = math.inf, 0.0, 0
    return at_range_end(c, i, size, side)
