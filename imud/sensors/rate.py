"""How fast something comes, as `imud status` shows it."""

import math
from collections import deque

SECOND_NS = 1_000_000_000
WINDOW_S = 11  # a second apart: the rate is that of the last ten seconds
STEADY, ALIKE = 3, 0.1  # looks in a row that must agree; by what share they may differ
OFF = 0.25  # share by which the rate must differ from the agreed one to count as another
LOOK_NS, TICKS = 900_000_000, 20  # at least, between two looks of `SampleRateMonitor`


class RateMeter:
    """How fast a counter counts, from a look per second."""

    def __init__(self) -> None:
        self._looks: deque[tuple[int, int]] = deque(maxlen=WINDOW_S)

    def update(self, count: int, now_ns: int) -> None:
        """Take note of the counter, as often as is convenient."""
        if not self._looks or now_ns - self._looks[-1][0] >= SECOND_NS:
            self._looks.append((now_ns, count))

    @property
    def hz(self) -> float:
        """NaN before the second look."""
        if len(self._looks) < 2:
            return math.nan
        (first_ns, first), (last_ns, last) = self._looks[0], self._looks[-1]
        return (last - first) * 1e9 / (last_ns - first_ns)


class SampleRateMonitor:
    """Whether ticks come as fast as was agreed: a device that started anew by itself may be back at its own rate.

    A machine that does not keep up sees them come unevenly.
    """

    def __init__(self, agreed_hz: float) -> None:
        self.agreed_hz = agreed_hz
        self._apart_ns = max(LOOK_NS, round(TICKS * 1e9 / agreed_hz))
        self._last: tuple[int, int] | None = None
        self._seen: deque[float] = deque(maxlen=STEADY)

    def update(self, tick: int, t_ns: int) -> None:
        """Take note of a tick and of when it came, as often as is convenient."""
        if self._last is not None:
            ticks, passed_ns = tick - self._last[0], t_ns - self._last[1]
            if ticks >= 0 and passed_ns < self._apart_ns:
                return
            self._seen.append(ticks * 1e9 / passed_ns if ticks > 0 and passed_ns < 2 * self._apart_ns else math.nan)
        self._last = tick, t_ns

    @property
    def share(self) -> float | None:
        """The rate over the agreed one: exactly 1.0 unless it is plainly another; None while it is not known."""
        mean = sum(self._seen) / STEADY
        if len(self._seen) < STEADY or not all(abs(hz / mean - 1.0) < ALIKE for hz in self._seen):
            return None
        share = mean / self.agreed_hz
        return share if abs(share - 1.0) > OFF else 1.0
