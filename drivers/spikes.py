"""Finds samples damaged on the wire, past a weak checksum or without one: they contradict their neighbours.

A sample is a spike if an axis differs from the last good value by more than motion can change it in one sample period
(`floor`), and by more than twice its recent changes. If the sample before differed in the same direction it is motion,
not a spike. No more than SPIKES_MAX samples in a row are called spikes, so that motion is never suppressed.
"""

from typing import Any

import numpy as np

from .jit import kernel

SPIKES_MAX = 3
GAP_MAX = 8  # ticks beyond which neighbours are not compared
SPIKE_SHARE = 1.0 / 8.0  # share of a spike's difference that is added to the recent changes
DECAY = 1.0 / 1024.0  # by which `recent_change` decays per sample

SPIKES = np.dtype(
    [
        ("raw", "<i8", (6,)),  # the present sample: gyro x y z, accelerometer x y z, LSB
        ("last_good", "<i8", (6,)),  # the last sample that was no spike
        ("sign", "<i8", (6,)),  # of the last spike's difference: -1, 1; 0: within the limit, or no spike
        ("floor", "<f8", (6,)),  # LSB per tick that are always allowed
        ("recent_change", "<f8", (6,)),  # largest difference per tick, decaying
        ("spike_count", "<i8"),  # spikes in a row
        ("started", "<i8"),
    ],
    align=True,
)


@kernel
def limit_of(s: Any, i: int, ticks: int) -> float:
    """How far axis i may differ from its last good value, LSB."""
    return float(max(s.floor[i], 2.0 * s.recent_change[i]) * (ticks + s.spike_count))


@kernel
def deviates(s: Any, ticks: int) -> bool:
    """Whether any axis differs from its last good value by more than it may. Without branches, to be fast."""
    found = False
    for i in range(6):
        found |= abs(float(s.raw[i] - s.last_good[i])) > limit_of(s, i, ticks)
    return found


@kernel
def changes_sign(s: Any, ticks: int) -> bool:
    """Whether an axis differs in another direction than at the spike before; stores the directions."""
    changed = False
    for i in range(6):
        limit = limit_of(s, i, ticks)
        difference = s.raw[i] - s.last_good[i]
        sign = 1 if difference > limit else -1 if difference < -limit else 0
        changed |= sign not in (0, s.sign[i])
        s.sign[i] = sign
    return changed


@kernel
def is_spike(s: Any, ticks: int) -> bool:
    """Whether s.raw, `ticks` after the sample before, is a spike; updates the record."""
    raw, last_good, sign, recent_change = s.raw, s.last_good, s.sign, s.recent_change
    comparable = s.started and 0 < ticks <= GAP_MAX
    if comparable and deviates(s, ticks) and changes_sign(s, ticks) and s.spike_count < SPIKES_MAX:
        for i in range(6):
            if sign[i] != 0:  # so that a difference that repeats is taken as motion
                recent_change[i] += abs(raw[i] - last_good[i]) * SPIKE_SHARE / ticks
        s.spike_count += 1
        return True
    if comparable:
        share = 1.0 / ticks
        for i in range(6):
            recent_change[i] = max(recent_change[i] * (1.0 - DECAY), abs(raw[i] - last_good[i]) * share)
    for i in range(6):
        last_good[i], sign[i] = raw[i], 0
    s.spike_count, s.started = 0, 1
    return False
