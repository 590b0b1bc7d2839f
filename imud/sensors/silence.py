"""How long the stream of a receiver, or of another sensor with its protocol, may be silent until it counts as broken.

Most send each second, or more often. Some send a burst each 10 or 30 s (power-save modes, trackers): the longest of the
last silences shows it, and a stream that has lasted too briefly to show its period is given the time of the slowest.
"""

SILENCE_NS = 5_000_000_000  # a stream this long silent is broken, if it is not known to be a slow one
PERIODS = 2.5  # of a slow one: one burst may be lost
SLOWEST_NS = 65_000_000_000  # a burst a minute, a little late; a longer silence is no period
ALIKE = 0.8  # silences of at least so much of the longest are its period's
PAUSE_NS = 1_000_000_000  # bytes of no use that come after it are not the rest of a burst
REMEMBERED = 10  # periods after which a long silence that did not come again counts no more


class SilenceLimit:
    """Takes the times of bytes. Not thread-safe."""

    def __init__(self, now_ns: int) -> None:
        """now_ns: when the stream began; just before, its device was recognised by what it sent."""
        self.last_ns = now_ns  # when something of use came
        self._first_ns = now_ns
        self._longest_ns, self._longest_at_ns = 0, now_ns
        self._unread_ns: int | None = None  # since when bytes of no use have come that are not the rest of a burst

    def add(self, now_ns: int, is_of_use: bool) -> None:
        """Bytes came; is_of_use: they completed an undamaged message."""
        if not is_of_use:
            if self._unread_ns is None and now_ns - self.last_ns > PAUSE_NS:
                self._unread_ns = now_ns
            return
        self._add_silence(now_ns - self.last_ns, now_ns)
        self.last_ns, self._unread_ns = now_ns, None

    def _add_silence(self, silence_ns: int, now_ns: int) -> None:
        is_old = now_ns - self._longest_at_ns > REMEMBERED * max(self._longest_ns, SILENCE_NS)
        if silence_ns >= ALIKE * self._longest_ns or is_old:
            self._longest_ns, self._longest_at_ns = min(silence_ns, SLOWEST_NS), now_ns

    @property
    def period_ns(self) -> int | None:
        """The longest of the last silences; None: it is not known yet."""
        is_known = self.last_ns - self._first_ns >= SILENCE_NS
        return self._longest_ns if is_known else None

    @property
    def limit_ns(self) -> int:
        """From when something of use came last. Bytes of no use are no silence: another device, another baud rate."""
        period_ns = self.period_ns
        limit_ns = max(SILENCE_NS, SLOWEST_NS if period_ns is None else round(PERIODS * period_ns))
        if self._unread_ns is not None:
            limit_ns = min(limit_ns, self._unread_ns - self.last_ns + SILENCE_NS)
        return limit_ns
