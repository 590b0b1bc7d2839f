"""Single rates that no motion makes: damage on the wire, or from electric fields, that no checksum shows.

Such a rate leaves the last good one by far more than rates lately did from sample to sample. It is replaced by that
one, and the next sample decides what it was. If its rate leaves to the same side, or if the force showed a shock and
now rate or force are still far from what they were, it was motion, as of a tap: rotation and velocity that were
withheld are added to the next sample. Else one sample was damaged, and nothing is lost.

Spikes of the accelerometer alone are not sought: many shocks look like one, and one costs the filters little. One that
comes with a spike of the gyro is replaced like it.
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
RINGING = 0.1  # of a tap: the least that remains of it at the next sample
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
        ("force", "<f8", (3,)),  # m/s^2, the last one that was not replaced
        ("withheld_force", "<f8", (3,)),  # m/s^2
        ("push", "<f8"),  # m/s^2, its step from the one before
        ("recent_push", "<f8"),  # m/s^2, largest lately
        ("spike", "<i8"),  # axes of the sample before that were called a spike: bits 0 to 2
        ("shock", "<i8"),  # 1: with a shock
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
def far_axes(s: Spikes, sample: Any, judged: int) -> int:
    """Axes, bits 0 to 2, whose rate is far from the last good one."""
    far = 0
    for i in range(3):
        if abs(sample.w[i] - s.good[i]) > max(s.floor, SUDDEN * s.recent[i]) and judged >> i & 1 == 0:
            far |= 1 << i
    return far


@kernel
def was_motion(s: Spikes, sample: Any, far: int, push: float) -> bool:
    """Does this sample show that the one before, which was called a spike, was motion? `push`: of the force since."""
    withheld2 = step2 = force2 = 0.0
    for i in range(3):
        withheld, step = s.withheld[i], sample.w[i] - s.good[i]
        if withheld * step > 0.5 * withheld * withheld > 0.0:
            return True
        withheld2 += withheld * withheld
        step2 += step * step
        force2 += s.withheld_force[i] ** 2
    rings = (far != 0 and step2 > RINGING**2 * withheld2) or push * push > RINGING**2 * force2
    return bool(s.shock == 1 and rings)


@kernel
def replace_spikes(s: Spikes, sample: Any, judged: int, frozen: bool) -> int:
    """Replace spikes of the gyro; returns in which axes the sample before showed one: bits 0 to 2.

    judged: axes that are at fault anyway. frozen: an axis is; what comes then is not compared with it. Adds to `sample`
    what was withheld from the one before, and was motion. A sample that is not newer is ignored.
    """
    if sample.t_ns <= s.t_ns:
        return 0
    neighbours = sample.t_ns - s.t_ns <= s.gap_ns
    s.t_ns = sample.t_ns - (s.gap_ns if frozen else 0)
    push2 = 0.0
    for i in range(3):
        push2 += (sample.f[i] - s.force[i]) ** 2
    push = math.sqrt(push2)
    pushed = push > max(SHOCK * s.recent_push, SHOCK_MPS2)
    before = s.push > max(SHOCK * s.recent_push, SHOCK_MPS2)  # the shock of a tap may come a sample before the rate
    far = far_axes(s, sample, judged) if neighbours else 0
    motion = s.spike != 0 and neighbours and was_motion(s, sample, far, push if pushed else 0.0)
    spike = far != 0 and not motion
    keep_force = spike and pushed
    for i in range(3):
        rate, force = sample.w[i], sample.f[i]
        if motion:
            sample.w[i] += s.withheld[i]
            sample.f[i] += s.withheld_force[i]
        replaced = spike and far >> i & 1 == 1
        s.withheld[i] = rate - s.good[i] if replaced else 0.0
        s.withheld_force[i] = force - s.force[i] if keep_force else 0.0
        if replaced:
            sample.w[i] = s.good[i]
        elif abs(rate) < math.inf:
            step = min(abs(rate - s.good[i]), max(s.floor, SUDDEN * s.recent[i]))  # one alone must not hide the next
            s.recent[i] = max(s.recent[i] * s.keep, step) if neighbours else 0.0
            s.good[i] = rate
        if keep_force:
            sample.f[i] = s.force[i]
        else:
            s.force[i] = force
    if not keep_force:
        if push < math.inf:
            s.recent_push = max(s.recent_push * s.keep, min(s.push, max(SHOCK * s.recent_push, SHOCK_MPS2)))
        s.push = push
    damaged = 0 if motion else s.spike
    s.spike, s.shock = far if spike else 0, 1 if pushed or before else 0
    return damaged
