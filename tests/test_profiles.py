"""Noise profiles: the data sheet's numbers in SI, and what the user knows better."""

import math
from dataclasses import asdict

import pytest

from imud.sensor_errors.profiles import PROFILES, profile_of
from imud.setup import config


def test_settings_that_are_not_given_are_the_profiles():
    assert profile_of(config.loads('[imu]\nprofile = "m-g350"')) == PROFILES["m-g350"]
    assert profile_of(config.loads("")) == PROFILES["consumer-mems"]


def test_given_settings_replace_the_profiles():
    text = """
        [imu]
        profile = "m-g350"
        [noise]
        gyro_random_walk_deg_per_sqrt_h = 0.3
        gyro_bias_instability_deg_per_h = 7.2
        gyro_bias_initial_dps = 1.0
        gyro_scale_percent = 0.2
        gyro_misalignment_percent = 0.1
        accel_random_walk_mps_per_sqrt_h = 0.06
        accel_bias_instability_mg = 0.2
        accel_bias_initial_mg = 4.0
        accel_scale_percent = 0.3
    """
    changed = {
        "gyro_noise": math.radians(0.3) / 60.0,
        "gyro_bias_instability": math.radians(7.2) / 3600.0,
        "gyro_bias_initial": math.radians(1.0),
        "gyro_bias_wide": math.radians(1.0),  # the user knows the part
        "gyro_scale": 0.002,
        "gyro_misalignment": 0.001,
        "accel_noise": 0.001,
        "accel_bias_instability": 0.2e-3 * 9.80665,
        "accel_bias_initial": 4e-3 * 9.80665,
        "accel_scale": 0.003,
    }
    assert asdict(profile_of(config.loads(text))) == pytest.approx(asdict(PROFILES["m-g350"]) | changed)


def test_the_epson_data_sheet():
    """M-G350-PD11: 0.2 deg/sqrt(h), 6 deg/h, 0.04 (m/s)/sqrt(h), 0.1 mG, in SI by hand."""
    profile = PROFILES["m-g350"]
    assert profile.gyro_noise == pytest.approx(5.818e-5, rel=1e-3)
    assert profile.gyro_bias_instability == pytest.approx(2.909e-5, rel=1e-3)
    assert profile.accel_noise == pytest.approx(6.667e-4, rel=1e-3)
    assert profile.accel_bias_instability == pytest.approx(9.807e-4, rel=1e-3)
