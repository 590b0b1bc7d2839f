"""Biases of the accelerometers or the gyros that step under way: the tilt stays right or is stated less sure."""

import numpy as np
import pytest
from accuracy_simulated import wander
from navigation_runner import navigate, settings_of
from navigation_simulation import Later, drive, errors, received, sensed
from test_navigation_aiding import headings
from test_navigation_gyro_bias_step import onset_ages

RATE, BEGIN_S = 100, 90.0
DRIVE = Later(drive, 180.0, speed=12.0)
OFF = 1e9
BLIND = {"imu_bias_step_chi2": OFF, "likely_imu_bias_step_chi2": OFF}
G = 9.80665


def sensed_with_step(seed, name, step, every=0.5):
    """(Drive, SAMPLE rows, FIX rows): from 90 s on the rates (w) or forces (f) of a drive are off by `step` (3,)."""
    d, rng = DRIVE, np.random.default_rng(seed)
    samples = sensed(d, rng)
    samples[name][int(BEGIN_S * RATE) :] += step
    return d, samples, received(d, rng, every=every, late=0.2, sigma=1.5, white=0.1, speed_sigma=0.05)


def without_velocity(fixes):
    fixes["v"] = fixes["speed"] = fixes["course"] = np.nan
    return fixes


def run(seed, name, step, tuning=None, alone=False):
    """(tilt errors, deg; SOLUTION rows) from the step on. alone: the receiver reports one position a second."""
    d, samples, fixes = sensed_with_step(seed, name, step, 1.0 if alone else 0.5)
    fixes = without_velocity(fixes) if alone else fixes
    out, begin = navigate(samples, fixes, settings_of("free", tuning=tuning))[0], int(BEGIN_S * RATE)
    return np.degrees(np.hypot(*errors(d, out)[2][begin:, :2].T)), out[begin:]


@pytest.mark.parametrize(
    ("name", "step"),
    [
        pytest.param("f", (0.08 * G, 0.0, 0.0), id="80 mg ahead"),
        pytest.param("f", (0.04 * G, 0.0, 0.0), id="40 mg ahead", marks=pytest.mark.thorough),
        pytest.param("w", (np.radians(1.0), 0.0, 0.0), id="1 deg/s of roll", marks=pytest.mark.thorough),
        pytest.param("w", (0.0, np.radians(1.0), 0.0), id="1 deg/s of pitch", marks=pytest.mark.thorough),
    ],
)
def test_a_step_is_found_and_the_tilt_is_right_again(name, step):
    found, blind = ([run(seed, name, step, tuning) for seed in range(3)] for tuning in (None, BLIND))
    mean, mean_blind = (np.mean([np.sqrt(np.mean(tilt**2)) for tilt, _ in runs]) for runs in (found, blind))
    assert mean < 0.3 * mean_blind
    for tilt, out in found:
        assert tilt[int(60 * RATE) :].max() < 1.0
        bias = out["ba" if name == "f" else "bg"]
        assert bias[-1] - bias[0] == pytest.approx(step, abs=0.1 * max(step))


@pytest.mark.parametrize(
    ("name", "step"),
    [
        pytest.param("f", (0.08 * G, 0.0, 0.0), id="80 mg ahead"),
        pytest.param("f", (0.0, 0.06 * G, 0.0), id="60 mg to the right", marks=pytest.mark.thorough),
        pytest.param("w", (np.radians(1.0), 0.0, 0.0), id="1 deg/s of roll"),
        pytest.param("w", (0.0, np.radians(0.5), 0.0), id="0.5 deg/s of pitch", marks=pytest.mark.thorough),
    ],
)
def test_positions_alone_show_a_step(name, step):
    """They show it only seconds later, and no longer when it began, or which sensor has changed."""
    found, blind = ([run(seed, name, step, tuning, alone=True) for seed in range(3)] for tuning in (None, BLIND))
    mean, mean_blind = (np.mean([np.sqrt(np.mean(tilt**2)) for tilt, _ in runs]) for runs in (found, blind))
    assert mean < 0.5 * mean_blind
    for tilt, out in found:
        sigma = np.degrees(out["sigma_rpy"][:, :2].max(axis=1))
        assert tilt[int(60 * RATE) :].max() < 1.5
        assert np.count_nonzero((tilt > 5.0) & (tilt > 4.0 * sigma)) < 4 * RATE


