"""A descriptor that becomes readable at a time: Linux's timerfd. (Python has it from 3.13 on.)"""

import ctypes
import math
import os
import time


class TimerFd:
    """`at` is the CLOCK_MONOTONIC time in s for which it is set; infinite: it is off."""

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self.fd: int = self._libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        self.at = math.inf

    def set(self, at: float) -> None:
        """Be readable from then on, and not before."""
        self.at = at
        ns = 0 if math.isinf(at) else max(round(at * 1e9), 1)
        value = (ctypes.c_long * 4)(0, 0, *divmod(ns, 1_000_000_000))  # interval, time: seconds and ns each
        self._libc.timerfd_settime(self.fd, 1, value, None)  # TFD_TIMER_ABSTIME

    def close(self) -> None:
        os.close(self.fd)
