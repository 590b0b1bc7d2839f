"""From the device's COUNT word to ticks: sample periods since the first sample, wraps removed, lost samples counted.

What one sample adds to COUNT differs between models and rates (1, 2, 20, …), so the most frequent difference is
learned. A jump of COUNT is accepted once `CONFIRMED` frames continue from it: the value may be damaged, which a 16-bit
checksum can miss, and two frames in a row may be damaged alike. Until then, and if COUNT does not count at all, each
frame is one tick, and so is the length of a frame of junk before it. If a checksum covers COUNT, a short jump is
accepted at once. A jump to a COUNT near 0, from which it goes on, is a device that was switched on anew.
"""

from typing import Any

import numpy as np

from ..jit import kernel

VOTES = 24  # lead of the most frequent difference over all others before it is taken as the step
CONFIRMED = 2  # frames that must continue from a jump
SHORT = 16  # samples of a jump that is accepted at once if a checksum covers COUNT
LOST_MAX = 2048  # samples; a longer jump means that the counter was restarted
FIRST = 16  # samples since it was restarted, at most, where the jump is to a COUNT near 0
LOST_AT_WRAP = 64  # samples; a jump to there over no more of them is a loss while COUNT wraps

COUNTING = np.dtype(
    [
        ("step", "<i8"),  # of COUNT per sample; 0: not known
        ("candidate", "<i8"),
        ("votes", "<i8"),
        ("accepted", "<i8"),  # the last COUNT accepted
        ("since", "<i8"),  # ticks returned since then
        ("unaccepted", "<i8"),  # the last COUNT not accepted
        ("confirmed", "<i8"),  # frames in sequence that continued from there
        ("begun_anew", "<i8"),  # 1: with this frame it is known that COUNT has begun anew at 0
    ],
    align=True,
)


@kernel
def learn_step(c: Any, count: int) -> None:
    """Majority vote over differences (Boyer and Moore, MJRTY, 1981)."""
    step = (count - c.accepted) & 0xFFFF
    c.accepted = count
    if step == c.candidate:
        c.votes = min(c.votes + 1, VOTES)
    elif c.votes == 0:
        c.candidate, c.votes = step, 1
    else:
        c.votes -= 1
    if c.votes == VOTES and 0 < c.candidate < 0x8000:
        c.step = c.candidate


@kernel
def ticks_since(c: Any, count: int, missing: int, first: bool, checked: bool) -> int:
    """Ticks from the last frame to this one with `count` (-1: has none) after junk of the size of `missing` frames."""
    expected = 1 + missing
    c.begun_anew = 0
    if first:
        c.accepted = count
        return 0
    if count < 0:
        return expected
    if c.step == 0:
        learn_step(c, count)
        return expected
    ahead = (count - c.accepted) & 0xFFFF
    if ahead == c.step and c.since == 0:  # as nearly always
        c.accepted, c.confirmed = count, 0
        return 1
    ticks = ahead // c.step - c.since
    if ahead % c.step != 0 or ticks > LOST_MAX:
        ticks = 0
    goes_on = c.since > 0 and (count - c.unaccepted) & 0xFFFF == c.step
    c.confirmed = c.confirmed + 1 if goes_on else 0
    ticks_max = max(expected, SHORT) if checked else expected
    if not (1 <= ticks <= ticks_max or c.confirmed >= CONFIRMED):
        c.unaccepted = count
        c.since += expected
        return expected
    if c.confirmed >= CONFIRMED and c.step <= count <= FIRST * c.step and not 1 <= ticks <= LOST_AT_WRAP:
        c.begun_anew = 1
        ticks = 1
    c.accepted, c.since = count, 0
    return int(max(ticks, 1))
