"""A sensor in a hand slips in its mount: the attitude filter notices soon, and mistakes no walk and no drive for it."""

import numpy as np
import pytest
from attitude_runs import Fields, samples_from, tilt_variance_deg2
from attitude_simulation import DEG, MG, Flaws, errors_deg, simulate, steady, wobble
from broad import solutions_of
from scipy.spatial.transform import Rotation

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Settings
from imud.drivers.sample import LIMITED_AXES
from imud.estimators.ahrs.attitude_step import window_angle
from imud.estimators.ahrs.clipping import compensate_clipping
from imud.estimators.ahrs.setup import configure, start
from imud.estimators.ahrs.state import ATTITUDE, STATES
from imud.estimators.records import ATTITUDE_VALID
from imud.math.kalman import packed_index

SLIP_S = 30.0
FLAWS = Flaws(gyro_bias=(0.2 * DEG, -0.1 * DEG, 0.15 * DEG))


def begun(course, start=5.0):
    """The course from `start` on, growing for 2 s, so that the body gains no velocity by its beginning."""
    return lambda t: course(t) * np.clip((t - start) / 2.0, 0.0, 1.0)[:, None]


def in_a_hand(seed, moving):
    """Turned and moved with `moving` m/s^2."""
    return simulate(50.0, 100.0, begun(wobble(seed, 0.8)), begun(wobble(seed + 50, moving, 2.0 + moving, 8.0 + moving)))


def after_slip(truth, samples, slip):
    """(solutions, error of the tilt in deg) of a sensor that turns in its mount by `slip` at SLIP_S."""
    late = truth.t >= SLIP_S
    for name in ("w", "f"):
        samples[name][late] = slip.apply(samples[name][late])
    attitude = Rotation.concatenate([truth.attitude[~late], truth.attitude[late] * slip.inv()])
    out = solutions_of(samples)
    return out, errors_deg(out["q_nb"], attitude)[0]


@pytest.mark.parametrize("moving", [0.3, 1.5, 4.0])
@pytest.mark.parametrize("angle_deg", [10.0, 40.0])
def test_the_tilt_is_right_again_six_seconds_after_a_slip(angle_deg, moving):
    for seed in range(3):
        truth = in_a_hand(seed, moving)
        samples = samples_from(truth, FLAWS)
        slip = Rotation.from_rotvec(angle_deg * DEG * np.array([0.6, -0.8, 0.0]))
        out, tilt = after_slip(truth, samples, slip)
        sigma = np.sqrt(tilt_variance_deg2(out))
        assert tilt[truth.t > SLIP_S + 6.0].max() < 4.0, seed
        believed = (out["status"] & ATTITUDE_VALID > 0) & (tilt > 5.0) & (tilt > 4.0 * sigma)
        assert believed[truth.t >= SLIP_S].sum() < 1.3 * 100.0, seed


def test_in_a_quiet_hand_the_tilt_is_less_sure_within_half_a_second_of_a_slip():
    """When the mean of the gain is what shows it, after .9 s."""
    slip = Rotation.from_rotvec(10.0 * DEG * np.array([0.6, -0.8, 0.0]))
    for seed in range(3):
        truth = in_a_hand(seed, 0.3)
        samples = samples_from(truth, FLAWS)
        late = truth.t >= SLIP_S
        for name in ("w", "f"):
            samples[name][late] = slip.apply(samples[name][late])
        tilt, _ = errors_deg(
            solutions_of(samples)["q_nb"],
            Rotation.concatenate([truth.attitude[~late], truth.attitude[late] * slip.inv()]),
        )
        out = solutions_of(samples)
        sure = (tilt > 5.0) & (tilt > 4.0 * np.sqrt(0.5 * tilt_variance_deg2(out)))
        assert sure.sum() < 0.6 * 100.0, seed


def test_a_brisk_hand_does_not_hide_a_slip():
    """It gains more velocity in every half second than the slip does in two seconds, and gives it back."""
    slip = Rotation.from_rotvec(10.0 * DEG * np.array([0.6, -0.8, 0.0]))
    for seed in range(3):
        truth = simulate(45.0, 100.0, begun(wobble(seed, 0.8)), begun(wobble(seed + 50, 15.0, 6.0, 8.0)))
        samples = samples_from(truth, FLAWS)
        late = truth.t >= SLIP_S
        for name in ("w", "f"):
            samples[name][late] = slip.apply(samples[name][late])
        attitude = Rotation.concatenate([truth.attitude[~late], truth.attitude[late] * slip.inv()])
        tilt, _ = errors_deg(solutions_of(samples)["q_nb"], attitude)
        assert tilt[truth.t > SLIP_S + 8.0].max() < 5.0, seed


