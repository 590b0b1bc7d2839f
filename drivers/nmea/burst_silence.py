"""How long a silence ends a burst: longer than the pauses within bursts, which some lines show by what comes late.

Receivers send a burst without a pause. Plotters and multiplexers may pass its sentences on one by one, a quarter of a
second apart: then a silence ends each burst before its rest comes.
"""

SILENCE_NS = 200_000_000  # longer than any pause within a receiver's burst, and than all together
SILENCE_MAX_NS = 1_000_000_000
LONGER = 1.5  # times
ENOUGH = 3  # bursts in sequence: in one, this process may have been delayed


class BurstSilence:
    """Not thread-safe. ns: from this silence on a burst is over."""

    def __init__(self) -> None:
        self.ns = SILENCE_NS
        self._burst = self._bursts = 0  # the last one that was not over; how many in sequence

    def was_too_short(self, burst: int) -> None:
        """A silence ended this burst, by its number, and then more of it came."""
        if burst == self._burst:
            return
        self._bursts = self._bursts + 1 if burst == self._burst + 1 else 1
        self._burst = burst
        if self._bursts == ENOUGH:
            self._bursts = 0
            self.ns = min(SILENCE_MAX_NS, round(LONGER * self.ns))
