"""Errors over sigmas in simulated drives with random biases and noise: about 1, neither boast nor fear."""

import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import drive, errors, received, sensed

from imud.configuration.settings import Imu, Navigation, Settings
from imud.sensor_errors.profiles import PROFILES


def normalised(name, rate, vehicle, seed, scale=0.0):
    """Mean squared error over variance of one run: position, velocity, attitude; and of its innovations.

    The gyros' scale factors have a sigma of `scale`, their axes about a third of that.
    """
    profile, rng = PROFILES[name], np.random.default_rng(seed)
    d = drive(110.0, rate=rate, speed=6.0 + seed % 4)
    bg = profile.gyro_bias_initial * rng.standard_normal(3)
    ba = profile.accel_bias_initial * rng.standard_normal(3)
    samples = sensed(d, rng, profile.gyro_noise, profile.accel_noise, bg, ba)
    samples["w"] += samples["w"] @ (scale * rng.standard_normal((3, 3)) * (0.35 + 0.65 * np.eye(3))).T
    fixes = received(d, rng, late=0.2, sigma=1.8, white=0.3, speed_sigma=0.1)
    settings = Settings(imu=Imu(profile=name), navigation=Navigation(vehicle=vehicle))
    out, rows, _ = navigate(samples, fixes, settings)
    k = np.arange(40 * rate, len(d.t), rate)
    sigmas = (out["sigma_p"], out["sigma_v"], out["sigma_rpy"])
    nees = [np.mean((e / s)[k] ** 2) for e, s in zip(errors(d, out), sigmas, strict=True)]
    rows = rows[(rows["used"] == 1) & (rows["t_ns"] > 140e9)]
    return [*nees, np.mean(rows["value"] ** 2 / rows["variance"])]


@pytest.mark.thorough
@pytest.mark.parametrize("name, rate, vehicle", [("consumer-mems", 100, "free"), ("m-g350", 200, "auto")])
def test_normalised_errors_are_about_one(name, rate, vehicle):
    p, v, a, nis = np.mean([normalised(name, rate, vehicle, seed) for seed in range(10)], axis=0)
    assert 0.5 < p < 2.0
    assert 0.25 < v < 2.0
    assert 0.2 < a < 2.0  # below 1: scale factor errors are allowed for, and there are none here
    assert 0.4 < nis < 1.6


@pytest.mark.thorough
@pytest.mark.parametrize("vehicle", ["free", "auto"])
def test_gyro_misalignment_is_not_known_better_than_turns_allow(vehicle):
    """In level turns a wrong axis is a tilt and an accelerometer bias that are fixed in the body: all stay unsure."""
    scale = PROFILES["consumer-mems"].gyro_scale
    _, _, a, _ = np.mean([normalised("consumer-mems", 100, vehicle, seed, scale) for seed in range(10)], axis=0)
    assert 0.2 < a < 2.0
