"""A receiver that repeats itself under new stamps while the vehicle moves: no fix, until its digits change."""

import math

import numpy as np
import pytest
from accuracy_simulated import figures
from navigation_runner import navigate, settings_of
from navigation_simulation import drive, errors, moved, received, sensed
from scipy.spatial.transform import Rotation
from simulated_errors import twice

from imud.estimators.records import COASTING, REJECTING

RATE, BEGIN_S, END_S = 100, 90.0, 120.0


def frozen(fixes, names):
    t = fixes["t_ns"] * 1e-9 - 100.0
    k = np.flatnonzero((t >= BEGIN_S) & (t < END_S))
    for name in names:
        fixes[name][k] = fixes[name][k[0]]


def errors_in_sigmas(d, out, begin_s, end_s):
    k = slice(int(begin_s * RATE), int(end_s * RATE))
    p = errors(d, out)[0][k, :2]
    return np.hypot(*p.T), np.abs(p / out["sigma_p"][k, :2])


@pytest.mark.parametrize("vehicle", ["free", "auto"])
@pytest.mark.parametrize("speed", [1.2, 15.0])
def test_a_frozen_receiver_is_an_outage_however_slow_the_vehicle_and_however_uncertain_the_estimate(speed, vehicle):
    """30 s without the constraint of a land vehicle make the velocity more uncertain than it is large."""
    d = drive(150.0, speed=speed)
    rng = np.random.default_rng(5)
    samples, fixes = sensed(d, rng, accel_psd=0.02), received(d, rng, late=0.2, sigma=0.5, white=0.05)
    frozen(fixes, ("lat", "lon", "height", "speed", "course"))
    out = navigate(samples, fixes, settings_of(vehicle))[0]
    t = fixes["t_ns"] * 1e-9 - 100.0
    gap = navigate(samples, fixes[(t < BEGIN_S) | (t >= END_S)], settings_of(vehicle))[0]
    away, sigmas = errors_in_sigmas(d, out, BEGIN_S, 150.0)
    assert sigmas.max() < 4.0
    assert away[int(33 * RATE) :].max() < 4.0
    assert away.max() < errors_in_sigmas(d, gap, BEGIN_S, 150.0)[0].max() + 4.0  # what the same outage costs
    assert out["status"][int((END_S - 1.0) * RATE)] & COASTING
    assert not (out["status"][int((END_S + 3.0) * RATE) :] & REJECTING).any()


def test_the_velocity_of_a_frozen_position_is_used_if_it_goes_on():
    d = drive(150.0, speed=15.0)
    rng = np.random.default_rng(6)
    samples, fixes = sensed(d, rng, accel_psd=0.02), received(d, rng, late=0.2, sigma=0.5, white=0.05)
    frozen(fixes, ("lat", "lon", "height"))
    out = navigate(samples, fixes, settings_of("free"))[0]
    away, sigmas = errors_in_sigmas(d, out, BEGIN_S, 150.0)
    assert away.max() < 6.0
    assert sigmas.max() < 4.0


def test_a_position_that_is_held_at_rest_is_used_and_released_when_it_changes():
    """Many receivers hold the position at rest and release it some metres after the start."""
    d = drive(150.0, rest=60.0, speed=8.0)
    rng = np.random.default_rng(7)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.2, sigma=0.5, white=0.05)
    t = fixes["t_ns"] * 1e-9 - 100.0
    held = np.flatnonzero((t > 5.0) & (t < 63.0))
    for name in ("lat", "lon", "height"):
        fixes[name][held] = fixes[name][held[0]]
    out, rows, _ = navigate(samples, fixes)
    assert rows["used"][(rows["kind"] == 0) & (rows["t_ns"] < 159 * 10**9)].all()
    assert errors_in_sigmas(d, out, 90.0, 150.0)[0].max() < 4.0


def stopping(seconds, stop_s, go_s=math.inf):
    """The car of `drive` that brakes, stands from `stop_s` to `go_s`, and drives on."""
    d = drive(seconds)
    under_way = np.where(d.t < go_s, np.clip((stop_s - d.t) / 5.0, 0.0, 1.0), np.clip((d.t - go_s) / 5.0, 0.0, 1.0))
    speed = np.hypot(*d.v[:, :2].T) * under_way
    yaw = np.unwrap(np.arctan2(d.v[:, 1], d.v[:, 0]))
    driven = np.where(under_way > 0.0, np.gradient(yaw), 0.0)
    yaw = yaw[0] + np.cumsum(driven)
    v = np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), 0.0 * yaw])
    return moved(d.t, v, Rotation.from_euler("Z", yaw[:, None]))


