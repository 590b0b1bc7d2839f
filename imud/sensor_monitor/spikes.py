"""Single rates that no motion makes: damage on the wire, or from electric fields, that no checksum shows.

Such a rate is replaced by the last good one. It leaves that by far more than rates lately did from sample to sample,
and the specific force shows no shock at the same time: a tap turns a sensor as suddenly, but also pushes it. If the
next rate leaves to the same side, it was motion: the rotation that was withheld is added to this rate. Spikes of the
accelerometer are not sought: many shocks look like one, and one costs the filters little.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.jit import kernel

if TYPE_CHECKING:
    from .types import Spikes

SUDDEN = 4.0  # times the largest of the recent steps
SHOCK, SHOCK_MPS2 = 2.0, 3.0  # times the largest of the recent steps of the force, and a step of so much: a shock
LEAST_RADPS, LEAST_RADPS2 = 1.0, 100.0  # steps of a rate, and per second, below which it is motion
RECENT_S = 0.25  # time constant with which steps are forgotten
GAP = 4.0  # periods after which samples are no neighbours

SPIKES = np.dtype(
    [
        ("floor", "<f8"),  # rad/s
        ("keep", "<f8"),  # of the recent largest step, per sample
        ("gap_ns", "<i8"),
        ("t_ns", "<i8"),
        ("good", "<f8", (3,)),  # rad/s, the last rate that was no spike
        ("recent", "<f8", (3,)),  # rad/s, largest step between samples lately
        ("withheld", "<f8", (3,)),  # rad/s, by which the sample before left, if it was called a spike
        ("force", "<f8", (3,)),  # m/s^2, of the sample before
        ("push", "<f8"),  # m/s^2, its step from the one before
        ("recent_push", "<f8"),  # m/s^2, largest lately
    ],
    align=True,
)


def new_spikes(rate_hz: float) -> Any:
    """A record (array of one SPIKES) for samples at this rate."""
    s = np.zeros(1, SPIKES)
    s["floor"], s["keep"] = max(LEAST_RADPS, LEAST_RADPS2 / rate_hz), math.exp(-1.0 / (RECENT_S * rate_hz))
    s["gap_ns"], s["t_ns"] = round(GAP * 1e9 / rate_hz), -(10**18)
    return s


@kernel
def replace_spikes(s: Spikes, sample: Any, judged: int) -> int:
    """Replace spikes of the gyro; returns which axes show one: bits 0 to 2. `judged`: axes that are at fault anyway.

    Adds to `sample` what was withheld from the one before, and was motion.
    """
    neighbours = sample.t_ns - s.t_ns <= s.gap_ns
    s.t_ns = sample.t_ns
    push2, keep = 0.0, s.keep
    for i in range(3):
        push2 += (sample.f[i] - s.force[i]) ** 2
        s.force[i] = sample.f[i]
    push, before, usual = math.sqrt(push2), s.push, s.recent_push
    shock = max(push, before) > max(SHOCK * usual, SHOCK_MPS2)
    s.push = push
    if push < math.inf:
        s.recent_push = max(usual * keep, before)
    found = 0
    for i in range(3):
        step = sample.w[i] - s.good[i]
        size, withheld = abs(step), s.withheld[i]
        was_motion = withheld * step > 0.5 * withheld * withheld > 0.0
        far = neighbours and not shock and size > max(s.floor, SUDDEN * s.recent[i]) and judged >> i & 1 == 0
        s.withheld[i] = 0.0
        if far and not was_motion:
            found |= 1 << i
            s.withheld[i] = step
            sample.w[i] = s.good[i]
        elif size < math.inf:
            s.recent[i] = max(s.recent[i] * keep, size) if neighbours else 0.0
            s.good[i] = sample.w[i]
            sample.w[i] += withheld if was_motion else 0.0
    return found
