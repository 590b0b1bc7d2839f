"""The line that turns a counter into host time, fitted to the earliest arrivals.

No sample arrives before it was sent, and many arrive late: so the line lies below all arrivals, as close to them as
possible. The earliest arrival of each window is a point; all windows grow together, until they reach back four minutes.
The edge of the points' lower convex hull at the middle of the time (of all lines below the points, that with the least
sum of distances) shows which points were in time, and a regression through those gives the slope. Where no arrival is
quite in time the windows' mean arrivals scatter less: they give a second slope, and the two are averaged, weighted by
the inverse of their variances. A slope is accepted if half of the points are near its line: in the first seconds most
may have been late.

Where samples queue behind each other hardly any is in time, so that perhaps no point was. So the line lies below all
points by a depth that is greater the more the points scatter and the fewer they are. Minima tend to a Weibull
distribution; the depth is the expected distance of the least of so many Weibull values from the distribution's end,
scaled by the distance between the points' quartile and median.

Source: Zhang, Liu and Xia, Clock synchronization algorithms for network measurements, IEEE INFOCOM (2002), sec. III.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imud.drivers import elementary

from ..compile.jit import kernel

if TYPE_CHECKING:
    from ..math.arrays import Reals
    from .types import Clock

POINTS, MAX_WINDOW_NS = 64, 4e9  # number of windows, and their greatest length
FIT_SPAN_NS = 3e9  # a slope needs a base line this long; until then the nominal period holds
FAR_NS = 20e6  # more than jitter: a sample this far from the line was counted wrongly, which slewing does not mend
WEIBULL_SHAPE = 2.2  # shape of the Weibull distribution, of arrivals that are hardly ever in time
WEIBULL_DEPTH = math.gamma(1.0 + 1.0 / WEIBULL_SHAPE) / (
    math.log(2.0) ** (1.0 / WEIBULL_SHAPE) - math.log(4.0 / 3.0) ** (1.0 / WEIBULL_SHAPE)
)
PERIOD_TOLERANCE = 0.5  # a fitted period that differs by a greater share from its nominal value is rejected


@kernel
def _merge_windows(clock: Clock) -> None:
    """Merge windows in pairs, so that all are of the same length; once they are long, drop the oldest instead."""
    if clock.window_ns >= MAX_WINDOW_NS:
        for i in range(1, clock.count):
            clock.ticks[i - 1], clock.arrivals[i - 1] = clock.ticks[i], clock.arrivals[i]
            clock.mean_ticks[i - 1], clock.mean_arrivals[i - 1] = clock.mean_ticks[i], clock.mean_arrivals[i]
        clock.count -= 1
        clock.sound_count = max(0, clock.sound_count - 1)
        return
    for i in range(clock.count // 2):
        a = clock.arrivals[2 * i] - clock.slope * clock.ticks[2 * i]
        b = clock.arrivals[2 * i + 1] - clock.slope * clock.ticks[2 * i + 1]
        earlier = 2 * i + (1 if b < a else 0)
        clock.ticks[i], clock.arrivals[i] = clock.ticks[earlier], clock.arrivals[earlier]
        clock.mean_ticks[i] = 0.5 * (clock.mean_ticks[2 * i] + clock.mean_ticks[2 * i + 1])
        clock.mean_arrivals[i] = 0.5 * (clock.mean_arrivals[2 * i] + clock.mean_arrivals[2 * i + 1])
    clock.count //= 2
    clock.sound_count //= 2
    clock.window_ns *= 2.0


@kernel
def add_point(clock: Clock) -> None:
    """Append the window that has ended to the points."""
    if clock.count == POINTS:
        _merge_windows(clock)
    clock.ticks[clock.count] = clock.window_x
    clock.arrivals[clock.count] = clock.window_arrival
    clock.mean_ticks[clock.count] = clock.window_mean_x
    clock.mean_arrivals[clock.count] = clock.window_mean
    clock.count += 1


@kernel
def _hull_slope(clock: Clock) -> float:
    """Slope of the lower hull's edge at the middle of the time."""
    hull = clock.hull
    n = 0
    middle = 0.5 * (clock.ticks[0] + clock.ticks[clock.count - 1])
    for i in range(clock.count):
        while n >= 2:
            a, b = hull[n - 2], hull[n - 1]
            ab = (clock.arrivals[b] - clock.arrivals[a]) * (clock.ticks[i] - clock.ticks[a])
            ai = (clock.arrivals[i] - clock.arrivals[a]) * (clock.ticks[b] - clock.ticks[a])
            if ab < ai:
                break
            n -= 1
        hull[n] = i
        n += 1
    e = 1
    while e < n - 1 and clock.ticks[hull[e]] < middle:
        e += 1
    a, b = hull[e - 1], hull[e]
    return float((clock.arrivals[b] - clock.arrivals[a]) / (clock.ticks[b] - clock.ticks[a]))


