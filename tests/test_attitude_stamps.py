"""Stamps that scatter about those of an even sensor, as where a host's arrivals are recorded: errors and sigmas."""

import numpy as np
import pytest
from attitude_runs import Fields, samples_from, tilt_variance_deg2
from attitude_simulation import DEG, Flaws, after, errors_deg, simulate, wobble
from broad import filter_of, solutions_of
from replay_in_process import replay

from imud.compile.jit import interpreted
from imud.estimators.ahrs import stamps
from imud.estimators.records import ATTITUDE_VALID

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
    sigma2 = [np.mean(tilt_variance_deg2(solutions_of(scattered(1, periods)[1]))[1000:]) for periods in (0.0, 0.1, 0.2)]
    assert 1.5 * sigma2[0] < sigma2[1] < 0.5 * sigma2[2]


def test_samples_that_come_late_and_then_at_once():
    """One in a hundred waits for up to five periods, and those behind it with it. By the stamps alone it is 9 deg."""
    tilts = []
    for seed in range(1, 7):
        truth, samples = brisk(seed)
        rng = np.random.default_rng(seed)
        waits = rng.uniform(0.0, 5.0, len(samples)) * (rng.random(len(samples)) < 0.01)
        late = PERIOD_NS * (rng.exponential(0.1, len(samples)) + waits)
        samples["t_ns"] = np.maximum.accumulate(samples["t_ns"] + np.round(late).astype(np.int64))
        samples["t_ns"] += 1000 * np.arange(len(samples))
        tilts.append(rms_tilt(samples, truth.attitude))
    assert np.mean(tilts) < 1.8


@pytest.fixture
def learned():
    """(parameters, state) after a minute of stamps that scatter by a tenth of a period; the last one is on the line."""
    _, samples = scattered(1, 0.1)
    filter_ = filter_of(samples)
    replay(filter_, samples)
    s = Fields(filter_.state[0])
    s.stamps.ahead, s.stamps.returns, s.stamps.waiting = 0.0, 0, 0
    return Fields(filter_.parameters[0]), s


def periods(learned, *dts):
    """The periods to integrate over where stamps are so many periods apart, in periods."""
    p, s = learned
    even = s.stamps.period
    w = s.imu.w.tolist()
    return [interpreted(stamps.even_period)(p, s, w, True, dt * even) / even for dt in dts]


def test_lost_samples_count_as_such_at_once(learned):
    assert periods(learned, 3.1, 0.9) == pytest.approx([3.0, 1.0], abs=0.02)


def test_once_a_late_sample_was_seen_the_next_one_shows_whether_samples_are_lost(learned):
    assert periods(learned, 4.0, 0.02, 0.02, 0.02) == pytest.approx([4.0, 0.05, 0.05, 0.05], abs=0.1)
    learned[1].stamps.ahead = 0.0
    assert periods(learned, 4.0, 0.02, 0.02, 0.02, 0.94) == pytest.approx([1.0, 1.0, 1.0, 1.0, 1.0], abs=0.02)
    assert periods(learned, 4.0, 1.0, 1.0) == pytest.approx([1.0, 4.0, 1.0], abs=0.02)
    assert periods(learned, 4.0, 1.0) == pytest.approx([4.0, 1.0], abs=0.02)


def test_the_attitude_is_stated_as_that_of_another_time_while_it_is_open(learned):
    _, s = learned
    s.imu.w = (0.0, 2.0, 0.0)
    s.stamps.returns = 1
    before = interpreted(stamps.turn_in_stamp_error)(s)
    periods(learned, 4.0)
    assert interpreted(stamps.turn_in_stamp_error)(s) == pytest.approx(np.hypot(before, 2.0 * 3.0 * 0.02), rel=0.02)


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
