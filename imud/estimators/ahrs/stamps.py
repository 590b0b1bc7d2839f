"""Stamps that scatter about even samples: the readings show it, and then the samples count as even.

Where stamps are right, a sample that comes late, between its neighbours, has a reading that is as much nearer to the
next one's; where even samples have stamps with errors, it has not. So the part of the reading's way from one neighbour
to the other is regressed on that of the stamp: the slope is 1 if the stamps are right, and 0 if only they are uneven.
It is learned while the body turns, and where it does not turn it does not matter.

The period to integrate over is that of a line through the stamps, followed with the slope as gain: with 1 it is what
the stamps say. A sample that is further from the line than stamps scatter comes after lost ones, or it is late, and the
next ones come at once, from a queue. Which of the two it is shows the next sample; until then it is what it was the
last time. Samples of a queue are even, whatever their stamps. The line is compared with the newest of them, which is
known once the next queue begins; how far that is behind it shows how many are lost. Packets are queues without end.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Vector

if TYPE_CHECKING:
    from .types import Parameters, State

PRIOR_SAMPLES = 16.0  # as so many samples counts the period assumed beforehand
LINE_SAMPLES = 100.0  # a line is fitted to so many samples at most: the clocks drift
PRIOR_VARIANCE = 0.25  # of the slope, about a half
LEAST_SCATTER = 0.02  # in periods; with less the stamps are taken as they are
SCATTER_SIGMAS = 4.0  # what is further from the line is no scatter
NOISE_SIGMAS = 4.0  # a change of the rate within so many of the gyro's noise shows nothing
LEAST_PERIOD = 0.05  # in periods: time does not stand still
MAX_MISFITS = 32  # so many samples off the line: the rate has changed, or there is no even one
BLOCK_SAMPLES = 32  # whose mean period is compared with the line's
LOSS_PROBABILITY = 0.01  # of a sample, beforehand
LOG_LOSS_PROBABILITY = math.log(LOSS_PROBABILITY)
LOSSES_TO_SETTLE = 10  # where samples were late, so many lost ones in a row show that none is any more
AT_ONCE = 0.25  # in periods; within it of the one before it a sample comes from a queue
MAX_REACH = 0.75  # in periods; what is further from one is no scatter, but lost or late
MAX_SLOPE_OF_QUEUES = 0.5  # where stamps are rather right no sample comes from a queue
PERIOD_ERROR = 0.05  # of the period assumed beforehand
LEAST_CHANGE = 0.25  # in periods, over a block; the line follows less by itself


@kernel
def forget_stamps(s: State) -> None:
    """After a long gap there is no line, and no neighbour to compare with."""
    s.stamps.last_dt = s.stamps.ahead = 0.0
    s.stamps.waiting = s.stamps.late = s.stamps.queued = 0
    s.stamps.unobserved = 0.0
    begin_block(s)


@kernel
def begin_block(s: State) -> None:
    """The next samples are those whose mean period is taken."""
    s.stamps.block_samples, s.stamps.block_s = 0, 0.0


@kernel
def restart_stamps(s: State, period: float) -> None:
    """Begin anew, with this period; `ahead` stays, so that what has not been integrated yet will be.

    The slope stays, too.
    """
    stamps = s.stamps
    stamps.last_dt, stamps.period = 0.0, period
    stamps.waiting = stamps.late = stamps.queued = stamps.misfits = stamps.losses_to_settle = 0
    stamps.unobserved = 0.0
    stamps.count = stamps.squares = 0.0
    update_gain(s)


@kernel
def scatters(s: State) -> bool:
    """Do the stamps scatter so much that it matters?"""
    return s.stamps.scatter > LEAST_SCATTER * s.stamps.period


@kernel
def least_gain(s: State) -> float:
    """Of a line fitted to all samples, or as many as the clocks allow."""
    return 4.0 / min(s.stamps.count + 4.0, LINE_SAMPLES)


@kernel
def least_slope(s: State) -> float:
    """The slope less its sigma."""
    return s.stamps.slope - math.sqrt(s.stamps.slope_variance)


@kernel
def update_gain(s: State) -> None:
    """What the sums say: the scatter, the slope, and how closely the line follows the stamps."""
    stamps = s.stamps
    stamps.scatter = math.sqrt(stamps.squares / max(stamps.count, 1.0))
    prior = stamps.reading_reading / (PRIOR_VARIANCE * max(stamps.taught, 1.0))
    total = stamps.offset_offset + prior
    stamps.slope, stamps.slope_variance = 0.5, PRIOR_VARIANCE
    if total > 0.0:
        stamps.slope = (stamps.offset_reading + 0.5 * prior) / total
        stamps.slope_variance = PRIOR_VARIANCE * prior / total
    stamps.gain = min(max(least_slope(s), least_gain(s)), 1.0)


@kernel
def compare_with_neighbours(p: Parameters, s: State, w: Vector, dt: float) -> None:
    """Rate w came dt after the last: is the reading of the last one where its stamp lies between its neighbours?

    Only a change of the rate beyond the gyro's noise shows it, and at rest there is none. A sudden one is no better
    evidence than a small one, so that all count over their squares.
    """
    stamps = s.stamps
    before = stamps.last_dt
    half = 0.5 * (before - dt) / (before + dt)  # how much nearer to this one the stamp is, over the way
    way2 = change2 = offset_offset = offset_reading = reading_reading = 0.0
    for i in range(3):
        first, second = stamps.rate_change[i], w[i] - s.imu.w[i]
        by_stamp, by_reading = half * (first + second), 0.5 * (first - second)
        way2 += (first + second) ** 2
        change2 += first * first + second * second
        offset_offset += by_stamp * by_stamp
        offset_reading += by_stamp * by_reading
        reading_reading += by_reading * by_reading
    noise2 = NOISE_SIGMAS**2 * 2.0 * p.gyro_psd / stamps.period
    if way2 > noise2 and s.stationarity.stationary == 0:
        share = 1.0 - noise2 / way2
        kept, each = max(1.0 - share * dt / p.tuning.stamp_time_s, 0.0), share / change2
        stamps.taught = kept * stamps.taught + share
        stamps.offset_offset = kept * stamps.offset_offset + each * offset_offset
        stamps.offset_reading = kept * stamps.offset_reading + each * offset_reading
        stamps.reading_reading = kept * stamps.reading_reading + each * reading_reading


@kernel
def add_to_scatter(p: Parameters, s: State, dt: float, square: float) -> None:
    """A sample, dt after the one before that was on the line, s; the square of its stamp's distance, s^2."""
    stamps = s.stamps
    kept = max(1.0 - dt / p.tuning.stamp_time_s, 0.0)
    stamps.squares = kept * stamps.squares + square
    stamps.count = kept * stamps.count + 1.0


