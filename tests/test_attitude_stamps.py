"""Stamps that scatter about those of an even sensor, as where a host's arrivals are recorded: errors and sigmas."""

import numpy as np
import pytest
from attitude_runs import Fields, samples_from, tilt_variance_deg2
from attitude_simulation import DEG, Flaws, after, errors_deg, simulate, wobble
from broad import filter_of, solutions_of
from replay_in_process import replay

from imud.batch import rate_hz_of
from imud.compile.jit import interpreted
from imud.drivers.sample import SAMPLE
from imud.estimators.ahrs import stamps
from imud.estimators.records import ATTITUDE_VALID, SOLUTION
from imud.smoothing.intervals import INTERVAL, record_intervals
from imud.smoothing.rows import Rows

PERIOD_NS = 2e7


def brisk(seed, rate_hz=50.0):
    """(truth, samples) of a brisk hand; every stamp is right."""
    truth = simulate(
        60.0, rate_hz, after(5.0, wobble(seed, 3.0, 1.0, 10.0)), after(5.0, wobble(seed + 50, 3.0, 4.0, 10.0))
    )
    return truth, samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3), seed)


def offsets(count, seed, periods):
    """So many periods RMS, less than half a period."""
    return np.clip(np.random.default_rng(seed).normal(0.0, periods, count), -0.45, 0.45)


def scattered(seed, periods):
    """(truth, samples) of a brisk hand; the stamps are wrong by so many periods, RMS."""
    truth, samples = brisk(seed)
    samples["t_ns"] += np.round(PERIOD_NS * offsets(len(samples), seed, periods)).astype(np.int64)
    return truth, samples


def uneven(seed, periods):
    """(truth, samples) of the same, which were taken as unevenly; every stamp is right."""
    truth, samples = brisk(seed, 2500.0)
    at = np.arange(50, len(samples) - 50, 50)
    at += np.round(50.0 * offsets(len(at), seed, periods)).astype(np.int64)
    return truth.attitude[at], samples[at]