@pytest.mark.parametrize("seed", range(4))
def test_an_estimate_that_is_set_to_a_fix_has_not_moved(seed):
    """A car stands when fixes come again, of four digits of a minute and without a velocity: they do not change.

    In the outage the biases of its gyros have changed by up to 3 deg/s, so that the estimate is far off; it shakes, so
    that it is not known to stand. The fixes that the estimate rejected, and then was set to, are not frozen.
    """
    d = stopping(180.0, 95.0)
    rng = np.random.default_rng(seed)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.2, sigma=0.01, white=0.01)
    samples["w"][d.t > 75.0] += np.radians((1.0, 1.0, 3.0))
    samples["f"][d.t > 95.0] += rng.normal(0.0, 1.0, (np.count_nonzero(d.t > 95.0), 3))
    fixes["speed"] = fixes["course"] = np.nan
    last = np.radians(1e-4 / 60.0)
    for name in ("lat", "lon"):
        fixes[name] = np.round(fixes[name] / last) * last
    t = fixes["t_ns"] * 1e-9 - 100.0
    out = navigate(samples, fixes[(t < 75.0) | (t > 98.0)], settings_of("free"))[0]
    assert errors_in_sigmas(d, out, 120.0, 180.0)[0].max() < 10.0  # 4000 m, if it is taken for frozen


@pytest.mark.parametrize("speed", [5.0, 15.0])
def test_a_receiver_whose_last_position_was_an_outlier_is_frozen_all_the_same(speed):
    d = drive(180.0, speed=speed)
    rng = np.random.default_rng(5)
    samples, fixes = sensed(d, rng, accel_psd=0.02), received(d, rng, late=0.2, sigma=0.5, white=0.05)
    frozen(fixes, ("lat", "lon", "height"))
    fixes["speed"] = fixes["course"] = np.nan
    t = fixes["t_ns"] * 1e-9 - 100.0
    fixes["lat"][(t >= BEGIN_S) & (t < END_S)] += 40.0 / 6.37e6
    away, sigmas = errors_in_sigmas(d, navigate(samples, fixes, settings_of("auto"))[0], BEGIN_S, 178.0)
    assert away.max() < 15.0  # 600 m, if it is followed
    assert sigmas.max() < 4.0


@pytest.mark.parametrize("rest_s", [30.0, 120.0])
def test_a_receiver_that_freezes_at_rest_is_frozen_once_the_vehicle_moves_on(rest_s):
    """However long it stood: the time in which nothing has changed counts from the end of the rest."""
    go_s = 95.0 + rest_s
    d = stopping(go_s + 80.0, 95.0, go_s)
    rng = np.random.default_rng(3)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.2, sigma=0.5, white=0.05)
    t = fixes["t_ns"] * 1e-9 - 100.0
    held = np.flatnonzero((t >= 95.2) & (t < go_s + 40.0))
    for name in ("lat", "lon", "height", "speed", "course"):
        fixes[name][held] = fixes[name][held[0]]
    away, sigmas = errors_in_sigmas(d, navigate(samples, fixes, settings_of("auto"))[0], go_s, go_s + 78.0)
    assert away.max() < 10.0  # 200 m, if it is followed
    assert sigmas.max() < 4.0


def test_positions_that_a_receiver_repeats_now_and_then_say_nothing_new():
    """A multicopter with RTK: one fix in three repeats the position before, four times in a row at most.

    As fixes they would show a delay; the time offset ran away with them, and no fix was used from then on.
    """
    row = figures("multicopter", "RTK", 0.0, 1300, error="held")
    assert row["position m"] < 0.1
    assert row["position s"] == row["yaw s"] == row["tilt s"] == 0.0


def test_a_fix_that_comes_twice_is_used_once():
    """Over two lines, say: the estimate is as without the second, until the next sample after each fix."""
    d = drive(150.0, speed=8.0)
    rng = np.random.default_rng(8)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.2)
    once, rows, _ = navigate(samples, fixes)
    again, rows_again, _ = navigate(samples, twice(d, fixes, rng))
    assert np.array_equal(once["v"], again["v"], equal_nan=True)
    assert np.array_equal(once["sigma_rpy"], again["sigma_rpy"])
    assert (rows["kind"] < 5).sum() == (rows_again["kind"] < 5).sum()


def test_a_course_of_few_digits_that_repeats_does_not_keep_velocities_from_being_compared():
    """A robot's with an RTK receiver, in steps of a degree: one in three is the same again."""
    d = drive(150.0, speed=1.2)
    rng = np.random.default_rng(9)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.1, sigma=0.02, white=0.01, speed_sigma=0.01, every=0.2)
    fixes["course"] = np.radians(np.round(np.degrees(fixes["course"])))
    fixes["sigma"] = (0.03, 0.03, 0.05)
    assert navigate(samples, fixes)[2]["velocity_discrepancy"]["count"][0] > 100


def test_a_course_that_a_slow_receiver_holds_is_no_direction():
    """A robot that turns below 1 m/s: its heading is right all the same, found from the positions."""
    for seed in (1700, 1701):
        row = figures("robot", "1 Hz", 0.0, seed, error="held course")
        assert row["yaw s"] < 5.0  # 180 and 115 s, where it is used
        assert row["position s"] == 0.0
