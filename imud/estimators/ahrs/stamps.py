"""Stamps that scatter about even samples: the readings show it, and then the samples count as even.

Where stamps are right, a sample that comes late, between its neighbours, has a reading that is as much nearer to the
next one's; where even samples have stamps with errors, it has not. So the part of the reading's way from one neighbour
to the other is regressed on that of the stamp: the slope is 1 if the stamps are right, and 0 if only they are uneven.
It is learned while the body turns, and where it does not turn it does not matter.

The period to integrate over is that of a line through the stamps, followed with the slope as gain: with 1 it is what
the stamps say. A sample that is further from the line than stamps scatter comes after lost ones, or it is late, and the
next ones come at once. Which of the two it is shows the next sample; until then it is what it was the last time.
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
LEAST_PERIOD = 0.05  # in periods: time does not stand still
MAX_MISFITS = 32  # so many samples off the line: the rate has changed, or there is no even one


@kernel
def forget_stamps(s: State) -> None:
    """After a long gap there is no line, and no neighbour to compare with."""
    s.stamps.last_dt = s.stamps.ahead = 0.0
    s.stamps.waiting = 0


@kernel
def restart_stamps(s: State, period: float) -> None:
    """Begin anew, with this period."""
    stamps = s.stamps
    forget_stamps(s)
    stamps.period, stamps.misfits, stamps.returns = period, 0, 0
    stamps.count = stamps.squares = stamps.offset_offset = stamps.offset_reading = stamps.reading_reading = 0.0


@kernel
def scatter_variance(s: State) -> float:
    """Of the stamps about those of even samples, s^2."""
    return s.stamps.squares / max(s.stamps.count, 1.0)


@kernel
def scatters(s: State) -> bool:
    """Do the stamps scatter so much that it matters?"""
    return scatter_variance(s) > (LEAST_SCATTER * s.stamps.period) ** 2


@kernel
def prior_weight(s: State) -> float:
    """The sum of squared offsets with which the slope would be as uncertain as it is beforehand."""
    return s.stamps.reading_reading / (PRIOR_VARIANCE * max(s.stamps.count, 1.0))


@kernel
def slope_variance(s: State) -> float:
    """Of the slope of the readings' offsets over those of the stamps."""
    prior = prior_weight(s)
    total = s.stamps.offset_offset + prior
    return PRIOR_VARIANCE * prior / total if total > 0.0 else PRIOR_VARIANCE


@kernel
def stamp_gain(s: State) -> float:
    """With which the line follows the stamps: the slope, but no less than the period needs to be learned."""
    stamps, prior = s.stamps, prior_weight(s)
    total = stamps.offset_offset + prior
    slope = (stamps.offset_reading + 0.5 * prior) / total if total > 0.0 else 0.5
    return min(max(slope - math.sqrt(slope_variance(s)), least_gain(s)), 1.0)


@kernel
def least_gain(s: State) -> float:
    """Of a line fitted to all samples, or as many as the clocks allow."""
    return 4.0 / min(s.stamps.count + 4.0, LINE_SAMPLES)


@kernel
def compare_with_neighbours(p: Parameters, s: State, w: Vector, dt: float) -> None:
    """Rate w came dt after the last: is the reading of the last one where its stamp lies between its neighbours?"""
    stamps = s.stamps
    kept = max(1.0 - dt / p.tuning.stamp_time_s, 0.0)
    before = stamps.last_dt
    half = 0.5 * (before - dt) / (before + dt)  # how much nearer to this one the stamp is, over the way
    offset_offset = offset_reading = reading_reading = 0.0
    for i in range(3):
        first, second = stamps.rate_change[i], w[i] - s.imu.w[i]
        by_stamp, by_reading = half * (first + second), 0.5 * (first - second)
        offset_offset += by_stamp * by_stamp
        offset_reading += by_stamp * by_reading
        reading_reading += by_reading * by_reading
    stamps.offset_offset = kept * stamps.offset_offset + offset_offset
    stamps.offset_reading = kept * stamps.offset_reading + offset_reading
    stamps.reading_reading = kept * stamps.reading_reading + reading_reading
    stamps.squares = kept * stamps.squares + (before - dt) ** 2 / 6.0  # has errors of three stamps: 1 + 4 + 1
    stamps.count = kept * stamps.count + 1.0


@kernel
def periods_since_last(s: State, dt: float) -> float:
    """How many periods after the last sample this one was taken, which was stamped dt later."""
    stamps = s.stamps
    late = dt - stamps.ahead - stamps.period
    if abs(late) < max(max(0.5, least_gain(s)) * stamps.period, SCATTER_SIGMAS * math.sqrt(scatter_variance(s))):
        stamps.misfits = max(stamps.misfits - 1, 0)
        stamps.waiting = 0
        return 1.0
    stamps.misfits += 2
    periods = math.floor(late / stamps.period + 1.5)
    if periods < 1.0:
        stamps.returns = 1
        return max(periods, 0.0)
    if scatters(s) and stamps.returns == 1 and (stamps.waiting == 0 or dt < 0.5 * stamps.period):
        stamps.waiting = 1
        return 1.0
    stamps.returns = stamps.waiting = 0
    return periods


@kernel
def even_period(p: Parameters, s: State, w: Vector, has_rate: bool, dt: float) -> float:
    """The period over which the rate w, stamped dt after the last one, is to be integrated, s."""
    stamps = s.stamps
    waited = stamps.waiting
    periods = periods_since_last(s, dt)
    if stamps.misfits > MAX_MISFITS:
        restart_stamps(s, dt)
        return dt
    early = stamps.ahead + periods * stamps.period - dt  # by how much the stamp is before the line
    period = dt
    if scatters(s):
        gain = 0.0 if stamps.waiting == 1 else stamp_gain(s)
        period = max(periods * stamps.period - gain * early, LEAST_PERIOD * stamps.period)
    stamps.ahead += period - dt
    if periods != 1.0 or waited == 1 or stamps.waiting == 1 or not has_rate:
        stamps.last_dt = 0.0
        return period
    stamps.period -= 6.0 * early / min(stamps.count + PRIOR_SAMPLES, LINE_SAMPLES) ** 2
    if stamps.last_dt > 0.0:
        compare_with_neighbours(p, s, w, dt)
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

    With a gain of 1 that is all of their scatter: uneven samples say less of the rates between them.
    """
    gain = stamp_gain(s)
    return (gain * (2.0 - gain) + slope_variance(s)) * scatter_variance(s)


@kernel
def turn_in_stamp_error(s: State) -> float:
    """By how much the body turns in the error of a stamp, rad: the attitude is that of another time than stated."""
    w, stamps = s.imu.w, s.stamps
    variance = (1.0 - stamp_gain(s)) * scatter_variance(s)
    if stamps.waiting == 1:
        variance += stamps.ahead * stamps.ahead
    return math.sqrt(variance * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]))
