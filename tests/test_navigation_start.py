"""The navigation filter finds its heading by itself: from rest, in any mounting, under way, or as the user says."""

import dataclasses

import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import drive, errors, ideal_sensor, received, sensed
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Initial, Navigation, Settings
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID, HEIGHT_VALID, POSITION_VALID

RATE = 100


def at(seconds):
    return int(seconds * RATE)


@pytest.mark.parametrize("yaw_deg, pitch_deg, roll_deg", [(0, 0, 0), (90, 10, -20), (-135, 0, 0), (30, 0, 180)])
def test_heading_is_found_whatever_the_mounting(yaw_deg, pitch_deg, roll_deg):
    rng = np.random.default_rng(3)
    mount = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).inv()
    d = drive(120.0)
    samples = sensed(d, rng, bg=(0.01, -0.02, 0.005), ba=(0.1, -0.2, 0.05), mount=mount)
    out, _, state = navigate(samples, received(d, rng, late=0.25))
    p, v, a = errors(d, out, mount)
    heading = (out["status"] & HEADING_VALID) > 0
    assert not heading[: at(10.0)].any()  # still at rest: nobody can know
    assert heading[at(30.0) :].all()
    assert np.abs(a[at(60.0) :, 2]).max() < np.radians(1.5)
    assert np.abs(a[at(60.0) :, :2]).max() < np.radians(0.5)
    assert np.abs(v[at(60.0) :]).max() < 0.4
    assert np.hypot(*p[at(60.0) :, :2].T).max() < 5.0
    forward = state["core"][0, 0]["nav"]["forward"] * np.sign(
        state["core"][0, 0]["nav"]["forward"] @ mount.apply([1, 0, 0])
    )
    assert forward == pytest.approx(mount.apply([1.0, 0.0, 0.0]), abs=0.02)


def test_before_the_heading_is_known_position_follows_the_receiver_and_roll_and_pitch_are_valid():
    rng = np.random.default_rng(4)
    d = drive(14.0, rest=20.0)
    out, _, _ = navigate(sensed(d, rng), received(d, rng))
    p, _, a = errors(d, out)
    assert (out["status"][at(3.0) :] & ATTITUDE_VALID).all()
    assert not (out["status"] & HEADING_VALID).any()
    assert (out["status"][at(1.1) :] & POSITION_VALID).all()
    assert not (out["status"][: at(0.9)] & POSITION_VALID).any()
    assert np.isnan(out["lat"][: at(0.9)]).all()
    assert np.abs(a[at(5.0) :, :2]).max() < np.radians(1.0)
    assert (np.abs(p[at(2.0) :]) < 4.0 * out["sigma_p"][at(2.0) :]).all()


def test_at_rest_tilt_and_level_bias_are_not_told_apart_whatever_the_vertical_bias():
    rng = np.random.default_rng(2)
    d = drive(30.0, rest=30.0)
    biases = {"bg": (-0.0045, -0.0184, 0.0016), "ba": (0.04, -0.21, -0.45)}
    out, _, _ = navigate(sensed(d, rng, **biases), received(d, rng, late=0.1))
    _, _, a = errors(d, out)
    assert (np.abs(a[at(2.0) :, :2]) < out["sigma_rpy"][at(2.0) :, :2]).all()
    assert np.abs(out["ba"][at(2.0) :, :2]).max() < 0.03


@pytest.mark.parametrize("seed", [5, 7, 10])
def test_a_hand_that_turns_the_sensor_slowly_is_hardly_taken_for_the_bias(seed):
    rng = np.random.default_rng(seed)
    d = drive(30.0, rest=30.0)
    periods, phases = rng.uniform(8.0, 25.0, (3, 5)), rng.uniform(0.0, 2.0 * np.pi, (3, 5))
    sway = np.radians([3.0, 3.0, 6.0]) * np.sin(2.0 * np.pi * d.t[:, None, None] / periods + phases).sum(-1)
    attitude = d.attitude * Rotation.from_rotvec(sway)
    w, f = ideal_sensor(d.t, d.lat, d.height, d.v, attitude)
    d, bg = dataclasses.replace(d, attitude=attitude, w=w, f=f), np.array([0.003, 0.001, 0.003])
    out, _, _ = navigate(sensed(d, rng, gyro_psd=2e-3, bg=bg), received(d, rng, late=0.1))
    assert (np.abs(out["bg"] - bg) / out["sigma_bg"])[at(1.0) :].max() < 10.0  # 20 to 30 where its turn is not noticed


