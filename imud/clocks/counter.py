"""Time: a device's counter fitted to the host's monotonic clock.

The line between them is fitted anew after each window (`clock_line`). Stamps follow a changed line by slewing, never by
stepping back.

A counter may be wrong. One that jumped ahead shows at once: its sample was there before it was taken. (While there is
no fit that may as well be said of the line: all that it rests on was late. Then everything begins anew.) One that stood
still while samples were not sent (a sensor may have none, and its samples are counted as they come) makes all that
follow late, and equally late; bytes that only waited do not, for whoever reads them has caught up with the end of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.jit import kernel
from .line import FAR_NS, POINTS, add_point, refit

if TYPE_CHECKING:
    from .types import Clock

WINDOW_NS = 0.5e9  # the first ones
SLEW = 0.01  # stamps run at most 1 % fast or slow while they catch up with a changed line
STOP = 0.9  # by how much stamps that are far ahead run slow
WATCH_NS, WATCHED = 250_000_000.0, 4  # host time, and samples at least, of which not one may be in time
SAME_NS = 10e6  # as late as before: more is a line that catches up
UNFITTED_NS = 50e6  # a nominal period may be a few percent off, and the line with it
PATIENCE = 8  # watches after which lateness is believed, whatever it is
LATE_SHARE = 1e-3  # of one sample in the mean lateness

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
        ("sigma_slope", "<f8"),  # its standard deviation, once there is a fit
        ("offset", "<f8"),  # ns above base_ns at base_tick
        ("slew_ns", "<f8"),  # what stamps are still ahead of the line
        ("last_tick", "<i8"),
        ("last_ns", "<i8"),
        ("window_ns", "<f8"),  # length
        ("window_start", "<i8"),  # tick
        ("window_x", "<f8"),
        ("window_arrival", "<f8"),
        ("window_residual", "<f8"),
        ("window_samples", "<i8"),  # not far too late
        ("window_mean_x", "<f8"),  # of their ticks
        ("window_mean", "<f8"),  # of their arrivals
        ("watch_start", "<f8"),  # arrival
        ("watch_samples", "<i8"),
        ("watch_least", "<f8"),  # lateness of the earliest
        ("watch_before", "<f8"),  # and in the watch before
        ("watches", "<i8"),  # in a row that were late
        ("count", "<i8"),
        ("ticks", "<f8", (POINTS,)),  # earliest arrival of each window, oldest first
        ("arrivals", "<f8", (POINTS,)),
        ("mean_ticks", "<f8", (POINTS,)),  # mean arrival of each window
        ("mean_arrivals", "<f8", (POINTS,)),
        ("hull", "<i8", (POINTS,)),  # scratch
        ("heights", "<f8", (POINTS,)),  # scratch
        ("residual_ns", "<f8"),  # median distance of the window minima above the line, once there is a fit
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
def _restart(clock: Clock, tick: int, arrival_ns: int) -> None:
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
    _window_anew(clock, tick)
    clock.watches = 0
    _watch_anew(clock, 0.0)


@kernel
def _window_anew(clock: Clock, tick: int) -> None:
    clock.window_start = tick
    clock.window_residual = np.inf
    clock.window_samples = 0
    clock.window_mean_x = 0.0
    clock.window_mean = 0.0


@kernel
def _watch_anew(clock: Clock, y: float) -> None:
    clock.watch_start = y
    clock.watch_samples = 0
    clock.watch_least = np.inf


@kernel
def _gather(clock: Clock, tick: int, x: float, y: float, residual: float) -> None:
    """Keep the earliest arrival of each window, and the mean, for the fit; what came far too late does not count."""
    if residual < clock.window_residual:
        clock.window_residual = residual
        clock.window_x = x
        clock.window_arrival = y
    if residual < FAR_NS or clock.fitted == 0:
        clock.window_samples += 1
        clock.window_mean_x += (x - clock.window_mean_x) / clock.window_samples
        clock.window_mean += (y - clock.window_mean) / clock.window_samples
    if (tick - clock.window_start) * clock.period_ns >= clock.window_ns:
        if clock.window_residual < FAR_NS or clock.fitted == 0:
            add_point(clock)
            refit(clock, x)
        _window_anew(clock, tick)


@kernel
def _correct(clock: Clock, tick: int, ticks: float) -> None:
    """So many ticks passed that were not counted (negative: were counted and did not pass)."""
    clock.missed += ticks
    clock.corrections += 1
    _window_anew(clock, tick)


@kernel
def _watch(clock: Clock, tick: int, arrival_ns: int, residual: float) -> None:
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
def stamp(clock: Clock, tick: int, arrival_ns: int) -> int:
    """Host time (int64 ns) of the sample with counter `tick`, which was there at `arrival_ns`. Strictly increasing."""
    if clock.started == 0 or tick <= clock.last_tick:
        _restart(clock, tick, arrival_ns)
        clock.last_tick = tick - 1
    y = float(arrival_ns - clock.base_ns)
    x = tick - clock.base_tick + clock.missed
    passed = clock.slope * (tick - clock.last_tick)
    residual = y - (clock.offset + clock.slope * x)
    if residual < -FAR_NS and clock.fitted == 0:
        ahead = clock.slew_ns - residual
        _restart(clock, tick, arrival_ns)
        clock.slew_ns = ahead
        x = y = residual = 0.0
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
    t_ns = max(int(clock.base_ns + int(line + 0.5)), int(clock.last_ns) + 1)
    clock.last_tick = tick
    clock.last_ns = t_ns
    _watch(clock, tick, arrival_ns, residual)
    return t_ns
