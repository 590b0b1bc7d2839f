"""What the noise of a resting gyro tells of its counts: whether one of them is twice as wide as the others.

White noise is Gaussian, and one mean and one deviation must explain how often each count is read. A block is believed
only if its readings differ as much from one to the next as from their mean, so that they are noise and no motion; and
only some blocks are, because one and the same noise, looked at for hours, would tell more than it knows.

Source: von Neumann, Distribution of the ratio of the mean square successive difference to the variance (1941).
"""

import math
from typing import Any

from ...kernels.jit import kernel
from .truncation import CELLS, candidates

BLOCK = 1000  # samples
BLOCKS = 16
FAINTEST, LOUDEST = 0.7, 4.0  # counts, of the noise: less does not reach the next count, more sees no single one
WHITEST = 0.4  # of the variance must be between neighbours
REACH = 4.0  # sigma
STRAY = 0.02  # of the readings may be anywhere
NOWHERE = -1


@kernel
def begin(s: Any) -> None:
    """Begin a new block."""
    s.still_samples = 0
    for k in range(3 * CELLS):
        s.still[k] = 0.0
    for i in range(3):
        s.still_step2[i] = 0.0


@kernel
def weigh(s: Any) -> bool:
    """Learn from a full block. Is there anything new?"""
    if s.still_blocks == BLOCKS:
        return False
    s.still_blocks += 1
    told = False
    for i in range(3):
        told |= weigh_axis(s, i)
    return told


@kernel
def weigh_axis(s: Any, i: int) -> bool:
    """Compare how often the counts of axis i were read with what noise would give if one of their cells were wide."""
    deviation = math.sqrt(0.5 * s.still_step2[i] / BLOCK)
    reach = math.ceil(REACH * deviation)
    middle = median(s, i * CELLS)
    if not (FAINTEST < deviation < LOUDEST and i * CELLS <= middle - reach and middle + reach < (i + 1) * CELLS):
        return False
    white = deviation**2 / explain(s, middle - reach, middle + reach + 1, NOWHERE)[1]
    if white < WHITEST:
        return False
    first, end = candidates(s, i)
    first, end = max(first, middle - reach - 1), min(end, middle + reach + 2)
    plain = likelihood(s, middle, reach, NOWHERE)
    for k in range(first, end):
        s.evidence[k] += min(white, 1.0) * (likelihood(s, middle, reach, k) - plain)
    return first < end


@kernel
def median(s: Any, first: int) -> int:
    """The cell, of those of the axis that begins with `first`, on both sides of which as many were read."""
    total, passed = 0.0, 0.0
    for k in range(first, first + CELLS):
        total += s.still[k]
    for k in range(first, first + CELLS):
        passed += s.still[k]
        if 2.0 * passed >= total:
            return k
    return first


@kernel
def edges(k: int, wide: int) -> tuple[float, float]:
    """Between which values, in counts, what is read as cell k lies if cell `wide` has two intervals."""
    if wide == NOWHERE:
        return k - 0.5, k + 0.5
    return k - (1.0 if k <= wide else 0.0), k + (1.0 if k >= wide else 0.0)


@kernel
def explain(s: Any, first: int, end: int, wide: int) -> tuple[float, float]:
    """Mean and variance of what was read as cells from `first` up to `end`, less what the cells' width makes."""
    n, mean, square, width2 = 0.0, 0.0, 0.0, 0.0
    for k in range(first, end):
        low, high = edges(k, wide)
        x, h = 0.5 * (low + high), s.still[k]
        n += h
        mean += h * x
        square += h * x * x
        width2 += h * (high - low) ** 2
    mean /= max(n, 1.0)
    return mean, max((square - width2 / 12.0) / max(n, 1.0) - mean * mean, FAINTEST**2)


@kernel
def likelihood(s: Any, middle: int, reach: int, wide: int) -> float:
    """Log likelihood of what was read about cell `middle` if cell `wide` is so, from Gaussian noise."""
    mean, variance = explain(s, middle - reach, middle + reach + 1, wide)
    scale = 1.0 / math.sqrt(2.0 * variance)
    total = 0.0
    below = math.erf((edges(middle - reach, wide)[0] - mean) * scale)
    for k in range(middle - reach, middle + reach + 1):
        through = math.erf((edges(k, wide)[1] - mean) * scale)
        total += s.still[k] * math.log((1.0 - STRAY) * 0.5 * (through - below) + STRAY / CELLS)
        below = through
    return total