def test_curves_without_a_receiver_are_not_taken_for_level_motion():
    rng = np.random.default_rng(4)
    d = drive(120.0, rest=6.0)
    out, _, _ = navigate(sensed(d, rng, bg=(0.001, -0.001, 0.002)), received(d, rng)[:0])
    _, _, a = errors(d, out)
    worst = np.abs(a[at(5.0) :, :2]) / out["sigma_rpy"][at(5.0) :, :2]
    assert worst.max() < 3.0
    assert np.abs(a[at(5.0) :, :2]).max() < np.radians(4.0)


def test_a_height_that_no_fix_has_is_not_valid():
    rng = np.random.default_rng(4)
    d = drive(60.0, rest=5.0)
    fixes = received(d, rng)
    fixes["height"] = np.nan
    out, _, _ = navigate(sensed(d, rng), fixes)
    p, _, _ = errors(d, out)
    assert (out["status"][-1] & HEADING_VALID) > 0
    assert not (out["status"] & HEIGHT_VALID).any()
    assert (out["sigma_p"][at(2.0) :, 2] > 500.0).all()
    assert np.hypot(*p[at(40.0) :, :2].T).max() < 5.0


def test_a_height_of_one_fix_stays_valid_when_the_next_has_none():
    rng = np.random.default_rng(4)
    d = drive(20.0, rest=20.0)
    fixes = received(d, rng)
    fixes["height"][5:] = np.nan
    out, _, _ = navigate(sensed(d, rng), fixes)
    p, _, _ = errors(d, out)
    assert (np.abs(p[at(2.0) :, 2]) < 4.0 * out["sigma_p"][at(2.0) :, 2]).all()
    assert (out["sigma_p"][at(2.0) :, 2] < 20.0).all()
    assert (out["status"][at(2.0) :] & HEIGHT_VALID).all()


def test_start_under_way():
    rng = np.random.default_rng(5)
    d = drive(150.0, rest=0.0, fast_start=True)
    out, _, _ = navigate(sensed(d, rng, bg=(0.02, -0.03, -0.01)), received(d, rng, late=0.25))
    _, v, a = errors(d, out)
    assert (out["status"][at(90.0) :] & HEADING_VALID).all()
    assert np.abs(a[at(110.0) :, 2]).max() < np.radians(3.0)
    assert np.abs(v[at(110.0) :, :2]).max() < 0.5


def test_start_under_way_with_a_gyro_bias_of_4_5_deg_per_s():
    rng = np.random.default_rng(1)
    d = drive(200.0, rest=0.0, fast_start=True)
    out, _, _ = navigate(sensed(d, rng, bg=(0.02, -0.03, np.radians(4.5))), received(d, rng, late=0.25))
    _, _, a = errors(d, out)
    assert np.abs(a[at(185.0) :, 2]).max() < np.radians(5.0)
    assert out["bg"][-1][2] == pytest.approx(np.radians(4.5), abs=2e-3)


