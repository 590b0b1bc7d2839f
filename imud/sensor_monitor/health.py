"""Whether an inertial sensor's readings can be true, axis by axis: frozen, at the end of the range, impossible.

`examine` marks a sample whose readings are not credible (flags of `drivers/sample.py`) and says since when they have
not been; what that means for the estimate is the estimator's business.

An axis is frozen when it repeats its value for longer than its noise allows. The noise is learned, because a quiet
sensor with a coarse resolution, or a simulated one without noise, may well repeat itself for ever. From sample to
sample noise goes up and down and motion does not, so noise is measured by second differences, in the quietest block
seen. An axis is judged only if these were at least FINE times its resolution (the smallest change seen) and if its data
sheet promises noise above the resolution. Some sensors hold a value for a few samples: the longest hold seen is usual.

A specific force that differs from gravity is no evidence of a fault: a hand shakes a sensor with 3 g, an aircraft in a
steep turn pulls as much for a minute. Both turn or change. A force that stays the same and far from gravity for 10 s in
a sensor that does not turn would be an acceleration along a straight line to more than 50 m/s.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from imud.drivers.sample import (
    LIMITED_AXES,
    LIMITED_FORCE,
    LIMITED_RATE,
    NO_FORCE,
    NO_RATE,
    NO_RATE_AXES,
    SATURATED,
    SUSPECT,
)

from ..compile.entry import entry
from ..compile.jit import kernel
from ..math.earth import STANDARD_GRAVITY
from ..sensor_errors.profiles import Profile
from .clipping import CLIPPING, is_clipped, new_clipping
from .findings import FINDINGS, FROZEN, INVALID, LIMITED, SPIKE, TEMPERATURE, UNITS, WEIGHT, ZERO
from .spikes import SPIKES, new_spikes, replace_spikes
from .units import RATE_UNITS, new_units, rates_are_in_degrees

if TYPE_CHECKING:
    from .types import Health

LEAST_RUN, LEAST_RUN_S = 20, 0.1  # of equal samples
USUAL = 8  # times the longest hold
BLOCK = 256  # samples from which noise is judged
HOLD = 8  # equal samples that are worth a look, and spoil a block
RESTLESS = BLOCK // 4  # bends to and fro in a block: of white noise three quarters of the samples
FINE = 2.0  # resolutions: mean second difference of white noise of one resolution, of which 20 equal are impossible
ZEROS = 3  # samples whose force is exactly nothing
IMPOSSIBLE = 2.0  # times the range
LATITUDE = 0.999  # of the range: scale factors are rounded
LIGHTEST, HEAVIEST = 0.5, 2.0  # of gravity: a specific force beyond is far from it
FAR_S, NEAR_S = 10.0, 1.0  # for which it is far while the sensor does not turn, or near, without a break
STEADY, STEADY_G = 0.25, 0.1  # of the force, and of gravity: by so much a steady one may change
TURNING = 0.1  # rad/s, beyond the biases of most gyros; an aircraft of 2 g at 170 m/s turns as fast
COLDEST, HOTTEST = -60.0, 130.0  # degC; one damaged word among good ones is none of the sensor's
SHOWN_NS = 2_000_000_000  # so long a finding is reported after it was last made

_RATES, _FORCES = 0b000111, 0b111000
_NO_RATE = _RATES << FROZEN | _RATES << INVALID | 1 << UNITS
_NO_FORCE = _FORCES << FROZEN | _FORCES << INVALID | 1 << ZERO | 1 << WEIGHT

HEALTH = np.dtype(
    [
        ("clipping", CLIPPING),
        ("spikes", SPIKES),
        ("units", RATE_UNITS),
        ("range", "<f8", (6,)),  # rad/s about x y z, m/s^2 along x y z; the sensor's axes
        ("promised", "<f8", (6,)),  # noise of a sample by the profile, same units
        ("least_run", "<i8"),
        ("far_samples", "<i8"),  # in FAR_S
        ("near_samples", "<i8"),  # in NEAR_S
        ("samples", "<i8"),
        ("last_ns", "<i8"),
        ("fresh", "<f8", (6,)),  # scratch: the sample at hand
        ("value", "<f8", (6,)),  # of the newest sample
        ("step", "<f8", (6,)),  # its difference from the one before
        ("curve", "<f8", (6,)),  # and that one's from the one before
        ("finest", "<f8", (6,)),  # smallest difference
        ("turns", "<i8", (6,)),  # changes of the second difference's sign, in the block at hand
        ("bend", "<f8", (6,)),  # sum of its sizes
        ("spoilt", "<i8", (6,)),  # 1: the block says nothing
        ("quietest", "<f8", (6,)),  # mean second difference of the quietest block; infinite: not known
        ("run", "<i8", (6,)),  # equal samples
        ("held", "<i8", (6,)),  # as many, once they are worth a look
        ("run_ns", "<i8", (6,)),  # when that value came
        ("longest", "<i8", (6,)),
        ("zeros", "<i8"),
        ("fever", "<i8"),  # samples in sequence with an impossible temperature
        ("far", "<i8"),  # samples whose force was far from gravity while the sensor did not turn, without a break
        ("near", "<i8"),  # samples in sequence whose force was near gravity
        ("far_ns", "<i8"),  # when the first of `far` came
        ("far_force", "<f8", (3,)),  # and its force
        ("informative_ns", "<i8", (2,)),  # last sample whose rates, and forces, were informative
        ("found_ns", "<i8", (FINDINGS,)),  # when last
        ("found", "<i8", (FINDINGS,)),  # samples
    ],
    align=True,
)


def new_health(profile: Profile, rate_hz: float) -> NDArray[np.void]:
    """A record (array of one HEALTH) for a sensor of this profile at `rate_hz`."""
    h = np.zeros(1, HEALTH)
    h["range"] = np.repeat((LATITUDE * profile.gyro_range, LATITUDE * profile.accel_range), 3)
    h["clipping"], h["spikes"] = new_clipping(rate_hz), new_spikes(rate_hz)
    h["units"] = new_units(rate_hz)
    h["clipping"]["floor"] = np.minimum(h["clipping"]["floor"], h["range"])
    h["promised"] = np.repeat((profile.gyro_noise, profile.accel_noise), 3) * math.sqrt(0.5 * rate_hz)
    h["least_run"] = max(LEAST_RUN, round(LEAST_RUN_S * rate_hz))
    h["far_samples"], h["near_samples"] = max(LEAST_RUN, round(FAR_S * rate_hz)), max(1, round(NEAR_S * rate_hz))
    h["finest"] = h["quietest"] = math.inf
    h["value"] = math.nan
    return h


@kernel
def take(h: Health, sample: Any) -> bool:
    """Note the values and what they tell of the noise; returns whether any of them deserves a closer look.

    Nearly all of what it costs to judge a sample is here, so there are no branches: this can become vector code.
    """
    value, step, curve, finest, turns, bend, run = h.value, h.step, h.curve, h.finest, h.turns, h.bend, h.run
    for i in range(3):
        h.fresh[i], h.fresh[3 + i] = sample.w[i], sample.f[i]
    odd = False
    bends = 0.0
    for i in range(6):
        v = h.fresh[i]
        d = v - value[i]
        size = abs(d)
        second = d - step[i]
        turns[i] += second * curve[i] < 0.0
        bend[i] += abs(second)
        bends += bend[i]
        finest[i] = min(finest[i], size if size > 0.0 else math.inf)
        curve[i], step[i], value[i] = second, d, v
        odd |= (run[i] >= HOLD - 1) | (not abs(v) < h.clipping.floor[i])
        run[i] = run[i] + 1 if size == 0.0 else 0
    return odd | (not bends < math.inf)


@kernel
def end_block(h: Health) -> None:
    """At the end of a block, learn the noise of each axis that held no value in it."""
    for i in range(6):
        if h.spoilt[i] == 0 and h.turns[i] >= RESTLESS:
            h.quietest[i] = min(h.quietest[i], h.bend[i] / BLOCK)
        h.bend[i] = 0.0
        h.turns[i] = h.spoilt[i] = 0


@kernel
def repeats_itself(h: Health, i: int, t_ns: int) -> bool:
    """Whether axis i has held its value for too long."""
    most = max(h.least_run, USUAL * h.longest[i])
    if h.run[i] < HOLD:
        if h.held[i] < most:
            h.longest[i] = max(h.longest[i], h.held[i])
        h.held[i] = 0
        return False
    if h.run[i] == HOLD:
        h.run_ns[i] = t_ns - HOLD * (t_ns - h.last_ns)
    h.held[i] = h.run[i]
    h.spoilt[i] = 1
    fine = FINE * h.finest[i] <= h.quietest[i] < math.inf and h.finest[i] <= h.promised[i]
    return bool(fine and h.run[i] >= most)


@kernel
def judge_axis(h: Health, i: int, t_ns: int) -> int:
    """Findings on axis i."""
    size = abs(h.value[i])
    if not math.isfinite(size):
        h.spoilt[i] = 1
        return 1 << (INVALID + i)
    if not math.isfinite(h.curve[i]):  # one of the two values before was not
        h.step[i] = h.curve[i] = h.bend[i] = 0.0
        h.spoilt[i] = 1
    if size >= h.range[i]:
        h.spoilt[i] = 1
        return 1 << ((INVALID if size > IMPOSSIBLE * h.range[i] else LIMITED) + i)
    if size > h.clipping.floor[i] and is_clipped(h.clipping, i, h.value[i], h.step[i]):
        h.spoilt[i] = 1
        return 1 << (LIMITED + i)
    return 1 << (FROZEN + i) if repeats_itself(h, i, t_ns) else 0


@kernel
def is_steady(h: Health, square: float) -> bool:
    """Whether the sensor does not turn, and shows the force of the first far sample."""
    v = h.value
    turn2 = change2 = 0.0
    for i in range(3):
        turn2 += v[i] * v[i]
        change2 += (v[3 + i] - h.far_force[i]) ** 2
    return bool(turn2 < TURNING**2 and change2 < STEADY**2 * square + (STEADY_G * STANDARD_GRAVITY) ** 2)


@kernel
def is_far_from_gravity(h: Health, square: float, t_ns: int) -> bool:
    """Whether the specific force (its square in (m/s^2)^2) has been far from gravity for so long that it is false."""
    if (LIGHTEST * STANDARD_GRAVITY) ** 2 < square < (HEAVIEST * STANDARD_GRAVITY) ** 2:
        h.near += 1
        if h.near >= h.near_samples or h.far < h.far_samples:
            h.far = 0
    elif 0.0 < square < math.inf:
        h.near = 0
        if h.far > 0 and (h.far >= h.far_samples or is_steady(h, square)):
            h.far += 1
        else:
            h.far, h.far_ns = 1, t_ns
            for i in range(3):
                h.far_force[i] = h.value[3 + i]
    return bool(h.far >= h.far_samples)


@kernel
def judge_force(h: Health, t_ns: int) -> int:
    """Findings on the three forces together."""
    f = h.value
    square = f[3] * f[3] + f[4] * f[4] + f[5] * f[5]
    h.zeros = h.zeros + 1 if square == 0.0 else 0
    findings = 1 << ZERO if h.zeros >= ZEROS else 0
    return findings | 1 << WEIGHT if is_far_from_gravity(h, square, t_ns) else findings


@kernel
def mark(h: Health, sample: Any, findings: int) -> None:
    """Write what the findings mean into the sample, and when they were made into the record."""
    t_ns = sample.t_ns
    for i in range(FINDINGS):
        if findings >> i & 1:
            h.found_ns[i] = t_ns
            h.found[i] += 1
    if findings & (0b111111 << LIMITED):
        sample.flags |= SATURATED
        sample.flags |= LIMITED_RATE if findings & (_RATES << LIMITED) else 0
        sample.flags |= (findings >> LIMITED & _RATES) * LIMITED_AXES
        sample.flags |= LIMITED_FORCE if findings & (_FORCES << LIMITED) else 0
    since = t_ns
    for i in range(6):
        if findings >> (FROZEN + i) & 1:
            since = min(since, h.run_ns[i])
    if findings & _NO_RATE:
        sample.flags |= NO_RATE
        if findings >> UNITS & 1 == 0:
            sample.flags |= (findings >> FROZEN & _RATES) * NO_RATE_AXES
        since = min(since, h.informative_ns[0])
    if findings & _NO_FORCE:
        sample.flags |= NO_FORCE
        since = min(since, h.informative_ns[1])
    if findings >> WEIGHT & 1:
        since = min(since, h.far_ns)
    sample.outage_s = (t_ns - since) * 1e-9


@kernel
def examine(h: Health, sample: Any) -> None:
    """Judge one sample (sensor axes, stamped) and mark it. Damage on the wire says nothing of the sensor."""
    sample.outage_s = 0.0
    if sample.flags & SUSPECT:
        return
    if h.samples == 0:
        h.informative_ns[0] = h.informative_ns[1] = sample.t_ns
    findings = 0
    if take(h, sample) or h.samples == 0:
        for i in range(6):
            findings |= judge_axis(h, i, sample.t_ns)
    findings |= judge_force(h, sample.t_ns)
    findings |= 1 << UNITS if rates_are_in_degrees(h.units, sample) else 0
    frozen = findings >> FROZEN & _RATES != 0
    findings |= replace_spikes(h.spikes, sample, findings >> LIMITED | findings >> INVALID, frozen) << SPIKE
    h.fever = h.fever + 1 if sample.temperature < COLDEST or sample.temperature > HOTTEST else 0
    if h.fever >= LEAST_RUN:
        findings |= 1 << TEMPERATURE
    h.samples += 1
    if h.samples % BLOCK == 0:
        end_block(h)
    if findings:
        mark(h, sample, findings)
    h.last_ns = sample.t_ns
    if findings & _NO_RATE == 0:
        h.informative_ns[0] = sample.t_ns
    if findings & _NO_FORCE == 0:
        h.informative_ns[1] = sample.t_ns


@entry
def examine_all(health: NDArray[np.void], samples: NDArray[np.void]) -> None:
    """`examine` each of these samples."""
    for k in range(len(samples)):
        examine(health[0], samples[k])


@entry
def shown(health: NDArray[np.void]) -> int:
    """The findings of the last `SHOWN_NS`, bit by bit, of a HEALTH record array: one that comes and goes stays."""
    h = health[0]
    now_ns = max(h.informative_ns[0], h.informative_ns[1])
    for i in range(FINDINGS):
        now_ns = max(now_ns, h.found_ns[i])
    findings = 0
    for i in range(FINDINGS):
        if h.found[i] > 0 and now_ns - h.found_ns[i] < SHOWN_NS:
            findings |= 1 << i
    return findings
