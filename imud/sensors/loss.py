"""Whether much of what a device sends does not arrive whole."""

from collections import deque

from .limits import LIMITS
from .rate import SECOND_NS, WINDOW_S

HIGH = LIMITS["damaged_share"].most
LOW = 0.5 * HIGH  # of what was sent in the last ten seconds: begins and ends to be worth a word
MIN_DAMAGED = 5  # damaged ones at least: a glitch is none


class LossMonitor:
    """How much of a stream is lost or damaged, from a look per second."""

    def __init__(self) -> None:
        self._looks: deque[tuple[int, int, int]] = deque(maxlen=WINDOW_S)
        self.is_high = False

    def update(self, whole: int, damaged: int, now_ns: int) -> None:
        """Take note of how many came whole, and how many did not, as often as is convenient."""
        if self._looks and now_ns - self._looks[-1][0] < SECOND_NS:
            return
        self._looks.append((now_ns, whole, damaged))
        came, failed = whole - self._looks[0][1], damaged - self._looks[0][2]
        bound = LOW if self.is_high else HIGH
        self.is_high = failed >= MIN_DAMAGED and failed > bound * (came + failed)
