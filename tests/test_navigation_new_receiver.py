"""Another receiver has another latency: that of the one before is not believed of it."""

import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import Later, drive, errors, received, sensed

from imud.configuration.settings import Imu, Settings
from imud.estimators.records import HEADING_VALID, NEW_RECEIVER
from imud.sensor_errors.profiles import PROFILES

RATE, SWAP_S, AWAY_S, AFTER_S = 100, 90.0, 4.0, 40.0
D = Later(drive, SWAP_S + AFTER_S, rate=RATE, speed=12.0)
PROFILE = PROFILES["m-g350"]


def swapped(seed, before_s, after_s):
    """Errors over sigmas of velocity, position and yaw after a swap of receivers whose stamps are late by so much."""
    rng = np.random.default_rng(seed)
    biases = PROFILE.gyro_bias_initial * rng.standard_normal(3), PROFILE.accel_bias_initial * rng.standard_normal(3)
    samples = sensed(D, rng, PROFILE.gyro_noise, PROFILE.accel_noise, *biases)
    first, second = (received(D, rng, late=0.2 + s, stamp=s, sigma=1.5) for s in (before_s, after_s))
    at_s = 100.0 + SWAP_S
    second = second[second["t_ns"] * 1e-9 > at_s + AWAY_S]
    second["flags"][0] = NEW_RECEIVER
    fixes = np.concatenate([first[first["arrival_ns"] * 1e-9 < at_s], second])
    out, _, _ = navigate(samples, fixes, Settings(imu=Imu(profile="m-g350")))
    position, velocity, attitude = errors(D, out)
    k = slice(round(SWAP_S * RATE), None)
    assert (out["status"][k] & HEADING_VALID != 0).all()
    z = velocity[k, :2] / out["sigma_v"][k, :2], position[k, :2] / out["sigma_p"][k, :2]
    return [np.abs(each).max() for each in (*z, attitude[k, 2] / out["sigma_rpy"][k, 2])]


@pytest.mark.thorough
@pytest.mark.parametrize("late_s", [(0.0, 0.0), (0.0, 0.1), (0.1, 0.0), (0.0, 0.3), (0.3, 0.0)], ids=str)
def test_errors_stay_within_their_sigmas_when_receivers_are_swapped(late_s):
    """Velocities were ten sigmas off, and yaw six, for ten seconds."""
    z = np.array([swapped(seed, *late_s) for seed in range(70, 74)])
    assert (z < 3.7).all(), z
    assert np.median(z) < 2.5
