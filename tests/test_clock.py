"""The clock: stamps against a simulated device whose true sample times are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imud.clock import EpochClock, new_clock, stamp

PERIOD_NS = 1_000_000


def stamps(ticks, arrivals, delay_ns=0.0, clock=None):
    clock = new_clock(PERIOD_NS, delay_ns) if clock is None else clock
    return np.array([stamp(clock[0], int(k), int(a)) for k, a in zip(ticks, arrivals, strict=True)]), clock


def device(n, clock_error=0.0, jitter_ns=5e6, seed=1, start_ns=10**15):
    """True sample times and arrival times (up to 2 jitter_ns late) of a device whose clock is off by `clock_error`."""
    rng = np.random.default_rng(seed)
    ticks = np.arange(n)
    truth = start_ns + ticks * PERIOD_NS * (1.0 + clock_error)
    return ticks, truth, truth + rng.uniform(0.0, 2.0 * jitter_ns, n)


def read_in_batches(truth, seed=1):
    """Arrival times when the host looks every 0.1 to 10 ms and takes all that is there."""
    looks = truth[0] + np.cumsum(np.random.default_rng(seed).uniform(1e5, 1e7, len(truth)))
    return looks[np.searchsorted(looks, truth)]


@pytest.mark.parametrize("clock_error", [0.0, 1e-3, -1e-3, 5e-5])
@pytest.mark.parametrize("batched", [False, True])
def test_arrival_jitter_of_5_ms_moves_a_stamp_by_less_than_half_a_millisecond(clock_error, batched):
    ticks, truth, arrivals = device(60_000, clock_error)
    t, clock = stamps(ticks, read_in_batches(truth) if batched else arrivals)
    error = t - truth
    assert np.abs(error[2_000:8_000]).max() < 2e6
    assert np.abs(error[8_000:]).max() < 0.1e6
    assert clock["slope"][0] / PERIOD_NS - 1.0 == pytest.approx(clock_error, abs=2e-5)


def test_stamps_are_older_than_the_arrival_by_the_stated_delay():
    ticks, truth, arrivals = device(5_000, jitter_ns=0.0)
    t, _ = stamps(ticks, arrivals, delay_ns=7e5)
    assert np.abs(t - (truth - 7e5)).max() <= 1


def test_a_stalled_host_does_not_move_the_stamps():
    ticks, truth, arrivals = device(40_000, jitter_ns=1e5)
    stalled = (ticks > 20_000) & (ticks < 20_800)
    arrivals = np.where(stalled, arrivals[20_800], arrivals)  # everything of 0.8 s is read at once
    t, clock = stamps(ticks, arrivals)
    assert np.abs(t - truth)[5_000:].max() < 0.3e6
    assert clock["resets"][0] == 0


def test_lost_samples_are_bridged_by_the_counter():
    ticks, truth, arrivals = device(30_000, 2e-4, jitter_ns=1e6)
    kept = np.random.default_rng(2).random(len(ticks)) > 0.3
    t, _ = stamps(ticks[kept], arrivals[kept])
    assert np.abs(t - truth[kept])[12_000:].max() < 0.5e6


def test_a_jumped_counter_starts_the_fit_anew():
    ticks, truth, arrivals = device(40_000, jitter_ns=1e5)
    ticks = np.where(ticks < 20_000, ticks, ticks + 50_000)
    t, clock = stamps(ticks, arrivals)
    assert clock["resets"][0] >= 1
    assert np.all(np.diff(t) > 0)
    count = np.arange(40_000)
    t, _ = stamps(count - 100_000 * (count >= 20_000), arrivals)
    assert np.abs(t - truth)[25_000:].max() < 0.5e6


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(st.integers(-3, 2000), st.integers(0, 2_000_000_000)), min_size=1, max_size=300),
)
def test_stamps_increase_whatever_comes(steps):
    ticks, arrivals = np.cumsum([s[0] for s in steps]), 10**12 + np.cumsum([s[1] for s in steps])
    t, _ = stamps(ticks, arrivals)
    assert np.all(np.diff(t) > 0)


def test_epochs_follow_the_fastest_delivery():
    clock = EpochClock(latency_s=0.15)
    rng = np.random.default_rng(3)
    late = rng.uniform(0.15e9, 0.4e9, 200)
    late[0] = 0.35e9
    utc = 86_350.0 + np.arange(200)  # over midnight
    true_ns = 5 * 10**12 + np.arange(200) * 10**9
    epochs = np.array([clock.epoch_ns(u % 86_400, int(t + d)) for u, t, d in zip(utc, true_ns, late, strict=True)])
    assert np.abs(epochs - true_ns)[30:].max() < 0.03e9


def test_a_step_of_the_receivers_utc_is_followed():
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
