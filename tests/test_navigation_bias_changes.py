"""Biases that change with the force or with warmth: the stated sigmas have room for it."""

import numpy as np
import pytest
from accuracy_simulated import figures
from navigation_runner import samples_of, settings_of
from replay_in_process import new_filter, replay

from imud.drivers.sample import POWER_ON
from imud.estimators.ins.setup import restore_biases
from imud.sensor_errors.profiles import PROFILES
from imud.sensor_errors.stored_biases import Biases

RATE, G, KNOWN = 100, 9.81, 1e-5
PROFILE = PROFILES["consumer-mems"]
NO_WARMTH, NO_FORCE = {"warm_up_share": 0.0}, {"gyro_force_share": 0.0}
NEVER = NO_WARMTH | {"force_change_time_s": 1e9}


def leaning(angle):
    """SAMPLE rows of a body that leans so, rad, about its forward axis, and vibrates, so that it is not at rest."""
    t = np.arange(len(angle)) / RATE
    w = np.column_stack([np.gradient(angle, t), 0.0 * t, 0.0 * t])
    f = -G * np.column_stack([0.0 * t, np.sin(angle), np.cos(angle)])
    return samples_of(100.0 + t, w, f + 0.5 * np.random.default_rng(0).standard_normal(f.shape))


def growth(samples, tuning):
    """What the variances of the vertical gyro bias and of the forward accelerometer bias grow by, per sample; they
    begin with KNOWN.
    """
    filter_ = new_filter("navigation", samples, settings_of(tuning=tuning))
    restore_biases(filter_.state, Biases((0.0,) * 3, (KNOWN,) * 3, (0.0,) * 3, (KNOWN,) * 3))
    out = replay(filter_, samples)[0]
    return out["sigma_bg"][:, 2] ** 2 - KNOWN**2, out["sigma_ba"][:, 0] ** 2 - KNOWN**2


def test_a_force_along_other_axes_opens_both_biases():
    """It leans by 30 deg: the force changes by 2 g sin(15 deg)."""
    t = np.arange(60 * RATE) / RATE
    samples = leaning(np.radians(30.0) * np.clip((t - 20.0) / 2.0, 0.0, 1.0))
    (gyro, accel), still = growth(samples, NO_WARMTH), growth(samples, NEVER)
    changed = 2.0 * G * np.sin(np.radians(15.0))
    assert gyro[-1] - still[0][-1] == pytest.approx((0.025 * PROFILE.gyro_bias_initial / G * changed) ** 2, rel=0.1)
    assert accel[-1] - still[1][-1] == pytest.approx((PROFILE.accel_scale * changed) ** 2, rel=0.1)
    assert gyro[19 * RATE] - still[0][19 * RATE] < 0.01 * (gyro[-1] - still[0][-1])


def test_waves_are_no_such_change():
    t = np.arange(60 * RATE) / RATE
    waves = leaning(np.radians(10.0) * np.sin(2.0 * np.pi * t / 6.0))
    swing = (0.025 * PROFILE.gyro_bias_initial * np.sin(np.radians(10.0))) ** 2
    assert growth(waves, NO_WARMTH)[0][-1] - growth(waves, NEVER)[0][-1] < 0.3 * swing


def test_a_sensor_warms_up_after_each_switch_on():
    samples = leaning(np.zeros(250 * RATE))
    gyro = growth(samples, {})[0] - growth(samples, NO_WARMTH)[0]
    warmth = (0.025 * PROFILE.gyro_bias_initial) ** 2
    assert gyro[50 * RATE] == pytest.approx(warmth * (1.0 - np.exp(-1.0)), rel=0.05)
    assert gyro[240 * RATE] == pytest.approx(warmth, rel=0.05)
    samples["flags"][200 * RATE] |= POWER_ON
    filter_ = new_filter("navigation", samples, settings_of())
    replay(filter_, samples)
    left = filter_.state["core"][0, 0]["bias_changes"]["warm_up_variance"]
    assert left == pytest.approx(warmth * np.exp(-1.0), rel=0.05)


@pytest.mark.parametrize(
    "vehicle, seeds, without", [("sailboat", (0, 3, 7), NEVER), ("crane", (5,), NO_WARMTH)], ids=["force", "warmth"]
)
def test_what_changes_the_bias_does_not_make_the_heading_wrong_and_sure(vehicle, seeds, without):
    wrong, before = (sum(figures(vehicle, "5 Hz", 0.0, seed, t)["yaw s"] for seed in seeds) for t in ({}, without))
    assert wrong < 2.0
    assert before > 20.0