@kernel
def count_misfit(s: State) -> None:
    """The sample is off the line, and comes from no queue."""
    before = s.stamps.misfits
    s.stamps.misfits += 2
    if before <= MAX_MISFITS < s.stamps.misfits:
        begin_block(s)
        s.stamps.block_samples = -1


@kernel
def gate_of(s: State) -> float:
    """What is further from the line is no scatter, s: it is likelier that a sample is lost.

    By Bayes' rule, of two normal distributions a period apart. The rate is as unsure as the line is short.
    """
    stamps = s.stamps
    rate_error = PERIOD_ERROR * stamps.unobserved * 4.0 / (stamps.count + 4.0)
    by_scatter = -LOG_LOSS_PROBABILITY * stamps.scatter**2 / stamps.period
    return max(0.5 * stamps.period + by_scatter, rate_error * stamps.period)


@kernel
def periods_since_last(s: State, dt: float) -> float:
    """How many periods after the last sample this one was taken, which was stamped dt later."""
    stamps = s.stamps
    if stamps.waiting == 1 and dt < 0.5 * stamps.period:
        stamps.queued = max(stamps.queued - 1, 0)
        return 1.0
    late = dt - stamps.ahead - stamps.period
    if abs(late) < gate_of(s):
        stamps.misfits, stamps.queued = max(stamps.misfits - 1, 0), max(stamps.queued - 1, 0)
        stamps.waiting = 0
        return 1.0
    periods = math.floor(late / stamps.period + 1.5)
    if periods < 1.0:
        stamps.losses_to_settle = LOSSES_TO_SETTLE if dt < AT_ONCE * stamps.period else max(stamps.losses_to_settle, 1)
        if stamps.queued == 0 and dt > LEAST_PERIOD * stamps.period:
            count_misfit(s)
        stamps.queued = max(stamps.queued - 1, 0)
        return max(periods, 0.0)
    stamps.queued = int(min(periods, 1e6)) + (stamps.queued if stamps.waiting == 0 else 0)
    if stamps.losses_to_settle > 0 and least_slope(s) < MAX_SLOPE_OF_QUEUES:
        lost = lost_in_queue(s)
        if lost + 1.0 < periods and not (stamps.waiting == 1 and stamps.late == 1):
            if lost > 0.0 or (stamps.waiting == 1 and stamps.ahead > gate_of(s)):
                count_misfit(s)
            stamps.waiting = 1
            return lost + 1.0
    count_misfit(s)
    stamps.losses_to_settle, stamps.waiting = max(stamps.losses_to_settle - 1, 0), 0
    return periods


@kernel
def lost_in_queue(s: State) -> float:
    """So many samples of a queue, whose newest was the last one, have not come."""
    if s.stamps.waiting == 0 or -s.stamps.ahead < gate_of(s):
        return 0.0
    return math.floor(-s.stamps.ahead / s.stamps.period + 0.5)


