"""A timer that a poll can wait for: Linux's timerfd on CLOCK_MONOTONIC, absolute times. (`os` has it from 3.13.)"""

import contextlib
import ctypes
import os
import select
import time

from ..errors import NotSerialError
from .reasons import reason

_NONBLOCK, _CLOEXEC, _ABSOLUTE = os.O_NONBLOCK, os.O_CLOEXEC, 1
_libc = ctypes.CDLL(None, use_errno=True)


class _TimeSpec(ctypes.Structure):
    _fields_ = (("s", ctypes.c_long), ("ns", ctypes.c_long))


class _TimerSpec(ctypes.Structure):
    _fields_ = (("interval", _TimeSpec), ("value", _TimeSpec))


class Timer:
    """One timer. `fd` is readable from its time on, until it is cleared or set anew. Not thread-safe."""

    def __init__(self) -> None:
        self.fd: int = _libc.timerfd_create(time.CLOCK_MONOTONIC, _NONBLOCK | _CLOEXEC)
        if self.fd < 0:
            raise OSError(ctypes.get_errno(), "cannot create a timer")
        self._spec = _TimerSpec()
        self._pointer = ctypes.byref(self._spec)

    def set(self, at_ns: int) -> None:
        """Expire at that time, at once if it is past."""
        value = self._spec.value
        value.s, value.ns = divmod(max(at_ns, 1), 1_000_000_000)  # 0 would disarm it
        _libc.timerfd_settime(self.fd, _ABSOLUTE, self._pointer, None)

    def clear(self) -> None:
        """Make `fd` not readable until the timer is set anew."""
        with contextlib.suppress(BlockingIOError):
            os.read(self.fd, 8)

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self.fd)


def timer_and_epoll(path: str) -> tuple[Timer, select.epoll]:
    """A timer, and an epoll that waits for it, of a port. Raises NotSerialError: too many descriptors are open."""
    try:
        timer = Timer()
        try:
            epoll = select.epoll()
        except OSError:
            timer.close()
            raise
    except OSError as error:
        raise NotSerialError(path, f"{path} cannot be used: {reason(error)}") from error
    epoll.register(timer.fd, select.EPOLLIN)
    return timer, epoll
