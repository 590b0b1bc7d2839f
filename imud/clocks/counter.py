"""Time: a device's counter fitted to the host's monotonic clock.

The line that turns ticks into host time is fitted anew after each window (`line.py`). Stamps follow a changed line by
slewing; they never step back.

A counter may be wrong. If it jumped ahead, or counted a repeated sample, the next sample arrives before the time that
the line gives it, which is impossible. The line may have been too high: then it is lowered, but by no more than the
drift of clocks and the way in which adapters deliver explain. What is more than that is no error of the line: the
counter is corrected, so that the points before still fit. (All of them may have been late by as much, which is mended
by the same. Before there is a fit the clock begins anew instead.) If the counter stood still for a time (sensors
without a counter have their samples counted on arrival, so that lost ones are not counted), all later samples are late,
and equally late. Bytes that only waited in a buffer are late, too, but ever less while the buffer empties. A counter
that seems to miss ticks again and again keeps another rate than the line: then the clock begins anew, as it does if
corrections leave no window whole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.jit import kernel
from .line import FAR_NS, POINTS, add_point, refit

if TYPE_CHECKING:
    from .types import Clock

WINDOW_NS = 0.5e9  # length of the first windows
SLEW = 0.01  # stamps run at most 1 % fast or slow while they catch up with a changed line
FAST_SLEW = 0.9  # share by which stamps run slow that are ahead of the line by more than that may be too high
WATCH_NS, WATCH_SAMPLES = 250_000_000.0, 4  # least length of a watch, in which it is seen whether any sample is in time
EQUAL_LATENESS_NS = 10e6  # two watches are equally late within this; otherwise a buffer is emptying
LATE_UNFITTED_NS = 50e6  # lateness before there is a fit: the nominal period may be wrong by some percent
MAX_LATE_WATCHES = 8  # after so many late watches in a row the clock begins anew
# By how much the line may have been too high: a tick of up to 5 ms hides behind an adapter that delivers as often, half
# a longer one; or some times the scatter of the earliest arrivals. A drift lowers the line for ever, but slowly.
TOLERANCE_NS, TOLERANCE_TICKS, TOLERANCE_SCATTERS, MAX_DRIFT = 5e6, 0.5, 4.0, 1e-3
UNFITTED_NS = 10e9  # corrections that leave no window whole for so long: the clock begins anew
MISSED_AGAIN_NS = 60e9  # two corrections for missed ticks within that time: the clock begins anew
MEAN_LATENESS_GAIN = 1e-3  # weight of one sample in the mean lateness

CLOCK = np.dtype(
    [
        ("period_ns", "<f8"),  # nominal, between ticks
        ("delay_ns", "<f8"),  # from the sample's instant to its arrival at best: filter group delay and wire time
        ("started", "<i8"),
        ("fitted", "<i8"),  # 1: slope comes from arrivals
        ("base_tick", "<i8"),
        ("base_ns", "<i8"),
        ("uncounted_ticks", "<f8"),  # ticks since base_tick that the counter missed
        ("slope", "<f8"),  # fitted period, ns per tick
        ("sigma_slope", "<f8"),  # its standard deviation, once there is a fit
        ("offset", "<f8"),  # ns above base_ns at base_tick
        ("slew_ns", "<f8"),  # by how much stamps are still ahead of the line
        ("last_tick", "<i8"),
        ("last_ns", "<i8"),
        ("lowered_ns", "<f8"),  # by how much the line was lowered, more than clocks drift
        ("sound_count", "<i8"),  # points from before it was lowered
        ("last_missed", "<f8"),  # arrival with which the counter was corrected for missed ticks, ns since base_ns
        ("last_window", "<f8"),  # arrival with which the last window ended, ns since base_ns
        ("window_ns", "<f8"),  # length of a window
        ("window_start", "<i8"),  # its first tick
        ("window_x", "<f8"),  # ticks since base_tick, of its earliest arrival
        ("window_arrival", "<f8"),  # ns since base_ns, of the same
        ("window_residual", "<f8"),  # ns above the line, of the same
        ("window_samples", "<i8"),  # samples in it that are not far too late
        ("window_mean_x", "<f8"),  # mean of their ticks
        ("window_mean", "<f8"),  # mean of their arrivals
        ("watch_start", "<f8"),  # arrival with which the watch began, ns since base_ns
        ("watch_samples", "<i8"),
        ("watch_min_lateness", "<f8"),  # ns, least lateness in it
        ("last_watch_lateness", "<f8"),  # ns, the same of the watch before
        ("late_watches", "<i8"),  # watches in a row without a sample in time
        ("count", "<i8"),  # of points that the line is fitted to
        ("ticks", "<f8", (POINTS,)),  # earliest arrival of each window, oldest first
        ("arrivals", "<f8", (POINTS,)),
        ("mean_ticks", "<f8", (POINTS,)),  # mean arrival of each window
        ("mean_arrivals", "<f8", (POINTS,)),
        ("hull", "<i8", (POINTS,)),  # scratch
        ("heights", "<f8", (POINTS,)),  # scratch
        ("residual_ns", "<f8"),  # median distance of the window minima above the line, once there is a fit
        ("corrections", "<i8"),  # how often the counter was corrected
        ("late_ns", "<f8"),  # lateness of samples: moving mean
        ("latest_ns", "<f8"),  # and largest
    ],
    align=True,
)


def new_clock(period_ns: float, delay_ns: float) -> Any:
    """A clock (array of one `CLOCK`) for a counter of nominal `period_ns`, of samples at least `delay_ns` old."""
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
    clock.uncounted_ticks = 0.0
    clock.offset = 0.0
    clock.slew_ns = 0.0
    clock.count = 0
    clock.window_ns = WINDOW_NS
    clock.last_window = 0.0
    clock.last_missed = -np.inf
    clock.lowered_ns = 0.0
    _begin_window(clock, tick)
    clock.late_watches = 0
    _begin_watch(clock, 0.0)


@kernel
def _begin_window(clock: Clock, tick: int) -> None:
    clock.window_start = tick
    clock.window_residual = np.inf
    clock.window_samples = 0
    clock.window_mean_x = 0.0
    clock.window_mean = 0.0


@kernel
def _begin_watch(clock: Clock, y: float) -> None:
    clock.watch_start = y
    clock.watch_samples = 0
    clock.watch_min_lateness = np.inf


@kernel
def _add_to_window(clock: Clock, tick: int, x: float, y: float, residual: float) -> None:
    """Keep the earliest and the mean arrival of each window for the fit; ignore arrivals that are far too late."""
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
            before = clock.offset + clock.slope * x
            refit(clock, x)
            clock.lowered_ns -= max(0.0, clock.offset + clock.slope * x - before)
        clock.last_window = y
        _begin_window(clock, tick)


@kernel
def _correct(clock: Clock, tick: int, ticks: float) -> None:
    """Correct the counter by `ticks` that it missed; negative: that it counted too many."""
    clock.uncounted_ticks += ticks
    clock.corrections += 1
    clock.lowered_ns = 0.0
    _begin_window(clock, tick)


@kernel
def _restart_ahead(clock: Clock, tick: int, arrival_ns: int, residual: float) -> None:
    """Begin anew; stamps do not step back."""
    ahead = clock.slew_ns - residual
    _restart(clock, tick, arrival_ns)
    clock.slew_ns = ahead


@kernel
def _lower(clock: Clock, residual: float) -> None:
    """Lower the line to an arrival that is earlier: the line was too high."""
    clock.offset += residual
    clock.slew_ns -= residual
    clock.lowered_ns -= residual
    clock.window_residual = np.inf


@kernel
def _correct_early(clock: Clock, tick: int, residual: float, elapsed: float) -> None:
    """Correct the counter, not the line, for an arrival that is too early. elapsed: since the last sample, in ns.

    The points since the line was first lowered for it are of neither count.
    """
    clock.offset += clock.lowered_ns
    clock.count = min(clock.count, clock.sound_count)
    clock.slew_ns += max(0.0, -residual - FAST_SLEW * elapsed)
    _correct(clock, tick, (residual - clock.lowered_ns) / clock.slope)


@kernel
def _check_lateness(clock: Clock, tick: int, arrival_ns: int, residual: float) -> None:
    """Correct the counter if all samples of two watches are late, and equally late: it missed some ticks before."""
    y = float(arrival_ns - clock.base_ns)
    clock.watch_samples += 1
    clock.watch_min_lateness = min(clock.watch_min_lateness, residual)
    if y - clock.watch_start < WATCH_NS or clock.watch_samples < WATCH_SAMPLES:
        return
    least, before = clock.watch_min_lateness, clock.last_watch_lateness
    clock.last_watch_lateness = least
    clock.late_watches = clock.late_watches + 1 if least > (FAR_NS if clock.fitted else LATE_UNFITTED_NS) else 0
    _begin_watch(clock, y)
    if clock.late_watches < 2:
        return
    equal = abs(least - before) < EQUAL_LATENESS_NS
    if equal and clock.fitted and y - clock.last_missed > MISSED_AGAIN_NS:
        _correct(clock, tick, min(least, before) / clock.slope)
        clock.late_watches = 0
        clock.last_missed = y
    elif equal or clock.late_watches >= MAX_LATE_WATCHES:
        clock.corrections += 1
        _restart(clock, tick, arrival_ns)


@kernel
def stamp(clock: Clock, tick: int, arrival_ns: int) -> int:
    """Host time (int64 ns) of the sample with counter `tick`, which arrived at `arrival_ns`. Strictly increasing."""
    if clock.started == 0 or tick <= clock.last_tick:
        _restart(clock, tick, arrival_ns)
        clock.last_tick = tick - 1
    y = float(arrival_ns - clock.base_ns)
    x = tick - clock.base_tick + clock.uncounted_ticks
    elapsed = clock.slope * (tick - clock.last_tick)
    residual = y - (clock.offset + clock.slope * x)
    tolerance = max(TOLERANCE_NS, TOLERANCE_TICKS * clock.slope, min(TOLERANCE_SCATTERS * clock.residual_ns, FAR_NS))
    clock.lowered_ns = max(0.0, clock.lowered_ns - MAX_DRIFT * elapsed)
    if clock.lowered_ns == 0.0:
        clock.sound_count = clock.count
    if residual < 0.0 and clock.fitted == 0:
        if residual < -FAR_NS:
            _restart_ahead(clock, tick, arrival_ns, residual)
            x = y = 0.0
        else:
            _lower(clock, residual)
            clock.lowered_ns = 0.0
        residual = 0.0
    elif residual < 0.0:
        if clock.lowered_ns - residual <= tolerance:
            _lower(clock, residual)
        elif y - clock.last_window > max(UNFITTED_NS, 2.0 * clock.window_ns):
            clock.corrections += 1
            _restart_ahead(clock, tick, arrival_ns, residual)
            x = y = 0.0
        else:
            _correct_early(clock, tick, residual, elapsed)
            x = tick - clock.base_tick + clock.uncounted_ticks
        residual = 0.0
    _add_to_window(clock, tick, x, y, residual)
    if clock.fitted == 1:
        clock.late_ns += MEAN_LATENESS_GAIN * (residual - clock.late_ns)
        clock.latest_ns = max(clock.latest_ns, residual)
    if clock.slew_ns < -FAR_NS:
        clock.slew_ns = 0.0
    max_change = (FAST_SLEW if clock.slew_ns > (tolerance if clock.fitted == 1 else FAR_NS) else SLEW) * elapsed
    clock.slew_ns -= max(-max_change, min(max_change, clock.slew_ns))
    line = clock.offset + clock.slope * x + clock.slew_ns - clock.delay_ns
    t_ns = max(int(clock.base_ns + int(line + 0.5)), int(clock.last_ns) + 1)
    clock.last_tick = tick
    clock.last_ns = t_ns
    _check_lateness(clock, tick, arrival_ns, residual)
    return t_ns
