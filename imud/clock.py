"""Time: a device's counter fitted to the host's monotonic clock.

Nothing arrives before it was sent, and much arrives late: so the line that turns a counter into host time lies below
all arrivals and as close to them as it can. Over a window the earliest arrival counts; over half a minute of windows
the line is the edge of their lower convex hull above the mean (the least sum of distances of all lines below the
points). Stamps follow a changed line by slewing, never by stepping back.

A counter may be wrong. One that jumped ahead shows at once: its sample was there before it was taken. One that stood
still while samples were not sent (a sensor may have none, and its samples are counted as they come) makes all that
follow late, and equally late; bytes that only waited do not, for whoever reads them has caught up with the end of it.

Source: Zhang, Liu and Xia, Clock synchronization algorithms for network measurements, IEEE INFOCOM (2002), sec. III.
"""

from typing import Any

import numpy as np

from .kernels.jit import kernel

POINTS = 64
WINDOW_NS = 500_000_000.0
MEMORY_NS = 120e9
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
def _thin(clock: Any) -> None:
    """Make room: forget what is too old, and of each two points of the older half the one farther above the line."""
    first = 0
    while clock.ticks[clock.count - 1] - clock.ticks[first] > MEMORY_NS / clock.period_ns:
        first += 1
    n = 0
    i = first
    while i < clock.count:
        if i < POINTS // 2:
            a = clock.arrivals[i] - clock.slope * clock.ticks[i]
            b = clock.arrivals[i + 1] - clock.slope * clock.ticks[i + 1]
            i += 1 if b < a else 0
            clock.ticks[n], clock.arrivals[n] = clock.ticks[i], clock.arrivals[i]
            i += 1 if b < a else 2
        else:
            clock.ticks[n], clock.arrivals[n] = clock.ticks[i], clock.arrivals[i]
            i += 1
        n += 1
    clock.count = n


@kernel
def _add_point(clock: Any) -> None:
    if clock.count == POINTS:
        _thin(clock)
    clock.ticks[clock.count] = clock.window_x
    clock.arrivals[clock.count] = clock.window_arrival
    clock.count += 1


@kernel
def _hull_slope(clock: Any) -> float:
    """Slope of the lower hull's edge above the mean tick."""
    hull = clock.hull
    n = 0
    mean = 0.0
    for i in range(clock.count):
        mean += clock.ticks[i] / clock.count
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
    while e < n - 1 and clock.ticks[hull[e]] < mean:
        e += 1
    a, b = hull[e - 1], hull[e]
    return float((clock.arrivals[b] - clock.arrivals[a]) / (clock.ticks[b] - clock.ticks[a]))


@kernel
def _refit(clock: Any, x: float) -> None:
    """Lay the line anew below the window minima; stamps stay where they are and slew to it."""
    before = clock.offset + clock.slope * x
    fitted = (clock.ticks[clock.count - 1] - clock.ticks[0]) * clock.period_ns >= FIT_SPAN_NS
    first = 0 if fitted else max(0, clock.count - 2)  # an unknown slope makes old points misleading
    if fitted:
        slope = _hull_slope(clock)
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
    if (tick - clock.window_start) * clock.period_ns >= WINDOW_NS:
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
