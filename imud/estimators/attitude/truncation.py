"""Whether the gyro's readings were cut off toward zero when they became integers, as a plain cast in C does it.

Such a reading is half a count too small in size whichever way the body turns, so that the bias seen at rest is not the
bias in motion: with 16 bits for 2000 deg/s the heading then drifts by 1.8 deg/min. It shows in the readings alone: two
intervals are cut off to zero, one to every other count. Whenever a rate passes through zero, of its readings of -1, 0
and 1 counts a half is zero if cut off, a third if rounded. Each pass adds to the odds, and readings are restored as far
as these go.

Source: Bayes' rule for two hypotheses, as in Wald, Sequential tests of statistical hypotheses (1945).
"""

import math
from typing import Any

from ...kernels.jit import kernel
from ...kernels.rotation import Vector

UNLIKELY = math.log(1.0 / 10.0)  # log odds of truncation before any reading
BEYOND_DOUBT = 12.0
ZERO = math.log((1.0 / 2.0) / (1.0 / 3.0))  # what a reading of zero tells in favour of truncation
ONE = math.log((1.0 / 4.0) / (1.0 / 3.0))
COARSEST = math.radians(0.2)  # rad/s, of a count
FAR = 8.0  # counts; a pass is from this far on one side to as far on the other, which noise about zero is not
INDEPENDENT = 4.0  # readings of one pass at most; more come from slow or uneven turning
SAME = 1e-6  # rad/s, between readings of the same count
WHOLE = 0.1  # of a count, how near to a whole number of them readings are


@kernel
def restored(s: Any, x: float, i: int) -> float:
    """Reading x of axis i with what was cut off."""
    return x + math.copysign(s.cut[i], x) if abs(x) > SAME else x


@kernel
def examine(s: Any, w: Vector) -> None:
    """Look at one sample of rates as read."""
    odds = s.truncation
    for i in range(3):
        step, count = abs(w[i] - s.read[i]), s.count[i]
        s.read[i] = w[i]
        if SAME < step < 0.99 * count:
            s.count[i] = step
            s.side[i] = 0.0
            odds = UNLIKELY
        elif count < COARSEST:
            odds = follow(s, i, w[i] / count, odds)
    if odds != s.truncation:
        s.truncation = min(max(odds, -BEYOND_DOUBT), BEYOND_DOUBT)
        restore(s)


@kernel
def follow(s: Any, i: int, x: float, odds: float) -> float:
    """Follow axis i, which now reads x counts, through zero; return the log odds with what a finished pass tells."""
    size = abs(x)
    if size > FAR:
        side = math.copysign(1.0, x)
        seen = s.zeros[i] + s.ones[i]
        if side == -s.side[i] and seen > 0.0:
            odds += (ZERO * s.zeros[i] + ONE * s.ones[i]) * min(1.0, INDEPENDENT / seen)
        s.side[i] = side
        s.zeros[i] = s.ones[i] = 0.0
    elif size < WHOLE:
        s.zeros[i] += 1.0
    elif abs(size - 1.0) < WHOLE:
        s.ones[i] += 1.0
    elif size < 1.0:
        return UNLIKELY  # these are no counts
    return odds


@kernel
def restore(s: Any) -> None:
    """Expect as much to be cut off as the odds say; the bias that was seen at rest lost it, too."""
    part = 0.5 / (1.0 + math.exp(-s.truncation))
    for i in range(3):
        cut = part * s.count[i]
        s.bg[i] += (cut - s.cut[i]) * s.rest_sign[i]
        s.cut[i] = cut
