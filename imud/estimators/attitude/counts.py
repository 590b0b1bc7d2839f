"""The counts that a gyro reads: their size, and how often each of those about zero is read.

A rate that passes through them reads each for about the same time, but twice as long where two intervals were cut off
to one (`truncation`). Only what goes all the way from one side to the other is such a pass, and a rest on the way
spoils it; the noise of a rest is looked at for itself (`noise_counts`).
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.rotation import Vector
from .noise_counts import BLOCK, begin, weigh
from .rest import REST_S
from .truncation import CELLS, WHOLE, WINDOW, restore

COARSEST = math.radians(0.2)  # rad/s, of a count
FINEST = math.radians(0.001)  # of which a half would be noticed
SAME = 1e-6  # rad/s, between readings of the same count
WIDE = math.log(2.0 * CELLS / (CELLS + 1.0))  # what a reading tells in favour of its cell's being the wide one
NARROW = math.log(CELLS / (CELLS + 1.0))  # and in favour of any other's


@kernel
def examine(s: Any, w: Vector) -> None:
    """Look at one sample of rates as read."""
    quiet = s.quiet_s >= REST_S
    told = False
    if quiet and s.still_samples == BLOCK:
        begin(s)
    for i in range(3):
        step, count = abs(w[i] - s.read[i]), s.count[i]
        s.read[i] = w[i]
        if SAME < step < 0.99 * count:
            s.count[i] = step
            told |= forget(s, i)
        elif FINEST < count < COARSEST:
            told |= place(s, i, w[i], step, quiet)
    if quiet:
        s.still_samples += 1
        if s.still_samples == BLOCK:
            told |= weigh(s)
    if told:
        restore(s)


@kernel
def place(s: Any, i: int, w: float, step: float, quiet: bool) -> bool:
    """Take the reading w of axis i, `step` from the last one, rad/s. Does it change what is believed?"""
    if abs(w) > (WINDOW + 1) * s.count[i]:  # far from it, as most are in motion
        return conclude(s, i, math.copysign(1.0, w))
    x = w / s.count[i]
    k = math.floor(x - s.phase[i] + 0.5)
    if abs(k) > WINDOW:
        return conclude(s, i, math.copysign(1.0, x))
    if abs(x - s.phase[i] - k) > WHOLE:
        s.phase[i] = x - math.floor(x + 0.5)
        return forget(s, i)
    cell = i * CELLS + WINDOW + k
    if quiet:
        s.still[cell] += 1.0
        s.still_step2[i] += (step / s.count[i]) ** 2
        s.side[i] = 0.0
    else:
        s.passed[cell] += 1.0
        s.seen[i] += 1.0
    return False


@kernel
def conclude(s: Any, i: int, side: float) -> bool:
    """Axis i is beyond the window; if it came from beyond the other end, learn from the pass."""
    seen, before = s.seen[i], s.side[i]
    s.side[i] = side
    if seen == 0.0:
        return False
    s.seen[i] = 0.0
    passes = bool(side == -before)
    weight = min(1.0, CELLS / seen)  # more readings than cells come from uneven turning
    for k in range(i * CELLS, (i + 1) * CELLS):
        if passes:
            s.evidence[k] += weight * (NARROW * (seen - s.passed[k]) + WIDE * s.passed[k])
        s.passed[k] = 0.0
    return passes


@kernel
def forget(s: Any, i: int) -> bool:
    """Begin anew with axis i. Was anything believed of it?"""
    believed = False
    for k in range(i * CELLS, (i + 1) * CELLS):
        believed |= s.evidence[k] != 0.0
        s.evidence[k] = s.passed[k] = 0.0
    s.side[i] = s.seen[i] = 0.0
    s.still_samples, s.still_blocks = BLOCK, 0
    return believed
