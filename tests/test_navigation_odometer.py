"""An odometer in the navigation filter: its scale is found, slips are left out, and a drifting receiver with it."""

import numpy as np
import pytest
from navigation_simulation import drive, errors, received, sensed
from scipy.spatial.transform import Rotation
from test_navigation_aiding import estimated, found_of_sources
from vehicle_simulation import FREE, vehicle

from imud.configuration.settings import Navigation, Settings
from imud.estimators.records import COASTING, HEADING_VALID, MEASUREMENT, ODOMETER, ODOMETER_SOURCE, REJECTING

SIGMA = 0.05
WARM = Settings(  # with the antenna at the sensor; the receiver does not average
    navigation=Navigation(lever_arm_sigma_m=0.0, tuning={"warm_up_share": 0.0, "averaging_delay_sigma": 2e-4})
)


def readings(d, rng, scale=0.02, every_s=0.1, late_s=0.02, unsigned=False):
    """MEASUREMENT rows of a wheel: the speed along the vehicle's own axis, `scale` too large."""
    step = round(every_s / (d.t[1] - d.t[0]))
    forward = np.sum(d.attitude.apply([1.0, 0.0, 0.0]) * d.v, axis=1)[step::step]
    rows = np.zeros(len(forward), MEASUREMENT)
    rows["t_ns"] = np.round(1e9 * (100.0 + d.t[step::step]))
    rows["arrival_ns"] = rows["t_ns"] + round(1e9 * late_s)
    rows["kind"], rows["sigma"] = ODOMETER_SOURCE, np.nan
    speed = (1.0 + scale) * forward + SIGMA * rng.standard_normal(len(forward))
    rows["value"][:, 0] = np.abs(speed) if unsigned else speed
    return rows


def recorded(seed, seconds, accel_psd=2e-3, **changes):
    rng = np.random.default_rng(seed)
    d = drive(seconds, **changes)
    return d, sensed(d, rng, accel_psd=accel_psd), received(d, rng, late=0.2, sigma=1.8, speed_sigma=0.1), rng


def without(fixes, begin, end):
    t = fixes["t_ns"] * 1e-9 - 100.0
    return fixes[(t < begin) | (t > end)]


@pytest.mark.parametrize("unsigned", [False, True])
def test_in_an_outage_the_wheels_hold_the_way_within_sigma(unsigned):
    """Also of a vehicle that reverses, whose wheel tells no sign; its accelerometers are noisy."""
    d, samples, fixes, rng = recorded(1, 200.0, accel_psd=0.1, speed=6.0, swing=1.3)
    fixes = without(fixes, 130.0, 190.0)
    alone, _ = estimated(samples, fixes, readings(d, rng)[:0], WARM)
    out, innovations = estimated(samples, fixes, readings(d, rng, unsigned=unsigned), WARM)
    end = (d.t > 185.0) & (d.t < 189.0)
    assert (out["status"][end] & COASTING).all()
    sigma = out["sigma_v"][end, :2]
    assert np.mean((errors(d, out)[1][end, :2] / sigma) ** 2) < 3.0
    assert sigma.mean() < 0.9 * alone["sigma_v"][end, :2].mean()  # across the way it is the heading's, as without them
    assert out["sigma_p"][end, :2].mean() < 0.65 * alone["sigma_p"][end, :2].mean()
    assert innovations["used"].mean() > 0.97
    found = innovations[(innovations["kind"] == ODOMETER) & (innovations["t_ns"] > 140e9)]
    assert 0.2 < np.mean(found["value"] ** 2 / found["variance"]) < 1.5


def test_slips_are_left_out_and_harm_nothing():
    d, samples, fixes, rng = recorded(2, 120.0)
    rows = readings(d, rng)
    t = rows["t_ns"] * 1e-9 - 100.0
    spin, lock = (t > 60.0) & (t < 62.5), (t > 80.0) & (t < 81.0)
    rows["value"][spin, 0] *= 1.4
    rows["value"][lock, 0] = 0.0
    out, innovations = estimated(samples, fixes, rows)
    epochs = innovations["t_ns"] * 1e-9 - 100.0
    during = ((epochs > 60.0) & (epochs < 62.5)) | ((epochs > 80.0) & (epochs < 81.0))
    assert innovations["used"][during].mean() < 0.5
    assert innovations["used"][~during].mean() > 0.97
    later = d.t > 50.0
    assert np.mean((errors(d, out)[1][later, :2] / out["sigma_v"][later, :2]) ** 2) < 2.0


