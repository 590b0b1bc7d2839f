"""The DMU's timer word: 16 bits of 0.79 us, which wrap every 51.8 ms, to ticks since the first packet.

How many wraps lie between two packets follows from the nominal spacing; which way the timer counts is learned from
packets. Until that is known, and for a timer that contradicts the spacing, a packet is its nominal number of ticks.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from ..jit import kernel
from .packet import TICK_NS

VOTES = 20  # difference of votes that decides for a direction
TIMER = np.dtype(
    [
        ("spacing", "<i8"),  # nominal ticks from packet to packet
        ("last", "<i8"),  # timer word of the last packet
        ("votes", "<i8"),  # for counting up; negative: down
        ("direction", "<i8"),  # 1 up, -1 down, 0 not known
    ],
    align=True,
)


@kernel
def distance(ticks: int, expected: int) -> int:
    """How far `ticks` is from `expected`, whatever the wraps between."""
    return abs(((ticks - expected + 0x8000) & 0xFFFF) - 0x8000)


@kernel
def learn_direction(t: Any, up: int, expected: int) -> None:
    """Vote by one step of the timer; a step that fits neither way removes a vote."""
    far_up, far_down = distance(up, expected), distance(-up, expected)
    if far_up == far_down or min(far_up, far_down) > t.spacing // 2:
        t.votes -= (t.votes > 0) - (t.votes < 0)
    else:
        t.votes += 1 if far_up < far_down else -1
    if abs(t.votes) >= VOTES:
        t.direction = 1 if t.votes > 0 else -1


@kernel
def ticks_since(t: Any, timer: int, missing: int, first: bool) -> int:
    """Ticks from the last packet to this one with the word `timer`, after junk of the size of `missing` packets."""
    up = (timer - t.last) & 0xFFFF
    t.last = timer
    if first:
        return 0
    expected: int = t.spacing * (1 + missing)
    if t.direction == 0:
        learn_direction(t, up, expected)
        return expected
    ahead = up if t.direction > 0 else -up & 0xFFFF
    wraps = max(0, (expected - ahead + 0x8000) >> 16)
    return int(max(1, ahead + (wraps << 16)))


def spacing_ns(timers: Sequence[int], rough_ns: float) -> float:
    """Mean time between packets with these timer words, most of which are about `rough_ns` apart, if the timer agrees.

    Some packets may be missing.
    """
    rough = rough_ns / TICK_NS
    steps = [after - before for before, after in pairwise(timers)]
    if not any(steps):
        return rough_ns
    down, up = ([_unwrapped(direction * step, rough) for step in steps] for direction in (-1, 1))
    best = min(down, up, key=lambda ticks: sorted(abs(one - rough) for one in ticks)[len(steps) // 2])
    mean = sum(best) / sum(max(1, round(one / rough)) for one in best)
    return mean * TICK_NS if abs(mean / rough - 1.0) < 0.1 else rough_ns


def _unwrapped(step: int, expected: float) -> int:
    """The number of ticks nearest to `expected` that a difference of timer words may stand for."""
    ahead = step & 0xFFFF
    return ahead + (max(0, round((expected - ahead) / 0x10000)) << 16)
