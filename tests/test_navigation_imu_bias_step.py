"""Biases of the accelerometers or the gyros that step under way: the tilt stays right or is stated less sure."""

import numpy as np
import pytest
from accuracy_simulated import wander
from navigation_runner import navigate, settings_of
from navigation_simulation import Later, drive, errors, received, sensed
from test_navigation_aiding import headings
from test_navigation_divergence import P, core
from test_navigation_gyro_bias_step import onset_ages

from imud.compile.jit import interpreted
from imud.estimators.ins.glr_tests.imu_bias_step import allow_for_imu_bias_step
from imud.estimators.ins.state import FORCES, IMU_STEP_FAULT, STATES
from imud.math.kalman import unpack

RATE, BEGIN_S = 100, 90.0
DRIVE = Later(drive, 180.0, speed=12.0)
OFF = 1e9
BLIND = dict.fromkeys(("imu_bias_step_chi2", "positions_step_chi2", "likely_imu_bias_step_chi2"), OFF)
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


def wrong_and_sure_s(tilt, out):
    sigma = np.degrees(out["sigma_rpy"][:, :2].max(axis=1))
    return np.count_nonzero((tilt > 5.0) & (tilt > 4.0 * sigma)) / RATE


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
    """They show it seconds later, and no longer when it began or in which sensor; some pass for a drift of them."""
    found, blind = ([run(seed, name, step, tuning, alone=True) for seed in range(5)] for tuning in (None, BLIND))
    rms, rms_blind = ([np.sqrt(np.mean(tilt**2)) for tilt, _ in runs] for runs in (found, blind))
    wrong, wrong_blind = (sum(wrong_and_sure_s(tilt, out) for tilt, out in runs) for runs in (found, blind))
    assert np.median(rms) < 0.5 * np.median(rms_blind)
    assert wrong <= 0.3 * wrong_blind


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


@pytest.mark.parametrize(("explained_by_other", "counts"), [(150.0, True), (250.0, False)])
def test_a_step_of_the_other_sensor_that_explains_half_as_much_counts_in_the_covariance(explained_by_other, counts):
    """P += e e', e being the difference of the two corrections."""
    c, d, onset = core(), np.array([0.1, -0.2, 0.3]), 1
    h, rng = 2 * onset + FORCES, np.random.default_rng(1)
    g, columns = c.imu_bias_step, slice(IMU_STEP_FAULT + 3 * h, IMU_STEP_FAULT + 3 * h + 3)
    c.gyro_bias_step.velocity_ns = c.nav.t_ns
    g.onset_ns[onset] = c.nav.t_ns
    information = 100.0 / (d @ d)
    g.information[h] = information * np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])
    g.vector[h] = (information + 1.0 / P.accel_bias_sigma**2) * d
    g.energy[onset], g.count[onset] = 1.1 * g.vector[h] @ d, 1e3
    c.faults.sensitivity[:, columns] = rng.standard_normal((STATES, 3))
    c.scratch.x[:STATES] = rng.standard_normal(STATES)
    before = unpack(c.cov.P, STATES)
    interpreted(allow_for_imu_bias_step)(P, c, FORCES, explained_by_other / 100.0 * g.vector[h] @ d)
    e = c.faults.sensitivity[:, columns] @ d + c.scratch.x[:STATES]
    np.testing.assert_allclose(unpack(c.cov.P, STATES), before + counts * np.outer(e, e), rtol=1e-9, atol=1e-12)


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
