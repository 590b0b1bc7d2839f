"""A sensor that was not connected for some seconds under way: what may have happened meanwhile, axis by axis."""

import numpy as np
import pytest
from navigation_runner import euler_deg
from navigation_simulation import drive, errors, received, sensed
from replay_in_process import new_filter, replay
from scipy.spatial.transform import Rotation
from vehicle_simulation import RATE, vehicle

from imud.configuration.settings import Imu, Initial, Navigation, Settings
from imud.drivers.sample import RECONNECTED
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID, NHC_LATERAL, POSITION_VALID
from imud.sensor_errors.profiles import PROFILES

PROFILE, SETTINGS = PROFILES["m-g350"], Settings(imu=Imu(profile="m-g350"))
AFTER = 25 * RATE  # samples after the gap that count


def steepest_bend(d, gap):
    """The first sample of a gap that begins in the steepest bend."""
    rate = np.abs(np.gradient(np.unwrap(d.attitude.as_euler("ZYX")[:, 0])))
    first, last = 55 * RATE, len(d.t) - gap - AFTER
    return first + int(np.argmax(rate[first:last]))


def interrupted(name, seed, gap_s, turned_deg=0.0):
    """(solutions from the reconnection on, truth there, errors of position, and of the attitude, NED)."""
    d, rng, gap = vehicle(name, seed), np.random.default_rng(seed), round(gap_s * RATE)
    off = steepest_bend(d, gap)
    on = off + gap
    turn = Rotation.from_euler("z", turned_deg, degrees=True)
    samples = sensed(d, rng, PROFILE.gyro_noise, PROFILE.accel_noise, (0.005, -0.004, 0.003), (0.05, -0.04, 0.03))
    samples["w"][on:], samples["f"][on:] = turn.inv().apply(samples["w"][on:]), turn.inv().apply(samples["f"][on:])
    samples["flags"][on] |= RECONNECTED
    kept = np.r_[0:off, on : len(d.t)]
    yaw = float(np.degrees(d.attitude[0].as_euler("ZYX")[0]))
    filter_ = new_filter("navigation", samples[kept], SETTINGS, Initial(yaw_deg=yaw))
    fixes = received(d, rng, every=0.5, late=0.2, sigma=1.8, speed_sigma=0.1)
    whole = np.zeros(len(d.t), replay(new_filter("tilt", samples[:9], SETTINGS), samples[:9])[0].dtype)
    whole["q_nb"][:, 0] = 1.0
    whole[kept] = replay(filter_, samples[kept], fixes)[0]
    after = slice(on, on + AFTER)
    q = d.attitude[after] * turn
    yaw_error = (euler_deg(whole["q_nb"][after])[:, 2] - np.degrees(q.as_euler("ZYX")[:, 0]) + 180.0) % 360.0 - 180.0
    position, _, attitude = errors(d, whole)
    return whole[after], position[after], np.degrees(attitude[after]), yaw_error


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gap_s", [2.0, 5.0, 10.0])
def test_a_car_in_a_bend_keeps_its_tilt_and_has_its_heading_back_with_the_next_fixes(gap_s, seed):
    out, position, attitude, yaw = interrupted("city", seed, gap_s)
    tilt, sigma = np.hypot(*attitude[:, :2].T), np.degrees(np.hypot(*out["sigma_rpy"][:, :2].T))
    assert (tilt < 4.0 * sigma).all()
    assert (out["status"] & ATTITUDE_VALID).all()
    valid = (out["status"] & HEADING_VALID) != 0
    assert valid[3 * RATE :].all()
    assert not (valid & (np.abs(yaw) > 4.0 * np.degrees(out["sigma_rpy"][:, 2])) & (np.abs(yaw) > 5.0)).any()
    assert not (np.abs(position[:, :2]) > np.maximum(4.0 * out["sigma_p"][:, :2], 5.0))[RATE:].any()


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["boat", "walk", "drone"])
def test_a_position_after_a_gap_is_as_good_as_it_says(name):
    """It was wrong by hundreds of metres: the tilt's error is one of the velocity, and a body leans to and fro."""
    for seed in range(3):
        out, position, _, _ = interrupted(name, seed, 10.0)
        assert (out["status"][2 * RATE :] & POSITION_VALID).all()
        assert not (np.abs(position[:, :2]) > np.maximum(4.0 * out["sigma_p"][:, :2], 5.0))[RATE:].any()


