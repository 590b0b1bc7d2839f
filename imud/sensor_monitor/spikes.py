"""Replaces spikes: single readings that are no motion but damage, on the wire or by electric fields, past any checksum.

Each reading is compared with the extrapolation of the ones before: linear, or constant where noise rules. A spike
differs from it by far more than readings have lately differed. All axes of that sensor are replaced by their
extrapolation, and the next samples decide whether it was motion. It was, if the next reading is near the one that was
withheld, or changes on as that did; if rates and forces showed a shock, as by a tap, that decays; or if a third sample
in a row deviates. Then the differences that were withheld are added to this sample, so that neither rotation nor
velocity is lost. Otherwise the sample was damaged.

A force that deviates together with a rate is replaced, too. One that deviates alone may be a real shock, shorter than
a sample if samples are rare: it is damage only if it is far beyond all recent shocks, and gone in the next sample.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.jit import kernel

if TYPE_CHECKING:
    from .types import Spikes

RATIO = 4.0  # a rate deviates from so many times the largest recent deviation on
MIN_RATE_RADPS, MIN_RATE_RADPS2 = 1.0, 100.0  # smaller deviations of a rate, and per second, are motion
FORCE_RATIO, MIN_FORCE_MPS2 = 2.0, 3.0  # the same of the force beside a rate that deviates
MEMORY_S = 0.25  # time constant with which recent deviations decay
RINGING_HZ = 200.0  # at this rate a shock lasts for more than a sample; at lower ones a lone force is damage only if
# it is larger, and no shock was in a longer time: both in proportion to the period squared
NEAR = 0.3  # a reading so near to the withheld one, or to one further on, in its deviation, shows that it was motion
REMAINS, LONE_REMAINS = 0.3, 0.1  # a deviation is over when less of it remains; the second: of a lone force
SHOCK_DECAYS = 0.8  # most share of a shock that remains in the next sample
MAX_SHOCK_RADPS = 10.0  # no shock turns a sensor faster
MOST_WITHHELD = 2  # samples in a row
MIN_BEGUN = 2  # samples after a start or a gap that are not judged: the first itself may be damaged
GAP_PERIODS = 4.0  # periods between samples from which they are not compared
RATES, FORCES = 0b000111, 0b111000  # bits of the axes
AXES = (1, 2, 4, 8, 16, 32)  # of each of them

SPIKES = np.dtype(
    [
        ("floor", "<f8"),  # rad/s, deviations that are always motion
        ("lone_floor", "<f8"),  # m/s^2, the same of a lone force
        ("decay", "<f8"),  # of recent and recent_force, per sample
        ("shock_decay", "<f8"),  # of recent_shock
        ("gap_ns", "<i8"),  # GAP_PERIODS
        ("t_ns", "<i8"),  # of the last sample
        ("last", "<f8", (6,)),  # rates, rad/s, and forces, m/s^2, that were not replaced
        ("step", "<f8", (6,)),  # their change from sample to sample
        ("mean_step", "<f8", (6,)),  # its mean magnitude lately
        ("mean_bend", "<f8", (6,)),  # and that of the change of the step: more than the step if all is noise
        ("reading", "<f8", (6,)),  # scratch: the sample as measured
        ("deviation", "<f8", (6,)),  # scratch: from its extrapolation
        ("recent", "<f8", (3,)),  # rad/s, largest deviation of each rate, decaying
        ("recent_force", "<f8"),  # m/s^2, largest magnitude of the force's deviation, decaying
        ("recent_shock", "<f8"),  # the same, decaying slowly
        ("begun", "<i8"),  # samples since the first, or since a gap, up to MIN_BEGUN
        ("elapsed", "<i8"),  # samples since the last that was not replaced
        ("count", "<i8"),  # samples in a row that are withheld
        ("axes", "<i8"),  # of them, that were replaced: bits 0 to 5
        ("seen", "<f8", (6,)),  # the last of them as measured
        ("jump", "<f8", (6,)),  # and its deviation; 0 in axes that were not replaced
        ("replaced", "<i8"),  # axes of this sample that have been replaced: bits 0 to 5
        ("withheld", "<f8", (6,)),  # what was measured in all of them less what replaced it
    ],
    align=True,
)


def new_spikes(rate_hz: float) -> Any:
    """A record (array of one SPIKES) for samples at this rate."""
    s = np.zeros(1, SPIKES)
    s["floor"] = max(MIN_RATE_RADPS, MIN_RATE_RADPS2 / rate_hz)
    ambiguity = max(1.0, (RINGING_HZ / rate_hz) ** 2)
    s["lone_floor"] = MIN_FORCE_MPS2 * ambiguity
    s["decay"] = math.exp(-1.0 / (MEMORY_S * rate_hz))
    s["shock_decay"] = math.exp(-1.0 / (MEMORY_S * ambiguity * rate_hz))
    s["gap_ns"], s["t_ns"] = round(GAP_PERIODS * 1e9 / rate_hz), -(10**18)
    return s


@kernel
def read(s: Spikes, sample: Any) -> None:
    """The reading, and its deviation from what the samples before let expect."""
    wx, wy, wz, fx, fy, fz = sample.w[0], sample.w[1], sample.w[2], sample.f[0], sample.f[1], sample.f[2]
    s.reading[0], s.reading[1], s.reading[2], s.reading[3], s.reading[4], s.reading[5] = wx, wy, wz, fx, fy, fz
    for i in range(6):
        slope = s.step[i] if s.mean_bend[i] < s.mean_step[i] else 0.0
        s.deviation[i] = s.reading[i] - (s.last[i] + slope * (1 + s.elapsed))


@kernel
def magnitude(v: Any, first: int) -> float:
    """Of the rates (first: 0) or the forces (3) in v."""
    return math.sqrt(v[first] * v[first] + v[first + 1] * v[first + 1] + v[first + 2] * v[first + 2])


@kernel
def growth(s: Spikes) -> float:
    """By how much an extrapolation over the withheld samples is worse than one by a single step."""
    return 0.5 * (1 + s.elapsed) * (2 + s.elapsed)


@kernel
def deviating_axes(s: Spikes, invalid: int, force: float) -> int:
    """Axes, bits 0 to 5, that deviate; invalid: axes that are not tested. force: their magnitude.

    Where a force deviates, all three do.
    """
    deviating, worse = 0, growth(s)
    for i in range(3):
        largest = worse * max(s.floor, RATIO * s.recent[i])
        if abs(s.deviation[i]) > largest and invalid >> i & 1 == 0:
            deviating |= 1 << i
    if invalid & FORCES:
        return deviating
    with_rate = worse * max(MIN_FORCE_MPS2, FORCE_RATIO * s.recent_force)
    alone = worse * max(s.lone_floor, RATIO * s.recent_shock)
    beside = deviating != 0 or s.axes & RATES != 0
    return deviating | FORCES if force > (with_rate if beside else alone) else deviating


@kernel
def remaining_axes(s: Spikes) -> int:
    """Of the axes that were withheld, those whose deviation remains."""
    remaining = 0
    if s.axes & RATES and magnitude(s.deviation, 0) > REMAINS * magnitude(s.jump, 0):
        remaining |= s.axes & RATES
    share = REMAINS if s.axes & RATES else LONE_REMAINS
    if s.axes & FORCES and magnitude(s.deviation, 3) > share * magnitude(s.jump, 3):
        remaining |= FORCES
    return remaining


@kernel
def was_motion(s: Spikes, remaining: int) -> bool:
    """Whether this sample shows that what was withheld before was motion."""
    if remaining == 0:
        return False
    if s.count >= MOST_WITHHELD or s.axes & RATES == 0:  # a lone force: nothing must remain of damage
        return True
    rate, force = magnitude(s.deviation, 0), magnitude(s.deviation, 3)
    rate_before, force_before = magnitude(s.jump, 0), magnitude(s.jump, 3)
    on = change2 = 0.0
    for i in range(3):
        on += (s.reading[i] - s.seen[i]) * s.jump[i]
    on = min(max(on / (rate_before * rate_before), 0.0), 1.0)  # the rate stays (0), or rises on as it did (1)
    for i in range(3):
        change2 += (s.reading[i] - s.seen[i] - on * s.jump[i]) ** 2
    if change2 < NEAR**2 * rate_before * rate_before:
        return True
    decays = rate < SHOCK_DECAYS * rate_before and force < SHOCK_DECAYS * force_before
    return bool(force_before > 0.0 and rate_before < MAX_SHOCK_RADPS and decays)


@kernel
def withhold(s: Spikes, sample: Any, deviating: int) -> None:
    """Replace the rates, the forces or both by their extrapolation."""
    axes = (RATES if deviating & RATES else 0) | (deviating & FORCES)
    for i in range(6):
        replaced = axes >> i & 1 == 1
        s.seen[i] = s.reading[i]
        s.jump[i] = s.deviation[i] if replaced else 0.0
        s.withheld[i] += s.jump[i]
        if replaced and i < 3:
            sample.w[i] -= s.deviation[i]
        elif replaced:
            sample.f[i - 3] -= s.deviation[i]
    s.elapsed, s.count, s.replaced = s.elapsed + 1, s.count + 1, axes
    s.axes |= deviating


@kernel
def give_back(s: Spikes, sample: Any) -> None:
    """What was withheld was motion: it is added to this sample."""
    for i in range(3):
        sample.w[i] += s.withheld[i]
        sample.f[i] += s.withheld[3 + i]
        s.recent[i] = max(s.recent[i], min(abs(s.jump[i]), RATIO * max(s.floor, RATIO * s.recent[i])))
    force = magnitude(s.jump, 3)
    s.recent_force, s.recent_shock = max(s.recent_force, force), max(s.recent_shock, force)


@kernel
def forget_withheld(s: Spikes, remaining: int) -> None:
    """Only these axes may still be motion; the rates, or the forces, that are none of them were damaged."""
    s.axes = remaining
    for i in range(6):
        if remaining & (RATES if i < 3 else FORCES) == 0:
            s.withheld[i] = 0.0


@kernel
def discard(s: Spikes) -> None:
    """Nothing is withheld any more."""
    s.count = s.axes = 0
    for i in range(6):
        s.withheld[i] = s.jump[i] = 0.0


@kernel
def accept(s: Spikes, invalid: int, neighbours: bool, force: float) -> None:
    """The reading is good: the extrapolation goes on from it."""
    worse, periods = growth(s), 1 + s.elapsed
    follows = neighbours and s.elapsed == 0
    for i in range(6):  # without branches, so that it compiles to vector code
        good = (invalid & AXES[i] == 0) & (abs(s.reading[i]) < math.inf)
        step = (s.reading[i] - s.last[i]) / periods if neighbours else 0.0
        mean_step = s.mean_step[i] + (1.0 - s.decay) * (abs(step) - s.mean_step[i])
        mean_bend = s.mean_bend[i] + (1.0 - s.decay) * (abs(step - s.step[i]) - s.mean_bend[i])
        s.mean_step[i] = mean_step if good & follows else s.mean_step[i]
        s.mean_bend[i] = mean_bend if good & follows else s.mean_bend[i]
        s.step[i], s.last[i] = step if good else s.step[i], s.reading[i] if good else s.last[i]
    for i in range(3):
        good = (invalid & AXES[i] == 0) & (abs(s.reading[i]) < math.inf)
        deviation = min(abs(s.deviation[i]) / worse, max(s.floor, RATIO * s.recent[i]))
        recent = max(s.recent[i] * s.decay, deviation) if neighbours else 0.0
        s.recent[i] = recent if good else s.recent[i]
    force = force / worse
    if neighbours and force < math.inf:
        s.recent_force = max(s.recent_force * s.decay, force)
        force = min(force, 0.5 * max(s.lone_floor, RATIO * s.recent_shock))  # one spike does not hide the next
        s.recent_shock = max(s.recent_shock * s.shock_decay, force)
    s.elapsed = 0
    discard(s)


@kernel
def replace_spikes(s: Spikes, sample: Any, invalid: int, frozen: bool) -> int:
    """Replace spikes; returns in which axes the samples before showed one: bits 0 to 2 of rates, 3 to 5 of forces.

    invalid: axes that have another fault. frozen: an axis is frozen, so that the next sample is not compared with this
    one. If the spike before was motion, what was withheld is added to `sample`. A sample that is not newer is ignored.
    """
    s.replaced = 0
    if sample.t_ns <= s.t_ns:
        return 0
    neighbours = sample.t_ns - s.t_ns <= s.gap_ns
    s.t_ns = sample.t_ns - (s.gap_ns if frozen else 0)
    read(s, sample)
    s.begun = min(s.begun + 1, MIN_BEGUN) if neighbours else 0
    force = magnitude(s.deviation, 3)
    deviating = deviating_axes(s, invalid, force) if s.begun == MIN_BEGUN else 0
    damaged = 0
    if s.count > 0 and neighbours:
        remaining = remaining_axes(s)
        if was_motion(s, remaining):
            give_back(s, sample)
            deviating = 0
        elif remaining:
            damaged = s.axes & ~remaining
            forget_withheld(s, remaining)
            deviating |= remaining
        else:
            damaged = s.axes
            discard(s)
    if deviating:
        withhold(s, sample, deviating)
    else:
        accept(s, invalid, neighbours, force)
    return damaged
