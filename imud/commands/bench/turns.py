"""Contestants that take turns, so that whatever slows the machine slows all of them alike."""

import statistics
from collections.abc import Callable


class Turns:
    """Calls each contestant once per round; a contestant returns the seconds it took."""

    def __init__(self, rounds: int, *contestants: Callable[[], float]) -> None:
        self._times = [[contestant() for contestant in contestants] for _ in range(rounds)]

    def median(self, index: int) -> float:
        """Seconds of one contestant."""
        return statistics.median(row[index] for row in self._times)

    def ratio(self, index: int, other: int) -> float:
        """Median of one's time over the other's in the same round."""
        return statistics.median(row[index] / row[other] for row in self._times)
