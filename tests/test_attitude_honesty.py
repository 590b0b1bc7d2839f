"""What the attitude filter claims to know: its sigmas, and what it finds out about the sensor by itself."""

import attitude_monte_carlo as monte_carlo
import numpy as np
import pytest
from attitude_runs import PROFILE_NAMES, Fields, rpy_deg, samples_from, tilt_variance_deg2, yaw_sigma_deg
from attitude_simulation import DEG, MG, Flaws, after, car_that_stops, errors_deg, measure, simulate, wobble
from broad import filter_of, samples_of, solutions_of
from replay_in_process import replay

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.estimators.ahrs.setup import configure, start
from imud.estimators.ahrs.state import ATTITUDE, STATES
from imud.estimators.ahrs.variance_factor import expect_correction, update_variance_factor
from imud.estimators.records import AT_REST, ATTITUDE_VALID
from imud.math.kalman import packed_index
from imud.sensor_errors.profiles import PROFILES


@pytest.mark.thorough
@pytest.mark.parametrize("profile", PROFILE_NAMES)
@pytest.mark.parametrize(
    ("turning", "accelerating", "still_s"), [(0.0, 0.0, 0.0), (1.0, 1.0, 5.0), (0.3, 1.0, 0.0), (1.0, 3.0, 0.0)]
)
def test_errors_agree_with_their_sigmas(profile, turning, accelerating, still_s):
    """Monte Carlo with the profile's own errors: squared error over variance, per component.

    In motion the first sample is not the moment before a simulation sets off.
    """
    first = 0 if still_s or turning == 0.0 else 50
    p, nees = PROFILES[profile], []
    for run in range(100):
        rng = np.random.default_rng(1000 + run)
        truth = simulate(
            30.0,
            50.0,
            after(still_s, wobble(run, turning)),
            after(still_s, wobble(99 + run, accelerating, 1.0, 4.0)),
            tuple(rng.uniform((-180.0, -50.0, 0.0), (180.0, 50.0, 0.0))),
        )
        flaws = Flaws(
            p.gyro_noise,
            p.accel_noise,
            tuple(rng.normal(0.0, p.gyro_bias_initial, 3)),
            tuple(rng.normal(0.0, p.accel_bias_initial, 3)),
            rng.normal(0.0, p.gyro_scale, (3, 3)),
            tuple(rng.normal(0.0, p.accel_scale, 3)),
        )
        out = solutions_of(samples_of(truth.t, *measure(truth, flaws, rng))[first:], profile)[50::50]
        attitude = truth.attitude[first:][50::50]
        tilt, _ = errors_deg(out["q_nb"], attitude)
        yaw = (rpy_deg(out)[:, 2] - attitude.as_euler("ZYX", degrees=True)[:, 0] + 180.0) % 360.0 - 180.0
        level = np.abs(np.sin(rpy_deg(out)[:, 1] * DEG)) < 0.8
        nees.append(
            (
                np.mean(tilt**2 / tilt_variance_deg2(out)),
                np.mean((yaw / np.maximum(yaw_sigma_deg(out), 0.05))[level] ** 2),
                np.mean(((out["bg"] - flaws.gyro_bias) / out["sigma_bg"]) ** 2),
                np.mean(((out["ba"] - flaws.accel_bias) / out["sigma_ba"]) ** 2),
            )
        )
    tilt_nees, yaw_nees, bias_nees, accel_nees = np.mean(nees, axis=0)
    assert 0.5 < tilt_nees < 1.8
    if first == 0:  # else the tilt of the start, from which yaw counts, is not known
        assert yaw_nees < 1.8 and (yaw_nees > 0.4 or turning == 0.0)
    assert 0.5 < accel_nees < 1.5
    assert bias_nees < 1.6 and (bias_nees > 0.4 or still_s > 0.0 or turning == 0.0)


@pytest.mark.parametrize(("down_mg", "assumed_mg"), [(5.0, 8.0), (-15.0, 8.0), (45.0, 38.0), (-70.0, 54.0)])
def test_an_unnamed_sensor_is_taken_as_calibrated_unless_its_weight_at_rest_is_false(down_mg, assumed_mg):
    truth = simulate(20.0, 100.0)
    out = solutions_of(samples_from(truth, Flaws(accel_bias=(0.0, 0.0, down_mg * MG), gyro_bias=(1.0 * DEG,) * 3)))
    np.testing.assert_allclose(out["sigma_ba"][-1, :2] / MG, assumed_mg, rtol=0.1)  # level, only the weight is seen
    tilt_sigma = np.sqrt(0.5 * tilt_variance_deg2(out)[-1])
    np.testing.assert_allclose(tilt_sigma, np.degrees(1e-3 * assumed_mg), rtol=0.2)
    assert np.max(np.abs(out["bg"][-1] - 1.0 * DEG)) < 0.02 * DEG


def test_no_motion_makes_an_uncertain_heading_certain():
    truth = simulate(90.0, 100.0, after(5.0, wobble(2, 0.6)), after(5.0, wobble(8, 2.0, 1.0, 4.0)))
    out = solutions_of(samples_from(truth), "m-g350", Initial(yaw_deg=0.0))
    level = np.abs(np.sin(rpy_deg(out)[:, 1] * DEG)) < 0.3
    assert level[6000:].sum() > 100
    assert np.min(yaw_sigma_deg(out)[level]) > 0.95  # it was given with 1 deg


