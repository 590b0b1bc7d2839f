"""A gyro bias that steps under way: the heading turns away, and is admitted or found again before it is far off."""

import numpy as np
import pytest
from navigation_runner import navigate, settings_of
from navigation_simulation import Later, drive, errors, moved, received, sensed
from replay_in_process import new_filter
from scipy.spatial.transform import Rotation

from imud.batch import play
from imud.estimators.ins.state import NEVER_NS
from imud.estimators.records import HEADING_VALID

RATE, BEGIN_S, STOP_S = 100, 90.0, 90.0
DRIVES = {speed: Later(drive, 150.0, speed=speed) for speed in (12.0, 3.0)}
OFF = 1e9
WARM = {"warm_up_share": 0.0}
BLIND = WARM | {f"{prefix}_bias_step_chi2": OFF for prefix in ("gyro", "likely_gyro", "imu", "likely_imu")}


def run(seed, step_dps, tuning=None, speed=12.0, every=1.0, shaken=0.0, survey=False):
    """(errors of the heading, deg; seconds wrong and sure) from the step on.

    every: s, between two fixes; shaken: m/s in a second, velocity noise of the vibration under way; survey: fixes of
    centimetres without a velocity.
    """
    d, rng = DRIVES[speed], np.random.default_rng(seed)
    samples = sensed(d, rng)
    shocks = np.random.default_rng(100 + seed).standard_normal((len(d.t), 3))
    samples["f"] += shaken * RATE**0.5 * (d.t > 10.0)[:, None] * shocks
    fixes = received(d, rng, every=every, late=0.2, sigma=1.5, white=0.1, speed_sigma=0.05)
    if survey:
        fixes = received(d, rng, every=every, late=0.2, sigma=0.02, white=0.01, hdop=0.05)
        fixes["speed"] = fixes["course"] = np.nan
    begin = int(BEGIN_S * RATE)
    samples["w"][begin:, 2] += np.radians(step_dps)
    out = navigate(samples, fixes, settings_of("free", tuning=tuning))[0]
    yaw, out = np.abs(np.degrees(errors(d, out)[2][begin:, 2])), out[begin:]
    sure = (yaw > 4.0 * np.degrees(out["sigma_rpy"][:, 2])) & (out["status"] & HEADING_VALID > 0)
    return yaw, float((sure & (yaw > 5.0)).sum()) / RATE


@pytest.mark.thorough
@pytest.mark.parametrize("step_dps", [1.0, -0.5])
@pytest.mark.parametrize("speed", DRIVES)
def test_a_step_of_the_bias_is_found(step_dps, speed):
    wrong = blind = 0.0
    for seed in range(3):
        yaw, seconds = run(seed, step_dps, speed=speed)
        wrong += seconds
        assert yaw[int(50 * RATE) :].max() < 3.0
        blind += run(seed, step_dps, BLIND, speed)[1]
    assert blind > 20.0
    assert wrong < 3.0


def test_positions_of_a_survey_show_a_step_of_the_bias():
    found = [run(seed, -0.5, survey=True) for seed in range(3)]
    assert max(yaw[int(25 * RATE) :].max() for yaw, _ in found) < 4.0
    assert sum(seconds for _, seconds in found) < 3.0


def test_velocities_at_5_hz_count_fully_where_vibration_makes_most_of_their_innovations():
    """A receiver's errors of one second are shared, those of the vibration are not."""
    found = [run(seed, 1.0, WARM | {"likely_gyro_bias_step_chi2": OFF}, every=0.2, shaken=0.3) for seed in range(8)]
    assert np.mean([seconds for _, seconds in found]) < 8.0  # as one in a second: 28 s


def test_a_likely_step_is_part_of_the_stated_sigma():
    stated, silent = (
        sum(run(seed, 1.0, {"likely_gyro_bias_step_chi2": least}, speed=3.0)[1] for seed in range(3))
        for least in (2.0, OFF)
    )
    assert stated < 0.5 * silent


