"""The attitude filter on samples that are missing, false, late or no numbers: nothing that was good is lost."""

import math

import numpy as np
import pytest
from attitude_runs import (
    PROFILE_NAMES,
    assert_whole,
    samples_from,
    still_then_moving,
    tilt_variance_deg2,
    yaw_sigma_deg,
)
from attitude_simulation import DEG, Flaws, after, errors_deg, simulate, steady, wobble
from broad import filter_of, samples_of, solutions_of
from hypothesis import given, settings
from hypothesis import strategies as st

from imud.configuration.settings import Initial
from imud.drivers.sample import LIMITED_FORCE, LIMITED_RATE, SUSPECT
from imud.drivers.sample import SATURATED as BEYOND_RANGE
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID, SATURATED, SOLUTION


@pytest.mark.parametrize("rubbish", [(1e9, -1e9), (math.nan, 0.0), (0.0, math.inf), (-math.inf, math.nan)])
def test_suspect_samples_are_held_over(rubbish):
    truth, samples = still_then_moving()
    for first in range(1000, 2900, 200):
        for k in range(first, first + 3):
            samples[k]["w"], samples[k]["f"] = rubbish
            samples[k]["flags"] = SUSPECT
    out = solutions_of(samples, "m-g350")
    assert_whole(out)
    tilt, yaw = errors_deg(out["q_nb"], truth.attitude)
    assert np.max(tilt) < 1.0 and np.max(np.abs(yaw)) < 1.5


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_values_that_are_no_numbers_are_suspect_without_a_flag(number):
    truth, samples = still_then_moving()
    samples["w"][1200:1203, 1] = number
    samples["f"][2000:2003, 2] = number
    out = solutions_of(samples, "m-g350")
    assert_whole(out)
    assert np.max(errors_deg(out["q_nb"], truth.attitude)[0]) < 0.5


@pytest.mark.parametrize("every", [2, 4, 10])
def test_single_rates_that_are_missing_in_a_turn_are_those_before(every):
    """A turn of 1 rad/s for 40 s; with rates that return to zero meanwhile it is 12 to 190 deg too short."""
    truth = simulate(45.0, 50.0, steady((0.0, 0.0, 1.0), 5.0, 45.0))
    samples = samples_from(truth, Flaws())
    samples["w"][(truth.t > 5.0) & (np.arange(len(samples)) % every == 0)] = math.nan
    out = solutions_of(samples, "consumer-mems")
    assert np.max(np.abs(errors_deg(out["q_nb"], truth.attitude)[1])) < 3.0


def test_held_values_cost_certainty():
    _, samples = still_then_moving()
    calm = solutions_of(samples, "m-g350")["sigma_rpy"][1050, 2]
    samples["flags"][1000:1050] = SUSPECT
    out = solutions_of(samples, "m-g350")
    assert out["sigma_rpy"][1055, 2] > calm + 2.0 * DEG


def test_nothing_but_suspect_samples_claims_nothing():
    _, samples = still_then_moving(5.0)
    samples["flags"] = SUSPECT
    out = solutions_of(samples, "m-g350")
    assert_whole(out)
    assert not np.any(out["status"] & ATTITUDE_VALID)


def test_saturation_is_reported_and_increases_the_sigma():
    _, samples = still_then_moving()
    calm = solutions_of(samples, "m-g350")["sigma_rpy"][1220, 2]
    samples["w"][1200:1220, 2] = 300.0 * DEG
    samples["flags"][1200:1220] = BEYOND_RANGE
    out = solutions_of(samples, "m-g350")
    assert_whole(out)
    assert np.array_equal(np.flatnonzero(out["status"] & SATURATED), np.arange(1200, 1220))
    assert out["sigma_rpy"][1222, 2] > calm + 10.0 * DEG


def test_only_the_sensor_that_is_named_saturated_costs_certainty():
    """A limited gyro costs yaw, in proportion to its rate; a limited accelerometer costs tilt; unnamed, both."""
    _, samples = still_then_moving()
    sigmas = {}
    for named in (0, LIMITED_RATE, LIMITED_FORCE, None):
        samples["flags"][1200:1300] = 0 if named is None else BEYOND_RANGE | named
        sigmas[named] = solutions_of(samples, "m-g350")["sigma_rpy"][1305]
    calm, both = sigmas[None], sigmas[0]
    yaw = np.sqrt([sigma[2] ** 2 - calm[2] ** 2 for sigma in (both, sigmas[LIMITED_RATE])])
    rate2 = np.sum(samples["w"][1200:1300] ** 2) * 0.01
    np.testing.assert_allclose(yaw, 0.2 * np.sqrt(rate2), rtol=0.1)
    assert sigmas[LIMITED_FORCE][2] < calm[2] + 0.02 * yaw[0]
    assert sigmas[LIMITED_FORCE][0] > 1.2 * calm[0]


def test_a_short_gap_is_extrapolated_within_the_sigmas():
    truth, samples = still_then_moving()
    keep = np.r_[0:1500, 1530:3000]
    out = solutions_of(samples[keep], "m-g350")
    tilt, yaw = errors_deg(out["q_nb"], truth.attitude[keep])
    whole = solutions_of(samples, "m-g350")
    assert out["sigma_rpy"][1503, 2] > whole["sigma_rpy"][1533, 2] + 0.5 * DEG
    assert np.all(np.abs(yaw[1500:]) < 3.0 * yaw_sigma_deg(out)[1500:])
    assert np.max(tilt[1510:] ** 2 / tilt_variance_deg2(out)[1510:]) < 9.0


