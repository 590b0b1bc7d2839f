"""Whether much of what a device sends does not arrive whole."""

from collections import deque

from .rate import LOOKS, SECOND_NS

MUCH, LITTLE = 0.01, 0.005  # of what was sent in the last ten seconds: begins and ends to be worth a word
SOME = 5  # damaged ones at least: a glitch is none


class Loss:
    """How much of a stream is lost or damaged, from a look per second."""

    def __init__(self) -> None:
        self._looks: deque[tuple[int, int, int]] = deque(maxlen=LOOKS)
        self.much = False

    def look(self, whole: int, damaged: int, now_ns: int) -> None:
        """Take note of how many came whole, and how many did not, as often as is convenient."""
        if self._looks and now_ns - self._looks[-1][0] < SECOND_NS:
            return
        self._looks.append((now_ns, whole, damaged))
        came, failed = whole - self._looks[0][1], damaged - self._looks[0][2]
        bound = LITTLE if self.much else MUCH
        self.much = failed >= SOME and failed > bound * (came + failed)