@pytest.mark.parametrize("across_g", [-0.1, pytest.param(-0.085, marks=pytest.mark.thorough)])
def test_a_large_step_across_a_car_that_turns_is_none_of_its_stamps(across_g):
    """In a steady turn it looks like fixes that are late, and the first fixes after it fit it badly: it begins between
    two of them.
    """
    step = (0.0, across_g * G, 0.0)
    for seed in range(4):
        d, samples, fixes = sensed_with_step(seed, "f", step)
        begin = int(BEGIN_S * RATE)
        off = np.degrees(errors(d, navigate(samples, fixes, settings_of("free"))[0])[2][begin:])
        assert np.abs(off[:, 2]).max() < 5.0
        assert np.sqrt(np.mean(np.hypot(*off[:, :2].T) ** 2)) < 0.5


def test_without_a_step_none_is_detected():
    none = (0.0, 0.0, 0.0)
    tilt, _ = run(4, "f", none)
    blind, _ = run(4, "f", none, {"imu_bias_step_chi2": OFF})
    np.testing.assert_array_equal(tilt, blind)


def test_a_likely_step_is_part_of_the_stated_sigma():
    step = (0.05 * G, 0.0, 0.0)
    stated, silent = (
        run(0, "f", step, {"imu_bias_step_chi2": OFF, "likely_imu_bias_step_chi2": least})[1]["sigma_rpy"][:, :2]
        for least in (8.0, OFF)
    )
    assert (stated >= silent).all()
    assert (stated > 1.5 * silent).any()


def test_one_onset_follows_the_fixes_and_one_is_always_older_than_the_second():
    d, rng = drive(300.0), np.random.default_rng(1)
    ages = onset_ages("imu_bias_step", sensed(d, rng), received(d, rng))
    assert len(ages) > 200
    assert np.median(ages[:, 0]) < 3.0
    assert ages[:, 1:].max(axis=0) == pytest.approx([12.0, 48.0], abs=2.0)
    assert ages[100:, 2].min() > 10.0


def test_with_positions_alone_the_first_two_onsets_wait_for_what_shows_late():
    d, rng = drive(300.0), np.random.default_rng(1)
    ages = onset_ages("imu_bias_step", sensed(d, rng), without_velocity(received(d, rng)))
    assert len(ages) > 200
    newest, older, oldest = ages[100:].T
    assert 1.5 < np.median(newest) < 4.5
    assert 4.0 <= older.min() < np.median(older) < 9.0
    assert 8.0 < oldest.min() < oldest.max() == pytest.approx(48.0, abs=2.0)


def test_where_either_sensor_may_have_changed_the_stated_tilt_allows_for_both():
    """Of a step of the accelerometers, as positions alone show it, the correction may be that of the gyros."""
    d, samples, fixes = sensed_with_step(7, "f", np.array([72.0, 46.0, -21.0]) * 1e-3 * G, 1.0)
    out = navigate(samples, without_velocity(fixes), settings_of("free"))[0]
    position, _, attitude = (error[int(BEGIN_S * RATE) :] for error in errors(d, out))
    tilt, sigma = np.degrees(np.hypot(*attitude[:, :2].T)), np.degrees(out["sigma_rpy"][int(BEGIN_S * RATE) :, :2])
    assert not ((tilt > 5.0) & (tilt > 4.0 * sigma.max(axis=1))).any()
    assert np.hypot(*position[:, :2].T).max() < 20.0


def test_beside_a_compass_errors_that_velocities_share_are_no_step():
    """A receiver of 10 Hz, whose velocities err alike for a second."""
    d, rng = DRIVE, np.random.default_rng(1)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.1, late=0.1, sigma=1.2, speed_sigma=0.03)
    error = wander(rng, len(fixes), 0.1, 0.15, 1.0)
    north = fixes["speed"] * np.cos(fixes["course"]) + error[:, 0]
    east = fixes["speed"] * np.sin(fixes["course"]) + error[:, 1]
    fixes["speed"], fixes["course"] = np.hypot(north, east), np.arctan2(east, north)
    out = navigate(samples, fixes, settings_of("auto"), aiding=headings(d, rng, 0.2))[0]
    assert np.abs(np.diff(out["ba"][int(50 * RATE) :], axis=0)).max() < 0.1
