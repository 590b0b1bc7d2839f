"""Whether an inertial sensor's readings can be true, axis by axis: frozen, at the end of the range, impossible.

`check_sample` marks a sample whose readings cannot be true (flags of `drivers/sample.py`), and says for how long they
have not been (`outage_s`); estimators read both.

An axis is frozen when it repeats its value for longer than its noise allows. The noise is learned, because a sensor
with little noise and a coarse resolution, or a simulated one without noise, may repeat a value for ever. Noise changes
its sign from sample to sample and motion does not, so noise is measured by second differences, in the block in which
they were smallest. An axis can be found frozen only if these were at least MIN_NOISE_STEPS times its resolution (the
smallest change seen) and if the noise of its data sheet is above the resolution. Some sensors hold each value for a few
samples: a hold is too long only if it is HOLD_FACTOR times the longest one seen before.

A sample that is repeated shows in all axes together: n axes of known noise need 1/n of the samples of one. What axes
repeat because their noise is small shows nothing; but if one of a sensor's has changed until the repetition began, all
three count as frozen with it. In what moves from the start on the noise may not become known. There a repeated sample
shows by its rates: they would have turned the force, and no acceleration turns with a body so exactly. Only a simulated
one may; so this holds where no axis has been seen to hold its value. Samples that are read several times before a new
one comes are usual after a while.

The noise of an axis that has never changed cannot be learned, but that of its neighbours can, after two blocks: the
gyros of a device have about the same noise and resolution, and so have its accelerometers. Such an axis is frozen if it
has repeated for ALL_REPEAT_S, and the quietest neighbour of known noise has NEIGHBOUR_NOISE_STEPS times its resolution.
This holds for devices only, not for arrays and tables, and not for an axis that the device does not have.

The noise of a device that repeats one sample from its first block on cannot be learned. When all axes have repeated for
ALL_REPEAT_S this is reported until one changes, but its samples are used: where the resolution is so coarse that all
axes are constant at rest, they are right. Arrays and tables may come from a simulation without noise, so this holds for
devices only.

A specific force that differs from gravity is no evidence of a fault: a hand shakes a sensor with 3 g, an aircraft in a
steep turn has as much for a minute. Both rotate, or the force changes. A constant force far from gravity for 10 s,
without rotation, would be an acceleration along a straight line to more than 34 m/s.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from imud.drivers.sample import (
    LIMITED_AXES,
    LIMITED_FORCE,
    LIMITED_RATE,
    NO_FORCE,
    NO_RATE,
    NO_RATE_AXES,
    SATURATED,
    SUSPECT,
    UNCONFIRMED_RATE,
)

from ..compile.entry import entry
from ..compile.jit import kernel
from ..math.arrays import Records
from ..math.earth import STANDARD_GRAVITY
from ..sensor_errors.profiles import Profile
from .clipping import CLIPPING, is_clipped, new_clipping
from .findings import FINDINGS, FROZEN, INVALID, LIMITED, REPEATED, SPIKE, TEMPERATURE, UNITS, WEIGHT, ZERO
from .spikes import SPIKES, new_spikes, replace_spikes
from .units import RATE_UNITS, new_units, rates_are_in_degrees

if TYPE_CHECKING:
    from .types import Health

MIN_REPEATS, MIN_REPEATS_S = 20, 0.1  # least number, and time, of equal samples of a frozen axis
MIN_WHOLE_REPEATS = 4  # least number of equal samples where all axes repeat
MAX_INT = 2**62
HOLD_FACTOR = 8  # an axis is frozen from so many times its longest hold on
ALL_REPEATS, ALL_REPEAT_S = 100, 1.0  # the same where the noise of an axis, or of all, is not known
BLOCK = 256  # samples over which noise is measured
LONG_HOLD = 8  # equal samples from which an axis is checked; noise is not measured in their block
MIN_SIGN_CHANGES = BLOCK // 4  # of second differences in a block of noise; white noise has three times as many
MAX_SHARE = 16.0 / BLOCK  # of a block's second differences in the largest one, if they are noise; white noise: 5
MIN_NOISE_STEPS = 2.0  # mean second difference, in resolutions, from which 20 equal samples in a row are impossible
NEIGHBOUR_NOISE_STEPS = 4.0  # the same of a neighbour; an axis of a third of its noise would change in a second, too
MIN_TURN_SAMPLES, MAX_TURN = 64, 0.1  # rad, by which repeated rates may have turned a force that repeats; samples
HELD_S = 0.5  # a sensor without noise repeats its values for longer at rest, or on level ground
REST_TURN = 0.02  # rad; what repeats a sample and would have turned the force by less may rest
ZERO_SAMPLES = 3  # samples in a row whose specific force is exactly 0
IMPOSSIBLE_RATIO = 2.0  # a reading beyond so many times the range is impossible
RANGE_SHARE = 0.999  # a reading from this share of the range on is at its end: scale factors are rounded
MIN_FORCE_G, MAX_FORCE_G = 0.65, 1.7  # times gravity; a range wrong by a factor of 2 is beyond them, with its bias
FAR_S, NEAR_S = 10.0, 1.0  # time far from gravity that is a fault, and near gravity that ends the fault
STEADY, STEADY_G = 0.25, 0.1  # a constant force changes by less than these shares of itself and of gravity
TURN_RATE = 0.1  # rad/s of a rotation: more than most gyro biases; an aircraft of 1.7 g at 135 m/s has as much
MIN_TEMPERATURE, MAX_TEMPERATURE = -60.0, 130.0  # degC, for MIN_REPEATS samples: one may be a damaged word
REPORT_NS = 2_000_000_000  # time for which a finding is reported after it was last made

_RATES, _FORCES = 0b000111, 0b111000
_NO_RATE = _RATES << FROZEN | _RATES << INVALID | 1 << UNITS
_NO_FORCE = _FORCES << FROZEN | _FORCES << INVALID | 1 << ZERO | 1 << WEIGHT

HEALTH = np.dtype(
    [
        ("clipping", CLIPPING),
        ("spikes", SPIKES),
        ("units", RATE_UNITS),
        ("range", "<f8", (6,)),  # rad/s about x y z, m/s^2 along x y z; the sensor's axes
        ("profile_noise", "<f8", (6,)),  # standard deviation of a sample by the profile, same units
        ("min_repeats", "<i8"),
        ("all_repeats", "<i8"),  # samples from which it is reported that all axes repeat
        ("unchanged_repeats", "<i8", (6,)),  # from which an axis that has never changed is frozen
        ("far_samples", "<i8"),  # in FAR_S
        ("near_samples", "<i8"),  # in NEAR_S
        ("samples", "<i8"),
        ("last_ns", "<i8"),
        ("reading", "<f8", (6,)),  # scratch: rates and forces of the sample
        ("suspicious", "<i8", (6,)),  # scratch: 1: the axis may be at fault
        ("value", "<f8", (6,)),  # of the newest sample
        ("difference", "<f8", (6,)),  # its difference from the sample before
        ("second_difference", "<f8", (6,)),  # the change of that difference
        ("resolution", "<f8", (6,)),  # smallest difference seen
        ("sign_changes", "<i8", (6,)),  # of the second difference, in the present block
        ("second_difference_sum", "<f8", (6,)),  # sum of its magnitudes in the block
        ("second_difference_max", "<f8", (6,)),  # the largest of them
        ("difference_sum", "<f8", (6,)),  # sum of the magnitudes of the difference
        ("block_invalid", "<i8", (6,)),  # 1: do not measure noise in this block
        ("noise", "<f8", (6,)),  # least mean second difference of a block; infinite: not known
        ("noise_is_pure", "<i8", (6,)),  # 1: neither motion nor a step was a large part of them
        ("repeats", "<i8", (6,)),  # equal samples in a row
        ("hold", "<i8", (6,)),  # the same from LONG_HOLD on, and until the hold has ended
        ("repeats_start_ns", "<i8", (6,)),  # time of the first of them
        ("whole_repeats", "<i8"),  # equal samples in a row in all axes at once
        ("whole_start_ns", "<i8"),  # time of the first of them
        ("whole_repeat_count", "<i8"),  # samples that were equal to the one before
        ("min_whole_repeats", "<i8"),
        ("has_held", "<i8"),  # 1: an axis has repeated its value for HELD_S, and not in motion with all others
        ("longest_hold", "<i8", (6,)),  # longest normal hold seen
        ("zero_count", "<i8"),  # samples in a row with a specific force of exactly 0
        ("bad_temperature_count", "<i8"),  # samples in a row with an impossible temperature
        ("far_count", "<i8"),  # samples in a row with a constant force far from gravity
        ("near_count", "<i8"),  # samples in a row with a force near gravity
        ("far_start_ns", "<i8"),  # time of the first sample in far_count
        ("far_force", "<f8", (3,)),  # m/s^2, its specific force
        ("informative_ns", "<i8", (2,)),  # time of the last sample with credible rates, and with credible forces
        ("found_ns", "<i8", (FINDINGS,)),  # of each finding, when it was last made
        ("found_count", "<i8", (FINDINGS,)),  # and in how many samples
    ],
    align=True,
)


def new_health(
    profile: Profile,
    rate_hz: float,
    is_device: bool = False,
    gyro_axes: tuple[bool, bool, bool] = (True, True, True),
) -> Records:
    """A record (array of one HEALTH) for a sensor of this profile at `rate_hz`.

    is_device: its samples come from a device, not from arrays or tables that may have been simulated without noise.
    gyro_axes: which gyros it has; the rates of the others are constant.
    """
    h = np.zeros(1, HEALTH)
    h["range"] = np.repeat((RANGE_SHARE * profile.gyro_range, RANGE_SHARE * profile.accel_range), 3)
    h["clipping"], h["spikes"] = new_clipping(rate_hz), new_spikes(rate_hz)
    h["units"] = new_units(rate_hz)
    h["clipping"]["floor"] = np.minimum(h["clipping"]["floor"], h["range"])
    h["profile_noise"] = np.repeat((profile.gyro_noise, profile.accel_noise), 3) * math.sqrt(0.5 * rate_hz)
    h["min_repeats"] = max(MIN_REPEATS, round(MIN_REPEATS_S * rate_hz))
    h["min_whole_repeats"] = max(MIN_WHOLE_REPEATS, round(MIN_REPEATS_S * rate_hz))
    h["all_repeats"] = max(ALL_REPEATS, round(ALL_REPEAT_S * rate_hz)) if is_device else np.iinfo(np.int64).max
    h["unchanged_repeats"] = np.where((*gyro_axes, True, True, True), h["all_repeats"][0], np.iinfo(np.int64).max)
    h["far_samples"], h["near_samples"] = max(MIN_REPEATS, round(FAR_S * rate_hz)), max(1, round(NEAR_S * rate_hz))
    h["resolution"] = h["noise"] = math.inf
    h["value"] = math.nan
    return h


@kernel
def update_statistics(h: Health, sample: Any) -> bool:
    """Update the statistics of all axes with a sample; returns whether any axis may be at fault, for `check_axis`.

    There are no branches, and what the axes have in common comes behind the loop, so that it compiles to vector code.
    """
    value, difference, second_difference, resolution = h.value, h.difference, h.second_difference, h.resolution
    sign_changes, second_difference_sum, repeats = h.sign_changes, h.second_difference_sum, h.repeats
    second_difference_max, difference_sum = h.second_difference_max, h.difference_sum
    wx, wy, wz, fx, fy, fz = sample.w[0], sample.w[1], sample.w[2], sample.f[0], sample.f[1], sample.f[2]
    h.reading[0], h.reading[1], h.reading[2], h.reading[3], h.reading[4], h.reading[5] = wx, wy, wz, fx, fy, fz
    for i in range(6):
        v = h.reading[i]
        d = v - value[i]
        size = abs(d)
        second = d - difference[i]
        h.suspicious[i] = 1 if (repeats[i] >= LONG_HOLD - 1) | (not abs(v) < h.clipping.floor[i]) else 0
        sign_changes[i] += 1 if second * second_difference[i] < 0.0 else 0
        second_difference_sum[i] += abs(second)
        second_difference_max[i] = max(second_difference_max[i], abs(second))
        difference_sum[i] += size
        resolution[i] = min(resolution[i], size if size > 0.0 else math.inf)
        second_difference[i], difference[i], value[i] = second, d, v
        repeats[i] = repeats[i] + 1 if size == 0.0 else 0
    suspicious, total, whole = 0, 0.0, repeats[0]
    for i in range(6):
        suspicious |= h.suspicious[i]
        total += second_difference_sum[i]
        whole = min(whole, repeats[i])
    h.whole_repeats = whole
    if whole > 0:
        h.whole_repeat_count += 1
        h.whole_start_ns = h.last_ns if whole == 1 else h.whole_start_ns
    return suspicious != 0 or whole >= h.min_whole_repeats or not total < math.inf


@kernel
def end_block(h: Health) -> None:
    """At the end of a block, update the noise of each axis for which the block is valid."""
    for i in range(6):
        if h.block_invalid[i] == 0 and h.sign_changes[i] >= MIN_SIGN_CHANGES:
            total = h.second_difference_sum[i]
            if total < BLOCK * h.noise[i]:
                pure = h.difference_sum[i] < total and h.second_difference_max[i] < MAX_SHARE * total
                h.noise[i], h.noise_is_pure[i] = total / BLOCK, 1 if pure else 0
        h.second_difference_sum[i] = h.second_difference_max[i] = h.difference_sum[i] = 0.0
        h.sign_changes[i] = h.block_invalid[i] = 0


@kernel
def has_noisy_neighbours(h: Health, i: int) -> bool:
    """Whether axis i would change if it had a third of the noise of the gyros, or accelerometers, beside it."""
    steps = math.inf
    first = 3 * (i // 3)
    for k in range(first, first + 3):
        if h.noise[k] < math.inf:
            steps = min(steps, h.noise[k] / h.resolution[k] if h.resolution[k] <= h.profile_noise[k] else 0.0)
    return bool(NEIGHBOUR_NOISE_STEPS <= steps < math.inf)


@kernel
def turn_of_force2(h: Health, steps: float, elapsed_s: float) -> float:
    """Square of the angle by which the rates would have turned the force, of so many samples ago (0 or 1), rad^2."""
    v, d = h.value, h.difference
    w = (v[0] - steps * d[0], v[1] - steps * d[1], v[2] - steps * d[2])
    f = (v[3] - steps * d[3], v[4] - steps * d[4], v[5] - steps * d[5])
    x, y, z = w[1] * f[2] - w[2] * f[1], w[2] * f[0] - w[0] * f[2], w[0] * f[1] - w[1] * f[0]
    return float((x * x + y * y + z * z) * elapsed_s**2 / max(f[0] * f[0] + f[1] * f[1] + f[2] * f[2], 1e-9))


@kernel
def was_repeated_in_motion(h: Health, i: int, t_ns: int) -> bool:
    """Whether axis i, which has just changed, had repeated its value because the whole sample was repeated.

    Its rates would have turned the force by then: a sensor without noise that rests may repeat a sample, too.
    """
    start, last, period = h.repeats_start_ns[i], h.last_ns, t_ns - h.last_ns
    whole = h.whole_start_ns - start <= LONG_HOLD * period
    return bool(whole and turn_of_force2(h, 1.0, (last - start) * 1e-9) > REST_TURN**2)


@kernel
def repeats_itself(h: Health, i: int, t_ns: int) -> bool:
    """Whether axis i has held its value for too long."""
    most = max(h.min_repeats, HOLD_FACTOR * h.longest_hold[i])
    if h.repeats[i] < LONG_HOLD:
        if LONG_HOLD <= h.hold[i] < MAX_INT and not was_repeated_in_motion(h, i, t_ns):
            h.has_held |= 1 if h.last_ns - h.repeats_start_ns[i] > 1e9 * HELD_S else 0
            if h.hold[i] < most:
                h.longest_hold[i] = max(h.longest_hold[i], h.hold[i])
        h.hold[i] = 0
        return False
    if h.repeats[i] == LONG_HOLD:
        h.repeats_start_ns[i] = t_ns - LONG_HOLD * (t_ns - h.last_ns)
    h.hold[i] = h.repeats[i]
    h.block_invalid[i] = 1
    if h.repeats[i] >= h.unchanged_repeats[i] and h.samples - h.repeats[i] < BLOCK:
        return has_noisy_neighbours(h, i)
    return bool(is_fine(h, i) and h.repeats[i] >= most)


@kernel
def is_fine(h: Health, i: int) -> bool:
    """Whether the noise of axis i is known, and enough that it hardly ever repeats a value."""
    fine = MIN_NOISE_STEPS * h.resolution[i] <= h.noise[i] < math.inf
    return bool(fine and h.resolution[i] <= h.profile_noise[i])


@kernel
def is_impossible_turn(h: Health, t_ns: int) -> bool:
    """Whether the rates that are repeated would have turned the force that is, in a sensor whose axes do not repeat."""
    for i in range(6):
        if h.has_held == 1 or h.repeats[i] >= h.whole_repeats + LONG_HOLD:
            return False
    turn2 = turn_of_force2(h, 0.0, (t_ns - h.whole_start_ns) * 1e-9)
    return bool(h.samples >= MIN_TURN_SAMPLES and turn2 > MAX_TURN**2)


@kernel
def axes_of_repeated_sample(h: Health, t_ns: int) -> int:
    """The axes, as bits, of a sample that is repeated for too long: what n axes show together needs 1/n of the time.

    Those count with it that alone may well repeat a value: all of a sensor of which one has changed until then.
    """
    fine = 0
    for i in range(6):
        fine += 1 if is_fine(h, i) else 0
    usual = h.samples / max(h.samples - h.whole_repeat_count, 1)  # equal samples for each reading
    least = max(float(h.min_whole_repeats), HOLD_FACTOR * (usual - 1.0))
    if h.whole_repeats < least or (fine * h.whole_repeats < MIN_REPEATS and not is_impossible_turn(h, t_ns)):
        return 0
    axes = 0
    for i in range(6):
        first = 3 * (i // 3)
        repeats = min(h.repeats[first], h.repeats[first + 1], h.repeats[first + 2])
        if repeats == h.whole_repeats:
            axes |= 1 << i
            h.repeats_start_ns[i] = h.whole_start_ns
            h.hold[i] = MAX_INT  # not a usual one
            h.block_invalid[i] = 1
    return axes


@kernel
def is_repeated(h: Health) -> bool:
    """Whether all axes have repeated their values for too long, and since the first block."""
    for i in range(6):
        if h.repeats[i] < h.all_repeats or h.samples - h.repeats[i] >= BLOCK:
            return False
    return True


@kernel
def check_axis(h: Health, i: int, t_ns: int) -> int:
    """Findings on axis i, as bits."""
    size = abs(h.value[i])
    if not math.isfinite(size):
        h.block_invalid[i] = 1
        return 1 << (INVALID + i)
    if not math.isfinite(h.second_difference[i]):  # one of the two values before was not finite
        h.difference[i] = h.second_difference[i] = h.second_difference_sum[i] = 0.0
        h.second_difference_max[i] = h.difference_sum[i] = 0.0
        h.block_invalid[i] = 1
    if size >= h.range[i]:
        h.block_invalid[i] = 1
        return 1 << ((INVALID if size > IMPOSSIBLE_RATIO * h.range[i] else LIMITED) + i)
    if size > h.clipping.floor[i]:
        step, bend, noise = h.difference[i], h.second_difference[i], h.noise[i]
        noise = noise if h.resolution[i] <= noise < math.inf else 0.0
        lsbs = noise / h.resolution[i] if h.noise_is_pure[i] == 1 and is_fine(h, i) else 0.0
        if is_clipped(h.clipping, i, h.value[i], step, bend, noise, lsbs, h.whole_repeats > 0):
            h.block_invalid[i] = 1
            return 1 << (LIMITED + i)
    return 1 << (FROZEN + i) if repeats_itself(h, i, t_ns) else 0


@kernel
def is_steady(h: Health, square: float) -> bool:
    """Whether the sensor does not rotate, and its specific force is still that of the first far sample."""
    v = h.value
    turn2 = change2 = 0.0
    for i in range(3):
        turn2 += v[i] * v[i]
        change2 += (v[3 + i] - h.far_force[i]) ** 2
    return bool(turn2 < TURN_RATE**2 and change2 < STEADY**2 * square + (STEADY_G * STANDARD_GRAVITY) ** 2)


@kernel
def is_far_from_gravity(h: Health, square: float, t_ns: int) -> bool:
    """Whether the specific force has been far from gravity for too long. square: of its magnitude, (m/s^2)^2."""
    if (MIN_FORCE_G * STANDARD_GRAVITY) ** 2 < square < (MAX_FORCE_G * STANDARD_GRAVITY) ** 2:
        h.near_count += 1
        if h.near_count >= h.near_samples or h.far_count < h.far_samples:
            h.far_count = 0
    elif 0.0 < square < math.inf:
        h.near_count = 0
        if h.far_count > 0 and (h.far_count >= h.far_samples or is_steady(h, square)):
            h.far_count += 1
        else:
            h.far_count, h.far_start_ns = 1, t_ns
            for i in range(3):
                h.far_force[i] = h.value[3 + i]
    return bool(h.far_count >= h.far_samples)


@kernel
def check_force(h: Health, t_ns: int) -> int:
    """Findings on the specific force as a vector, as bits."""
    f = h.value
    square = f[3] * f[3] + f[4] * f[4] + f[5] * f[5]
    h.zero_count = h.zero_count + 1 if square == 0.0 else 0
    findings = 1 << ZERO if h.zero_count >= ZERO_SAMPLES else 0
    return findings | 1 << WEIGHT if is_far_from_gravity(h, square, t_ns) else findings


@kernel
def mark(h: Health, sample: Any, findings: int) -> None:
    """Set the flags of the sample by the findings; count these in the record, with their times."""
    t_ns = sample.t_ns
    for i in range(FINDINGS):
        if findings >> i & 1:
            h.found_ns[i] = t_ns
            h.found_count[i] += 1
    if findings & (0b111111 << LIMITED):
        sample.flags |= SATURATED
        sample.flags |= LIMITED_RATE if findings & (_RATES << LIMITED) else 0
        sample.flags |= (findings >> LIMITED & _RATES) * LIMITED_AXES
        sample.flags |= LIMITED_FORCE if findings & (_FORCES << LIMITED) else 0
    since = t_ns
    for i in range(6):
        if findings >> (FROZEN + i) & 1:
            since = min(since, h.repeats_start_ns[i])
    if findings & _NO_RATE:
        sample.flags |= NO_RATE
        if findings & (_RATES << INVALID | 1 << UNITS) == 0:  # else all of them
            sample.flags |= (findings >> FROZEN & _RATES) * NO_RATE_AXES
        since = min(since, h.informative_ns[0])
    if findings & _NO_FORCE:
        sample.flags |= NO_FORCE
        since = min(since, h.informative_ns[1])
    if findings >> WEIGHT & 1:
        since = min(since, h.far_start_ns)
    sample.outage_s = (t_ns - since) * 1e-9


@kernel
def check_sample(h: Health, sample: Any) -> None:
    """Check one sample (sensor axes, stamped) and mark it. One that was damaged on the wire is ignored."""
    sample.outage_s = 0.0
    if sample.flags & SUSPECT:
        return
    if h.samples == 0:
        h.informative_ns[0] = h.informative_ns[1] = sample.t_ns
    findings = 0
    if update_statistics(h, sample) or h.samples == 0:
        for i in range(6):
            findings |= check_axis(h, i, sample.t_ns)
        findings |= axes_of_repeated_sample(h, sample.t_ns) << FROZEN
        findings |= 1 << REPEATED if is_repeated(h) else 0
    findings |= check_force(h, sample.t_ns)
    if sample.t_ns > h.last_ns or h.samples == 0:
        findings |= 1 << UNITS if rates_are_in_degrees(h.units, sample) else 0
        sample.flags |= UNCONFIRMED_RATE if h.units.unconfirmed == 1 else 0
    frozen = findings >> FROZEN & _RATES != 0
    findings |= replace_spikes(h.spikes, sample, findings >> INVALID & (_RATES | _FORCES), frozen) << SPIKE
    findings &= ~(h.spikes.replaced << LIMITED)  # the sample no longer shows the end of the range
    impossible = sample.temperature < MIN_TEMPERATURE or sample.temperature > MAX_TEMPERATURE
    h.bad_temperature_count = h.bad_temperature_count + 1 if impossible else 0
    if h.bad_temperature_count >= MIN_REPEATS:
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
def check_samples(health: Records, samples: Records) -> None:
    """`check_sample` for each of these samples."""
    for k in range(len(samples)):
        check_sample(health[0], samples[k])


@entry
def recent_findings(health: Records) -> int:
    """The findings of the last REPORT_NS as bits, of a HEALTH record array; so one that comes and goes stays."""
    h = health[0]
    now_ns = max(h.informative_ns[0], h.informative_ns[1])
    for i in range(FINDINGS):
        now_ns = max(now_ns, h.found_ns[i])
    findings = 0
    for i in range(FINDINGS):
        if h.found_count[i] > 0 and now_ns - h.found_ns[i] < REPORT_NS:
            findings |= 1 << i
    return findings