def test_the_sigma_of_the_tilt_follows_how_small_its_corrections_are():
    """Of a sensor that is shaken in a hand, without errors that last; 0.50 to 0.76 by the covariance alone."""
    for seed in range(3):
        rates, acceleration = after(5.0, wobble(seed, 2.0, 2.0, 12.0)), after(5.0, wobble(seed + 50, 6.0, 5.0, 20.0))
        truth = simulate(100.0, 100.0, rates, acceleration, (10.0, 5.0, 0.0))
        out = solutions_of(samples_from(truth, seed=seed), "m-g350")
        tilt, _ = errors_deg(out["q_nb"], truth.attitude)
        variance = tilt_variance_deg2(out)
        assert np.median(variance[9000:]) < 0.4 * np.median(variance[1500:2500]), seed
        assert np.mean(tilt[1500:] ** 2 / variance[1500:]) < 1.0, seed


def test_a_large_sum_of_corrections_counts_at_once_and_a_larger_variance_until_it_is_compared():
    parameters = configure(Settings(), 100.0)
    p, s = Fields(parameters[0]), Fields(start(parameters, Initial())[0])
    s.stationarity.gravity_checked, s.attitude_step.hand_held_s = 1, 20.0
    s.integrals.time, s.integrals.c[:] = 0.05, 0.05 * np.eye(3).ravel()
    s.cov.P[:] = 0.0
    tilts = [interpreted(packed_index)(STATES, i, i) for i in (ATTITUDE, ATTITUDE + 1)]
    s.cov.P[tilts], s.scratch.ph[ATTITUDE : ATTITUDE + 2] = 1e-4, 1e-3
    for _ in range(1200):
        interpreted(expect_correction)(s, 1.0)
        interpreted(update_variance_factor)(p, s)
    least = s.variance_factor.tilt_scale[0]
    assert least < 0.6
    s.cov.P[tilts] = 1e-2
    interpreted(update_variance_factor)(p, s)
    assert s.variance_factor.tilt_scale[0] > 1.5 * least
    s.cov.P[tilts], s.scratch.x[ATTITUDE] = 1e-4, 0.03
    interpreted(update_variance_factor)(p, s)
    assert s.variance_factor.tilt_scale[0] == 1.0
    s.attitude_step.hand_held_s, s.scratch.x[ATTITUDE] = 0.0, 0.0
    interpreted(update_variance_factor)(p, s)
    assert s.variance_factor.squares == 0.0 and s.variance_factor.tilt_scale[1] == 1.0


FAR_FROM_ZERO, ABOUT_ZERO = (0.3, -0.2, -0.4), (0.08, -0.05, -0.4)  # deg/s


@pytest.mark.parametrize(
    ("cast", "bias_degps", "removed_degps"),
    [
        (np.trunc, FAR_FROM_ZERO, 0.0),
        (np.trunc, ABOUT_ZERO, 0.47),
        (np.round, FAR_FROM_ZERO, 0.0),
        (np.round, ABOUT_ZERO, 0.47),
        (np.floor, ABOUT_ZERO, 0.47),
        (None, ABOUT_ZERO, 0.0),
    ],
)
def test_rates_truncated_toward_zero_are_recognised_and_compensated(cast, bias_degps, removed_degps):
    """By crossings of zero, or by the noise of a rest near it, also if a bias was removed after the cast."""
    count = 2000.0 * DEG / 2**15
    truth = simulate(120.0, 200.0, after(8.0, wobble(6, 0.5, 0.3, 1.5)), after(8.0, wobble(6, 0.5, 1.0, 3.0)))
    samples = samples_from(truth, Flaws(gyro_bias=tuple(np.array(bias_degps) * DEG)))
    if cast is not None:
        samples["w"] = cast(samples["w"] / count) * count
    samples["w"] -= removed_degps * DEG
    out, _ = replay(filter_ := filter_of(samples, "m-g350"), samples)
    truncated = filter_.state["quantization"]["max_error"][0]
    np.testing.assert_allclose(truncated, 0.5 * count * (cast is np.trunc), atol=0.1 * count)
    expected = (np.array(bias_degps) - removed_degps) * DEG - 0.5 * count * (cast is np.floor)
    np.testing.assert_allclose(out["bg"][-1], expected, atol=0.3 * count)
    _, yaw = errors_deg(out["q_nb"], truth.attitude)
    drift_deg_per_min = np.polyfit(truth.t[12000:], yaw[12000:], 1)[0] * 60.0
    assert abs(drift_deg_per_min) < 0.9  # 1.8 if truncated and not compensated


# shocks


