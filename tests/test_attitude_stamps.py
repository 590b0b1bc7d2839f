"""Stamps that scatter about those of an even sensor, as where a host's arrivals are recorded: errors and sigmas."""

import numpy as np
import pytest
from attitude_runs import Fields, samples_from, tilt_variance_deg2
from attitude_simulation import DEG, Flaws, after, errors_deg, simulate, wobble
from broad import solutions_of

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ahrs.last_sample import store_first_sample, update_stamp_variance
from imud.estimators.ahrs.setup import configure, start
from imud.estimators.records import ATTITUDE_VALID


def scattered(seed, periods):
    """(truth, samples) of a brisk hand; the stamps are wrong by so many periods, RMS."""
    truth = simulate(
        60.0, 50.0, after(5.0, wobble(seed, 3.0, 1.0, 10.0)), after(5.0, wobble(seed + 50, 3.0, 4.0, 10.0))
    )
    samples = samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3), seed)
    off = np.clip(np.random.default_rng(seed).normal(0.0, periods, len(samples)), -0.45, 0.45)
    samples["t_ns"] += np.round(2e7 * off).astype(np.int64)
    return truth, samples


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_tilt_stays_within_its_sigmas(seed):
    truth, samples = scattered(seed, 0.2)
    out = solutions_of(samples)
    tilt = errors_deg(out["q_nb"], truth.attitude)[0]
    nees = tilt**2 / tilt_variance_deg2(out)
    valid = out["status"] & ATTITUDE_VALID != 0
    assert np.mean(nees[500:]) < 2.0
    assert not np.any(valid & (tilt > 5.0) & (nees > 8.0))


def test_the_more_stamps_scatter_the_less_sure_is_the_tilt():
    sigma2 = [np.mean(tilt_variance_deg2(solutions_of(scattered(1, periods)[1]))[1000:]) for periods in (0.0, 0.1, 0.2)]
    assert 2.0 * sigma2[0] < sigma2[1] < 0.5 * sigma2[2]


def test_stamps_that_are_right_count_as_such_where_every_third_sample_is_lost():
    """Long and short periods alternate: stated are 2.6 deg if that is taken for errors of the stamps, else 1.4."""
    truth = simulate(60.0, 150.0, after(5.0, wobble(1, 3.0, 1.0, 10.0)), after(5.0, wobble(51, 3.0, 4.0, 10.0)))
    samples = samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3), 1)
    lost = samples[np.arange(len(samples)) % 3 != 2]
    every, found = (np.mean(tilt_variance_deg2(solutions_of(rows))[1000:]) for rows in (samples, lost))
    assert found < 2.0 * every


def test_no_period_before_a_gap_is_compared_with_one_after_it():
    s = Fields(start(configure(Settings(), 100.0), Initial())[0])
    s.imu.last_dt, s.imu.dt_change = 0.01, 0.005
    interpreted(store_first_sample)(s, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))
    interpreted(update_stamp_variance)(s, 0.02, 1.0)
    assert s.imu.dt_covariance == 0.0
