"""Time: a device's counter fitted to the host's monotonic clock.

Nothing arrives before it was sent, and much arrives late: so the line that turns a counter into host time lies below
all arrivals and as close to them as it can. Over a window the earliest arrival counts, and the windows grow, all alike,
until they reach back four minutes. The edge of their lower convex hull above the middle (the least sum of distances of
all lines below the points) shows which of them were in time; a regression through those gives the slope, for where no
arrival is quite in time the edge alone wanders with the two it rests on. The line lies below all of them. Stamps follow
a changed line by slewing, never by stepping back.

A counter may be wrong. One that jumped ahead shows at once: its sample was there before it was taken. One that stood
still while samples were not sent (a sensor may have none, and its samples are counted as they come) makes all that
follow late, and equally late; bytes that only waited do not, for whoever reads them has caught up with the end of it.

Source: Zhang, Liu and Xia, Clock synchronization algorithms for network measurements, IEEE INFOCOM (2002), sec. III.
"""

from typing import Any

import numpy as np

from .kernels.jit import kernel

POINTS = 64
WINDOW_NS, LONGEST_NS = 0.5e9, 4e9
FIT_SPAN_NS = 3e9  # a slope needs a base line this long; until then the nominal period holds
SLEW = 0.01  # stamps run at most 1 % fast or slow while they catch up with a changed line
FAR_NS = 20e6  # more than jitter: what is this far from the line was counted wrongly, and is not caught up with slowly
STOP = 0.9  # by how much stamps that are far ahead run slow
WATCH_NS, WATCHED = 250_000_000.0, 4  # host time, and samples at least, of which not one may be in time
SAME_NS = 10e6  # as late as before: more is a line that catches up
UNFITTED_NS = 50e6  # a nominal period may be a few percent off, and the line with it
PATIENCE = 8  # watches after which lateness is believed, whatever it is
LATE_SHARE = 1e-3  # of one sample in the mean lateness
PERIOD_TOLERANCE = 0.1  # a fitted period further off its nominal value is not believed

CLOCK = np.dtype(
    [
        ("period_ns", "<f8"),  # nominal, between ticks
        ("delay_ns", "<f8"),  # from the sample's instant to its arrival at best: filter group delay and wire time
        ("started", "<i8"),
        ("fitted", "<i8"),  # 1: slope comes from arrivals
        ("base_tick", "<i8"),
        ("base_ns", "<i8"),
        ("missed", "<f8"),  # ticks that passed since base_tick and were not counted
        ("slope", "<f8"),  # fitted period, ns per tick
        ("offset", "<f8"),  # ns above base_ns at base_tick
        ("slew_ns", "<f8"),  # what stamps are still ahead of the line
        ("last_tick", "<i8"),
        ("last_ns", "<i8"),
        ("window_ns", "<f8"),  # length
        ("window_start", "<i8"),  # tick
        ("window_x", "<f8"),
        ("window_arrival", "<f8"),
        ("window_residual", "<f8"),
        ("watch_start", "<f8"),  # arrival
        ("watch_samples", "<i8"),
        ("watch_least", "<f8"),  # lateness of the earliest
        ("watch_before", "<f8"),  # and in the watch before
        ("watches", "<i8"),  # in a row that were late
        ("count", "<i8"),
        ("ticks", "<f8", (POINTS,)),  # earliest arrival of each window, oldest first
        ("arrivals", "<f8", (POINTS,)),
        ("hull", "<i8", (POINTS,)),  # scratch
        ("heights", "<f8", (POINTS,)),  # scratch
        ("residual_ns", "<f8"),  # mean distance of the window minima above the line
        ("corrections", "<i8"),  # of the counter
        ("late_ns", "<f8"),  # how much later than at best samples come, mean of late
        ("latest_ns", "<f8"),  # and at most
    ],
    align=True,
)