@pytest.mark.parametrize(
    "white, wander, found_s, position, yaw_deg",
    [(0.02, 0.0, 60, 0.2, 2.0), (0.1, 1.5, 90, 4.0, 8.0), (1.0, 1.0, 90, 4.0, 8.0)],
)
def test_positions_alone_are_enough(white, wander, found_s, position, yaw_deg):
    rng = np.random.default_rng(6)
    d = drive(160.0)
    fixes = received(d, rng, sigma=wander, white=white)
    fixes["speed"] = fixes["course"] = np.nan
    if white < 0.1:
        fixes["hdop"], fixes["sigma"] = np.nan, (0.02, 0.02, 0.04)
    out, _, _ = navigate(sensed(d, rng), fixes)
    p, _, a = errors(d, out)
    assert (out["status"][at(found_s) :] & HEADING_VALID).all()
    assert np.abs(a[at(130.0) :, 2]).max() < np.radians(yaw_deg)
    assert np.sqrt(np.mean(p[at(130.0) :, :2] ** 2)) < position
    assert np.mean((a[at(found_s) :, 2] / out["sigma_rpy"][at(found_s) :, 2]) ** 2) < 4.0


def test_a_jump_before_the_heading_is_known_is_no_speed():
    rng = np.random.default_rng(6)
    d = drive(45.0, rest=60.0)
    fixes = received(d, rng)
    fixes["speed"] = fixes["course"] = np.nan
    fixes["lat"][20:] += 1000.0 / 6.37e6
    out, _, _ = navigate(sensed(d, rng), fixes)
    _, v, _ = errors(d, out)
    assert (np.abs(v[at(10.0) :, :2]) < 4.0 * out["sigma_v"][at(10.0) :, :2]).all()


def test_a_fix_every_five_seconds_is_enough():
    rng = np.random.default_rng(6)
    d = drive(150.0)
    out, _, _ = navigate(sensed(d, rng), received(d, rng, every=5.0))
    assert (out["status"][at(90.0) :] & HEADING_VALID).all()
    assert np.abs(errors(d, out)[2][at(120.0) :, 2]).max() < np.radians(3.0)


def test_what_the_user_knows_is_taken_at_once():
    rng = np.random.default_rng(7)
    d = drive(20.0, rest=30.0)
    start = Initial(
        lat_deg=np.degrees(d.lat[0]), lon_deg=np.degrees(d.lon[0]), height_m=500.0, vn_mps=0.0, ve_mps=0.0, vd_mps=0.0,
        roll_deg=0.0, pitch_deg=0.0, yaw_deg=np.degrees(0.7),
    )  # fmt: skip
    out, _, _ = navigate(sensed(d, rng), received(d, rng)[:0], None, start)
    assert (out["status"][at(1.0) :] & (POSITION_VALID | HEADING_VALID | ATTITUDE_VALID) == 7).all()
    p, v, a = errors(d, out)
    assert np.degrees(np.abs(a)).max() < 2.0
    assert np.abs(v).max() < 0.5
    assert (np.abs(p) < 4.0 * out["sigma_p"]).all()


@pytest.mark.parametrize("vehicle, constrained", [("free", 0), ("auto", 1), ("land", 1)])
def test_the_land_vehicle_constraint_is_a_mode(vehicle, constrained):
    rng = np.random.default_rng(8)
    d = drive(90.0)
    out, _, state = navigate(sensed(d, rng), received(d, rng), Settings(navigation=Navigation(vehicle=vehicle)))
    assert state["core"][0, 0]["nhc"]["enabled"] == constrained
    assert np.isfinite(out["sigma_v"][-1]).all()


def test_auto_does_not_take_a_craft_that_moves_sideways_for_a_land_vehicle():
    rng = np.random.default_rng(9)
    d = drive(120.0)
    drifting = Rotation.from_rotvec(np.outer(2.5 * np.sin(0.2 * d.t), (0, 0, 1)))  # its nose turns about freely
    d.w = drifting.inv().apply(d.w) + np.column_stack([0 * d.t, 0 * d.t, 0.5 * np.cos(0.2 * d.t)])
    d.f, d.attitude = drifting.inv().apply(d.f), d.attitude * drifting
    out, _, state = navigate(sensed(d, rng), received(d, rng))
    _, v, a = errors(d, out)
    assert state["core"][0, 0]["nhc"]["enabled"] == 0
    assert np.abs(v[at(80.0) :, :2]).max() < 0.5
    assert np.abs(a[at(80.0) :, 2]).max() < np.radians(3.0)
