"""Time: a receiver's UTC fitted to the host's monotonic clock."""

_DAY_NS = 86_400_000_000_000
_SECOND_NS = 1_000_000_000
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

    def epoch_ns(self, utc_of_day_s: float, arrival_ns: int, pulse_ns: int | None = None) -> int:
        """Monotonic time in ns of the epoch that the receiver calls `utc_of_day_s` and that arrived at `arrival_ns`.

        With a pulse, which marks a full second, that is exact; the fix must arrive within a second then, as all do.
        """
        utc_ns = round(utc_of_day_s * 1e9)
        if pulse_ns is not None:
            return arrival_ns - (arrival_ns - pulse_ns - utc_ns % _SECOND_NS) % _SECOND_NS
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
