"""Finds samples damaged on the wire, past a weak checksum or without one: they contradict their neighbours.

A sample is a spike if an axis differs from the last good value by more than motion can change it in one sample period
(`floor`), and by more than twice its recent changes. If the sample before differed in the same direction it is motion,
not a spike. No more than SPIKES_MAX samples in a row are called spikes, so that motion is never suppressed.

A line that breaks many frames damages as many values in frames that look whole. So where frames lately broke
(`broken_share`) it is motion only if the sample before had nearly the same values, or if so many samples in a row are
hardly all damaged; and differences are then no measure of the motion beyond what is allowed already.
"""

from typing import Any

import numpy as np

from . import elementary
from .jit import kernel

SPIKES_MAX = 3
DAMAGED_SPIKES_MAX = 1000  # the same on a line that damages nearly all frames
CHANCE = 1e-10  # probability from which it is no chance that so many samples in a row are damaged
ALIKE, OFTEN_ALIKE = 3, 4  # spikes in a row with nearly the same values that are motion; where most frames break
GAP_MAX = 8  # ticks beyond which neighbours are not compared
SPIKE_SHARE = 1.0 / 8.0  # share of a spike's difference that is added to the recent changes
RATIO = 2.0  # of the largest change lately, that an axis may change in a tick
DECAY = 1.0 / 1024.0  # by which `recent_change` decays per sample
BROKEN_SHARE_GAIN = 1.0 / 256.0  # weight of one frame in `broken_share`
NEWEST_GAIN = 1.0 / 16.0  # the same in `newest_broken_share`
DAMAGING_SHARE = 0.003  # of frames that break: one in the time constant. From here on the line damages values
UNDAMAGED_SHARE = 0.001  # at which it no longer does
DAMAGED_RATIO, MEDIAN_GAIN = 8.0, 1.0 / 16.0  # RATIO on such a line: of the median; step with which that is found
DAMAGED_FLOOR = 1.0 / 16.0  # of `floor`, on such a line
DAMAGED_GAP_MAX = 128  # GAP_MAX on such a line: whole frames are rare, and the first after a gap may be damaged, too

SPIKES = np.dtype(
    [
        ("raw", "<i8", (6,)),  # the present sample: gyro x y z, accelerometer x y z, LSB
        ("last_good", "<i8", (6,)),  # the last sample that was no spike
        ("sign", "<i8", (6,)),  # of the last spike's difference: -1, 1; 0: within the limit, or no spike
        ("floor", "<f8", (6,)),  # LSB per tick that are always allowed
        ("recent_change", "<f8", (6,)),  # largest difference per tick, decaying; if damaging its median
        ("last_spike", "<i8", (6,)),  # the last spike
        ("broken_share", "<f8"),  # of frames that lately broke on the line, where no checksum covers the values
        ("newest_broken_share", "<f8"),  # the same of the last few frames
        ("damaging", "<i8"),  # 1: beyond DAMAGING_SHARE, until UNDAMAGED_SHARE
        ("alike", "<i8"),  # spikes in a row that are near each other, on such a line
        ("spike_count", "<i8"),  # spikes in a row
        ("started", "<i8"),
    ],
    align=True,
)


@kernel
def count_frame(s: Any, broken: bool) -> None:
    """Count a frame of values without a checksum; broken: bytes before it belong to no frame."""
    one = 1.0 if broken else 0.0
    s.broken_share += BROKEN_SHARE_GAIN * (one - s.broken_share)
    s.newest_broken_share += NEWEST_GAIN * (one - s.newest_broken_share)
    damaging = 1 if s.broken_share > (UNDAMAGED_SHARE if s.damaging else DAMAGING_SHARE) else 0
    if damaging != s.damaging:  # the same changes are allowed as before
        for i in range(6):
            s.recent_change[i] *= RATIO / DAMAGED_RATIO if damaging else DAMAGED_RATIO / RATIO
    s.damaging = damaging


