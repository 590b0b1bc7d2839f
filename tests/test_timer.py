"""The timer that a loop waits for beside its lines."""

import select
import time

from imud.drivers.transport.timer import Timer


def test_a_timer_rings_at_its_time_and_not_before():
    timer = Timer()
    poll = select.poll()
    poll.register(timer.fd, select.POLLIN)
    due_ns = time.monotonic_ns() + 20_000_000
    timer.set(due_ns)
    assert poll.poll(1000)
    assert time.monotonic_ns() >= due_ns
    timer.clear()
    timer.clear()
    assert not poll.poll(0)
    timer.set(0)
    assert poll.poll(1000)
    timer.close()
