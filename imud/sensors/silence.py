"""How long the stream of a receiver, or of another sensor with its protocol, may be silent until it counts as broken.

Most send each second, or more often: a stream that has sent for longer than a burst lasts is one of these. Some send a
burst each 10 or 30 s (power-save modes, trackers): two long silences in sequence that are alike show it. Until one of
both is known, a stream is given the time of the slowest, and then that of its first long silence.
"""

SILENCE_NS = 5_000_000_000  # a stream this long silent is broken, if it is not known to be a slow one
PERIODS = 2.5  # of a slow one: one burst may be lost
SLOWEST_NS = 65_000_000_000  # a burst a minute, a little late; a longer silence is no period
LONG_NS = round(SILENCE_NS / PERIODS)  # a silence that is longer is a long one
SENDING_NS = 2_000_000_000  # without a long silence: longer than a burst at usual baud rates
ALIKE = 0.8  # of two long silences, the shorter is at least so much of the longer
PAUSE_NS = 1_000_000_000  # bytes of no use that come after it are not the rest of a burst
REMEMBERED = 10  # periods after which a long period that did not show again counts no more


class SilenceLimit:
    """Takes the times of bytes. Not thread-safe."""

    def __init__(self, now_ns: int) -> None:
        """now_ns: when the stream began; just before, its device was recognised by what it sent."""
        self.last_ns = now_ns  # when something of use came
        self._first_ns = now_ns
        self._since_ns = now_ns  # since when there was no long silence
        self._long_ns = 0  # the last long silence
        self._period_ns: int | None = None  # 0: a short one; None: it is not known yet
        self._shown_ns = now_ns  # when a long one showed last
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
        if silence_ns > LONG_NS:
            before_ns, self._long_ns, self._since_ns = self._long_ns, min(silence_ns, SLOWEST_NS), now_ns
            longer_ns = max(before_ns, self._long_ns)
            if min(before_ns, self._long_ns) >= ALIKE * longer_ns:
                self._period_ns, self._shown_ns = longer_ns, now_ns
        elif now_ns - self._since_ns >= SENDING_NS and now_ns - self._shown_ns > REMEMBERED * (self._period_ns or 0):
            self._period_ns = 0

    @property
    def period_ns(self) -> int | None:
        """A long period, or what the first long silence lets expect; 0: a short one; None: it is not known yet."""
        if self._period_ns is None and self.last_ns - self._first_ns >= SILENCE_NS:
            return self._long_ns
        return self._period_ns

    @property
    def limit_ns(self) -> int:
        """From when something of use came last. Bytes of no use are no silence: another device, another baud rate."""
        period_ns = self.period_ns
        limit_ns = max(SILENCE_NS, SLOWEST_NS if period_ns is None else round(PERIODS * period_ns))
        if self._unread_ns is not None:
            limit_ns = min(limit_ns, self._unread_ns - self.last_ns + SILENCE_NS)
        return limit_ns
