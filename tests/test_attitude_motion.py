"""The attitude filter on bodies that turn and on vehicles: acceleration is not tilt, slow rotation is not bias."""

import numpy as np
import pytest
from attitude_monte_carlo import flight, run, walking
from attitude_runs import PROFILE_NAMES, samples_from, tilt_variance_deg2, yaw_sigma_deg
from attitude_simulation import DEG, MG, Flaws, after, errors_deg, simulate, steady, wobble
from broad import samples_of, solutions_of
from scipy.spatial.transform import Rotation

from imud.estimators.records import AT_REST, ATTITUDE_VALID
from imud.sensor_errors.profiles import PROFILES


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_a_start_in_motion_converges_to_its_sigmas(profile):
    p = PROFILES[profile]
    truth = simulate(60.0, 200.0, wobble(3, 1.0), wobble(4, 1.0, 1.0, 4.0), (30.0, -20.0, 0.0))
    flaws = Flaws(gyro_bias=(p.gyro_bias_initial,) * 3, accel_bias=(0.0, p.accel_bias_initial, 0.0))
    out = solutions_of(samples_from(truth, flaws), profile)
    tilt, _ = errors_deg(out["q_nb"], truth.attitude)
    assert not np.any(out["status"] & AT_REST)
    assert np.max(tilt[8000:]) < 2.5
    left = np.abs(out["bg"][-1] - p.gyro_bias_initial)
    assert np.max(left) < 0.4 * p.gyro_bias_initial and np.all(left < 3.0 * out["sigma_bg"][-1])
    assert np.mean(tilt[4000:] ** 2 / tilt_variance_deg2(out)[4000:]) < 3.0


def test_a_full_turn_about_each_axis_comes_back():
    rates = [steady(tuple(90.0 * DEG * (k == i) for k in range(3)), 4.0 + 6.0 * i, 8.0 + 6.0 * i) for i in range(3)]
    truth = simulate(24.0, 200.0, lambda t: sum(rate(t) for rate in rates), rpy_deg=(5.0, 5.0, 0.0))
    out = solutions_of(samples_from(truth), "m-g350")
    tilt, yaw = errors_deg(out["q_nb"], truth.attitude)
    assert np.max(tilt) < 0.5 and np.max(np.abs(yaw)) < 0.5  # the first rate of each turn may be a spike: 0.45 deg


def test_coning_does_not_drift():
    """Classical coning: a cone of half-angle 3 deg at 10 Hz; mean rates over 10 ms miss 19 deg/min of it."""
    angle, pulse = 3.0 * DEG, 2.0 * np.pi * 10.0
    t = np.arange(0.0, 60.0, 0.01)
    fine = Rotation.from_rotvec(np.column_stack([angle * np.cos(pulse * t), angle * np.sin(pulse * t), 0.0 * t]))
    steps = fine[:-1].inv() * fine[1:]
    substeps = 64
    ts = (t[:-1, None] + np.arange(substeps + 1) * 0.01 / substeps).ravel()
    dense = Rotation.from_rotvec(np.column_stack([angle * np.cos(pulse * ts), angle * np.sin(pulse * ts), 0.0 * ts]))
    quats = dense.as_quat().reshape(len(t) - 1, substeps + 1, 4)
    increments = Rotation.from_quat(quats[:, :-1].reshape(-1, 4)).inv() * Rotation.from_quat(
        quats[:, 1:].reshape(-1, 4)
    )
    mean_rate = increments.as_rotvec().reshape(len(t) - 1, substeps, 3).sum(1) / 0.01
    uncorrected = np.degrees((steps.as_rotvec() / 0.01 - mean_rate)[:, 2].mean()) * 60.0
    assert abs(uncorrected) > 10.0  # the test has something to show
    force = fine[1:].inv().apply([0.0, 0.0, -9.80665])
    out = solutions_of(samples_of(t[1:], mean_rate, force), "m-g350")
    _, yaw = errors_deg(out["q_nb"], fine[1:])
    assert abs(np.polyfit(t[1:], yaw, 1)[0] * 60.0) < 0.15 * abs(uncorrected)


@pytest.mark.parametrize("rate_hz", [20.0, 100.0, 400.0, 2000.0])
def test_the_sample_rate_does_not_matter(rate_hz):
    truth = simulate(30.0, rate_hz, after(5.0, wobble(5, 0.8, 0.3, 1.5)), after(5.0, wobble(6, 1.0, 1.0, 3.0)))
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=(0.3 * DEG,) * 3)), "m-g350")
    tilt, yaw = errors_deg(out["q_nb"], truth.attitude)
    assert np.sqrt(np.mean(tilt**2)) < 0.6
    assert np.max(np.abs(yaw)) < 1.5


