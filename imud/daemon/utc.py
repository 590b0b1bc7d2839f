"""UTC for what the daemon sends: this machine's clock, or the receiver's time while that clock is wrong.

A clock that is set is smoother, and mostly more exact, than what comes over a serial line. But a machine without a
battery and a network begins where it stopped, or in 1970.
"""

import math
import time
from collections import deque

from ..sensors.receiver import Receiver

_DAY_S = 86_400.0
_DIFFERS_S = 1.0  # either may be wrong: fixes come late over Bluetooth or a network, by seconds
_WRONG_S = 30.0  # the machine's clock is: a receiver that does not know the leap seconds yet errs by up to 18 s
_FIXES = 3  # of whose times the median counts


class Utc:
    """Continues with the receiver's time when the receiver is gone. Not thread-safe.

    Once a fix has had a date, fixes without one do not count; before, only the time of day of these does.
    """

    def __init__(self) -> None:
        # unix time of the last fixes less CLOCK_BOOTTIME, which a suspension does not stop
        self._by_receiver_s: deque[float] = deque(maxlen=_FIXES)
        self._is_dated = False  # those have dates
        self._differs = self._is_wrong = False

    def add(self, receiver: Receiver) -> None:
        """A fix of the receiver was used."""
        offset_s = receiver.utc_less_monotonic_s(time.time_ns())
        if offset_s is None:
            return
        is_dated = receiver.last_used_fix.date is not None
        if is_dated and not self._is_dated:
            self._by_receiver_s.clear()
            self._is_dated = True
        if is_dated or not self._is_dated:
            self._by_receiver_s.append(offset_s - _suspended_s())

    def machine_differs(self) -> bool:
        """Whether the machine's clock, or the receiver's, is wrong by more than a second."""
        self._differs = _exceeds(self._difference_s(), _DIFFERS_S, self._differs)
        return self._differs

    def at(self, t_ns: int) -> float:
        """Unix time of a monotonic one."""
        difference_s = self._difference_s()
        self._is_wrong = _exceeds(difference_s, _WRONG_S, self._is_wrong)
        return _machines_s() + (difference_s if self._is_wrong else 0.0) + t_ns * 1e-9

    def _difference_s(self) -> float:
        """By how much the receiver is ahead of the machine's clock; 0 before the first fix."""
        if not self._by_receiver_s:
            return 0.0
        receivers_s = sorted(self._by_receiver_s)[len(self._by_receiver_s) // 2] + _suspended_s()
        difference_s = receivers_s - _machines_s()
        return difference_s if self._is_dated else math.remainder(difference_s, _DAY_S)


def _exceeds(difference_s: float, limit_s: float, did: bool) -> bool:
    """Ends at half of the limit, so that it does not change to and fro."""
    return abs(difference_s) > (0.5 * limit_s if did else limit_s)


def _machines_s() -> float:
    return (time.time_ns() - time.monotonic_ns()) * 1e-9


def _suspended_s() -> float:
    return (time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()) * 1e-9
