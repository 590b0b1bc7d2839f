"""Whether a serial line is too slow for what its device sends, so that its messages wait in the device's buffer."""

from collections import deque
from dataclasses import dataclass

from .rate import SECOND_NS

_BITS = 10  # on the line per byte: start, 8 data, stop
_SECONDS = 4  # without a pause that show it
_CLOCK = 0.03  # share by which the baud rate of a device may differ from the one named
_JITTER_NS = 20_000_000  # of the best arrival in a second
_PAUSE_NS = 50_000_000  # between bytes; those of a line without pauses come every 16 ms, unless the host is late


@dataclass
class _Second:
    """A second of the host's clock in which bytes came."""

    number: int
    ahead_ns: float  # time that the line needs for all bytes so far, less the time that has passed: the most in it
    has_pause: bool = False


class LineLoad:
    """How busy a line is, from the bytes that have come. Not thread-safe; all times are monotonic nanoseconds.

    A line that is busy all the time brings as many bytes as its baud rate allows, and without pauses. Bursts over USB
    or a pseudo-terminal, which have no baud rate, may by chance bring as many, but with pauses in every second.
    """

    def __init__(self, baud: int) -> None:
        """baud: 0 if the line has none, which is then never too slow."""
        self.is_saturated = False
        self._is_judged = not baud  # whether the line has been seen to have pauses, or not to have any
        self._byte_ns = _BITS * 1e9 / baud if baud else 0.0
        self._busy_ns = 0.0
        self._last_ns: int | None = None
        self._first_ns = 0
        self._seconds: deque[_Second] = deque(maxlen=_SECONDS + 1)  # the newest is not over

    @property
    def hides_age(self) -> bool:
        """Whether what comes may have waited in the device, so that its arrival does not show how old it is."""
        return self.is_saturated or not self._is_judged

    def add(self, size: int, now_ns: int) -> None:
        """So many bytes have come."""
        if not self._byte_ns:
            return
        if self._last_ns is None:
            self._last_ns = self._first_ns = now_ns
            self._seconds.append(_Second(now_ns // SECOND_NS, 0.0, has_pause=True))  # for all that is known
        busy_ns = size * self._byte_ns
        self._busy_ns += busy_ns
        silent_ns = now_ns - self._last_ns
        has_pause = silent_ns > _PAUSE_NS  # perhaps only of the host: it needs one in each second
        self._is_judged |= silent_ns - busy_ns > _PAUSE_NS
        self._last_ns = now_ns
        self._note(_Second(now_ns // SECOND_NS, self._busy_ns - (now_ns - self._first_ns), has_pause))

    def _note(self, new: _Second) -> None:
        if self._seconds and self._seconds[-1].number == new.number:
            newest = self._seconds[-1]
            newest.ahead_ns = max(newest.ahead_ns, new.ahead_ns)
            newest.has_pause |= new.has_pause
            return
        if self._seconds and self._seconds[-1].number + 1 < new.number:
            self._seconds.clear()
        self._seconds.append(new)
        self._judge(list(self._seconds)[:-1])

    def _judge(self, over: list[_Second]) -> None:
        """Judge by the seconds that are over."""
        if len(over) < 2:
            return
        passed_s = len(over) - 1
        is_full = len(over) == _SECONDS
        change_ns = over[-1].ahead_ns - over[0].ahead_ns
        is_steady = abs(change_ns) <= _CLOCK * passed_s * SECOND_NS + _JITTER_NS
        self.is_saturated = is_full and is_steady and not all(each.has_pause for each in over)
        self._is_judged |= is_full or not is_steady