def new_clock(period_ns: float, delay_ns: float) -> Any:
    """A clock (array of one `CLOCK`) for a counter of nominal `period_ns` whose samples are `delay_ns` old at best."""
    clock = np.zeros(1, CLOCK)
    clock["period_ns"], clock["delay_ns"] = period_ns, delay_ns
    return clock


@kernel
def _restart(clock: Any, tick: int, arrival_ns: int) -> None:
    clock.base_tick = tick
    clock.base_ns = arrival_ns
    if clock.started == 0:
        clock.slope = clock.period_ns
    clock.started = 1
    clock.fitted = 0
    clock.missed = 0.0
    clock.offset = 0.0
    clock.slew_ns = 0.0
    clock.count = 0
    clock.window_ns = WINDOW_NS
    clock.window_start = tick
    clock.window_residual = np.inf
    clock.watches = 0
    _watch_anew(clock, 0.0)


@kernel
def _watch_anew(clock: Any, y: float) -> None:
    clock.watch_start = y
    clock.watch_samples = 0
    clock.watch_least = np.inf


@kernel
def _make_room(clock: Any) -> None:
    """Join windows two by two, which keeps the points alike; once they are long, forget the oldest."""
    if clock.window_ns >= LONGEST_NS:
        for i in range(1, clock.count):
            clock.ticks[i - 1], clock.arrivals[i - 1] = clock.ticks[i], clock.arrivals[i]
        clock.count -= 1
        return
    for i in range(clock.count // 2):
        a = clock.arrivals[2 * i] - clock.slope * clock.ticks[2 * i]
        b = clock.arrivals[2 * i + 1] - clock.slope * clock.ticks[2 * i + 1]
        earlier = 2 * i + (1 if b < a else 0)
        clock.ticks[i], clock.arrivals[i] = clock.ticks[earlier], clock.arrivals[earlier]
    clock.count //= 2
    clock.window_ns *= 2.0


@kernel
def _add_point(clock: Any) -> None:
    if clock.count == POINTS:
        _make_room(clock)
    clock.ticks[clock.count] = clock.window_x
    clock.arrivals[clock.count] = clock.window_arrival
    clock.count += 1


@kernel
def _hull_slope(clock: Any) -> float:
    """Slope of the lower hull's edge above the middle of the time."""
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
def _median_height(clock: Any, slope: float) -> float:
    """Of the points above the line of this slope below all of them."""
    heights = clock.heights
    for i in range(clock.count):
        height = clock.arrivals[i] - slope * clock.ticks[i]
        k = i
        while k > 0 and heights[k - 1] > height:
            heights[k] = heights[k - 1]
            k -= 1
        heights[k] = height
    return float(heights[clock.count // 2] - heights[0])


@kernel
def _settled_slope(clock: Any, slope: float) -> float:
    """Slope of the points' regression, with full weight on the line of the hull and ever less above their median."""
    offset = np.inf
    for i in range(clock.count):
        offset = min(offset, clock.arrivals[i] - slope * clock.ticks[i])
    scale = max(_median_height(clock, slope), 1.0)
    origin = clock.ticks[clock.count - 1]
    n = x = y = xx = xy = 0.0
    for i in range(clock.count):
        tick = clock.ticks[i] - origin
        height = clock.arrivals[i] - slope * clock.ticks[i] - offset
        w = 1.0 / (1.0 + (height / scale) ** 2)
        n += w
        x += w * tick
        y += w * height
        xx += w * tick * tick
        xy += w * tick * height
    return slope + (n * xy - x * y) / (n * xx - x * x)


@kernel
def _refit(clock: Any, x: float) -> None:
    """Lay the line anew below the window minima; stamps stay where they are and slew to it."""
    before = clock.offset + clock.slope * x
    fitted = (clock.ticks[clock.count - 1] - clock.ticks[0]) * clock.period_ns >= FIT_SPAN_NS
    first = 0 if fitted else max(0, clock.count - 2)  # an unknown slope makes old points misleading
    if fitted:
        slope = _settled_slope(clock, _hull_slope(clock))
        if abs(slope / clock.period_ns - 1.0) < PERIOD_TOLERANCE:
            clock.slope = slope
            clock.fitted = 1
    offset = np.inf
    total = 0.0
    for i in range(first, clock.count):
        d = clock.arrivals[i] - clock.slope * clock.ticks[i]
        offset = min(offset, d)
        total += d
    clock.offset = offset
    clock.residual_ns = total / (clock.count - first) - offset
    clock.slew_ns += before - (clock.offset + clock.slope * x)


@kernel
def _gather(clock: Any, tick: int, x: float, y: float, residual: float) -> None:
    """Keep the earliest arrival of each window for the fit; one that is far too late says nothing of the line."""
    if residual < clock.window_residual:
        clock.window_residual = residual
        clock.window_x = x
        clock.window_arrival = y
    if (tick - clock.window_start) * clock.period_ns >= clock.window_ns:
        if clock.window_residual < FAR_NS or clock.fitted == 0:
            _add_point(clock)
            _refit(clock, x)
        clock.window_start = tick
        clock.window_residual = np.inf


@kernel
def _correct(clock: Any, tick: int, ticks: float) -> None:
    """So many ticks passed that were not counted (negative: were counted and did not pass)."""
    clock.missed += ticks
    clock.corrections += 1
    clock.window_start = tick
    clock.window_residual = np.inf


@kernel
def _watch(clock: Any, tick: int, arrival_ns: int, residual: float) -> None:
    """Notice samples that are all late, and equally late, for two watches: the counter missed the time before them."""
    y = float(arrival_ns - clock.base_ns)
    clock.watch_samples += 1
    clock.watch_least = min(clock.watch_least, residual)
    if y - clock.watch_start < WATCH_NS or clock.watch_samples < WATCHED:
        return
    least, before = clock.watch_least, clock.watch_before
    clock.watch_before = least
    clock.watches = clock.watches + 1 if least > (FAR_NS if clock.fitted else UNFITTED_NS) else 0
    _watch_anew(clock, y)
    if clock.watches < 2:
        return
    same = abs(least - before) < SAME_NS
    if same and clock.fitted:
        _correct(clock, tick, min(least, before) / clock.slope)
        clock.watches = 0
    elif same or clock.watches >= PATIENCE:
        clock.corrections += 1
        _restart(clock, tick, arrival_ns)


@kernel
def stamp(clock: Any, tick: int, arrival_ns: int) -> int:
    """Host time (int64 ns) of the sample with counter `tick`, which was there at `arrival_ns`. Strictly increasing."""
    if clock.started == 0 or tick <= clock.last_tick:
        _restart(clock, tick, arrival_ns)
        clock.last_tick = tick - 1
    y = float(arrival_ns - clock.base_ns)
    x = tick - clock.base_tick + clock.missed
    passed = clock.slope * (tick - clock.last_tick)
    residual = y - (clock.offset + clock.slope * x)
    if residual < -FAR_NS:
        ahead = min(-residual, passed) / clock.slope
        _correct(clock, tick, -ahead)
        x -= ahead
        residual += ahead * clock.slope
    if residual < 0.0:  # earlier than the line allows: the line was too high
        clock.offset += residual
        clock.slew_ns -= residual
        residual = 0.0
        clock.window_residual = np.inf
    _gather(clock, tick, x, y, residual)
    if clock.fitted == 1:
        clock.late_ns += LATE_SHARE * (residual - clock.late_ns)
        clock.latest_ns = max(clock.latest_ns, residual)
    if clock.slew_ns < -FAR_NS:
        clock.slew_ns = 0.0
    most = (STOP if clock.slew_ns > FAR_NS else SLEW) * passed
    clock.slew_ns -= max(-most, min(most, clock.slew_ns))
    line = clock.offset + clock.slope * x + clock.slew_ns - clock.delay_ns
    t_ns = max(int(clock.base_ns + int(line)), int(clock.last_ns) + 1)
    clock.last_tick = tick
    clock.last_ns = t_ns
    _watch(clock, tick, arrival_ns, residual)
    return t_ns