@pytest.mark.parametrize("angle_deg", [10.0, 30.0])
def test_a_slip_at_rest_is_found_in_seconds(angle_deg):
    """The force is as large as before, so it is no acceleration: one is believed for 30 s."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        truth = simulate(45.0, 100.0, rpy_deg=tuple(rng.uniform(-60.0, 60.0, 3)))
        flaws = Flaws(gyro_bias=FLAWS.gyro_bias, accel_bias=tuple(rng.normal(0.0, 4.0 * MG, 3)))
        samples = samples_from(truth, flaws, seed)
        across = np.cross(samples["f"][0], rng.normal(size=3))
        slip = Rotation.from_rotvec(angle_deg * DEG * across / np.linalg.norm(across))
        out, tilt = after_slip(truth, samples, slip)
        sure = (out["status"] & ATTITUDE_VALID > 0) & (tilt > 5.0) & (tilt**2 > 8.0 * tilt_variance_deg2(out))
        assert np.count_nonzero(sure) < 6.0 * 100.0, seed
        assert tilt[truth.t > SLIP_S + 10.0].max() < 2.0, seed


def sure_and_wrong_s(out, tilt, rate_hz=100.0):
    """Seconds with more than 5 deg and 4 sigma, with ATTITUDE_VALID."""
    sure = (out["status"] & ATTITUDE_VALID > 0) & (tilt > 5.0) & (tilt**2 > 8.0 * tilt_variance_deg2(out))
    return np.count_nonzero(sure) / rate_hz


@pytest.mark.parametrize("rest_s", [0.0, 26.0])
def test_a_slip_is_one_before_any_rest_and_soon_after_one(rest_s):
    """Who turns by 1 rad/s and more is no vehicle, long before there have been ten seconds of it."""
    slip = Rotation.from_rotvec(10.0 * DEG * np.array([0.6, -0.8, 0.0]))
    for seed in range(3):
        truth = simulate(
            45.0,
            100.0,
            begun(wobble(seed, 1.5), rest_s),
            begun(wobble(seed + 50, 1.0, 3.0, 9.0), rest_s),
        )
        out, tilt = after_slip(truth, samples_from(truth, FLAWS), slip)
        assert sure_and_wrong_s(out[truth.t > SLIP_S], tilt[truth.t > SLIP_S]) < 1.3, seed
        assert tilt[truth.t > SLIP_S + 8.0].max() < 4.0, seed


def test_a_hand_in_a_bus_that_sets_off_is_less_sure():
    """It looks like a slip: roll and pitch become wrong by that acceleration, but the sigmas say so for most of it."""
    wrong_s = 0.0
    for seed in range(4):
        hand, off = wobble(seed + 50, 1.0, 3.0, 9.0), steady((1.7, 0.0, 0.0), 30.0, 38.0)
        course = lambda t, hand=hand, off=off: begun(hand)(t) + off(t)  # noqa: E731
        truth = simulate(48.0, 100.0, begun(wobble(seed, 0.8)), course)
        out = solutions_of(samples_from(truth, FLAWS))
        tilt, _ = errors_deg(out["q_nb"], truth.attitude)
        wrong_s += sure_and_wrong_s(out[200:], tilt[200:])
        assert tilt[4600:].max() < 1.5, seed
    assert wrong_s < 6.0


def test_an_even_acceleration_after_a_rest_is_no_slip():
    """Of 1.7 m/s^2 for 12 s, without vibration: tilt by the force would be off by 10 deg."""
    for seed in range(3):
        truth = simulate(50.0, 100.0, acceleration=steady((1.7, 0.0, 0.0), 30.0, 42.0), rpy_deg=(10.0, -5.0, 40.0))
        accel_bias = tuple(np.random.default_rng(seed).normal(0.0, 4.0 * MG, 3))
        tilt, _ = errors_deg(
            solutions_of(samples_from(truth, Flaws(accel_bias=accel_bias), seed))["q_nb"], truth.attitude
        )
        assert tilt[200:].max() < 1.5, seed


def carried_off(speed, seed):
    """Turned in a hand, then carried off at `speed` m/s by a walk that shakes it."""
    angle = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi)
    ahead = np.array([np.cos(angle), np.sin(angle), 0.0])
    hand, steps = begun(wobble(seed + 50, 1.5, 3.0, 9.0)), np.array([0.8, 0.8, 2.5])

    def acceleration(t):
        walking = (t > 30.0) & (t < 51.0)
        off = speed * (((t > 30.0) & (t < 31.0)) * 1.0 - ((t > 50.0) & (t < 51.0)))
        walk = off[:, None] * ahead + steps * (np.sin(12.0 * t) * walking)[:, None]
        return hand(t) * (t < 28.0)[:, None] + walk

    return simulate(65.0, 100.0, begun(wobble(seed, 0.8)), acceleration)


@pytest.mark.parametrize("speed", [1.5, 3.0])
def test_a_walk_is_no_slip(speed):
    for seed in range(3):
        truth = carried_off(speed, seed)
        out = solutions_of(samples_from(truth, FLAWS))
        tilt, _ = errors_deg(out["q_nb"], truth.attitude)
        assert (tilt[200:] ** 2 / tilt_variance_deg2(out)[200:]).mean() < 3.0, seed
        assert tilt[200:].max() < 4.0, seed


def test_a_vehicle_in_which_a_sensor_is_laid_down_may_gain_any_velocity():
    """Handled for 20 s, laid down for 15, then 2.5 m/s^2 for 8 s on a road that shakes it."""
    ahead = np.array([2.5, 0.0, 0.0])
    hand, turns = begun(wobble(7, 1.5, 3.0, 9.0)), begun(wobble(8, 0.8))
    until = 25.0
    truth = simulate(
        80.0,
        100.0,
        lambda t: turns(t) * np.clip((until - t) / 2.0, 0.0, 1.0)[:, None],
        lambda t: (
            hand(t) * np.clip((until - t) / 2.0, 0.0, 1.0)[:, None]
            + ahead * (((t > 40.0) & (t < 48.0)) * 1.0 - ((t > 65.0) & (t < 73.0)))[:, None]
        ),
    )
    samples = samples_from(truth, FLAWS)
    samples["f"] += 0.3 * np.random.default_rng(1).normal(size=(len(truth.t), 3)) * (truth.t > 40.0)[:, None]
    out = solutions_of(samples)
    tilt, _ = errors_deg(out["q_nb"], truth.attitude)
    assert tilt[200:].max() < 3.0
    assert (out["status"][200:] & ATTITUDE_VALID).all()


def test_what_a_clipped_gyro_may_hide_is_no_evidence_of_a_slip():
    """The variance that clipping adds to the attitude, is added to that of the mean force's angle."""
    parameters = configure(Settings(), 100.0)
    p, s = Fields(parameters[0]), Fields(start(parameters, Initial())[0])
    s.attitude_step.window_s, s.attitude_step.usual_gain2 = 3.0, 100.0
    s.attitude_step.window_delta_v[:] = s.attitude_step.window_mean_v[:] = 6.0, 0.0, -29.0
    s.attitude_step.mean_force[:] = 2.0, 0.0, -9.6
    use_mean, angle, variance = interpreted(window_angle)(p, s)
    assert (use_mean, angle) == (True, pytest.approx(np.arctan2(6.0, 29.0)))
    i = interpreted(packed_index)(STATES, ATTITUDE, ATTITUDE)
    s.nav.q_nb[:], before = (1.0, 0.0, 0.0, 0.0), s.cov.P[i]
    for w in (3.0, 9.0, 9.0, 9.0):
        s.imu.w[:] = interpreted(compensate_clipping)(p, s, (w, 0.0, 0.0), 0.01, LIMITED_AXES if w > 5.0 else 0)
    added = s.cov.P[i] - before
    assert added > 0.0
    assert interpreted(window_angle)(p, s) == (True, angle, pytest.approx(variance + added))


@pytest.mark.parametrize("angle_deg", [6.0, 8.0, 12.0])
def test_a_slip_at_rest_is_stated_before_it_is_decided(angle_deg):
    """What is no gravity in the known attitude may be an acceleration; or the sensor has been turned."""
    truth = simulate(50.0, 100.0, begun(wobble(1, 0.5), 45.0), rpy_deg=(5.0, 3.0, 0.0))
    slip = Rotation.from_rotvec(angle_deg * DEG * np.array([0.6, 0.8, 0.0]))
    out, tilt = after_slip(truth, samples_from(truth, FLAWS), slip)
    late = (truth.t > SLIP_S + 1.5) & (truth.t < 45.0)
    wrong = (tilt > 5.0) & (tilt**2 > 8.0 * tilt_variance_deg2(out)) & (out["status"] & ATTITUDE_VALID != 0)
    assert not np.any(wrong[late])