@kernel
def follow_rate(s: State, dt: float) -> bool:
    """Compare the mean period of a block without lost or late samples with the line's. Has the line begun anew?"""
    stamps = s.stamps
    scatter = SCATTER_SIGMAS * math.sqrt(2.0) * stamps.scatter  # of the difference of two stamps
    restarts = stamps.misfits > MAX_MISFITS
    if stamps.block_samples < 0:
        stamps.block_samples = 0
        return False
    if not restarts and abs(dt - stamps.period) > min(max(0.5 * stamps.period, scatter), MAX_REACH * stamps.period):
        begin_block(s)
        return False
    stamps.block_samples += 1
    stamps.block_s += dt
    if stamps.block_samples < BLOCK_SAMPLES:
        return False
    mean = stamps.block_s / stamps.block_samples
    if dt < 0.5 * mean:  # within a packet, which ends with the next one that comes late
        return False
    hidden = 1.0 if scatter > MAX_REACH * stamps.period else 0.0  # a lost sample may pass for scatter
    if restarts:
        restart_stamps(s, mean)
    elif BLOCK_SAMPLES * abs(mean - stamps.period) > (LEAST_CHANGE + hidden) * stamps.period + scatter:
        stamps.period = mean
    begin_block(s)
    return restarts


@kernel
def even_period(p: Parameters, s: State, w: Vector, has_rate: bool, dt: float) -> float:
    """The period over which the rate w, stamped dt after the last one, is to be integrated, s.

    The sum of the periods is that of the stamps, but for `ahead`.
    """
    stamps = s.stamps
    waited, came_late, before = stamps.waiting, stamps.late == 1, stamps.ahead
    from_queue = dt < 0.5 * stamps.period and (waited == 1 or stamps.queued > 0)
    periods = periods_since_last(s, dt)
    restarted = follow_rate(s, dt)
    is_late = periods > 1.0 or (stamps.waiting == 1 and not from_queue)
    ends_queue = waited == 1 and stamps.waiting == 1 and is_late
    early = before + periods * stamps.period - dt  # by how much the stamp is before the line
    if ends_queue:
        early = before + (periods - 1.0) * stamps.period  # that of the sample before
    period = dt - before
    if stamps.waiting == 1:
        gain = stamps.gain if scatters(s) else 1.0
        period = periods * stamps.period - (gain * early if ends_queue else 0.0)
    elif scatters(s):
        period = periods * stamps.period - stamps.gain * early
    period = max(period, min(LEAST_PERIOD * stamps.period, dt))
    stamps.ahead += period - dt
    on_line = ends_queue or (periods == 1.0 and waited == 0 and stamps.waiting == 0)
    on_line = on_line and abs(early) < gate_of(s)
    stamps.late = 1 if is_late else 0
    stamps.unobserved += 1.0
    if restarted or not has_rate or not (on_line or from_queue or is_late):
        stamps.last_dt = 0.0
        return period
    if stamps.last_dt > 0.0 and not is_late and (from_queue or not came_late):
        compare_with_neighbours(p, s, w, dt)
    if on_line:
        samples = min(stamps.count + max(PRIOR_SAMPLES / stamps.unobserved, 2.5), LINE_SAMPLES)
        stamps.period -= 6.0 * early / (samples * samples * stamps.unobserved)
        if ends_queue:
            add_to_scatter(p, s, stamps.unobserved * stamps.period, early * early)
            stamps.misfits = max(stamps.misfits - int(stamps.unobserved), 0)
        elif stamps.last_dt > 0.0 and not came_late:
            # has errors of three stamps: 1 + 4 + 1
            add_to_scatter(p, s, dt, (stamps.last_dt - dt) ** 2 / 6.0)
        stamps.unobserved = 0.0
    update_gain(s)
    for i in range(3):
        stamps.rate_change[i] = w[i] - s.imu.w[i]
    stamps.last_dt = dt
    return period


@kernel
def time_lost(p: Parameters, s: State, dt: float) -> float:
    """Of the time dt since the last sample that for which samples are missing, s."""
    return dt - s.stamps.period if dt > p.tuning.gap_periods * s.stamps.period else 0.0


@kernel
def stamp_variance(s: State) -> float:
    """Of what is left of the errors of the stamps in the periods, s^2.

    With a gain of 1 that is all of their scatter: uneven samples say less of the rates between them. In a queue it is
    all of the distance, with the probability that stamps are right: the faster the sensor would then be for a while,
    over its mean rate, the less likely they are.
    """
    stamps = s.stamps
    scatter2, gain = stamps.scatter**2, stamps.gain
    if stamps.waiting == 1:
        rarely = 2.0 * stamps.last_dt / stamps.period if stamps.late == 0 else 0.0  # if it was late no time is missing
        return rarely * (stamps.slope_variance + stamps.slope**2) * max(scatter2, stamps.ahead**2)
    return (gain * (2.0 - gain) + stamps.slope_variance + (stamps.slope - gain) ** 2) * scatter2


@kernel
def turn_in_stamp_error(s: State) -> float:
    """By how much the body turns in the error of a stamp, rad: the attitude is that of another time than stated."""
    w, stamps = s.imu.w, s.stamps
    variance = max((1.0 - stamps.gain) * stamps.scatter**2, stamps.ahead**2)
    return math.sqrt(variance * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]))
