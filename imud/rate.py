"""How fast something comes, as `imud status` shows it."""

import math
from collections import deque

SECOND_NS = 1_000_000_000
LOOKS = 11  # a second apart: the rate is that of the last ten seconds


class Rate:
    """How fast a counter counts, from a glance per second."""

    def __init__(self) -> None:
        self._looks: deque[tuple[int, int]] = deque(maxlen=LOOKS)

    def look(self, count: int, now_ns: int) -> None:
        """Take note of the counter, as often as is convenient."""
        if not self._looks or now_ns - self._looks[-1][0] >= SECOND_NS:
            self._looks.append((now_ns, count))

    @property
    def hz(self) -> float:
        """NaN before the second glance."""
        if len(self._looks) < 2:
            return math.nan
        (first_ns, first), (last_ns, last) = self._looks[0], self._looks[-1]
        return (last - first) * 1e9 / (last_ns - first_ns)