@kernel
def allowance(s: Any, ticks: int) -> tuple[float, float]:
    """Factors of `floor` and of `recent_change`, of which the larger product is what an axis may change in `ticks`.

    Motion goes on in many ticks; noise does not, nor does what a line hides that damages most.
    """
    if s.damaging:
        growth = ticks**0.5
        return DAMAGED_FLOOR * growth, DAMAGED_RATIO * growth
    return 1.0 * ticks, RATIO * ticks


@kernel
def limit_of(s: Any, i: int, factors: tuple[float, float]) -> float:
    """How far axis i may change, LSB; factors: see `allowance`."""
    return float(max(factors[0] * s.floor[i], factors[1] * s.recent_change[i]))


@kernel
def deviates(s: Any, ticks: int) -> bool:
    """Whether any axis differs from its last good value by more than it may. Without branches, to be fast."""
    factors = allowance(s, ticks + s.spike_count)
    found = False
    for i in range(6):
        found |= abs(float(s.raw[i] - s.last_good[i])) > limit_of(s, i, factors)
    return found


@kernel
def changes_sign(s: Any, ticks: int) -> bool:
    """Whether an axis differs in another direction than at the spike before; stores the directions."""
    factors = allowance(s, ticks + s.spike_count)
    changed = False
    for i in range(6):
        limit = limit_of(s, i, factors)
        difference = s.raw[i] - s.last_good[i]
        sign = 1 if difference > limit else -1 if difference < -limit else 0
        changed |= sign not in (0, s.sign[i])
        s.sign[i] = sign
    return changed


@kernel
def is_near_last_spike(s: Any, ticks: int) -> bool:
    """Whether no axis has changed by more than it may since the spike before."""
    factors = allowance(s, ticks)
    near = s.spike_count > 0
    for i in range(6):
        limit = limit_of(s, i, factors)
        near &= abs(float(s.raw[i] - s.last_spike[i])) <= limit
    return bool(near)


@kernel
def is_motion(s: Any, ticks: int) -> bool:
    """Whether a sample that deviates shows motion."""
    changed = changes_sign(s, ticks)
    if s.damaging == 0:
        return bool(not changed or s.spike_count >= SPIKES_MAX)
    s.alike = s.alike + 1 if is_near_last_spike(s, ticks) else 1
    share = min(max(float(s.broken_share), float(s.newest_broken_share)), 0.999)
    most = min(max(elementary.log(CHANCE) / elementary.log(share), SPIKES_MAX), DAMAGED_SPIKES_MAX)
    return bool(s.alike >= (ALIKE if share < 0.5 else OFTEN_ALIKE) or s.spike_count >= most)


@kernel
def update_recent_change(s: Any, ticks: int) -> None:
    """The largest change lately; where the line damages values the median of changes."""
    share = 1.0 / ticks
    if s.damaging:
        for i in range(6):
            change, recent = abs(s.raw[i] - s.last_good[i]) * share, s.recent_change[i]
            step = MEDIAN_GAIN * max(recent, DAMAGED_FLOOR * s.floor[i] / DAMAGED_RATIO)
            s.recent_change[i] = recent + step if change > recent else max(recent - step, 0.0)
        return
    for i in range(6):
        s.recent_change[i] = max(s.recent_change[i] * (1.0 - DECAY), abs(s.raw[i] - s.last_good[i]) * share)


@kernel
def is_spike(s: Any, ticks: int) -> bool:
    """Whether s.raw, `ticks` after the sample before, is a spike; updates the record."""
    raw, last_good, sign, recent_change = s.raw, s.last_good, s.sign, s.recent_change
    comparable = s.started and 0 < ticks <= (DAMAGED_GAP_MAX if s.damaging else GAP_MAX)
    if comparable and deviates(s, ticks) and not is_motion(s, ticks):
        for i in range(6):
            s.last_spike[i] = raw[i]
            if sign[i] != 0 and s.damaging == 0:  # so that a difference that repeats is taken as motion
                recent_change[i] += abs(raw[i] - last_good[i]) * SPIKE_SHARE / ticks
        if s.damaging:
            update_recent_change(s, ticks)
        s.spike_count += 1
        return True
    if comparable:
        update_recent_change(s, ticks)
    for i in range(6):
        last_good[i], sign[i] = raw[i], 0
    s.spike_count, s.started = 0, 1
    return False
