"""Time: a receiver's UTC fitted to the host's monotonic clock."""

_DAY_NS = 86_400_000_000_000
_SECOND_NS = 1_000_000_000
_MAX_DELAY_NS = 10_000_000_000  # a tty buffers 4096 bytes, 9 s at 4800 baud; a greater delay is a step of UTC
_MEMORY_S = 64  # time over which the least delay is taken
_STEP_S = 5  # arrivals that are late by whole seconds for this time are a step of the receiver's UTC
_MAX_SPREAD_NS, _WHOLE_TOLERANCE_NS = 500_000_000, 250_000_000
_QUEUE_NS = 3_000_000_000  # after the first fix the rest of a queue has come


class EpochClock:
    """A receiver's UTC time of day fitted to the host's monotonic clock: the smallest delay seen is the latency.

    An epoch is never later than its arrival less the latency, nor more than 10 s earlier. A step of the receiver's UTC
    takes effect at once if it is forward or of more than 10 s; after 5 s if it is of whole seconds (leap seconds); else
    after 64 s, since a serial line that falls behind looks the same. Not thread-safe; one per receiver.

    is_known: the epochs are right. The first fixes may come from a queue, in a buffer of the kernel or of an adapter,
    and be older than their arrival says, until two in sequence come about as far apart as they were made.
    """

    def __init__(self, latency_s: float) -> None:
        self._latency_ns = round(latency_s * 1e9)
        self.is_known = False
        self._first_ns: int | None = None  # arrival of the first fix
        self._last = 0, 0  # UTC and arrival of the last one, ns
        self._seconds: list[int] = []  # seconds of the host's clock in which fixes arrived, oldest first
        self._min_offset: list[int] = []  # least arrival less UTC in each of them, ns

    def epoch_ns(self, utc_of_day_s: float, arrival_ns: int, pulse_ns: int | None = None) -> int:
        """Monotonic time in ns of the epoch `utc_of_day_s` (s since midnight) of a fix that arrived at `arrival_ns`.

        pulse_ns: of a PPS pulse, which marks a full second: then the result is exact. It must arrive within a second.
        """
        utc_ns = round(utc_of_day_s * 1e9)
        if not self.is_known:
            self._find_end_of_queue(utc_ns, arrival_ns)
        if pulse_ns is not None:
            return arrival_ns - (arrival_ns - pulse_ns - utc_ns % _SECOND_NS) % _SECOND_NS
        if self._min_offset:
            utc_ns += round((arrival_ns - utc_ns - self._min_offset[-1]) / _DAY_NS) * _DAY_NS
        self._add(arrival_ns // 1_000_000_000, arrival_ns - utc_ns)
        return utc_ns + min(self._min_offset) - self._latency_ns

    def _find_end_of_queue(self, utc_ns: int, arrival_ns: int) -> None:
        if self._first_ns is None:
            self._first_ns = arrival_ns
        else:
            interval_ns = (utc_ns - self._last[0]) % _DAY_NS
            in_time = 0 < 3 * interval_ns < 4 * (arrival_ns - self._last[1])
            self.is_known = in_time or arrival_ns - self._first_ns > _QUEUE_NS
        self._last = utc_ns, arrival_ns

    def _add(self, second: int, offset: int) -> None:
        if self._min_offset and abs(offset - min(self._min_offset)) > _MAX_DELAY_NS:
            self._truncate(0)
        if self._seconds and self._seconds[-1] == second:
            self._min_offset[-1] = min(self._min_offset[-1], offset)
        else:
            self._seconds.append(second)
            self._min_offset.append(offset)
        self._truncate(_MEMORY_S)
        if self._has_stepped():
            self._truncate(_STEP_S)

    def _truncate(self, n: int) -> None:
        self._seconds, self._min_offset = (
            values[max(0, len(values) - n) :] for values in (self._seconds, self._min_offset)
        )

    def _has_stepped(self) -> bool:
        """Whether all of the last seconds are late by about the same, whole, number of seconds."""
        before, recent = self._min_offset[:-_STEP_S], self._min_offset[-_STEP_S:]
        if not before or recent[0] - before[-1] < _MAX_SPREAD_NS or max(recent) - min(recent) > _MAX_SPREAD_NS:
            return False
        excess = min(recent) - min(before)
        whole = round(excess / 1e9)
        return whole > 0 and abs(excess - whole * 1_000_000_000) < _WHOLE_TOLERANCE_NS