def test_a_sensor_turned_about_the_vertical_is_seldom_wrong_and_sure():
    wrong = 0.0
    for name in ("city", "motorway"):
        for seed in range(3):
            out, _, _, yaw = interrupted(name, seed, 5.0, 45.0)
            valid = (out["status"] & HEADING_VALID) != 0
            wrong += (valid & (np.abs(yaw) > np.maximum(4.0 * np.degrees(out["sigma_rpy"][:, 2]), 5.0))).sum() / RATE
    assert wrong < 15.0  # of 150 s


@pytest.mark.parametrize(("speed", "waits"), [(1.5, False), (12.0, True)])
def test_the_constraint_waits_for_a_course_only_where_that_would_give_the_heading(speed, waits):
    """At a walk it waited, too: for up to two seconds nothing held the velocity, and no course was used."""
    d, rng, off, on = drive(60.0, speed=speed, swing=0.0), np.random.default_rng(2), 5000, 5300
    samples, fixes = sensed(d, rng), received(d, rng, late=0.1, sigma=1.2)
    samples["flags"][on] |= RECONNECTED
    settings = Settings(navigation=Navigation(vehicle="land"))
    fixes = fixes[fixes["arrival_ns"] < samples["t_ns"][off]]
    _, rows = replay(new_filter("navigation", samples, settings), np.delete(samples, slice(off, on)), fixes)
    after = rows["t_ns"][rows["kind"] == NHC_LATERAL]
    first_s = 1e-9 * (after[after > samples["t_ns"][on]][0] - samples["t_ns"][on])
    assert (first_s > 1.9) == waits and (first_s < 0.2) != waits


@pytest.mark.parametrize(("begin_s", "seed"), [(8.5, 1), (9.5, 1), (7.5, 2), (8.5, 2)])
def test_fixes_that_come_in_a_gap_before_the_heading_is_known_are_no_tilt(begin_s, seed):
    """Fused at the last sample before the gap they were: the car accelerates, and its heading was wrong by 14 deg."""
    d, rng = drive(40.0, rest=5.0), np.random.default_rng(seed)
    samples = sensed(d, rng, PROFILE.gyro_noise, PROFILE.accel_noise, (0.005, -0.004, 0.006), (0.05, -0.04, 0.03))
    fixes = received(d, rng, every=0.2, late=0.16, sigma=1.0, speed_sigma=0.1)
    kept = (d.t < begin_s) | (d.t >= begin_s + 1.3)
    out, _ = replay(new_filter("navigation", samples[kept], SETTINGS), samples[kept], fixes)
    heading = np.degrees(d.attitude[kept].as_euler("ZYX")[:, 0])
    yaw = (euler_deg(out["q_nb"])[:, 2] - heading + 180.0) % 360.0 - 180.0
    known = (out["status"] & HEADING_VALID) != 0
    assert known[round(20.0 * RATE) :].all()
    assert (np.abs(yaw) < 2.5 * np.degrees(out["sigma_rpy"][:, 2]))[known].all()


@pytest.mark.parametrize("block_s", [0.2, 0.6, 1.0])
def test_a_sensor_whose_samples_come_in_blocks_gets_its_heading(block_s):
    """A fix then is newer than the newest sample, by up to a block less its own delay."""
    d, rng = drive(60.0, rest=5.0), np.random.default_rng(1)
    samples = sensed(d, rng, PROFILE.gyro_noise, PROFILE.accel_noise)
    fixes = received(d, rng, every=0.2, late=0.1, sigma=1.0, speed_sigma=0.1)
    block_ns = round(1e9 * block_s)
    fixes["arrival_ns"] = fixes["arrival_ns"] // block_ns * block_ns  # what has come until then
    out, _ = replay(new_filter("navigation", samples, SETTINGS), samples, fixes)
    known = (out["status"] & HEADING_VALID) != 0
    assert known[round(30.0 * RATE) :].all()
    yaw = (euler_deg(out["q_nb"])[:, 2] - np.degrees(d.attitude.as_euler("ZYX")[:, 0]) + 180.0) % 360.0 - 180.0
    assert np.abs(yaw[known]).max() < 8.0