def test_shocks_and_vibration_cost_certainty_and_smooth_motion_does_not():
    """By 0.01 rad for each m/s that came and went between two samples, in all axes.

    This shock lasts for two samples; the sensor monitor gives the first back with the second. One alone is damage.
    """
    truth = simulate(20.0, 200.0, acceleration=after(5.0, wobble(1, 1.0, 1.0, 3.0)))
    sigmas = []
    for shock in (0.0, 15.0):
        samples = samples_from(truth)
        samples["f"][3000:3002, 2] += shock
        sigmas.append(yaw_sigma_deg(solutions_of(samples, "m-g350")))
    unannounced = np.array([1.0, -2.0, 1.0]) * 30.0 / 200.0  # m/s, second differences of one shock
    expected = np.degrees(0.01) * np.sqrt((unannounced**2).sum())
    np.testing.assert_allclose(np.sqrt(sigmas[1][3030] ** 2 - sigmas[0][3030] ** 2), expected, rtol=0.1)
    samples = samples_from(truth)
    samples["f"][2000::2, 0] += 5.0
    samples["f"][2001::2, 0] -= 5.0
    shaken = yaw_sigma_deg(solutions_of(samples, "m-g350"))
    expected = np.degrees(0.01) * 20.0 / 200.0 * np.sqrt(2000)
    np.testing.assert_allclose(np.sqrt(shaken[-1] ** 2 - sigmas[0][-1] ** 2), expected, rtol=0.1)


@pytest.mark.parametrize("road", [0.0, 0.3])  # m/s^2
@pytest.mark.parametrize("seed", range(2))
def test_cruising_is_no_rest_and_the_stop_of_a_vehicle_that_its_road_shook_is(seed, road):
    """An engine idles all the time at 26 Hz; where nothing else shakes, a stop may be taken for cruising."""
    p = PROFILES["consumer-mems"]
    rng = np.random.default_rng(seed)
    truth, phase = car_that_stops(180.0)
    flaws = Flaws(p.gyro_noise, p.accel_noise, accel_bias=tuple(rng.normal(0.0, p.accel_bias_initial, 3)))
    w, f = measure(truth, flaws, rng)
    f[:, 2] += 0.1 * np.sin(2.0 * np.pi * 26.0 * truth.t)
    f += road * rng.normal(size=f.shape) * ((phase > 0.0) & (phase < 31.0))[:, None]
    out = solutions_of(samples_of(truth.t, w, f), "consumer-mems")
    tilt, _ = errors_deg(out["q_nb"], truth.attitude)
    assert np.mean(tilt**2 / tilt_variance_deg2(out)) < 2.0
    rests = out["status"] & AT_REST > 0
    assert np.mean(rests[(phase > 8.0) & (phase < 26.0)]) < 0.1
    if road > 0.0:
        assert np.mean(rests[(phase > 33.0) & (truth.t > 60.0)]) > 0.9


def test_a_tilt_that_a_steady_turn_hides_is_stated():
    """On a roundabout from the first sample on: the centripetal force looks like a tilt and a gyro bias."""
    wrong_s = 0.0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        rate, speed = rng.uniform(0.5, 1.2), rng.uniform(1.5, 3.5)

        def centripetal(t, rate=rate, speed=speed):
            return speed * rate * np.column_stack([-np.sin(rate * t), np.cos(rate * t), 0.0 * t])

        def rates(t, seed=seed, rate=rate):
            return wobble(seed, 0.1)(t) + np.array([0.0, 0.0, rate])

        truth = simulate(80.0, 100.0, rates, centripetal)
        flaws = Flaws(0.01 * DEG, 2e-3, tuple(rng.normal(0.0, 1.5 * DEG, 3)), tuple(rng.normal(0.0, 4.0 * MG, 3)))
        out = solutions_of(samples_from(truth, flaws, seed))
        tilt, _ = errors_deg(out["q_nb"], truth.attitude)
        sure = (out["status"] & ATTITUDE_VALID != 0) & (tilt > 2.0) & (tilt**2 > 8.0 * tilt_variance_deg2(out))
        wrong_s += 0.01 * np.count_nonzero(sure[500:])
    assert wrong_s < 2.0


def test_flights_that_begin_before_the_first_sample_are_seldom_wrong_and_sure():
    """Without the hypotheses of faster bodies than hands: NEES 2.6, and 3.5 % of the time wrong and sure."""
    runs = np.array([monte_carlo.run((monte_carlo.flight, "auto", number, False, ())) for number in range(0, 12, 2)])
    _, nees, _, wrong_percent = runs.mean(axis=0)
    assert 0.2 < nees < 1.6
    assert wrong_percent < 0.5


@pytest.mark.parametrize("seed", [0, 3, 5])
def test_a_gyro_bias_that_changes_in_a_hand_is_learned_anew(seed):
    truth = simulate(120.0, 100.0, after(5.0, wobble(seed, 0.8)), after(5.0, wobble(seed + 50, 1.0, 3.0, 9.0)))
    bias, step = np.array([0.2, -0.1, 0.1]) * DEG, np.array([0.3, -0.2, 0.4]) * DEG
    samples = samples_from(truth, Flaws(gyro_bias=tuple(bias)), seed)
    samples["w"][4000:] += step
    last = solutions_of(samples)[-1]
    assert np.all(np.abs(last["bg"] - bias - step) < 2.5 * last["sigma_bg"])
