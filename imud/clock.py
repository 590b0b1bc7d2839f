"""Time: a device's counter, and a receiver's UTC, fitted to the host's monotonic clock.

Nothing arrives before it was sent, and much arrives late: so the line that turns a counter into host time lies below
all arrivals and as close to them as it can. Over a window the earliest arrival counts; over half a minute of windows
the line is the edge of their lower convex hull above the mean (the least sum of distances of all lines below the
points). Stamps follow a changed line by slewing, never by stepping back.

Source: Zhang, Liu and Xia, Clock synchronization algorithms for network measurements, IEEE INFOCOM (2002), sec. III.
"""

from typing import Any

import numpy as np

from .kernels.jit import kernel

POINTS = 64
WINDOW_NS = 500_000_000.0
FIT_SPAN_NS = 3e9  # a slope needs a base line this long; until then the nominal period holds
SLEW = 0.01  # stamps run at most 1 % fast or slow while they catch up with a changed line
LATE_NS = 1.5e9  # later than any buffer can make a byte: the counter jumped, so fit anew
PERIOD_TOLERANCE = 0.1  # a fitted period further off its nominal value is not believed

CLOCK = np.dtype(
    [
        ("period_ns", "<f8"),  # nominal, between ticks
        ("delay_ns", "<f8"),  # from the sample's instant to its arrival at best: filter group delay and wire time
        ("started", "<i8"),
        ("base_tick", "<i8"),
        ("base_ns", "<i8"),
        ("slope", "<f8"),  # fitted period, ns per tick
        ("offset", "<f8"),  # ns above base_ns at base_tick
        ("slew_ns", "<f8"),  # what stamps are still ahead of the line
        ("last_tick", "<i8"),
        ("last_ns", "<i8"),
        ("window_start", "<i8"),
        ("window_tick", "<i8"),
        ("window_arrival", "<f8"),
        ("window_residual", "<f8"),
        ("late_windows", "<i8"),
        ("count", "<i8"),
        ("ticks", "<f8", (POINTS,)),  # earliest arrival of each window, oldest first
        ("arrivals", "<f8", (POINTS,)),
        ("residual_ns", "<f8"),  # mean distance of the window minima above the line
        ("resets", "<i8"),
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
    clock.offset = 0.0
    clock.slew_ns = 0.0
    clock.count = 0
    clock.late_windows = 0
    clock.window_start = tick
    clock.window_residual = np.inf


@kernel
def _add_point(clock: Any) -> None:
    if clock.count == POINTS:
        for i in range(1, POINTS):
            clock.ticks[i - 1] = clock.ticks[i]
            clock.arrivals[i - 1] = clock.arrivals[i]
        clock.count -= 1
    clock.ticks[clock.count] = clock.window_tick - clock.base_tick
    clock.arrivals[clock.count] = clock.window_arrival
    clock.count += 1


@kernel
def _hull_slope(clock: Any) -> float:
    """Slope of the lower hull's edge above the mean tick."""
    hull = np.empty(POINTS, np.int64)
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
def _refit(clock: Any, tick: int) -> None:
    """Lay the line anew below the window minima; stamps stay where they are and slew to it."""
    x = float(tick - clock.base_tick)
    before = clock.offset + clock.slope * x
    fitted = (clock.ticks[clock.count - 1] - clock.ticks[0]) * clock.period_ns >= FIT_SPAN_NS
    first = 0 if fitted else max(0, clock.count - 2)  # an unknown slope makes old points misleading
    if fitted:
        slope = _hull_slope(clock)
        if abs(slope / clock.period_ns - 1.0) < PERIOD_TOLERANCE:
            clock.slope = slope
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
def _close_window(clock: Any, tick: int, arrival_ns: int) -> None:
    if clock.window_residual > LATE_NS:
        clock.late_windows += 1
        if clock.late_windows >= 2:
            clock.resets += 1
            _restart(clock, tick, arrival_ns)
            return
    else:
        clock.late_windows = 0
        _add_point(clock)
        _refit(clock, tick)
    clock.window_start = tick
    clock.window_residual = np.inf


@kernel
def stamp(clock: Any, tick: int, arrival_ns: int) -> int:
    """Host time (int64 ns) of the sample with counter `tick`, which was there at `arrival_ns`. Strictly increasing."""
    if clock.started == 0 or tick <= clock.last_tick:
        _restart(clock, tick, arrival_ns)
        clock.last_tick = tick - 1
    y = float(arrival_ns - clock.base_ns)
    residual = y - (clock.offset + clock.slope * (tick - clock.base_tick))
    if residual < 0.0:  # earlier than the line allows: the line was too high
        if residual < -LATE_NS:
            clock.resets += 1
            _restart(clock, tick, arrival_ns)
        else:
            clock.offset += residual
            clock.slew_ns -= residual
        residual = 0.0
        clock.window_residual = np.inf
        y = float(arrival_ns - clock.base_ns)
    if residual < clock.window_residual:
        clock.window_residual = residual
        clock.window_tick = tick
        clock.window_arrival = y
    if (tick - clock.window_start) * clock.period_ns >= WINDOW_NS:
        _close_window(clock, tick, arrival_ns)
    most = SLEW * clock.period_ns * (tick - clock.last_tick)
    clock.slew_ns -= max(-most, min(most, clock.slew_ns))
    line = clock.offset + clock.slope * (tick - clock.base_tick) + clock.slew_ns - clock.delay_ns
    t_ns = max(int(clock.base_ns + int(line)), int(clock.last_ns) + 1)
    clock.last_tick = tick
    clock.last_ns = t_ns
    return t_ns


_DAY_NS = 86_400_000_000_000
_BAND_NS = 10_000_000_000  # a tty's 4096 bytes last 9 s at 4800 baud: what comes later still, UTC stepped
_MEMORY_S = 64
_STEP_S = 5  # so long must arrivals stay late by whole seconds until that is a step of the receiver's UTC
_ABRUPT_NS, _NEAR_WHOLE_NS = 500_000_000, 250_000_000


class EpochClock:
    """A receiver's UTC time of day fitted to the host's monotonic clock: the smallest delay seen is the latency.

    An epoch is never placed after its arrival less the latency, nor more than 10 s before. Steps of the receiver's UTC
    are followed at once if forward, or of more than 10 s; after 5 s if of whole seconds (leap seconds that it learns,
    or that occur); else after 64 s, for a line that falls behind looks the same. Not thread-safe; one per receiver.
    """

    def __init__(self, latency_s: float) -> None:
        self._latency_ns = round(latency_s * 1e9)
        self._seconds: list[int] = []  # of arrival, on the host's clock, oldest first
        self._least: list[int] = []  # arrival less UTC, ns, the least in each of them

    def epoch_ns(self, utc_of_day_s: float, arrival_ns: int) -> int:
        """Monotonic time in ns of the epoch that the receiver calls `utc_of_day_s` and that arrived at `arrival_ns`."""
        utc_ns = round(utc_of_day_s * 1e9)
        if self._least:
            utc_ns += round((arrival_ns - utc_ns - self._least[-1]) / _DAY_NS) * _DAY_NS
        self._remember(arrival_ns // 1_000_000_000, arrival_ns - utc_ns)
        return utc_ns + min(self._least) - self._latency_ns

    def _remember(self, second: int, offset: int) -> None:
        if self._least and abs(offset - min(self._least)) > _BAND_NS:
            self._keep(0)
        if self._seconds and self._seconds[-1] == second:
            self._least[-1] = min(self._least[-1], offset)
        else:
            self._seconds.append(second)
            self._least.append(offset)
        self._keep(_MEMORY_S)
        if self._stepped():
            self._keep(_STEP_S)

    def _keep(self, n: int) -> None:
        self._seconds, self._least = (values[max(0, len(values) - n) :] for values in (self._seconds, self._least))

    def _stepped(self) -> bool:
        """Whether all of the last seconds are late by about the same, whole, number of seconds."""
        before, recent = self._least[:-_STEP_S], self._least[-_STEP_S:]
        if not before or recent[0] - before[-1] < _ABRUPT_NS or max(recent) - min(recent) > _ABRUPT_NS:
            return False
        excess = min(recent) - min(before)
        whole = round(excess / 1e9)
        return whole > 0 and abs(excess - whole * 1_000_000_000) < _NEAR_WHOLE_NS
