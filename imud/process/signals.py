"""Signals for an event loop: their actions run at once, and a descriptor wakes the loop."""

import contextlib
import os
import signal
from collections.abc import Callable, Iterator, Mapping


def endings() -> set[signal.Signals]:
    """Those that end a program: a hang-up only where whoever started us has not had it ignored, as nohup has."""
    hang_up = set() if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else {signal.SIGHUP}
    return {signal.SIGTERM, signal.SIGINT} | hang_up


@contextlib.contextmanager
def caught(actions: Mapping[signal.Signals, Callable[[], None]]) -> Iterator[int]:
    """Lets signals call their actions; yields a descriptor that becomes readable when they have."""
    reader, writer = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    before = {number: signal.signal(number, lambda n, _: actions[signal.Signals(n)]()) for number in actions}
    wakeup = signal.set_wakeup_fd(writer)
    try:
        yield reader
    finally:
        signal.set_wakeup_fd(wakeup)
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(reader)
        os.close(writer)
