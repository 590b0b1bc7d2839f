"""Epochs of a receiver on the host's clock, against simulated receivers whose true epochs are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imud.clocks.epochs import EpochClock

LATENCY_S = 0.15
DAY_S = 86_400
HOST_NS = 5 * 10**12


class Receiver:
    """Fixes `interval_s` apart from `utc_s` on; each late by the latency and more. Keeps the clock's errors, in s."""

    def __init__(self, interval_s=1.0, utc_s=40_000.0):
        self.clock, self.interval_s = EpochClock(LATENCY_S), interval_s
        self.utc_s, self.true_ns, self.arrival_ns, self.errors = utc_s, HOST_NS, 0, []

    def fix(self, late_s=0.0, step_s=0.0, at_ns=None):
        """One fix; before it the receiver's UTC steps."""
        self.utc_s += self.interval_s + step_s
        self.true_ns += round(self.interval_s * 1e9)
        arrival_ns = self.true_ns + round((LATENCY_S + late_s) * 1e9)
        self.arrival_ns = max(self.arrival_ns, arrival_ns if at_ns is None else max(at_ns, arrival_ns))
        epoch_ns = self.clock.epoch_ns(self.utc_s % DAY_S, self.arrival_ns)
        assert epoch_ns <= self.arrival_ns - LATENCY_S * 1e9 + 1.0
        self.errors.append((epoch_ns - self.true_ns) * 1e-9)
        return self.errors[-1]


def wobble(seed, n, width_s=0.17):
    return np.random.default_rng(seed).uniform(0.0, width_s, n)


@given(st.lists(st.tuples(st.floats(0.0, 86_400.999), st.integers(0, 3 * 10**9)), min_size=1, max_size=150))
def test_no_epoch_is_after_its_arrival_nor_far_before(steps):
    clock, arrival_ns = EpochClock(LATENCY_S), HOST_NS
    for utc_s, wait_ns in steps:
        arrival_ns += wait_ns
        delay_s = (arrival_ns - clock.epoch_ns(utc_s, arrival_ns)) * 1e-9
        assert LATENCY_S - 1e-6 <= delay_s <= LATENCY_S + 10.0 + 1e-6


@given(
    st.lists(st.floats(0.0, 0.7), min_size=1, max_size=200), st.sampled_from([0.1, 0.2, 1.0, 5.0]), st.integers(0, 99)
)
def test_an_epoch_is_as_late_as_the_earliest_arrival_of_the_last_minute(extra, interval_s, seed):
    receiver, late = Receiver(interval_s, DAY_S - seed), []  # over midnight
    for extra_s in extra:
        error = receiver.fix(extra_s)
        late.append((receiver.arrival_ns - receiver.true_ns) * 1e-9 - LATENCY_S)
        assert min(late) - 1e-6 <= error <= min(late[-int(60 / max(1.0, interval_s)) :]) + 1e-6


@pytest.mark.thorough
@pytest.mark.parametrize("interval_s", [0.1, 0.2, 1.0])
@pytest.mark.parametrize("step_s", [-1.0, -2.0, -3.0, -9.0, -18.0, -3600.0, 1.0, 3.0, 18.0, 30_000.0])
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_a_step_of_whole_seconds_is_tracked_within_six_seconds(interval_s, step_s, seed):
    receiver = Receiver(interval_s)
    for late_s in wobble(seed, 100):
        receiver.fix(late_s)
    n = int(6 / interval_s)
    after = [receiver.fix(late_s, step_s if k == 0 else 0.0) for k, late_s in enumerate(wobble(seed + 1, 4 * n))]
    assert np.abs(after[n:]).max() < 0.3
    if step_s > 0.0 or step_s < -10.0:
        assert np.abs(after).max() < 0.3, "at once"


@pytest.mark.parametrize("step_s", [-0.4, -1.5, -2.4, 0.6])
def test_any_other_step_is_tracked_after_a_minute(step_s):
    receiver = Receiver()
    for late_s in wobble(1, 100):
        receiver.fix(late_s)
    after = [receiver.fix(late_s, step_s if k == 0 else 0.0) for k, late_s in enumerate(wobble(2, 100))]
    assert np.abs(after[66:]).max() < 0.2


