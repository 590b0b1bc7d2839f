"""Which kind of sentence begins a burst, which one ends it, and which come in one of several bursts only."""

import math
from collections import Counter
from dataclasses import dataclass

from .epochs import DAY_NS, SAME_NS, same_time

ESTABLISHED = 2  # score of a kind that was at this end in the last two bursts
FIRST_ELSEWHERE, LAST_ELSEWHERE = -3, -100  # score of one that was not: others may follow it in one of so many bursts
MISSED = 3  # intervals after which a kind that came regularly is no longer expected


class BurstOrder:
    """The kinds of sentence that are first, or last, in a burst: learned, as any sentence may be lost."""

    def __init__(self, elsewhere: int) -> None:
        """elsewhere: score of a kind that was not at this end; it counts up to ESTABLISHED."""
        self._elsewhere = elsewhere
        self._score: Counter[str] = Counter()

    def confirm(self, kind: str) -> None:
        """In a burst `kind` was at this end."""
        self._score[kind] = min(self._score[kind] + 1, ESTABLISHED)

    def contradict(self, kind: str) -> None:
        """In a burst `kind` was not at this end."""
        self._score[kind] = self._elsewhere

    def forget(self, kind: str) -> None:
        """Where `kind` was is known to be no evidence."""
        self._score[kind] = 0

    def is_established(self, kind: str) -> bool:
        """Whether `kind` was at this end in the last bursts."""
        return self._score[kind] >= ESTABLISHED

    def is_contradicted(self, kind: str) -> bool:
        """Whether `kind` was elsewhere in the last bursts."""
        return self._score[kind] < 0


@dataclass
class _Times:
    """The newest time of day of a kind, and its interval to the one before; `regular`: twice the same interval."""

    utc_ns: int
    interval_ns: int = 0
    regular: bool = False


class RegularKinds:
    """The kinds that follow another in a burst at equal intervals, so that it is known which bursts have one.

    Of a receiver that sends GGA once a second and RMC each fifth second, only each fifth GGA is followed by an RMC.
    """

    def __init__(self) -> None:
        self._times: dict[str, _Times] = {}

    def note(self, kind: str, utc_ns: int) -> bool:
        """An epoch of this time of day has this kind. Returns whether the kind is regular since now."""
        before = self._times.get(kind)
        if before is None:
            self._times[kind] = _Times(utc_ns)
            return False
        interval_ns = (utc_ns - before.utc_ns) % DAY_NS
        was_regular = before.regular
        if was_regular and self.is_due(kind, utc_ns):  # perhaps after one that was lost
            before.utc_ns = utc_ns
        else:
            regular = interval_ns > SAME_NS and same_time(interval_ns, before.interval_ns)
            self._times[kind] = _Times(utc_ns, interval_ns, regular)
        return not was_regular and self._times[kind].regular

    def is_regular(self, kind: str) -> bool:
        """Whether it is known when this kind comes."""
        return kind in self._times and self._times[kind].regular

    def is_due(self, kind: str, utc_ns: int) -> bool:
        """Whether an epoch of this time is one of those in which the kind comes."""
        times = self._times.get(kind)
        if times is None or not times.regular:
            return False
        since_ns = (utc_ns - times.utc_ns) % DAY_NS
        if since_ns > MISSED * times.interval_ns + SAME_NS:
            return False
        return abs(math.remainder(since_ns, times.interval_ns)) <= SAME_NS

    def due(self, utc_ns: int) -> list[str]:
        """All that are due in an epoch of this time."""
        return [kind for kind in self._times if self.is_due(kind, utc_ns)]
