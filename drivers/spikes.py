"""Damaged values: past a weak checksum, or without one, damage shows only as a sample that contradicts its neighbours.

A sample is a spike if an axis leaves the last good value by more than motion ever makes it in one sample period
(`floor`), and by more than twice what it recently did. It is motion, not a spike, if the sample before left to the same
side. Never more than `RUN_MAX` samples in a row are called spikes, so motion is never suppressed.
"""

from typing import Any

import numpy as np

from .jit import kernel

RUN_MAX = 3
GAP_MAX = 8  # ticks beyond which neighbours are not compared
REPEATED = 1.0 / 8.0  # share of a spike's difference that counts as motion
DECAY = 1.0 / 1024.0  # per sample, of the recent largest difference

SPIKES = np.dtype(
    [
        ("raw", "<i8", (6,)),  # gyro x y z, accelerometer x y z of the sample at hand, LSB
        ("good", "<i8", (6,)),  # of the last sample that was no spike
        ("side", "<i8", (6,)),  # to which side the spike before this sample left: -1, 0, 1
        ("floor", "<f8", (6,)),  # LSB per tick that are always allowed
        ("recent", "<f8", (6,)),  # largest difference per tick, decaying
        ("run", "<i8"),  # spikes in a row
        ("started", "<i8"),
    ],
    align=True,
)


@kernel
def is_far(s: Any, ticks: int) -> bool:
    """Whether any axis leaves the last good value by more than it may. Without branches, as each sample is tested."""
    far = False
    for i in range(6):
        far |= abs(float(s.raw[i] - s.good[i])) > max(s.floor[i], 2.0 * s.recent[i]) * (ticks + s.run)
    return far


@kernel
def contradicts(s: Any, ticks: int) -> bool:
    """Whether an axis leaves to another side than the spike before did; the sides are noted."""
    odd = False
    for i in range(6):
        limit = max(s.floor[i], 2.0 * s.recent[i]) * (ticks + s.run)
        left = s.raw[i] - s.good[i]
        to = 1 if left > limit else -1 if left < -limit else 0
        odd |= to not in (0, s.side[i])
        s.side[i] = to
    return odd


@kernel
def is_spike(s: Any, ticks: int) -> bool:
    """Judge s.raw, `ticks` after the sample before."""
    raw, good, side, recent = s.raw, s.good, s.side, s.recent
    comparable = s.started and 0 < ticks <= GAP_MAX
    if comparable and is_far(s, ticks) and contradicts(s, ticks) and s.run < RUN_MAX:
        for i in range(6):
            if side[i] != 0:  # a difference that repeats is motion
                recent[i] += abs(raw[i] - good[i]) * REPEATED / ticks
        s.run += 1
        return True
    if comparable:
        share = 1.0 / ticks
        for i in range(6):
            recent[i] = max(recent[i] * (1.0 - DECAY), abs(raw[i] - good[i]) * share)
    for i in range(6):
        good[i], side[i] = raw[i], 0
    s.run, s.started = 0, 1
    return False
