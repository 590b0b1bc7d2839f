"""The quantization of the gyro: the size of its least significant bit, and how often each code about zero is read.

A rate that passes through the codes reads each for about the same time, but the one at zero twice as long if readings
are truncated toward zero (`truncation`). Only a rate that goes all the way from one side of the window to the other is
such a crossing, and a rest on the way spoils it; the noise of a rest is evaluated by itself (`rest_histogram`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Vector
from .rest_histogram import count_at_rest, evaluate_full_block, reset_blocks, start_block
from .state import BINS, WINDOW
from .truncation import add_evidence, reset_evidence, update_truncation

if TYPE_CHECKING:
    from .types import Parameters, State

# Log likelihood ratio of one reading, that a given code is twice as wide as the others, against that none is: if the
# reading shows that code, and if it shows another.
SHOWN = math.log(2.0 * BINS / (BINS + 1.0))
NOT_SHOWN = math.log(BINS / (BINS + 1.0))


@kernel
def update_quantization(p: Parameters, s: State, w: Vector) -> None:
    """Learn from one sample of rates as read."""
    c, z = p.tuning, s.quantization
    at_rest = s.stationarity.low_motion_s >= c.stationary_time_s
    informative = False
    if at_rest and z.rest_samples == c.block_samples:
        start_block(s)
    for i in range(3):
        step, lsb = abs(w[i] - z.last_reading[i]), z.lsb[i]
        z.last_reading[i] = w[i]
        if c.min_step_radps < step < 0.99 * lsb:
            z.lsb[i] = step
            informative |= reset_axis(p, s, i)
        elif c.min_lsb_radps < lsb < c.max_lsb_radps:
            informative |= count_reading(p, s, i, w[i], step, at_rest)
    if at_rest:
        informative |= evaluate_full_block(p, s)
    if informative:
        update_truncation(p, s)


@kernel
def count_reading(p: Parameters, s: State, i: int, w: float, step: float, at_rest: bool) -> bool:
    """Count the reading w of axis i, `step` from the last one, rad/s; returns whether it was informative."""
    z = s.quantization
    if abs(w) > (WINDOW + 1) * z.lsb[i]:  # far from zero, as most are in motion
        return leave_window(s, i, math.copysign(1.0, w))
    x = w / z.lsb[i]
    k = math.floor(x - z.offset[i] + 0.5)
    if abs(k) > WINDOW:
        return leave_window(s, i, math.copysign(1.0, x))
    if abs(x - z.offset[i] - k) > p.tuning.max_code_error:
        z.offset[i] = x - math.floor(x + 0.5)
        return reset_axis(p, s, i)
    code = i * BINS + WINDOW + k
    if at_rest:
        count_at_rest(s, i, code, step / z.lsb[i])
        z.last_side[i] = 0.0
    else:
        z.crossing_histogram[code] += 1.0
        z.crossing_count[i] += 1.0
    return False


@kernel
def leave_window(s: State, i: int, side: float) -> bool:
    """Axis i is beyond the window; if it came from beyond the other end, learn from the crossing."""
    z = s.quantization
    count, before = z.crossing_count[i], z.last_side[i]
    z.last_side[i] = side
    if count == 0.0:
        return False
    z.crossing_count[i] = 0.0
    crossed = bool(side == -before)
    weight = min(1.0, BINS / count)  # more readings than bins come from uneven rotation
    for k in range(i * BINS, (i + 1) * BINS):
        shown = z.crossing_histogram[k]
        if crossed:
            add_evidence(s, k, weight * (NOT_SHOWN * (count - shown) + SHOWN * shown))
        z.crossing_histogram[k] = 0.0
    return crossed


@kernel
def reset_axis(p: Parameters, s: State, i: int) -> bool:
    """Start again with axis i; returns whether anything was known of it."""
    z = s.quantization
    for k in range(i * BINS, (i + 1) * BINS):
        z.crossing_histogram[k] = 0.0
    z.last_side[i] = z.crossing_count[i] = 0.0
    reset_blocks(p, s)
    return reset_evidence(s, i)