def test_wheels_in_wrong_units_are_rejected_and_change_little():
    """km/h instead of m/s."""
    d, samples, fixes, rng = recorded(3, 90.0)
    rows = readings(d, rng)
    rows["value"][:, 0] *= 3.6
    out, innovations = estimated(samples, fixes, rows)
    alone, _ = estimated(samples, fixes, rows[:0])
    moving = innovations["t_ns"] > 130e9
    assert innovations["used"][moving].mean() < 0.05
    found = found_of_sources(samples, fixes, rows, Settings())[ODOMETER_SOURCE]
    assert found["finding"] == "it contradicts the estimate"
    later = d.t > 60.0
    apart = np.abs(out["v"][later] - alone["v"][later]) / alone["sigma_v"][later]
    assert apart.max() < 1.0


def ramped(fixes, begin, direction, speed=1.0, velocity=True):
    """Fixes of a receiver that drifts since `begin` s with `speed` m/s, and says so in its velocity, too."""
    fixes = fixes.copy()
    dt = np.maximum(fixes["t_ns"] * 1e-9 - 100.0 - begin, 0.0)
    north, east = speed * np.cos(direction), speed * np.sin(direction)
    fixes["lat"] += north * dt / 6.37e6
    fixes["lon"] += east * dt / (6.39e6 * np.cos(np.radians(48.0)))
    if velocity:
        v = fixes["speed"] * np.exp(1j * fixes["course"]) + (dt > 0.0) * (north + 1j * east)
        fixes["speed"], fixes["course"] = np.abs(v), np.angle(v)
    return fixes


@pytest.mark.parametrize("direction", [0.3, 1.9, 3.4, 5.0])
def test_a_receiver_that_drifts_by_1_mps_and_says_so_is_found_within_30_s(direction):
    d, samples, fixes, rng = recorded(4, 240.0)
    fixes = ramped(fixes, 120.0, direction)
    out, _ = estimated(samples, fixes, readings(d, rng))
    rejecting = d.t[(out["status"] & REJECTING) != 0]
    assert 120.0 < rejecting[rejecting > 120.0].min() < 150.0
    assert np.hypot(*errors(d, out)[0][d.t > 235.0, :2].T).max() < 15.0  # the receiver is 115 m away


@pytest.mark.parametrize("end", [130.0, 160.0])
def test_a_receiver_that_stops_drifting_is_used_again(end):
    """And stays in use: what contradicted the wheels during the drift is no evidence of another one."""
    d, samples, fixes, rng = recorded(5, 240.0)
    drifted = ramped(fixes, 100.0, 0.3)
    late = fixes["t_ns"] > (end + 100.0) * 1e9
    drifted[late] = fixes[late]
    out, _ = estimated(samples, drifted, readings(d, rng))
    assert (out["status"][(d.t > 115.0) & (d.t < end - 2.0)] & REJECTING).all()
    assert not (out["status"][d.t > end + 25.0] & REJECTING).any()
    assert np.hypot(*errors(d, out)[0][d.t > end + 40.0, :2].T).max() < 6.0
    assert np.hypot(*out["sigma_p"][d.t > end + 40.0, :2].T).max() < 6.0


def test_a_drift_across_a_straight_road_is_not_forgotten_as_the_heading_grows_uncertain():
    rng = np.random.default_rng(7)
    d = drive(240.0, speed=10.0, swing=0.2, straight_s=116.0)
    samples, fixes = sensed(d, rng, gyro_psd=4e-3), received(d, rng, late=0.2, sigma=1.8, speed_sigma=0.1)
    drifted = ramped(fixes, 120.0, np.arctan2(d.v[-1, 1], d.v[-1, 0]) + np.pi / 2.0)
    out, _ = estimated(samples, drifted, readings(d, rng))
    later = d.t > 126.0
    assert (out["status"][later] & REJECTING).all()
    errors_m, sigma = np.hypot(*errors(d, out)[0][:, :2].T), np.hypot(*out["sigma_p"][:, :2].T)
    assert (errors_m < 3.0 * sigma)[later].all() and out["sigma_rpy"][-1, 2] > np.radians(2.0)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("speed", [5.0, 10.0])
