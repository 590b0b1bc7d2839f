"""Replaces spikes: single rates that are no motion but damage, on the wire or by electric fields, past any checksum.

A spike differs from the last good rate by far more than rates have lately changed from sample to sample. It is replaced
by the last good rate, and the next sample decides whether it was motion. It was, if the next rate differs in the same
direction; or if the specific force showed a shock, as by a tap, and rate or force still differ. Then the differences
that were withheld are added to the next sample, so that neither rotation nor velocity is lost. Otherwise the sample was
damaged.

Spikes of the accelerometer alone are not detected: many shocks look like one, and a spike does little harm to the
filters. One that coincides with a spike of the gyro is replaced, too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.jit import kernel

if TYPE_CHECKING:
    from .types import Spikes

CHANGE_RATIO = 4.0  # a rate deviates from so many times the largest recent change on
SHOCK_RATIO, SHOCK_MPS2 = (
    2.0,
    3.0,
)  # a shock: the force changes by so many times its largest recent change, and by so much
MIN_REMAINDER = 0.1  # least share of a tap's change that remains at the next sample
MIN_CHANGE_RADPS, MIN_CHANGE_RADPS2 = 1.0, 100.0  # smaller changes of a rate, and per second, are motion
MEMORY_S = 0.25  # time constant with which recent changes decay
GAP_PERIODS = 4.0  # periods between samples from which they are not compared

SPIKES = np.dtype(
    [
        ("floor", "<f8"),  # rad/s, changes that are always motion
        ("decay", "<f8"),  # of recent_change and recent_force_change, per sample
        ("gap_ns", "<i8"),  # GAP_PERIODS
        ("t_ns", "<i8"),  # of the last sample
        ("last_good", "<f8", (3,)),  # rad/s, the last rate that was not replaced
        ("recent_change", "<f8", (3,)),  # rad/s, largest change between samples, decaying
        ("withheld", "<f8", (3,)),  # rad/s, of the last sample: its rate less the one that replaced it
        ("last_force", "<f8", (3,)),  # m/s^2, the last force that was not replaced
        ("withheld_force", "<f8", (3,)),  # m/s^2, the same of the force
        ("force_change", "<f8"),  # m/s^2, magnitude of the last change of the force
        ("recent_force_change", "<f8"),  # m/s^2, largest one, decaying
        ("spike_axes", "<i8"),  # axes that were replaced in the last sample: bits 0 to 2
        ("shock", "<i8"),  # 1: the last sample or the one before showed a shock
    ],
    align=True,
)


def new_spikes(rate_hz: float) -> Any:
    """A record (array of one SPIKES) for samples at this rate."""
    s = np.zeros(1, SPIKES)
    s["floor"], s["decay"] = max(MIN_CHANGE_RADPS, MIN_CHANGE_RADPS2 / rate_hz), math.exp(-1.0 / (MEMORY_S * rate_hz))
    s["gap_ns"], s["t_ns"] = round(GAP_PERIODS * 1e9 / rate_hz), -(10**18)
    return s


@kernel
def deviating_axes(s: Spikes, sample: Any, excluded: int) -> int:
    """Axes, bits 0 to 2, whose rate deviates from the last good one; excluded: axes that are not tested."""
    deviating = 0
    for i in range(3):
        largest = max(s.floor, CHANGE_RATIO * s.recent_change[i])
        if abs(sample.w[i] - s.last_good[i]) > largest and excluded >> i & 1 == 0:
            deviating |= 1 << i
    return deviating


@kernel
def was_motion(s: Spikes, sample: Any, deviating: int, force_change: float) -> bool:
    """Whether this sample shows that the spike before was motion. force_change: m/s^2, of a shock since, else 0."""
    withheld2 = change2 = withheld_force2 = 0.0
    for i in range(3):
        withheld, change = s.withheld[i], sample.w[i] - s.last_good[i]
        if withheld * change > 0.5 * withheld * withheld > 0.0:
            return True
        withheld2 += withheld * withheld
        change2 += change * change
        withheld_force2 += s.withheld_force[i] ** 2
    rate_remains = deviating != 0 and change2 > MIN_REMAINDER**2 * withheld2
    force_remains = force_change * force_change > MIN_REMAINDER**2 * withheld_force2
    return bool(s.shock == 1 and (rate_remains or force_remains))


@kernel
def replace_spikes(s: Spikes, sample: Any, excluded: int, frozen: bool) -> int:
    """Replace spikes of the gyro; returns in which axes the sample before showed one: bits 0 to 2.

    excluded: axes that have another fault. frozen: an axis is frozen, so that the next sample is not compared with this
    one. If the spike before was motion, what was withheld is added to `sample`. A sample that is not newer is ignored.
    """
    if sample.t_ns <= s.t_ns:
        return 0
    neighbours = sample.t_ns - s.t_ns <= s.gap_ns
    s.t_ns = sample.t_ns - (s.gap_ns if frozen else 0)
    force_change2 = 0.0
    for i in range(3):
        force_change2 += (sample.f[i] - s.last_force[i]) ** 2
    force_change = math.sqrt(force_change2)
    least_shock = max(SHOCK_RATIO * s.recent_force_change, SHOCK_MPS2)
    is_shock, was_shock = force_change > least_shock, s.force_change > least_shock  # the rate may follow a sample later
    deviating = deviating_axes(s, sample, excluded) if neighbours else 0
    motion = s.spike_axes != 0 and neighbours and was_motion(s, sample, deviating, force_change if is_shock else 0.0)
    is_spike = deviating != 0 and not motion
    force_replaced = is_spike and is_shock
    for i in range(3):
        rate, force = sample.w[i], sample.f[i]
        if motion:
            sample.w[i] += s.withheld[i]
            sample.f[i] += s.withheld_force[i]
        replaced = is_spike and deviating >> i & 1 == 1
        s.withheld[i] = rate - s.last_good[i] if replaced else 0.0
        s.withheld_force[i] = force - s.last_force[i] if force_replaced else 0.0
        if replaced:
            sample.w[i] = s.last_good[i]
        elif abs(rate) < math.inf:
            largest = max(s.floor, CHANGE_RATIO * s.recent_change[i])
            change = min(abs(rate - s.last_good[i]), largest)  # bounded, so that one change does not hide the next
            s.recent_change[i] = max(s.recent_change[i] * s.decay, change) if neighbours else 0.0
            s.last_good[i] = rate
        if force_replaced:
            sample.f[i] = s.last_force[i]
        else:
            s.last_force[i] = force
    if not force_replaced:
        if force_change < math.inf:
            s.recent_force_change = max(s.recent_force_change * s.decay, min(s.force_change, least_shock))
        s.force_change = force_change
    damaged = 0 if motion else s.spike_axes
    s.spike_axes, s.shock = deviating if is_spike else 0, 1 if is_shock or was_shock else 0
    return damaged