def test_a_leap_second_does_not_move_the_epochs_for_long():
    clock, errors = EpochClock(LATENCY_S), []
    labels = [
        *range(DAY_S - 30, DAY_S + 1),
        *range(DAY_S, DAY_S + 30),
    ]  # 23:59:60 is 86400, and 00:00:00 comes after it
    for k, label in enumerate(labels):
        true_ns = HOST_NS + k * 10**9
        utc_s = float(label) if k <= 30 else float(label - DAY_S)
        errors.append((clock.epoch_ns(utc_s, true_ns + 150_000_000) - true_ns) * 1e-9)
    assert np.abs(errors[:31]).max() < 1e-6
    assert np.abs(errors[36:]).max() < 1e-6
    assert min(errors) >= -1.0 - 1e-6


def test_the_clock_before_the_first_fix_is_forgotten_at_the_jump():
    receiver = Receiver(utc_s=86_386.0)
    for late_s in wobble(3, 20):
        receiver.fix(late_s)
    assert 0.0 <= receiver.fix(0.1, -56_709.4) <= 0.1 + 1e-6
    assert max(abs(receiver.fix(late_s)) for late_s in wobble(4, 20)) < 0.2


@pytest.mark.parametrize("interval_s", [0.1, 0.2, 1.0])
@pytest.mark.parametrize("stall_s", [0.5, 1.0, 1.3, 2.0, 3.1, 5.0, 9.0])
def test_what_a_stalled_host_reads_at_once_keeps_its_epochs(interval_s, stall_s):
    receiver = Receiver(interval_s)
    for late_s in wobble(5, 200, 0.05):
        receiver.fix(late_s)
    wake_ns = receiver.true_ns + round(stall_s * 1e9)
    during = [receiver.fix(0.0, at_ns=wake_ns) for _ in range(int(stall_s / interval_s))]
    after = [receiver.fix(late_s) for late_s in wobble(6, 100, 0.05)]
    assert np.abs(during + after).max() < 0.06


@pytest.mark.parametrize("late_s", [0.2, 0.7, 1.0, 1.2, 2.0])
def test_every_fifth_burst_of_a_slow_line_may_be_late(late_s):
    receiver = Receiver()
    for k, extra_s in enumerate(wobble(7, 300, 0.05)):
        receiver.fix(extra_s + (late_s if k % 5 == 0 and k else 0.0))
    assert np.abs(receiver.errors).max() < 0.06


def test_a_line_that_falls_behind_is_no_step():
    receiver = Receiver()
    for k in range(60):
        receiver.fix(0.05 * k)
    assert np.abs(receiver.errors).max() < 1e-6


def test_one_wrong_time_spoils_few_epochs():
    for wrong_s in (-7.0, 4.0, 30.0, -400.0):
        receiver = Receiver()
        for late_s in wobble(8, 50):
            receiver.fix(late_s)
        receiver.fix(0.1, wrong_s)
        receiver.fix(0.1, -wrong_s)
        after = [receiver.fix(late_s) for late_s in wobble(9, 30)]
        assert np.abs(after[6:]).max() < 0.3


def test_a_lost_hour_does_not_disturb_the_clock():
    receiver = Receiver()
    for late_s in wobble(10, 30):
        receiver.fix(late_s)
    receiver.utc_s += 3600.0
    receiver.true_ns += 3600 * 10**9
    assert 0.0 <= receiver.fix(0.1) <= 0.1 + 1e-6


def test_epochs_follow_the_fastest_delivery():
    clock = EpochClock(latency_s=0.15)
    rng = np.random.default_rng(3)
    late = rng.uniform(0.15e9, 0.4e9, 200)
    late[0] = 0.35e9
    utc = 86_350.0 + np.arange(200)  # over midnight
    true_ns = 5 * 10**12 + np.arange(200) * 10**9
    epochs = np.array([clock.epoch_ns(u % 86_400, int(t + d)) for u, t, d in zip(utc, true_ns, late, strict=True)])
    assert np.abs(epochs - true_ns)[30:].max() < 0.03e9


def test_a_step_of_the_receivers_utc_is_tracked():
    clock = EpochClock(latency_s=0.1)
    for k in range(20):
        utc = 1000.0 + k + (18.0 if k >= 10 else 0.0)
        epoch = clock.epoch_ns(utc, 10**12 + k * 10**9 + 10**8)
    assert epoch == 10**12 + 19 * 10**9
    clock = EpochClock(latency_s=0.1)
    for k in range(20):
        utc = 1000.0 + k - (18.0 if k >= 10 else 0.0)
        epoch = clock.epoch_ns(utc, 10**12 + k * 10**9 + 10**8)
    assert epoch == 10**12 + 19 * 10**9
