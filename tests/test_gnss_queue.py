"""A receiver whose first fixes have waited somewhere: they arrive at once, so their arrivals do not say their age."""

import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import drive, errors, received, sensed
from nmea_lines import gga

from imud.clocks.epochs import EpochClock
from imud.configuration.settings import Gnss
from imud.drivers.registry import by_name
from imud.estimators.records import POSITION_VALID
from imud.sensors.receiver import Receiver

SECOND = 1_000_000_000
LATENCY_S = 0.15


def bursts(arrival_s):
    """Every 5 s what has been made since."""
    return np.ceil((arrival_s - LATENCY_S) / 5.0) * 5.0 + LATENCY_S


def queue(arrival_s):
    """What was made in the first 38 s comes at their end; the drive begins at 10 s."""
    return np.maximum(arrival_s, 138.0 + 1e-3 * np.arange(len(arrival_s)))


@pytest.mark.parametrize("delivery", [bursts, queue])
@pytest.mark.parametrize("seed", [1, 2])
def test_positions_are_within_their_sigmas_from_the_first_one_on(delivery, seed):
    rng = np.random.default_rng(seed)
    d = drive(90.0, speed=20.0)
    samples, fixes = sensed(d, rng), received(d, rng, late=LATENCY_S)
    arrival_ns = np.rint(delivery(fixes["arrival_ns"] * 1e-9) * 1e9).astype(int)
    clock, known = EpochClock(LATENCY_S), []
    for k, at_ns in enumerate(arrival_ns):
        t_ns = clock.epoch_ns(fixes["t_ns"][k] * 1e-9, int(at_ns))
        fixes["t_ns"][k], fixes["arrival_ns"][k] = t_ns, at_ns
        known.append(clock.is_known)
    out = navigate(samples, fixes[known])[0]
    p = np.abs(errors(d, out)[0][:, :2])
    valid = (out["status"] & POSITION_VALID) != 0
    assert valid[-1000:].all()
    assert (p < np.maximum(4.0 * out["sigma_p"][:, :2], 5.0))[valid].all()


@pytest.mark.parametrize("interval_s", [0.1, 0.2, 1.0, 5.0])
@pytest.mark.parametrize("queued", [0, 1, 2, 30])
def test_the_fixes_of_a_queue_are_not_used(interval_s, queued):
    """Nor is the first one of a receiver without a queue: it looks the same."""
    receiver, used = Receiver(by_name("nmea"), Gnss(latency_s=LATENCY_S), 0), []
    for k in range(queued + 10):
        made_s = 100.0 + interval_s * (k - queued)
        arrival_s = max(made_s, 100.0) + LATENCY_S + 1e-3 * (k if k <= queued else queued)
        utc_s = 60.0 + interval_s * k
        sentence = gga(f"12{int(utc_s // 60):02d}{utc_s % 60:06.3f}")
        rows = receiver.feed(sentence, round(arrival_s * 1e9)) + receiver.flush(round((arrival_s + 1e-4) * 1e9))
        used += [int(row["t_ns"][0]) * 1e-9 for row in rows]
    assert len(used) == 9 and receiver.refused == {"unknown age": queued + 1}
    assert used == pytest.approx([100.0 + interval_s * k for k in range(1, 10)], abs=0.05)


def test_a_queue_of_three_is_in_the_log():
    receiver, messages = Receiver(by_name("nmea"), Gnss(), 0), []
    for second in range(8):
        receiver.feed(gga(f"12000{second}.000"), max(second, 4) * SECOND)
        messages.append(receiver.message)
        receiver.message = ""
    first, second = filter(None, messages)
    assert "their age is not known" in first and second == "the fixes are used again"


@pytest.mark.parametrize("latency_s", [1.9, 2.1])
def test_fixes_that_are_always_too_late_are_a_fault(latency_s):
    receiver = Receiver(by_name("nmea"), Gnss(latency_s=latency_s), 0)
    for second in range(8):
        receiver.feed(gga(f"12000{second}.000"), (5 + second) * SECOND)
    assert any("too late" in fault for fault in receiver.faults(13 * SECOND)) == (latency_s > 2.0)


def test_a_pulse_does_not_make_a_queue_right():
    clock = EpochClock(LATENCY_S)
    for k in range(5):
        clock.epoch_ns(10.0 + k, 100 * SECOND + k, 99_900_000_000)
        assert not clock.is_known
    assert clock.epoch_ns(15.0, 101 * SECOND + 200_000_000, 101 * SECOND) == 101 * SECOND and clock.is_known


@pytest.mark.parametrize("step", [1, -1])
def test_a_time_that_runs_backward_is_a_fault_also_over_midnight(step):
    receiver = Receiver(by_name("nmea"), Gnss(), 0)
    for k in range(8):
        second = (86_398 + step * k if step > 0 else 2 - k) % 86_400
        receiver.feed(gga(f"{second // 3600:02d}{second // 60 % 60:02d}{second % 60:02d}.000"), (5 + k) * SECOND)
    assert any("backward" in fault for fault in receiver.faults(13 * SECOND)) == (step < 0)


def used_of(seconds):
    """Which of the fixes of these times of day, one a second, are used; and the receiver."""
    receiver, used = Receiver(by_name("nmea"), Gnss(), 0), []
    for k, second in enumerate(seconds):
        text = f"{second // 3600 % 24:02d}{second // 60 % 60:02d}{second % 60:02d}.000"
        rows = receiver.feed(gga(text), (5 + k) * SECOND) + receiver.flush((5 + k) * SECOND + 300_000_000)
        used.append(bool(rows))
    return used, receiver


def test_fixes_of_a_time_that_runs_backward_are_not_used():
    used, _ = used_of(range(50_000, 49_980, -1))
    assert not any(used[3:])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_fixes_of_a_time_that_jumps_about_are_not_used_and_it_is_a_fault(seed):
    times = [int(second) for second in np.random.default_rng(seed).integers(0, 86_400, 20)]
    used, receiver = used_of(times)
    assert not any(used[3:])
    assert any("its time" in fault for fault in receiver.faults(25 * SECOND))  # backward, if the last ones happen to
    used, receiver = used_of([*times, *range(40_000, 40_020)])
    assert all(used[-15:]) and not receiver.faults(45 * SECOND)


def test_a_single_step_of_the_time_costs_no_fix_by_that():
    used, receiver = used_of([*range(40_000, 40_010), *range(50_000, 50_010)])
    assert all(used[1:]) and not receiver.faults(25 * SECOND)