def test_the_covariance_does_not_depend_on_the_sample_rate():
    sigmas = []
    for rate_hz in (50.0, 1000.0):
        truth = simulate(20.0, rate_hz, after(5.0, wobble(5, 0.8)), after(5.0, wobble(6, 1.0, 1.0, 4.0)))
        sigmas.append(solutions_of(samples_from(truth), "m-g350")["sigma_rpy"][-1])
    np.testing.assert_allclose(sigmas[0], sigmas[1], rtol=0.15)


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_steady_acceleration_and_uniform_motion_are_not_mistaken_for_tilt(profile):
    speed_up, brake = steady((2.5, 0.0, 0.0), 10.0, 25.0), steady((-3.0, 0.0, 0.0), 38.0, 50.5)
    truth = simulate(60.0, 100.0, acceleration=lambda t: speed_up(t) + brake(t))
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3)), profile)
    tilt, _ = errors_deg(out["q_nb"], truth.attitude)
    assert np.max(tilt) < 0.3  # an averaged accelerometer is 17 deg wrong here
    assert not np.any(out["status"][1150:2500] & AT_REST)


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_a_circle_of_40_s_leaves_the_vehicle_level(profile):
    turn = 0.3

    def centripetal(t):
        psi = turn * (t - 10.0)
        inward = 15.0 * turn * np.column_stack([-np.sin(psi), np.cos(psi), 0.0 * psi])
        return inward * ((t > 10.0) & (t < 50.0))[:, None]

    truth = simulate(60.0, 100.0, steady((0.0, 0.0, turn), 10.0, 50.0), centripetal)
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3)), profile)
    tilt, _ = errors_deg(out["q_nb"], truth.attitude)
    assert np.max(tilt) < 0.5  # an averaged accelerometer is 25 deg wrong here


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_a_vehicle_that_comes_back_on_a_figure_eight_stays_level(profile):
    """80 m by 40 m at 8 m/s: far enough from home for its place to tell nothing."""

    def course(t):
        u = 0.15 * np.maximum(t - 10.0, 0.0)
        velocity = (
            0.15 * np.column_stack([40.0 * np.cos(u), 40.0 * np.cos(2.0 * u)]) * np.minimum(u / 0.9, 1.0)[:, None]
        )
        return velocity, np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0] + 1e-12 * (u == 0.0)))

    step = 1e-3

    def rates(t):
        turn = (course(t + step)[1] - course(t - step)[1]) / (2.0 * step)
        return np.column_stack([0.0 * t, 0.0 * t, turn * (t > 10.0 + step)])

    def acceleration(t):
        return np.column_stack([(course(t + step)[0] - course(t - step)[0]) / (2.0 * step), 0.0 * t])

    truth = simulate(180.0, 100.0, rates, acceleration, (0.0, 0.0, 45.0))
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=(0.2 * DEG,) * 3)), profile)
    tilt, _ = errors_deg(out["q_nb"], truth.attitude)
    assert np.max(tilt) < 1.5


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_a_slow_turntable_is_not_taken_for_bias(profile):
    truth = simulate(140.0, 100.0, steady((0.0, 0.0, 1.0 * DEG), 15.0, 135.0))
    bias = (0.3 * DEG, -0.2 * DEG, 0.1 * DEG)
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=bias)), profile)
    assert not np.any(out["status"][1600:13400] & AT_REST)
    assert np.max(np.abs(out["bg"][500:13500] - bias)) < 0.02 * DEG
    assert np.max(np.abs(out["bg"][-1] - bias)) < 0.03 * DEG
    _, yaw = errors_deg(out["q_nb"], truth.attitude)
    assert np.max(np.abs(yaw)) < 3.0
    assert np.all(np.abs(yaw[100:]) < 3.0 * yaw_sigma_deg(out)[100:])


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_a_start_on_a_turntable_is_corrected_when_it_stops(profile):
    truth = simulate(60.0, 100.0, steady((0.0, 0.0, 1.0 * DEG), -1.0, 40.0))
    out = solutions_of(samples_from(truth), profile)
    assert abs(out["bg"][3900][2] - 1.0 * DEG) < 0.05 * DEG  # no sensor could tell
    assert np.max(np.abs(out["bg"][4800:])) < 0.02 * DEG


def test_rotation_faster_than_any_likely_bias_is_never_bias():
    truth = simulate(30.0, 100.0, steady((0.0, 0.0, 3.0 * DEG), -1.0, 40.0))
    out = solutions_of(samples_from(truth), "m-g350")
    assert not np.any(out["status"] & AT_REST)
    _, yaw = errors_deg(out["q_nb"], truth.attitude)
    assert np.max(np.abs(yaw)) < 3.0