def test_a_drift_across_a_straight_road_is_found_within_15_s(speed, side):
    """Only what is known of the heading tells it from a heading error."""
    rng = np.random.default_rng(8)
    d = drive(180.0, speed=speed, swing=0.2, straight_s=96.0)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.2, sigma=1.8, speed_sigma=0.1)
    drifted = ramped(fixes, 115.0, np.arctan2(d.v[-1, 1], d.v[-1, 0]) + side * np.pi / 2.0)
    out, _ = estimated(samples, drifted, readings(d, rng))
    assert (out["status"][d.t > 130.0] & REJECTING).all()
    errors_m, sigma = np.hypot(*errors(d, out)[0][:, :2].T), np.hypot(*out["sigma_p"][:, :2].T)
    assert (errors_m < 4.0 * sigma)[d.t > 115.0].all()
    assert errors_m[-1] < 20.0  # the receiver is 65 m away


@pytest.mark.parametrize(("where", "deg", "seed"), [("drone", 10.0, 52), ("walk", 20.0, 52), ("city", 45.0, 51)])
def test_a_sensor_that_is_turned_in_the_vehicle_is_not_believed_to_be_straight(where, deg, seed):
    """The axis of the odometer is then another one than x of the body: its yaw was taken for the heading's error."""
    rng = np.random.default_rng(seed)
    d, mount = vehicle(where, seed), Rotation.from_euler("z", -deg, degrees=True)
    samples = sensed(d, rng, bg=(0.002, -0.001, 0.0015), ba=(0.03, -0.02, 0.02), mount=mount)
    fixes = without(without(received(d, rng, late=0.1, sigma=1.2), 35.0, 50.0), 110.0, 130.0)
    settings = Settings(navigation=Navigation(vehicle="free" if where in FREE else "auto"))
    out, innovations = estimated(samples, fixes, readings(d, np.random.default_rng(seed)), settings)
    position, velocity, attitude = errors(d, out, mount)
    known = out["status"] & HEADING_VALID != 0
    for error, sigma, large in (
        (position[:, :2], out["sigma_p"][:, :2], 5.0),
        (velocity[:, :2], out["sigma_v"][:, :2], 1.0),
        (attitude[:, 2:], out["sigma_rpy"][:, 2:], np.radians(3.0)),
    ):
        assert not ((np.abs(error) > 4.0 * sigma) & (np.abs(error) > large))[known].any()
    late = innovations["t_ns"] > 150e9
    assert late.any() and innovations["used"][late].mean() > 0.95


def test_across_the_body_a_reading_is_not_used_and_that_is_said():
    """No direction can be told from it; what is wrong then is most likely the mounting."""
    d, rng = vehicle("walk", 51, 60.0), np.random.default_rng(51)
    samples = sensed(d, rng, mount=Rotation.from_euler("z", -90.0, degrees=True))
    settings = Settings(navigation=Navigation(vehicle="free"))
    found = found_of_sources(samples, received(d, rng), readings(d, rng), settings)[ODOMETER_SOURCE]
    assert "imu.mount_rpy_deg" in found["finding"]


def test_a_wrong_odometer_does_not_cost_the_receiver():
    """Wheels that show nothing: the receiver stays in use."""
    d, samples, fixes, rng = recorded(6, 120.0)
    rows = readings(d, rng)
    rows["value"][rows["t_ns"] > 150e9, 0] = 0.0
    out, _ = estimated(samples, fixes, rows)
    assert not (out["status"][d.t > 50.0] & REJECTING).any()
    later = d.t > 60.0
    assert np.mean((errors(d, out)[1][later, :2] / out["sigma_v"][later, :2]) ** 2) < 2.5


def test_errors_are_within_sigma_over_many_drives():
    nees = []
    for seed in range(6):
        d, samples, fixes, rng = recorded(10 + seed, 100.0, speed=6.0 + seed)
        out, _ = estimated(samples, fixes, readings(d, rng, scale=0.03 * rng.standard_normal()))
        k = np.arange(4000, len(d.t), 100)
        sigmas = (out["sigma_p"], out["sigma_v"], out["sigma_rpy"])
        nees.append([np.mean((e / s)[k] ** 2) for e, s in zip(errors(d, out), sigmas, strict=True)])
    position, velocity, attitude = np.mean(nees, axis=0)
    assert 0.3 < position < 2.0
    assert 0.2 < velocity < 2.0
    assert 0.1 < attitude < 2.0
