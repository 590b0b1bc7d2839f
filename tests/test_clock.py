"""The clock: stamps against a simulated device whose true sample times are known."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy  # imports scipy.stats when it is used
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from in_c import in_c

from imud.clocks.counter import new_clock, stamp
from imud.clocks.line import MAX_WINDOW_NS, POINTS, add_point
from imud.drivers.jit import kernel
from imud.sensors.inertial import Inertial

PERIOD_NS = 1_000_000


@kernel
def stamp_all(clock, ticks, arrivals, out):
    for i in range(len(ticks)):
        out[i] = stamp(clock, ticks[i], arrivals[i])


stamp_all = in_c(stamp_all)
add_point_in_c = in_c(add_point)


def stamps(ticks, arrivals, delay_ns=0.0, clock=None):
    clock = new_clock(PERIOD_NS, delay_ns) if clock is None else clock
    ticks, arrivals = (np.asarray(values).astype(np.int64) for values in (ticks, arrivals))
    assert len(ticks) == len(arrivals)
    out = np.empty(len(ticks), np.int64)
    stamp_all(clock[0], ticks, arrivals, out)
    return out, clock


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
    assert clock["corrections"][0] == 0


def test_the_counter_counts_lost_samples():
    ticks, truth, arrivals = device(30_000, 2e-4, jitter_ns=1e6)
    kept = np.random.default_rng(2).random(len(ticks)) > 0.3
    t, _ = stamps(ticks[kept], arrivals[kept])
    assert np.abs(t - truth[kept])[12_000:].max() < 0.5e6


def test_a_jumped_counter_starts_the_fit_anew():
    ticks, truth, arrivals = device(40_000, jitter_ns=1e5)
    ticks = np.where(ticks < 20_000, ticks, ticks + 50_000)
    t, clock = stamps(ticks, arrivals)
    assert clock["corrections"][0] >= 1
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


def without_counting(truth, gap_s, at):
    """The samples from `at` on are taken `gap_s` later, and no counter tells."""
    return truth + np.where(np.arange(len(truth)) >= at, gap_s * 1e9, 0.0)


@pytest.mark.parametrize("gap_s", [0.06, 0.5, 3.0])
@pytest.mark.parametrize("rate_hz", [50, 125, 1000])
@pytest.mark.parametrize("clock_error", [0.0, 1e-3])
def test_a_silent_gap_is_found_within_a_second(gap_s, rate_hz, clock_error):
    n, at = 40 * rate_hz, 25 * rate_hz
    period = 1e9 / rate_hz
    truth = without_counting(10**15 + np.arange(n) * period * (1.0 + clock_error), gap_s, at)
    arrivals = truth + np.random.default_rng(4).uniform(0.0, 10e6, n)
    t, clock = stamps(np.arange(n), arrivals, clock=new_clock(period, 0.0))
    error = np.abs(t - truth)
    assert error[10 * rate_hz : at].max() < 0.5e6
    assert error[at + rate_hz :].max() < 1.5e6  # as good as the few samples since tell
    assert clock["corrections"][0] == 1
    assert clock["slope"][0] / period - 1.0 == pytest.approx(clock_error, abs=1e-4)


@pytest.mark.parametrize("gap_s", [0.06, 0.5, 3.0])
def test_a_silent_gap_before_there_is_a_fit_does_no_harm(gap_s):
    truth = without_counting(10**15 + np.arange(3000) * 1e7, gap_s, 150)
    t, clock = stamps(np.arange(3000), truth + 1e5, clock=new_clock(1e7, 0.0))
    assert np.abs(t - truth)[300:].max() < 1e6
    assert clock["slope"][0] == pytest.approx(1e7, rel=2e-5)


@pytest.mark.parametrize(
    ("rate_hz", "stalls"),
    [(20, [(1.33, 1.2)]), (50, [(0.62, 0.2), (1.74, 2.0)]), (125, [(0.84, 1.2), (2.44, 1.2)]), (1000, [(1.9, 2.5)])],
)
def test_a_host_that_stalls_before_there_is_a_fit_gets_a_good_one(rate_hz, stalls):
    """Whole windows are late then, and so was the line: a wrong slope would call for corrections that keep it wrong."""
    period = 1e9 / rate_hz
    truth = 10**15 + np.arange(20 * rate_hz) * period
    arrivals = truth + np.random.default_rng(1).uniform(0.0, 1e6, len(truth))
    for begin_s, length_s in stalls:
        begin = 10**15 + begin_s * 1e9
        arrivals[(arrivals > begin) & (arrivals < begin + length_s * 1e9)] = begin + length_s * 1e9
    t, clock = stamps(np.arange(len(truth)), arrivals, clock=new_clock(period, 0.0))
    assert np.abs(t - truth)[10 * rate_hz :].max() < 1e6
    assert clock["slope"][0] == pytest.approx(period, rel=1e-4)
    assert clock["corrections"][0] == 0


@pytest.mark.parametrize("stop_s", [0.3, 3.0])
@pytest.mark.parametrize("kept_s", [9.0, 0.2])
def test_after_a_suspension_only_what_overflowed_is_missing(stop_s, kept_s):
    _, truth, arrivals = device(30_000, jitter_ns=1e5)
    waking = truth[20_000] + stop_s * 1e9
    lost = (truth > truth[20_000] + kept_s * 1e9) & (truth < waking)
    arrivals = np.where((truth >= truth[20_000]) & (truth < waking), waking, arrivals)
    truth, arrivals = truth[~lost], arrivals[~lost]
    t, clock = stamps(np.arange(len(truth)), arrivals)  # nothing counts what is lost
    error = np.abs(t - truth)
    assert error[10_000:20_000].max() < 0.1e6
    assert error[truth > waking + 1e9].max() < 0.3e6
    assert clock["corrections"][0] == lost.any()


def test_a_backlog_that_a_slow_line_works_off_is_no_gap():
    ticks, truth, _ = device(6_000, jitter_ns=1e5)
    truth = 10**15 + ticks * 1e7
    late = np.maximum(0.0, 1e9 - 0.4 * (truth - truth[3000])) * (ticks >= 3000)  # 24 kbit/s on a line of 38.4
    t, clock = stamps(ticks, truth + late, clock=new_clock(1e7, 0.0))
    assert np.abs(t - truth)[1000:].max() < 0.1e6
    assert clock["corrections"][0] == 0


def test_a_counter_that_jumps_ahead_is_corrected_at_once():
    ticks, truth, arrivals = device(30_000, 1e-3, jitter_ns=1e5)
    t, clock = stamps(ticks + 1500 * (ticks >= 15_000), arrivals)
    assert np.abs(t - truth)[10_000:].max() < 0.3e6
    assert clock["corrections"][0] == 1


def repeated(ticks, times):
    """Index of each sample that arrives where some are repeated, and nothing counts that."""
    return np.repeat(ticks, 1 + times)


@pytest.mark.parametrize("rate_hz", [100, 250, 1000])
@pytest.mark.parametrize("batch_ns", [1e6, 4e6, 16e6])
@pytest.mark.parametrize("times", [1, 3, 10, 30, 200])
def test_samples_repeated_at_once_move_the_stamps_by_a_few_milliseconds(rate_hz, batch_ns, times):
    """Ten were enough for stamps that ran away for good."""
    n, at = 120 * rate_hz, 40 * rate_hz
    truth = 10**15 + np.arange(n) * 1e9 / rate_hz * (1.0 - 3e-4)
    arrivals = delayed(truth + np.random.default_rng(3).exponential(0.1e6, n), "batches", batch_ns, None)
    k = repeated(np.arange(n), times * (np.arange(n) == at))
    t, _ = stamps(np.arange(len(k)), arrivals[k], clock=new_clock(1e9 / rate_hz, 0.0))
    error = (t - truth[k])[10 * rate_hz :]
    at -= 10 * rate_hz
    latest = 0.1 * times * 1e9 / rate_hz  # of the repeated ones: stamps do not step back
    assert error[:at].max() < 4.1e6 and error.min() > -9e6
    assert error.max() < 20e6 + latest
    assert error[at + times + 3 * rate_hz :].max() < 4.1e6
    assert np.all(np.diff(t) > 0)


@pytest.mark.parametrize("rate_hz", [100, 250, 1000])
@pytest.mark.parametrize("share", [0.001, 0.01, 0.05, 0.3])
def test_a_flood_of_repeated_samples_is_over_soon_after_its_end(rate_hz, share):
    n = 200 * rate_hz
    rng = np.random.default_rng(5)
    truth = 10**15 + np.arange(n) * 1e9 / rate_hz * (1.0 - 3e-4)
    flooded = (np.arange(n) > 40 * rate_hz) & (np.arange(n) < 50 * rate_hz)
    k = repeated(np.arange(n), flooded & (rng.random(n) < share))
    arrivals = np.maximum.accumulate(truth + rng.exponential(0.1e6, n))
    t, _ = stamps(np.arange(len(k)), arrivals[k], clock=new_clock(1e9 / rate_hz, 0.0))
    error, since_s = t - truth[k], (truth[k] - truth[0]) / 1e9
    assert error.max() < 35e6 and error.min() > -0.2e9
    assert np.abs(error[since_s > 70]).max() < 25e6
    assert np.abs(error[since_s > 150]).max() < 1.5e6


@pytest.mark.parametrize("rate_hz", [100, 1000])
@pytest.mark.parametrize("ahead_ns", [10e6, 15e6, 30e6, 200e6])
def test_a_counter_that_jumps_ahead_by_little_does_not_tilt_the_line(rate_hz, ahead_ns):
    n, at = 100 * rate_hz, 40 * rate_hz
    truth = 10**15 + np.arange(n) * 1e9 / rate_hz
    arrivals = np.maximum.accumulate(truth + np.random.default_rng(5).exponential(0.1e6, n))
    ticks = np.arange(n) + round(ahead_ns * 1e-9 * rate_hz) * (np.arange(n) >= at)
    t, _ = stamps(ticks, arrivals, clock=new_clock(1e9 / rate_hz, 0.0))
    assert np.abs(t - truth)[: at - 1].max() < 0.2e6
    assert np.abs(t - truth).max() < 15e6
    assert np.abs(t - truth)[at + rate_hz :].max() < 4e6


def test_a_line_that_is_late_until_now_is_lowered_at_once():
    ticks, truth, arrivals = device(60_000, 3e-5, jitter_ns=1e5)
    t, clock = stamps(ticks, np.maximum.accumulate(arrivals + 12e6 * (ticks < 40_000)))
    assert np.abs(t - truth)[41_000:].max() < 0.5e6
    assert clock["slope"][0] / PERIOD_NS - 1.0 == pytest.approx(3e-5, abs=1e-5)


def test_a_device_that_keeps_another_rate_than_before_is_measured_anew():
    n = 150_000
    truth = 10**15 + np.cumsum(np.where(np.arange(n) < 40_000, 1e6, 1.001e6))  # 1000 ppm slower, from one to the next
    t, clock = stamps(np.arange(n), np.maximum.accumulate(truth + np.random.default_rng(5).exponential(0.1e6, n)))
    assert np.abs(t - truth).max() < 25e6
    assert np.abs(t - truth)[110_000:].max() < 0.5e6
    assert clock["slope"][0] / PERIOD_NS - 1.0 == pytest.approx(1e-3, abs=1e-5)


def test_a_late_start_is_made_good_in_a_moment():
    ticks, truth, arrivals = device(5_000, jitter_ns=1e4)
    arrivals[:400] = truth[400]  # what had waited
    t, _ = stamps(ticks, arrivals)
    assert np.abs(t - truth)[1_000:].max() < 20e6
    assert np.abs(t - truth)[3_500:].max() < 0.1e6


JITTERS = st.one_of(
    st.tuples(st.just("uniform"), st.floats(0.0, 10e6)),
    st.tuples(st.just("batches"), st.floats(0.5e6, 10e6)),
    st.tuples(st.just("exponential"), st.floats(1e4, 2e6)),
    st.tuples(st.just("bursts"), st.floats(1e6, 10e6)),
)


def delayed(truth, kind, size_ns, rng):
    """Arrivals in order, the earliest of them punctual now and then."""
    if kind == "batches":
        return np.ceil(truth / size_ns) * size_ns
    delays = {
        "uniform": lambda: rng.uniform(0.0, size_ns, len(truth)),
        "exponential": lambda: np.minimum(rng.exponential(size_ns, len(truth)), 10e6),
        "bursts": lambda: np.where(rng.random(len(truth)) < 0.3, size_ns, 0.0),
    }
    return np.maximum.accumulate(truth + delays[kind]())


def slowest_beat(period_ns, batch_ns):
    """Its frequency as a share of the samples', among the beats that hide more than half a millisecond."""
    ratio = period_ns * np.arange(1, 1 + batch_ns // 0.5e6) / batch_ns
    return np.abs(ratio - np.round(ratio)).min()


@settings(max_examples=40, deadline=None)
@given(JITTERS, st.sampled_from([80.0, 100.0, 160.0]), st.floats(-1e-3, 1e-3), st.integers(0, 99))
def test_whatever_the_jitter_the_stamps_move_by_less_than_half_a_millisecond(jitter, rate_hz, clock_error, seed):
    n = round(40 * rate_hz)
    truth = 10**15 + np.arange(n) * 1e9 / rate_hz * (1.0 + clock_error)
    if jitter[0] == "batches":  # what beats slower than it is looked at is a drift, as far as arrivals tell
        assume(slowest_beat(1e9 / rate_hz * (1.0 + clock_error), jitter[1]) * rate_hz > 1.0 / 3.0)
    t, clock = stamps(
        np.arange(n), delayed(truth, *jitter, np.random.default_rng(seed)), clock=new_clock(1e9 / rate_hz, 0.0)
    )
    error = (t - truth)[n // 4 :]
    latency = jitter[1] if jitter[0] == "batches" else 0.0  # a beat of the two rates hides part of it
    assert error.min() > -0.5e6 - latency
    assert error.max() < 0.5e6 + latency
    assert np.ptp(error) < 0.5e6 + latency
    assert clock["corrections"][0] == 0


@pytest.mark.parametrize("seconds", [5, 20])
def test_the_drift_lies_within_its_sigma(seconds):
    z = []
    for seed in range(25):
        error = np.random.default_rng(seed).uniform(-1e-4, 1e-4)
        ticks = np.arange(200 * seconds)
        true = ticks * 5e6 * (1.0 + error)
        jitter = np.random.default_rng(seed).exponential(1e6, len(ticks))
        _, clock = stamps(ticks, np.maximum.accumulate(true + jitter) + 1e9, clock=new_clock(5e6, 0.0))
        fit = Inertial(SimpleNamespace(clock=clock, rx=np.zeros(1, np.uint8))).clock_fit()
        z.append((fit.drift - error) / fit.sigma_drift)
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.4


def queued(truth, rng):
    """Each sample is delayed by up to 10 ms, and waits for the one before: at 1 kHz hardly one is in time."""
    return np.maximum.accumulate(truth + rng.uniform(0.0, 10e6, len(truth)))


@pytest.mark.parametrize("clock_error", [0.0, 1e-3, -3e-5])
@pytest.mark.parametrize("seed", [1, 2])
def test_samples_that_wait_for_each_other_move_a_stamp_by_half_a_millisecond(clock_error, seed):
    ticks, truth, _ = device(150_000, clock_error, seed=seed)
    t, clock = stamps(ticks, queued(truth, np.random.default_rng(seed)))
    error = t - truth
    assert np.sqrt(np.mean(error[5_000:10_000] ** 2)) < 0.8e6  # the earliest of 5000 arrivals scatters by 0.3 ms itself
    assert np.abs(error[10_000:]).max() < 0.7e6
    assert np.ptp(error[100_000:]) < 0.5e6
    assert clock["corrections"][0] == 0


@pytest.mark.parametrize("clock_error", [0.4, 0.12, 0.02, -0.03, -0.07, -0.3])
def test_a_device_with_a_bad_oscillator_is_tracked(clock_error):
    ticks, truth, _ = device(30_000, clock_error)  # such as a program that sleeps a millisecond between its samples
    t, clock = stamps(ticks, queued(truth, np.random.default_rng(5)) if clock_error < 0 else truth + 1e5)
    assert np.abs(t - truth)[5_000:].max() < 5e6
    assert np.abs(t - truth)[15_000:].max() < 2.5e6
    assert clock["corrections"][0] == 0


def test_a_busy_host_does_not_tilt_the_line():
    ticks, truth, _ = device(150_000, 5e-5)
    rng = np.random.default_rng(3)
    busy = ticks % 60_000 > 40_000  # then nothing is in time
    late = rng.exponential(0.1e6, len(ticks)) + busy * (1.5e6 + rng.exponential(3e6, len(ticks)))
    t, _ = stamps(ticks, np.maximum.accumulate(truth + np.minimum(late, 19e6)))
    assert np.abs(t - truth)[10_000:].max() < 0.1e6


def hull_slope(x, y):
    """Slope of the lower hull's edge above the middle, by trying all pairs of points."""
    below = []
    for i in range(len(x)):
        for k in range(i + 1, len(x)):
            slope = (y[k] - y[i]) / (x[k] - x[i])
            if (y - y[i] - slope * (x - x[i]) >= -1e-3).all():
                below.append(
                    (abs(x[i] + x[k] - x[0] - x[-1]) if x[i] < 0.5 * (x[0] + x[-1]) <= x[k] else np.inf, slope)
                )
    return min(below)[1]


def regression(x, y, w):
    """Slope and its variance, by numpy."""
    x = x - x[-1]
    line = np.polyfit(x, y, 1, w=np.sqrt(w))
    scatter = np.average((y - np.polyval(line, x)) ** 2, weights=w)
    return line[0], max(scatter, 1.0 / w.sum()) / np.sum(w * (x - np.average(x, weights=w)) ** 2)


def settled(x, y, mean_x, mean_y):
    """Slope of the line and its sigma: the mean of two regressions, weighted by the inverse of their variances."""
    hull = hull_slope(x, y)
    least = (y - hull * x).min()
    above = y - hull * x - least
    w = 1.0 / (1.0 + (above / max(np.sort(above)[len(x) // 2], 1.0)) ** 2)
    slopes, variances = np.transpose(
        [regression(x, above, w), regression(mean_x, mean_y - hull * mean_x - least, np.ones(len(x)))]
    )
    return hull + np.average(slopes, weights=1.0 / variances), np.sum(1.0 / variances) ** -0.5


def depth(heights):
    """How far below the least of Weibull's values (shape 2.2) their end is expected, by SciPy."""
    weibull = scipy.stats.weibull_min(2.2)
    heights, n = np.sort(heights), len(heights)
    least = scipy.stats.weibull_min(2.2, scale=n ** (-1 / 2.2)).mean()  # the least of n has a Weibull distribution, too
    return (heights[n // 2] - heights[n // 4]) * least / (weibull.ppf(0.5) - weibull.ppf(0.25))


@settings(max_examples=25, deadline=None)
@given(JITTERS, st.floats(-1e-3, 1e-3), st.integers(0, 99), st.floats(8.0, 300.0))
def test_the_line_is_fitted_to_the_earliest_arrivals_and_the_means_and_lies_below_them(
    jitter, clock_error, seed, seconds
):
    n = round(40.0 * seconds)
    truth = 10**15 + np.arange(n) * 25e6 * (1.0 + clock_error)
    arrivals = delayed(truth, *jitter, np.random.default_rng(seed)).astype(np.int64)
    _, clock = stamps(np.arange(n), arrivals, clock=new_clock(25e6, 0.0))
    points = clock["count"][0]
    x, y, mean_x, mean_y = (clock[f][0][:points] for f in ("ticks", "arrivals", "mean_ticks", "mean_arrivals"))
    assert clock["corrections"][0] == 0
    window = clock["window_ns"][0] / 25e6
    assert np.diff(x).max() < 2.0 * window + 2
    assert seconds * 40 - x[0] >= min(0.9 * n, 7000) - 2 * window  # reaches back to the start, or four minutes
    since = arrivals - clock["base_ns"][0]
    assert np.isin(y, since).all()
    ends = np.append(-1, 20 * np.arange(1, n // 20 + 1))  # of the first windows, half a second each
    for i in range(points if points == n // 20 else 0):
        assert mean_x[i] == pytest.approx(np.arange(n)[ends[i] + 1 : ends[i + 1] + 1].mean())
        assert mean_y[i] == pytest.approx(since[ends[i] + 1 : ends[i + 1] + 1].mean())
    slope = clock["slope"][0]
    expected, sigma = settled(x, y, mean_x, mean_y)
    assert slope == pytest.approx(expected, rel=1e-9)
    assert clock["sigma_slope"][0] == pytest.approx(sigma, rel=1e-3, abs=1e-3)
    line = (y - slope * x).min() - depth(y - slope * x)
    assert clock["offset"][0] <= line + 1.0
    assert (y - slope * x - clock["offset"][0]).min() >= -1.0


def test_points_from_before_the_line_was_lowered_are_never_fewer_than_none():
    """All that were there are dropped, one by one, while the line is lowered again and again."""
    clock = new_clock(PERIOD_NS, 0.0)
    clock["count"], clock["sound_count"], clock["window_ns"] = POINTS, 1, MAX_WINDOW_NS
    found = []
    for _ in range(3):
        add_point_in_c(clock[0])
        found.append((int(clock["count"][0]), int(clock["sound_count"][0])))
    assert found == [(POINTS, 0)] * 3
