"""Stamps that scatter about those of an even sensor, as where a host's arrivals are recorded: errors and sigmas."""

import numpy as np
import pytest
from attitude_runs import samples_from, tilt_variance_deg2
from attitude_simulation import DEG, Flaws, after, errors_deg, simulate, wobble
from broad import solutions_of

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
