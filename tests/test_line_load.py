"""A receiver whose line is too slow for its sentences: they wait in its buffer, and nothing in them says so."""

import numpy as np
import pytest

from imud.configuration.settings import Gnss
from imud.drivers.registry import by_name
from imud.firmware_sim.fixes import SimulatedFixes
from imud.firmware_sim.motion import Trajectory
from imud.firmware_sim.nmea import FvM11
from imud.firmware_sim.scenarios import SCENARIOS
from imud.sensors.line_load import LineLoad
from imud.sensors.receiver import Receiver

MS = 1_000_000
SECOND = 1000 * MS


def reads(burst, interval_s, baud, seconds, clock=1.0, every_ms=16):
    """(arrival in ns, bytes) of what a line of that baud rate brings: a burst of so many bytes in each interval.

    clock: of the device, as a share of the baud rate. The host reads every few milliseconds, 30 ms late now and then.
    """
    chance = np.random.default_rng(1)
    waiting, due_s, out = 0.0, 0.0, []
    for k in range(int(1000 * seconds / every_ms)):
        now_s = 1e-3 * every_ms * k
        while due_s <= now_s:
            waiting, due_s = waiting + burst, due_s + interval_s
        sent = min(waiting, 1e-3 * every_ms * clock * baud / 10.0)
        waiting = min(waiting - sent, 2.0 * burst)
        late_ms = 30 if chance.random() < 0.02 else chance.uniform(0.0, 2.0)
        if sent:
            out.append((round(now_s * 1e9 + late_ms * MS), sent))
    return sorted(out)


def judged(arrivals, baud):
    """(is_saturated, hides_age) after each read."""
    load, out = LineLoad(baud), []
    for now_ns, size in arrivals:
        load.add(size, 100 * SECOND + now_ns)
        out.append((load.is_saturated, load.hides_age))
    return np.array(out)


@pytest.mark.parametrize("baud", [4800, 9600, 115200])
@pytest.mark.parametrize("clock", [0.98, 1.0, 1.02])
@pytest.mark.parametrize("interval_s", [0.1, 0.2, 1.0])
def test_a_line_that_is_busy_all_the_time_is_saturated(baud, clock, interval_s):
    seen = judged(reads(1.2 * baud / 10.0 * interval_s, interval_s, baud, 20.0, clock), baud)
    after = len(seen) * 7 // 20
    assert seen[after:, 0].mean() > 0.99
    assert seen[:, 1].mean() > 0.99


@pytest.mark.parametrize("baud", [4800, 9600, 115200])
@pytest.mark.parametrize("share", [0.05, 0.5, 0.8, 0.9])
@pytest.mark.parametrize("interval_s", [0.05, 0.2, 1.0])
def test_a_line_with_pauses_is_not_and_that_is_known_in_three_seconds(baud, share, interval_s):
    seen = judged(reads(share * baud / 10.0 * interval_s, interval_s, baud, 20.0), baud)
    assert not seen[:, 0].any()
    assert not seen[len(seen) * 3 // 20 :, 1].any()


def test_bursts_over_usb_that_by_chance_are_as_many_as_the_baud_rate_allows_are_not():
    bursts = [(round(1e9 * k) + 2 * MS * i, 96.0) for k in range(20) for i in range(10)]
    assert not judged(bursts, 9600)[:, 0].any()
    assert not judged(bursts, 9600)[len(bursts) // 10 :, 1].any()


@pytest.mark.parametrize("size, rate_hz", [(95.0, 10), (96.0, 10), (192.0, 5), (480.0, 2), (965.0, 1)])
def test_whole_bursts_that_are_as_many_as_the_baud_rate_allows_are_not(size, rate_hz):
    """As of a program that writes to a pseudo-terminal: each sentence is there at once."""
    bursts = [(round(1e9 * k / rate_hz), size) for k in range(20 * rate_hz)]
    assert not judged(bursts, 9600)[:, 0].any()
    assert not judged(bursts, 9600)[6 * rate_hz :, 1].any()


def test_a_line_that_has_caught_up_is_no_longer_saturated():
    slow = reads(1.5 * 192.0, 0.2, 9600, 10.0)
    fast = [(10 * SECOND + t_ns, size) for t_ns, size in reads(100.0, 0.2, 9600, 10.0)]
    seen = judged(slow + fast, 9600)
    assert seen[len(slow) - 1, 0] and not seen[-len(fast) // 2 :].any()


def received(baud, rate_hz):
    """What has come from an emulated receiver on a line of that baud rate, in 10 s; it has run for 10 s before."""
    source = SimulatedFixes(
        Trajectory(SCENARIOS["car"](0.0, 0.0, 0.0), 35.0, 139.0, 60.0), np.random.default_rng(1), 1.8e9
    )
    emulated = FvM11(source, 1.8e9, baud, rate_hz, no_fix_s=0.0)
    receiver = Receiver(by_name("nmea"), Gnss(), 0, baud=baud)
    for k in range(5000):
        t = 4e-3 * k
        emulated.advance(t)
        if (data := emulated.uart.take(t, baud)) and t > 10.0:
            receiver.feed(data, round(t * 1e9))
    return receiver


def test_fixes_that_wait_for_the_line_are_not_used_and_it_is_a_fault():
    receiver = received(9600, 5.0)
    assert receiver.used == 0 and receiver.refused["unknown age"] > 20
    assert any("too slow" in fault for fault in receiver.faults(20 * SECOND))


def test_at_a_higher_baud_rate_they_are_used():
    receiver = received(57600, 5.0)
    assert receiver.used > 45 and receiver.faults(20 * SECOND) == ()
