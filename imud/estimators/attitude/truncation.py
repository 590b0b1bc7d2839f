"""Whether the gyro's readings were cut off toward zero when they became integers, as a plain cast in C does it.

Such a reading is half a count too small in size whichever way the body turns, so that the bias seen at rest is not the
bias in motion: with 16 bits for 2000 deg/s the heading then drifts by 1.8 deg/min. It shows in the readings alone: two
intervals are cut off to zero, one to every other count. `counts` and `noise_counts` gather how much likelier what they
see is if one cell is so wide than if none is; the axes of a gyro are cast alike, and readings are restored as far as
the odds go.

Readings that are whole counts were cut off at zero if at all. Where a bias was taken out after the cast, as
calibrations do, they are whole counts but for a common rest, and zero may have been at any of them.

Source: Bayes' rule for two hypotheses, as in Wald, Sequential tests of statistical hypotheses (1945).
"""

import math
from typing import Any

from ...kernels.jit import kernel

WINDOW = 32  # counts on either side of the reading next to zero, in which zero itself is sought
CELLS = 2 * WINDOW + 1
WHOLE = 0.1  # of a count, how near to a whole number of them readings are
UNLIKELY = math.log(1.0 / 10.0)  # log odds of truncation before any reading
BEYOND_DOUBT = 12.0


@kernel
def restored(s: Any, x: float, i: int) -> float:
    """Reading x of axis i with what was cut off."""
    most = float(s.cut_most[i])
    if most == 0.0:
        return x
    if abs(x) > (WINDOW + 1) * s.count[i]:
        return x + math.copysign(most, x)
    k = math.floor(x / s.count[i] - s.phase[i] + 0.5)
    if k < -WINDOW:
        return x - most
    if k > WINDOW:
        return x + most
    return float(x + s.cut[i * CELLS + WINDOW + k])


@kernel
def candidates(s: Any, i: int) -> tuple[int, int]:
    """The first cell of axis i that may be the wide one, and the one after the last."""
    if abs(s.phase[i]) < WHOLE:
        return i * CELLS + WINDOW, i * CELLS + WINDOW + 1
    return i * CELLS, (i + 1) * CELLS


@kernel
def restore(s: Any) -> None:
    """Expect as much to be cut off as the evidence says; the bias that was seen at rest lost it, too."""
    odds = UNLIKELY
    for i in range(3):
        odds += log_mean(s, i)
    s.truncation = min(max(odds, -BEYOND_DOUBT), BEYOND_DOUBT)
    part = 0.5 / (1.0 + math.exp(-s.truncation))
    for i in range(3):
        s.cut_most[i] = part * s.count[i]
        s.bg[i] += spread(s, i)


@kernel
def log_mean(s: Any, i: int) -> float:
    """Of the likelihood ratios of all places where axis i may have its wide cell."""
    first, end = candidates(s, i)
    top, total = s.evidence[first], 0.0
    for k in range(first, end):
        top = max(top, s.evidence[k])
    for k in range(first, end):
        total += math.exp(s.evidence[k] - top)
    return float(top + math.log(total / (end - first)))


@kernel
def spread(s: Any, i: int) -> float:
    """Expect of each reading of axis i that it lost `cut_most` on the side of zero that it is on.

    Returns by how much more that is than before for those seen at rest, and keeps how far it may be wrong for them.
    """
    first, end = candidates(s, i)
    mean = log_mean(s, i)
    still = 0.0
    for k in range(i * CELLS, (i + 1) * CELLS):
        still += s.still[k]
    below, still_below, more, lost, lost2 = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(i * CELLS, (i + 1) * CELLS):
        here = math.exp(s.evidence[k] - mean) / (end - first) if first <= k < end else 0.0
        cut = s.cut_most[i] * (2.0 * below + here - 1.0)
        more += s.still[k] * (cut - s.cut[k])
        s.cut[k] = cut
        below += here
        side = still - s.still[k] - 2.0 * still_below  # readings above this cell less those below it
        lost += here * side
        lost2 += here * side * side
        still_below += s.still[k]
    if still == 0.0:
        return 0.0
    most = s.cut_most[i]
    s.cut_var[i] = max(0.5 * s.count[i] * most * lost2 - (most * lost) ** 2, 0.0) / still**2
    return more / still