@pytest.mark.parametrize("place", [0, 5000], ids=["at the start", "after a long gap"])
@pytest.mark.parametrize("damage_mps2", [3.0, 5.0, 7.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_damaged_first_force_is_not_taken_for_the_vertical(place, damage_mps2, seed):
    truth = simulate(8.0, 1000.0, rpy_deg=(10.0, -5.0, 0.0))
    samples = samples_from(truth, seed=seed)
    samples["f"][place, 1] += damage_mps2  # one bit of the reading, which no checksum shows
    samples["t_ns"][5000:] += 2_000_000_000
    out = solutions_of(samples, "m-g350")
    tilt, _ = errors_deg(out["q_nb"], truth.attitude)
    claimed = out["status"] & ATTITUDE_VALID != 0
    assert np.all(tilt[claimed] < 3.0 * np.sqrt(tilt_variance_deg2(out))[claimed])
    assert claimed[place + 1000] and tilt[place + 1000] < 1.0


def test_after_a_long_gap_it_levels_again_and_keeps_the_biases():
    truth = simulate(30.0, 100.0, steady((60.0 * DEG, 0.0, 90.0 * DEG), 12.0, 14.0))
    bias = (0.4 * DEG, -0.3 * DEG, 0.2 * DEG)
    samples = samples_from(truth, Flaws(gyro_bias=bias))
    keep = np.r_[0:1150, 1500:3000]
    out = solutions_of(samples[keep], "m-g350", Initial(yaw_deg=0.0))
    tilt, _ = errors_deg(out["q_nb"], truth.attitude[keep])
    assert np.max(tilt[1150:]) < 0.5
    assert np.max(np.abs(out["bg"][1150:] - bias)) < 0.02 * DEG
    assert out["status"][1149] & HEADING_VALID and not np.any(out["status"][1150:] & HEADING_VALID)
    assert np.all(yaw_sigma_deg(out)[1150:] > 90.0)


def test_samples_that_are_not_newer_are_ignored():
    _, samples = still_then_moving(8.0)
    doubled = np.repeat(samples, 2)
    doubled["t_ns"][1::4] -= 50_000_000
    doubled["w"][1::2] = 1e3
    out = solutions_of(samples, "m-g350")
    filter_, twice = filter_of(samples, "m-g350"), np.zeros(len(doubled), SOLUTION)
    filter_.run(doubled, twice)
    assert twice[0::2].tobytes() == out.tobytes()
    assert np.array_equal(twice[1::2]["q_nb"], out["q_nb"])


@pytest.mark.parametrize("moving", [True, False])
def test_a_dead_accelerometer_leaves_a_gyro_whose_tilt_grows_uncertain(moving):
    truth = simulate(90.0, 100.0, after(5.0, wobble(1, 0.5 * moving)), rpy_deg=(10.0, 5.0, 0.0))
    samples = samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3))
    samples["f"][1000:6000] = 0.0
    out = solutions_of(samples, "m-g350")
    assert_whole(out)
    tilt, _ = errors_deg(out["q_nb"], truth.attitude)
    assert np.max(tilt) < 3.0
    assert tilt_variance_deg2(out)[5990] > tilt_variance_deg2(out)[1200] + 0.3**2
    assert np.max(tilt**2 / tilt_variance_deg2(out)) < 9.0
    np.testing.assert_allclose(out["ba"][5990], out["ba"][990], atol=0.03)
    assert np.max(tilt[7500:]) < 0.5 and np.sqrt(tilt_variance_deg2(out)[7500]) < 0.8  # it came back at 60 s


def test_without_any_force_there_is_no_attitude_until_there_is():
    truth = simulate(20.0, 100.0, rpy_deg=(30.0, 0.0, 0.0))
    samples = samples_from(truth)
    samples["f"][:1000] = 0.0
    out = solutions_of(samples, "m-g350")
    assert_whole(out)
    assert not np.any(out["status"][:1000] & ATTITUDE_VALID)
    assert np.all(out["status"][1050:] & ATTITUDE_VALID)
    assert np.max(errors_deg(out["q_nb"], truth.attitude)[0][1000:]) < 0.5


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_no_input_makes_it_give_what_is_not_a_number(seed):
    rng = np.random.default_rng(seed)
    n = 400
    samples = samples_of(np.arange(n) / 100.0, rng.normal(0.0, 1.0, (n, 3)), rng.normal(0.0, 10.0, (n, 3)))
    wild = rng.random(n) < 0.2
    samples["w"][wild] *= 10.0 ** rng.uniform(-10, 6, (wild.sum(), 3))
    samples["f"][wild] *= 10.0 ** rng.uniform(-10, 6, (wild.sum(), 3))
    samples["flags"] = rng.integers(0, 8, n)
    samples["t_ns"] += rng.choice([0, 0, 0, -30_000_000, 5_000_000_000], n).cumsum()
    samples["w"][rng.random(n) < 0.05] = np.nan
    for profile in PROFILE_NAMES:
        out = solutions_of(samples, profile)
        assert_whole(out)
        assert np.all(out["sigma_rpy"] >= 0.0) and np.all(out["sigma_rpy"] <= math.pi / math.sqrt(3.0) + 1e-12)