def test_a_long_even_curve_is_neither_rest_nor_bias():
    """At 0.05 rad/s and 15 m/s, with a bias of the other sign: the rate shown is smaller than the bias, and steady."""
    turn, ahead = 0.05, steady((15.0 / 6.0, 0.0, 0.0), 10.0, 16.0)
    brake = steady((-15.0 / 4.0, 0.0, 0.0), 60.0, 64.0)

    def acceleration(t):
        psi = turn * np.clip(t - 10.0, 0.0, 50.0)
        speed = 15.0 * np.minimum(np.clip((t - 10.0) / 6.0, 0.0, 1.0), np.clip((64.0 - t) / 4.0, 0.0, 1.0))
        along = (ahead(t) + brake(t))[:, 0]
        across = speed * turn * ((t > 10.0) & (t < 60.0))
        cosine, sine = np.cos(psi), np.sin(psi)
        return np.column_stack([along * cosine - across * sine, along * sine + across * cosine, 0.0 * psi])

    truth = simulate(90.0, 100.0, steady((0.0, 0.0, turn), 10.0, 60.0), acceleration)
    flaws = Flaws(gyro_bias=(0.3 * DEG, -0.2 * DEG, -2.0 * DEG), accel_bias=(0.0, 25.0 * MG, 0.0))
    out = solutions_of(samples_from(truth, flaws), "consumer-mems")
    assert np.max(np.abs(out["bg"][1000:, 2] + 2.0 * DEG)) < 0.05 * DEG
    assert not np.any(out["status"][1300:6000] & AT_REST)
    assert np.all(out["status"][8500:] & AT_REST)


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_smooth_hills_and_bends_are_neither_rest_nor_bias(profile):
    """A road without a shake at 15 m/s, 4 deg up and down in 27 s, bends: rates pass slowly through the bias."""
    step = 1e-3

    def angles(t):
        s = np.maximum(t - 16.0, 0.0)
        return 4.0 * DEG * (1.0 - np.cos(2.0 * np.pi * s / 27.0)) / 2.0, 0.4 * (1.0 - np.cos(0.07 * s))

    def rates(t):
        (pitch_before, yaw_before), (pitch, _), (pitch_after, yaw_after) = angles(t - step), angles(t), angles(t + step)
        turning = (yaw_after - yaw_before) / (2.0 * step)
        pitching = (pitch_after - pitch_before) / (2.0 * step)
        return np.column_stack([-turning * np.sin(pitch), pitching, turning * np.cos(pitch)])

    def velocity(t):
        pitch, yaw = angles(t)
        ahead = np.column_stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)])
        return 15.0 * np.clip((t - 10.0) / 6.0, 0.0, 1.0)[:, None] * ahead

    def acceleration(t):
        return (velocity(t + step) - velocity(t - step)) / (2.0 * step)

    truth = simulate(200.0, 50.0, rates, acceleration)
    bias = np.array((0.3, -0.2, 0.1)) * DEG
    out = solutions_of(samples_from(truth, Flaws(gyro_bias=tuple(bias))), profile)
    assert np.max(np.abs(out["bg"] - bias)[500:]) < 0.13 * DEG
    tilt, yaw = errors_deg(out["q_nb"], truth.attitude)
    assert np.max(tilt) < 4.0
    assert np.all(np.abs(yaw[500:]) < 3.0 * yaw_sigma_deg(out)[500:])


@pytest.mark.thorough
@pytest.mark.parametrize(("motion", "most_deg", "most_wrong"), [(walking, 3.5, 2.0), (flight, 11.0, 8.0)])
def test_a_slow_velocity_is_not_taken_for_travel_where_there_was_no_rest(motion, most_deg, most_wrong):
    """It would hide in the tilt: walks and flights that begin in motion were 5 and 15 deg off, for most of a minute."""
    runs = [run((motion, "auto", number, False, ())) for number in range(0, 24, 2)]
    squared_tilt, nees, _, wrong = np.mean(runs, axis=0)
    assert np.sqrt(squared_tilt) < most_deg and nees < 3.0 and wrong < most_wrong


def test_in_brisk_motion_nothing_is_claimed_of_the_first_samples():
    """A force that happens to be as large as gravity and points elsewhere."""
    push = wobble(7, 15.0, 6.0, 12.0)
    truth = simulate(10.0, 100.0, wobble(8, 0.5), push)
    samples = samples_from(truth)
    size = np.linalg.norm(samples["f"], axis=1)
    down = truth.attitude.apply(samples["f"])[:, 2] / size
    wrong = np.flatnonzero((np.abs(size - 9.8) < 1.0) & (down > -0.5) & (truth.t < 7.0))
    assert len(wrong) > 10
    for first in wrong[::5]:
        out = solutions_of(samples[first:])
        tilt, _ = errors_deg(out["q_nb"], truth.attitude[first:])
        sure = (tilt > 10.0) & (tilt**2 > 8.0 * tilt_variance_deg2(out)) & (out["status"] & ATTITUDE_VALID != 0)
        assert not np.any(sure[:80])
