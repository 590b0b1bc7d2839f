"""The time offset on a vehicle that vibrates, with a receiver whose velocities are older than its positions."""

import numpy as np
import pytest
from navigation_runner import settings_of
from navigation_simulation import drive, errors, received, sensed
from replay_in_process import new_filter, replay

from imud.estimators.filter_states import cells

LAG_S = 0.14


@pytest.mark.parametrize("seed", range(3))
def test_vibration_gives_no_time_offset(seed):
    """The acceleration at a fix is as noisy as the velocity, and by the same noise: errors in variables."""
    rng = np.random.default_rng(seed)
    d = drive(150.0, speed=15.0)
    samples = sensed(d, rng, accel_psd=0.1)
    fixes = received(d, rng, every=0.2, late=0.2, sigma=0.01, white=0.008, lag=LAG_S)
    fixes["sigma"] = 0.015, 0.015, 0.03
    filter_ = new_filter("navigation", samples, settings_of(lever_arm_sigma_m=0.0))
    out, _ = replay(filter_, samples, fixes)
    found = cells(filter_.filter_states())
    assert found["time_offset_s"][-1] == pytest.approx(0.0, abs=0.03)
    assert found["velocity_time_offset_s"][-1] == pytest.approx(LAG_S, abs=0.01)
    assert np.sqrt(np.mean(errors(d, out)[0][d.t > 75.0, :2] ** 2)) < 0.4  # m