def packets(t_ns, size):
    """So many samples come at once with the newest of them."""
    i = np.arange(len(t_ns))
    newest = np.minimum(i // size * size + size - 1, len(t_ns) - 1)
    return t_ns[newest] + 2000 * (i - newest)


def polls(t_ns, every, seed):
    """Asked every so many periods, and a tenth of one later in the mean, for all samples since."""
    period = t_ns[1] - t_ns[0]
    poll = np.ceil((t_ns - t_ns[0]) / (every * period)).astype(int)
    late = np.random.default_rng(seed).exponential(0.1, poll[-1] + 1)
    arrival = np.round(period * (every * np.arange(poll[-1] + 1) + late)).astype(np.int64)
    return np.maximum.accumulate(t_ns[0] + arrival[poll]) + 2000 * np.arange(len(t_ns))


def rms_tilt(samples, attitude):
    return np.sqrt(np.mean(errors_deg(solutions_of(samples)["q_nb"], attitude)[0] ** 2))


def gain_after(samples):
    filter_ = filter_of(samples)
    replay(filter_, samples)
    return float(filter_.state[0]["stamps"]["gain"])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_tilt_stays_within_its_sigmas(seed):
    truth, samples = scattered(seed, 0.2)
    out = solutions_of(samples)
    tilt = errors_deg(out["q_nb"], truth.attitude)[0]
    nees = tilt**2 / tilt_variance_deg2(out)
    valid = out["status"] & ATTITUDE_VALID != 0
    assert np.mean(nees[500:]) < 2.0
    assert not np.any(valid & (tilt > 5.0) & (nees > 8.0))


def test_even_samples_count_as_even():
    """By the stamps alone it is 1.7 deg; with stamps that are right 0.3."""
    runs = [scattered(seed, 0.2) for seed in range(1, 7)]
    assert np.mean([rms_tilt(samples, truth.attitude) for truth, samples in runs]) < 1.2
    assert all(gain_after(samples) < 0.1 for _, samples in runs)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_uneven_samples_whose_stamps_are_right_count_as_stamped(seed):
    assert gain_after(uneven(seed, 0.2)[1]) > 0.9


def test_the_more_stamps_scatter_the_less_sure_is_the_tilt():
    """Of a tenth of a period little is left once the line is known (1.0, 1.9, 4.7 deg^2), hence 1.5 and not 2."""
    sigma2 = [np.mean(tilt_variance_deg2(solutions_of(scattered(1, periods)[1]))[1000:]) for periods in (0.0, 0.1, 0.2)]
    assert 1.5 * sigma2[0] < sigma2[1] < 0.5 * sigma2[2]


def with_delays(samples, seed, most=5.0):
    """One in a hundred waits for up to so many periods, and those behind it with it."""
    rng = np.random.default_rng(seed)
    waits = rng.uniform(0.0, most, len(samples)) * (rng.random(len(samples)) < 0.01)
    samples["t_ns"] += np.round(PERIOD_NS * (rng.exponential(0.1, len(samples)) + waits)).astype(np.int64)
    samples["t_ns"] = np.maximum.accumulate(samples["t_ns"]) + 1000 * np.arange(len(samples))
    return samples


def mean_rms_without(kept_share, runs):
    """Of (seed, truth, samples), where some samples are lost."""
    tilts = []
    for seed, truth, samples in runs:
        kept = np.random.default_rng(seed).random(len(samples)) < kept_share
        tilts.append(rms_tilt(samples[kept], truth.attitude[kept]))
    return np.mean(tilts)


def test_samples_that_come_late_and_then_at_once():
    """By the stamps alone it is 9 deg."""
    runs = ((seed, *brisk(seed)) for seed in range(1, 7))
    assert mean_rms_without(1.0, [(seed, truth, with_delays(samples, seed)) for seed, truth, samples in runs]) < 1.8


def test_lost_samples_beside_late_ones():
    """One in a hundred is lost as well. Where the last one of both kinds says which the next one is it is 4.7 deg."""
    runs = ((seed, *brisk(seed)) for seed in range(1, 9))
    assert mean_rms_without(0.99, [(seed, truth, with_delays(samples, seed)) for seed, truth, samples in runs]) < 3.4


def test_lost_samples_between_stamps_that_scatter():
    """One in ten. If only what is beyond four sigma of the scatter comes after a lost one it is 4.1 deg."""
    assert mean_rms_without(0.9, [(seed, *scattered(seed, 0.2)) for seed in range(1, 9)]) < 3.2


def in_packets(seed, size):
    truth, samples = brisk(seed, 200.0)
    samples["t_ns"] = packets(samples["t_ns"], size)
    return truth, samples


@pytest.mark.parametrize("size", [2, 3, 10, 30])
def test_samples_that_come_in_packets(size):
    """With even stamps it is 0.35 deg. With each packet taken for a gap it was 0.35, 1.2, 4.2 and 13."""
    runs = [in_packets(seed, size) for seed in range(1, 5)]
    assert np.mean([rms_tilt(samples, truth.attitude) for truth, samples in runs]) < 0.45
    for _, samples in runs:
        filter_ = filter_of(samples)
        replay(filter_, samples)
        assert filter_.state[0]["stamps"]["period"] == pytest.approx(0.005, rel=0.01)
        assert filter_.state[0]["stamps"]["slope"] < 0.1


@pytest.mark.parametrize("every", [1.6, 3.2, 10.3])
def test_samples_that_are_polled(every):
    """Every so many periods. With each poll taken for a gap it was 0.4, 1.3 and 4.5 deg."""
    tilts = []
    for seed in range(1, 5):
        truth, samples = brisk(seed, 200.0)
        samples["t_ns"] = polls(samples["t_ns"], every, seed)
        tilts.append(rms_tilt(samples, truth.attitude))
    assert np.mean(tilts) < 0.6


def test_samples_that_packets_lack():
    """One in a hundred is lost. If it is taken for the last one of its packet it is 0.83 deg."""
    assert mean_rms_without(0.99, [(seed, *in_packets(seed, 10)) for seed in range(1, 9)]) < 0.6


@pytest.mark.parametrize("size", [2, 3, 10, 30])
def test_the_nominal_rate_of_packets_is_that_of_their_samples(size):
    _, samples = in_packets(1, size)
    for count in (500, 501, len(samples)):
        assert rate_hz_of(samples[:count]) == pytest.approx(200.0, rel=0.08)


@pytest.mark.parametrize("size", [2, 3, 10, 30])
@pytest.mark.parametrize("lost", [0.01, 0.1])
def test_the_nominal_rate_of_packets_that_lack_samples_is_that_of_the_sensor(size, lost):
    """The mean of the samples that come is lower by 1 and 10 %."""
    _, samples = in_packets(1, size)
    kept = np.random.default_rng(1).random(len(samples)) > lost
    assert rate_hz_of(samples[kept]) == pytest.approx(200.0, rel=0.002)


@pytest.mark.parametrize("every", [1.6, 1.8, 2.8, 3.2, 10.3])
def test_the_nominal_rate_of_polls_is_the_mean_one(every):
    """The largest number of samples of a poll, over its duration, is up to 25 % more."""
    _, samples = brisk(1, 200.0)
    samples["t_ns"] = polls(samples["t_ns"], every, 1)
    assert rate_hz_of(samples) == pytest.approx(200.0, rel=0.002)


@pytest.mark.parametrize("late", [0.1, 0.3, 0.5])
def test_the_nominal_rate_of_polls_that_are_late_is_the_mean_one(late):
    """By this share of the time between them, 1 sigma of those that are late."""
    _, samples = brisk(1, 200.0)
    rng = np.random.default_rng(1)
    times_ns = np.cumsum(50e6 * (1.0 + late * np.abs(rng.standard_normal(2000)))).astype(np.int64) + samples["t_ns"][0]
    samples = samples[samples["t_ns"] <= times_ns[-1]]
    samples["t_ns"] = times_ns[np.searchsorted(times_ns, samples["t_ns"])]
    assert rate_hz_of(samples) == pytest.approx(200.0, rel=0.01)


def test_a_sample_that_came_twice_does_not_change_the_nominal_rate_of_packets_that_lack_samples():
    t_ns = np.repeat(np.arange(1200) * 50_000_000, 10)
    t_ns = t_ns[np.random.default_rng(1).random(len(t_ns)) > 0.01]
    full = np.unique(t_ns)[np.unique(t_ns, return_counts=True)[1] == 10]
    samples = np.zeros(len(t_ns) + 1, SAMPLE)
    samples["t_ns"] = np.sort(np.append(t_ns, full[300]))
    assert rate_hz_of(samples) == pytest.approx(200.0, rel=0.002)


def test_packets_that_lack_one_sample_in_ten():
    """With the mean period for the sensor's it is 6.7 deg."""
    assert mean_rms_without(0.9, [(seed, *in_packets(seed, 10)) for seed in range(1, 5)]) < 3.0


def test_the_nominal_rate_where_samples_are_lost_is_that_without():
    _, samples = brisk(1, 200.0)
    kept = np.random.default_rng(1).random(len(samples)) > 0.1
    assert rate_hz_of(samples[kept]) == pytest.approx(200.0, rel=1e-6)


def test_a_longer_queue_after_a_shorter_one():
    """Once samples came late and then at once, sixty more do. By a queue's period as the line's it is 63 deg."""
    truth, samples = brisk(1, 200.0)
    t_ns = samples["t_ns"] + np.round(5e6 * np.clip(offsets(len(samples), 1, 0.05), -0.4, 0.4)).astype(np.int64)
    for first, count in ((4000, 8), (8000, 60)):
        t_ns[first : first + count] = t_ns[first + count]
    samples["t_ns"] = np.maximum.accumulate(t_ns) + 2000 * np.arange(len(samples))
    out = solutions_of(samples)
    assert np.all(errors_deg(out["q_nb"], truth.attitude)[0][8062:] < 3.0)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_stated_rate_is_that_of_the_newest_sample(seed):
    _, samples = brisk(seed)
    out = solutions_of(with_delays(samples, seed, 12.0))
    rates = out["w"] + out["bg"]
    repeated = np.all(np.abs(np.diff(rates, axis=0)) < 1e-12, axis=1)
    assert np.count_nonzero(repeated) < 3


def test_at_most_one_covariance_interval_ends_in_a_run_of_the_recorded_filter():
    """A queue holds more time than its stamps say, and several intervals end in it; each has its row."""
    _, samples = brisk(1)
    t_ns = samples["t_ns"] + np.round(PERIOD_NS * offsets(len(samples), 1, 0.05)).astype(np.int64)
    for first, count in ((1000, 8), (1500, 20), (2000, 20)):
        t_ns[first : first + count] = t_ns[first + count]
    samples["t_ns"] = np.maximum.accumulate(t_ns) + 2000 * np.arange(len(samples))
    solutions, intervals = Rows(SOLUTION), Rows(INTERVAL)
    record_intervals(filter_of(samples), samples, solutions, intervals)
    assert len(solutions.array()) == len(samples)
    assert np.all(intervals.array()["history"]["intervals"] == 1)


def test_rest_teaches_nothing_of_the_slope():
    """At rest the readings are noise, which lies nowhere between its neighbours."""
    samples = samples_from(simulate(60.0, 50.0), Flaws(gyro_bias=(0.2 * DEG,) * 3), 1)
    samples["t_ns"] += np.round(PERIOD_NS * offsets(len(samples), 1, 0.2)).astype(np.int64)
    filter_ = filter_of(samples)
    replay(filter_, samples)
    assert filter_.state[0]["stamps"]["taught"] < 1.0
    assert filter_.state[0]["stamps"]["slope_variance"] >= stamps.PRIOR_VARIANCE


@pytest.fixture
def learned():
    """(parameters, state) after a minute of stamps that scatter by a tenth of a period; the last one is on the line."""
    _, samples = scattered(1, 0.1)
    filter_ = filter_of(samples)
    replay(filter_, samples)
    s = Fields(filter_.state[0])
    s.stamps.ahead, s.stamps.losses_to_settle, s.stamps.waiting = 0.0, 0, 0
    return Fields(filter_.parameters[0]), s


def periods(learned, *dts):
    """The periods to integrate over where stamps are so many periods apart, in periods."""
    return periods_at(learned, learned[1].stamps.period, *dts)


def periods_at(learned, even, *dts):
    """The same where `even` s are a period."""
    p, s = learned
    w = s.imu.w.tolist()
    return [interpreted(stamps.even_period)(p, s, w, True, dt * even) / even for dt in dts]


def test_lost_samples_count_as_such_at_once(learned):
    assert periods(learned, 3.1, 0.9) == pytest.approx([3.0, 1.0], abs=0.02)


def test_once_a_late_sample_was_seen_the_next_one_shows_whether_samples_are_lost(learned):
    assert periods(learned, 4.0, 0.02, 0.02, 0.02) == pytest.approx([4.0, 0.05, 0.05, 0.05], abs=0.1)
    learned[1].stamps.ahead = 0.0
    assert periods(learned, 4.0, 0.02, 0.02, 0.02, 0.94) == pytest.approx([1.0, 1.0, 1.0, 1.0, 1.0], abs=0.02)
    for _ in range(stamps.LOSSES_TO_SETTLE):
        assert periods(learned, 4.0, 1.0, 1.0) == pytest.approx([1.0, 4.0, 1.0], abs=0.02)
    assert periods(learned, 4.0, 1.0) == pytest.approx([4.0, 1.0], abs=0.02)


def test_the_attitude_is_stated_as_that_of_another_time_while_it_is_open(learned):
    _, s = learned
    s.imu.w = (0.0, 2.0, 0.0)
    s.stamps.losses_to_settle = 1
    before = interpreted(stamps.turn_in_stamp_error)(s)
    periods(learned, 4.0)
    assert interpreted(stamps.turn_in_stamp_error)(s) == pytest.approx(np.hypot(before, 2.0 * 3.0 * 0.02), rel=0.02)


def test_the_attitude_is_stated_as_that_of_another_time_wherever_it_is(learned):
    _, s = learned
    s.imu.w = (0.0, 2.0, 0.0)
    s.stamps.ahead = 0.02
    assert interpreted(stamps.turn_in_stamp_error)(s) == pytest.approx(0.04)


@pytest.mark.parametrize("returns", [0, 1])
@pytest.mark.parametrize("count", [8, 20, 40, 100])
def test_what_is_integrated_is_what_is_stamped(learned, returns, count):
    """So many samples wait, come at once with the next one, and then the rate is what it was."""
    _, s = learned
    s.stamps.losses_to_settle = returns
    even = s.stamps.period
    stamped = [count + 1.0, *([0.001] * count), *([1.0] * 60)]
    assert sum(periods(learned, *stamped)) == pytest.approx(sum(stamped), abs=0.1)
    assert s.stamps.period == pytest.approx(even, rel=0.01)
    assert s.stamps.misfits == 0


@pytest.mark.parametrize("lost", [0, 1, 3])
def test_what_a_packet_lacks_is_lost(learned, lost):
    """Known when the next packet comes, whose samples are even, too."""
    _, s = learned
    s.stamps.losses_to_settle = 1
    assert periods(learned, *[10.0, *([0.001] * 9)]) == pytest.approx([1.0] * 10, abs=0.02)
    assert sum(periods(learned, *[10.0, *([0.001] * (9 - lost))])) == pytest.approx(10.0 - lost, abs=0.1)
    assert periods(learned, *[10.0, *([0.001] * 9)]) == pytest.approx([1.0 + lost, *([1.0] * 9)], abs=0.1)


def test_a_restart_keeps_what_is_owed(learned):
    p, s = learned
    even = s.stamps.period
    s.stamps.ahead, s.stamps.misfits = -5.0 * even, stamps.MAX_MISFITS + 40
    s.stamps.block_samples, s.stamps.block_s = stamps.BLOCK_SAMPLES - 1, (stamps.BLOCK_SAMPLES - 1) * even
    got = interpreted(stamps.even_period)(p, s, s.imu.w.tolist(), True, even)
    assert got == pytest.approx(6.0 * even)
    assert interpreted(stamps.time_lost)(p, s, got) == pytest.approx(5.0 * even, rel=0.01)
    assert s.stamps.ahead == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("ratio", [0.7, 0.9, 0.95, 1.05, 1.1, 1.3])
def test_a_rate_that_changes_a_little(learned, ratio):
    """After two hundred samples the line has the new period, and no stamp is off it by more than they scatter."""
    _, s = learned
    even = s.stamps.period
    stamped = np.diff(ratio * np.arange(401) + offsets(401, 1, 0.1))
    periods(learned, *stamped[:200])
    assert s.stamps.period == pytest.approx(ratio * even, rel=0.01)
    for dt in stamped[200:]:
        periods_at(learned, even, dt)
        assert abs(s.stamps.ahead) < 0.5 * even


def test_between_two_samples_a_lost_one_is_their_mean():
    """One in ten is lost. With the next one integrated twice it is 2.1 deg."""
    tilts = []
    for seed in range(1, 7):
        truth, samples = brisk(seed)
        kept = np.random.default_rng(seed).random(len(samples)) > 0.1
        tilts.append(rms_tilt(samples[kept], truth.attitude[kept]))
    assert np.mean(tilts) < 1.0


def test_a_rate_that_is_halved_is_no_scatter():
    _, samples = brisk(1)
    i = np.arange(len(samples))
    samples = samples[(i < 1500) | (i % 2 == 0)]
    filter_ = filter_of(samples)
    replay(filter_, samples)
    s = Fields(filter_.state[0])
    assert not interpreted(stamps.scatters)(s)
    assert s.stamps.ahead == 0.0


def test_stamps_that_are_right_count_as_such_where_every_third_sample_is_lost():
    """Long and short periods alternate: stated are 2.6 deg if that is taken for errors of the stamps, else 1.4."""
    truth = simulate(60.0, 150.0, after(5.0, wobble(1, 3.0, 1.0, 10.0)), after(5.0, wobble(51, 3.0, 4.0, 10.0)))
    samples = samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3), 1)
    lost = samples[np.arange(len(samples)) % 3 != 2]
    every, found = (np.mean(tilt_variance_deg2(solutions_of(rows))[1000:]) for rows in (samples, lost))
    assert found < 2.0 * every


def test_two_samples_for_each_poll_whose_stamps_are_right():
    """Long and short periods alternate, and are no whole multiples of each other."""
    _, samples = brisk(1, 500.0)
    at = np.flatnonzero(np.isin(np.arange(len(samples)) % 20, (0, 7)))
    assert gain_after(samples[at]) > 0.8


def test_no_period_before_a_gap_is_compared_with_one_after_it():
    _, samples = brisk(1)
    filter_ = filter_of(samples)
    samples["t_ns"][500:] += 1_300_000_000
    samples = samples[:501]
    replay(filter_, samples)
    s = filter_.state[0]["stamps"]
    assert s["last_dt"] == 0.0
    assert s["squares"] < 1e-12
