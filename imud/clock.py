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
_JUMP_NS = 2_500_000_000  # no receiver talks this late: its notion of UTC stepped
_MEMORY = 64


class EpochClock:
    """A receiver's UTC time of day fitted to the host's monotonic clock: the smallest delay seen is the latency.

    Not thread-safe; one per receiver.
    """

    def __init__(self, latency_s: float) -> None:
        self._latency_ns = round(latency_s * 1e9)
        self._offsets: list[int] = []
        self._late = 0

    def epoch_ns(self, utc_of_day_s: float, arrival_ns: int) -> int:
        """Monotonic time in ns of the epoch that the receiver calls `utc_of_day_s` and that arrived at `arrival_ns`."""
        utc_ns = round(utc_of_day_s * 1e9)
        offset = arrival_ns - utc_ns
        if self._offsets:
            days = round((offset - self._offsets[-1]) / _DAY_NS)
            offset -= days * _DAY_NS
            utc_ns += days * _DAY_NS
            self._forget_steps(offset)
        self._offsets = [*self._offsets[1 - _MEMORY :], offset]
        return utc_ns + min(self._offsets) - self._latency_ns

    def _forget_steps(self, offset: int) -> None:
        excess = offset - min(self._offsets)
        self._late = self._late + 1 if excess > _JUMP_NS else 0
        if excess < -_JUMP_NS or self._late >= 3:
            self._offsets = []
            self._late = 0
