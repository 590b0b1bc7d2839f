"""A gyro bias that steps under way: the heading turns away, and is admitted or found again before it is far off."""

import numpy as np
import pytest
from navigation_runner import navigate, settings_of
from navigation_simulation import drive, errors, received, sensed

from imud.estimators.records import HEADING_VALID

RATE, BEGIN_S = 100, 90.0
D = drive(150.0, speed=12.0)


def run(seed, step_dps, vehicle="free", tuning=None):
    """(errors of the heading, deg; the same over sigma; status) from the step on."""
    rng = np.random.default_rng(seed)
    samples = sensed(D, rng)
    fixes = received(D, rng, late=0.2, sigma=1.5, white=0.1, speed_sigma=0.05)
    begin = int(BEGIN_S * RATE)
    samples["w"][begin:, 2] += np.radians(step_dps)
    out = navigate(samples, fixes, settings_of(vehicle, tuning=tuning))[0]
    yaw, out = np.degrees(errors(D, out)[2][begin:, 2]), out[begin:]
    return np.abs(yaw), np.abs(yaw) / np.degrees(out["sigma_rpy"][:, 2]), out["status"]


@pytest.mark.parametrize("step_dps", [1.0, -0.5])
def test_a_step_of_the_bias_is_found(step_dps):
    wrong = blind = 0.0
    for seed in range(3):
        yaw, sigmas, status = run(seed, step_dps)
        sure = (yaw > 5.0) & (sigmas > 4.0) & (status & HEADING_VALID > 0)
        wrong += sure.sum() / RATE
        assert yaw[int(40 * RATE) :].max() < 3.0
        yaw, sigmas, status = run(seed, step_dps, tuning={"gyro_bias_step_chi2": 1e9})
        blind += ((yaw > 5.0) & (sigmas > 4.0) & (status & HEADING_VALID > 0)).sum() / RATE
    assert wrong <= 0.5 * blind
    assert wrong < 6.0


def test_without_a_step_nothing_is_doubted():
    yaw, _, _ = run(4, 0.0)
    blind, _, _ = run(4, 0.0, tuning={"gyro_bias_step_chi2": 1e9})
    np.testing.assert_array_equal(yaw, blind)