@kernel
def _heights(clock: Clock, slope: float) -> tuple[float, float, float]:
    """Of a line of this slope: its offset below all points, their median height above it, and the depth (see above)."""
    heights = clock.heights
    for i in range(clock.count):
        height = clock.arrivals[i] - slope * clock.ticks[i]
        k = i
        while k > 0 and heights[k - 1] > height:
            heights[k] = heights[k - 1]
            k -= 1
        heights[k] = height
    n = clock.count
    depth = (
        WEIBULL_DEPTH / elementary.exp(elementary.log(float(n)) / WEIBULL_SHAPE) * (heights[n // 2] - heights[n // 4])
    )
    return heights[0], heights[n // 2] - heights[0], depth


@kernel
def _regression(
    ticks: Reals, arrivals: Reals, count: int, slope: float, offset: float, scale: float
) -> tuple[float, float]:
    """Slope and its variance; the weight of a point falls with its height above the line, in units of `scale`."""
    origin = ticks[count - 1]
    n = x = y = xx = xy = yy = 0.0
    for i in range(count):
        tick = ticks[i] - origin
        height = arrivals[i] - slope * ticks[i] - offset
        w = 1.0 / (1.0 + (height / scale) ** 2)
        n += w
        x += w * tick
        y += w * height
        xx += w * tick * tick
        xy += w * tick * height
        yy += w * height * height
    xx -= x * x / n
    xy -= x * y / n
    yy -= y * y / n
    return slope + xy / xx, max(yy - xy * xy / xx, 1.0) / (n * xx)


@kernel
def _settled_slope(clock: Clock) -> tuple[float, float]:
    """Slope, and its sigma: of the earliest arrivals near the hull's line and of the windows' means, averaged."""
    slope = _hull_slope(clock)
    offset, median, _ = _heights(clock, slope)
    n = clock.count
    earliest, v_earliest = _regression(clock.ticks, clock.arrivals, n, slope, offset, max(median, 1.0))
    mean, v_mean = _regression(clock.mean_ticks, clock.mean_arrivals, n, slope, offset, np.inf)
    v = v_earliest * v_mean / (v_earliest + v_mean)
    return v * (earliest / v_earliest + mean / v_mean), math.sqrt(v)


@kernel
def _rough_slope(clock: Clock) -> float:
    """Slope from the first point to the last, if those between agree with it but not with the slope so far."""
    last = clock.count - 1
    if last < 2:
        return float(clock.slope)
    span = clock.ticks[last] - clock.ticks[0]
    slope = (clock.arrivals[last] - clock.arrivals[0]) / span
    plausible = abs(slope / clock.period_ns - 1.0) < PERIOD_TOLERANCE and abs(slope - clock.slope) * span > FAR_NS
    for i in range(1, last):
        line = clock.arrivals[0] + slope * (clock.ticks[i] - clock.ticks[0])
        plausible = plausible and abs(clock.arrivals[i] - line) < FAR_NS
    return float(slope if plausible else clock.slope)


@kernel
def refit(clock: Clock, x: float) -> None:
    """Fit the line to the window minima; stamps do not jump, but slew to it from now on. x: ticks since base_tick."""
    before = clock.offset + clock.slope * x
    if (clock.ticks[clock.count - 1] - clock.ticks[0]) * clock.period_ns >= FIT_SPAN_NS:
        slope, sigma = _settled_slope(clock)
        _, median, _ = _heights(clock, slope)
        if abs(slope / clock.period_ns - 1.0) < PERIOD_TOLERANCE and median < FAR_NS:
            clock.slope = slope
            clock.sigma_slope = sigma
            clock.fitted = 1
    if clock.fitted == 1:
        least, median, depth = _heights(clock, clock.slope)
        clock.offset = least - depth
        clock.residual_ns = median + depth
    else:  # an unknown slope makes old points misleading
        clock.slope = _rough_slope(clock)
        clock.offset = np.inf
        for i in range(max(0, clock.count - 2), clock.count):
            clock.offset = min(clock.offset, clock.arrivals[i] - clock.slope * clock.ticks[i])
    clock.slew_ns += before - (clock.offset + clock.slope * x)
