"""Signals for an event loop: their actions run at once, and a descriptor wakes up the loop."""

import contextlib
import os
import signal
from collections.abc import Callable, Iterator, Mapping


def endings() -> set[signal.Signals]:
    """The signals that end a program; SIGHUP only if it was not being ignored when we started, as under nohup."""
    hang_up = set() if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else {signal.SIGHUP}
    return {signal.SIGTERM, signal.SIGINT} | hang_up


@contextlib.contextmanager
def caught(actions: Mapping[signal.Signals, Callable[[], None]]) -> Iterator[int]:
    """Within the block, signals call their actions; yields a descriptor that becomes readable when one has.

    One that was blocked until now, and has come meanwhile, calls its action at once.
    """
    reader, writer = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    before = {number: signal.signal(number, lambda n, _: actions[signal.Signals(n)]()) for number in actions}
    wakeup = signal.set_wakeup_fd(writer)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, actions)
    try:
        yield reader
    finally:
        signal.set_wakeup_fd(wakeup)
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(reader)
        os.close(writer)
