"""Which kind of sentence begins a burst, and which one ends it."""

from collections import Counter

ESTABLISHED = 2  # score of a kind that was at this end in the last two bursts
FIRST_ELSEWHERE, LAST_ELSEWHERE = -3, -100  # score of one that was not: others may follow it in one of so many bursts


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

    def is_established(self, kind: str) -> bool:
        """Whether `kind` was at this end in the last bursts."""
        return self._score[kind] >= ESTABLISHED

    def is_contradicted(self, kind: str) -> bool:
        """Whether `kind` was elsewhere in the last bursts."""
        return self._score[kind] < 0