def test_without_a_step_none_is_detected():
    yaw, _ = run(4, 0.0)
    blind, _ = run(4, 0.0, tuning={"gyro_bias_step_chi2": OFF})
    np.testing.assert_array_equal(yaw, blind)


def onset_ages(test, samples, fixes):
    """Ages of the onsets of a GLR test, s, in each second in which all are open; it detects nothing."""
    filter_ = new_filter("navigation", samples, settings_of("free", tuning={f"{test}_chi2": OFF}))
    ages = []

    def look(t_ns):
        onsets = filter_.state["core"][0, 0][test]["onset_ns"]
        if onsets.min() > NEVER_NS:
            ages.append(1e-9 * (t_ns - onsets))

    order = np.argsort(fixes["arrival_ns"], kind="stable")
    play(filter_, samples.copy(), fixes[order], lambda rows: None, each_second=look)
    return np.array(ages)


def test_an_onset_of_half_the_greatest_age_is_always_there():
    """They once began anew together now and then, and a step of seconds before was not seen."""
    d, rng = drive(300.0), np.random.default_rng(1)
    ages = onset_ages("gyro_bias_step", sensed(d, rng), received(d, rng))
    assert len(ages) > 200
    assert (np.diff(ages, axis=1) >= 0.0).all()
    assert ages.max(axis=0) == pytest.approx([12.0, 24.0, 48.0, 96.0], abs=2.0)
    assert ages[100:].min(axis=0) == pytest.approx([0.0, 12.0, 24.0, 48.0], abs=2.0)


def test_a_step_that_is_found_opens_the_biases_of_all_axes():
    """Only the vertical part of it shows, and a vehicle leans: the axis that has it is not known."""
    d, rng = DRIVES[12.0], np.random.default_rng(0)
    samples = sensed(d, rng)
    samples["w"][int(BEGIN_S * RATE) :, 2] += np.radians(1.0)
    fixes = received(d, rng, late=0.2, sigma=1.5, white=0.1, speed_sigma=0.05)
    out = navigate(samples, fixes, settings_of("free"))[0]
    opened = np.degrees(out["sigma_bg"][1:] ** 2 - out["sigma_bg"][:-1] ** 2)
    k = int(BEGIN_S * RATE) + np.argmax(opened[int(BEGIN_S * RATE) :, 2])
    assert (np.degrees(out["sigma_bg"][k + 1]) > 0.1).all()
    assert (np.degrees(out["sigma_bg"][k]) < 0.1).all()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_step_before_a_stop_leaves_a_heading_that_is_less_sure_and_not_none(seed):
    """A robot stands still soon after a step. A rate at rest that contradicts the bias replaces it."""
    rng, t = np.random.default_rng(seed), np.arange(150 * RATE) / RATE
    speed = 1.4 * np.clip((t - 10.0) / 2.0, 0.0, 1.0) * np.clip((STOP_S - t) / 2.0, 0.0, 1.0)
    yaw = 0.5 + np.cumsum(0.5 * speed * np.sin(0.4 * t)) / RATE
    v = np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), 0.0 * t])
    d = moved(t, v, Rotation.from_euler("z", yaw[:, None]))
    samples, fixes = sensed(d, rng), received(d, rng, every=0.2, late=0.1, sigma=0.5)
    samples["w"][t >= STOP_S - 12.0, 2] += np.radians(0.4)
    out = navigate(samples, fixes)[0]
    yaw_error, sigma = np.abs(errors(d, out)[2][:, 2]), out["sigma_rpy"][:, 2]
    later = t > STOP_S - 12.0
    assert (out["status"][later] & HEADING_VALID > 0).all()
    assert yaw_error[-1] < 3.0 * sigma[-1]
    assert sigma[-1] > 1.5 * sigma[int((STOP_S - 13.0) * RATE)]
    assert np.degrees(yaw_error[-1]) < 12.0
    assert np.degrees(out["bg"][-1, 2]) == pytest.approx(0.4, abs=0.05)
