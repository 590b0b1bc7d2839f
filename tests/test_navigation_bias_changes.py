"""Biases that change with the force, and as a sensor warms up: the stated sigmas have room for it."""

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
COLD = {"warm_up_share": 0.0}
NEVER = COLD | {"force_change_time_s": 1e9}


def leaning(angle):
    """SAMPLE rows of a body that leans so, rad, about its forward axis, and vibrates, so that it is not at rest."""
    t = np.arange(len(angle)) / RATE
    w = np.column_stack([np.gradient(angle, t), 0.0 * t, 0.0 * t])
    f = -G * np.column_stack([0.0 * t, np.sin(angle), np.cos(angle)])
    return samples_of(100.0 + t, w, f + 0.5 * np.random.default_rng(0).standard_normal(f.shape))


def growth(samples, tuning):
    """What the variance of the vertical gyro bias grows by, per sample; it begins with that of KNOWN."""
    filter_ = new_filter("navigation", samples, settings_of(tuning=tuning))
    restore_biases(filter_.state, Biases((0.0,) * 3, (KNOWN,) * 3, (0.0,) * 3, (KNOWN,) * 3))
    out = replay(filter_, samples)[0]
    return out["sigma_bg"][:, 2] ** 2 - KNOWN**2


def test_a_force_along_other_axes_opens_the_bias():
    """It leans by 30 deg: the force changes by 2 g sin(15 deg)."""
    t = np.arange(60 * RATE) / RATE
    samples = leaning(np.radians(30.0) * np.clip((t - 20.0) / 2.0, 0.0, 1.0))
    gyro, still = growth(samples, COLD), growth(samples, NEVER)
    changed = 2.0 * G * np.sin(np.radians(15.0))
    assert gyro[-1] - still[-1] == pytest.approx((0.025 * PROFILE.gyro_bias_initial / G * changed) ** 2, rel=0.1)
    assert gyro[19 * RATE] - still[19 * RATE] < 0.01 * (gyro[-1] - still[-1])


def test_waves_are_no_such_change():
    t = np.arange(60 * RATE) / RATE
    waves = leaning(np.radians(10.0) * np.sin(2.0 * np.pi * t / 6.0))
    swing = (0.025 * PROFILE.gyro_bias_initial * np.sin(np.radians(10.0))) ** 2
    assert growth(waves, COLD)[-1] - growth(waves, NEVER)[-1] < 0.3 * swing


def warming(samples, begin=0):
    """What warming up has added to the variance of the gyro bias, as a share of all that it adds, at each sample."""
    added = growth(samples, {}) - growth(samples, COLD)
    return (added - added[begin]) / (0.05 * PROFILE.gyro_bias_initial) ** 2


def test_warming_up_opens_the_bias():
    t = np.arange(121 * RATE) / RATE
    share = warming(leaning(0.0 * t))
    for at in (10, 40, 120):
        assert share[at * RATE] == pytest.approx(1.0 - np.exp(-2.0 * at / 60.0), abs=0.02)


def test_a_sensor_that_was_switched_off_warms_up_again():
    """Each growth begins with the variance after the power-on, which is the same with and without warming up."""
    on, samples = 120 * RATE, leaning(np.zeros(180 * RATE))
    samples["flags"][on] |= POWER_ON
    assert warming(samples, on)[-1] > 0.3
    samples["flags"][on] = 0
    assert warming(samples, on)[-1] < 0.1


@pytest.mark.thorough
def test_what_the_force_changes_does_not_make_the_heading_wrong_and_sure():
    wrong, before = (sum(figures("sailboat", "5 Hz", 0.0, seed, t)["yaw s"] for seed in (0, 3, 7)) for t in ({}, NEVER))
    assert wrong < 2.0
    assert before > 20.0


@pytest.mark.thorough
def test_a_sensor_that_warms_up_does_not_make_the_heading_wrong_and_sure():
    """By 0.05 deg/s (1 sigma), with cranes, whose heading few fixes show."""
    wrong, before = (sum(figures("crane", "5 Hz", 0.0, seed, t)["yaw s"] for seed in (0, 5)) for t in ({}, COLD))
    assert wrong < 2.0
    assert before > 20.0
