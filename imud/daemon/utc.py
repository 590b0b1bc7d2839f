"""UTC for what the daemon sends: this machine's clock, or the receiver's time while the two contradict each other.

A clock that is set is smoother, and mostly more exact, than what comes over a serial line. But a machine without a
battery and a network begins where it stopped, or in 1970.
"""

import math
import time
from collections import deque

from ..sensors.receiver import Receiver

_DIFFERS_S, _AGREES_S = 1.0, 0.5  # more is no latency of the receiver; less, and the machine's clock counts again
_ROLLOVER_S = 1024 * 7 * 86_400  # after which GPS's week number begins anew; receivers that ignore it err by so much
_FIXES = 3  # of whose times the median counts


class Utc:
    """Continues with the receiver's time when the receiver is gone. Not thread-safe."""

    def __init__(self) -> None:
        # unix time of the last fixes less CLOCK_BOOTTIME, which a suspension does not stop
        self._by_receiver_s: deque[float] = deque(maxlen=_FIXES)
        self._differs = False

    def add(self, receiver: Receiver) -> None:
        """A fix of the receiver was used."""
        offset_s = receiver.utc_less_monotonic_s(time.time_ns())
        if offset_s is not None:
            self._by_receiver_s.append(offset_s - _suspended_s())

    def machine_differs(self) -> bool:
        """Whether the machine's clock, or the receiver's, is wrong by more than a second."""
        if self._by_receiver_s:
            difference_s = math.remainder(self._receivers_s() - _machines_s(), _ROLLOVER_S)
            self._differs = abs(difference_s) > (_AGREES_S if self._differs else _DIFFERS_S)
        return self._differs

    def at(self, t_ns: int) -> float:
        """Unix time of a monotonic one."""
        return (self._receivers_s() if self.machine_differs() else _machines_s()) + t_ns * 1e-9

    def _receivers_s(self) -> float:
        """Its unix time less the monotonic one."""
        return sorted(self._by_receiver_s)[len(self._by_receiver_s) // 2] + _suspended_s()


def _machines_s() -> float:
    return (time.time_ns() - time.monotonic_ns()) * 1e-9


def _suspended_s() -> float:
    return (time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()) * 1e-9
