"""Tilt from the accelerometer alone, against closed forms, SciPy's rotations and Monte Carlo."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Imu, Initial, Settings
from imud.drivers.sample import SAMPLE, SUSPECT
from imud.drivers.sample import SATURATED as BEYOND_RANGE
from imud.estimators import registry
from imud.estimators.records import ATTITUDE_VALID, HEADING_VALID, SATURATED, SOLUTION
from imud.estimators.tilt import BANDWIDTH_HZ, ESTIMATOR
from imud.pipeline import Filter
from imud.sensor_errors.profiles import PROFILES

G = 9.80665
RATE_HZ = 50.0
PROFILE = PROFILES["mma7260"]
UNIFORM = math.pi / math.sqrt(3.0)
TAU = 1.0 / (2.0 * math.pi * BANDWIDTH_HZ)


def samples(force, rate=(0.0, 0.0, 0.0), flags=0, hz=RATE_HZ):
    rows = np.zeros(len(force), SAMPLE)
    rows["t_ns"] = 1_000_000_000 + np.round(np.arange(len(force)) * (1e9 / hz)).astype(np.int64)
    rows["f"], rows["w"], rows["flags"] = force, rate, flags
    return rows


def run(rows, hz=RATE_HZ, **initial):
    out = np.zeros(len(rows), SOLUTION)
    Filter(ESTIMATOR, Settings(imu=Imu(profile="mma7260")), Initial(**initial), hz).run(rows.copy(), out)
    return out


def weight(roll, pitch, yaw=0.0):
    """What a body at rest measures, by SciPy: the inverse rotation of (0, 0, -g)."""
    return Rotation.from_euler("ZYX", [yaw, pitch, roll]).inv().apply([0.0, 0.0, -G])


def angles(solution):
    """Roll, pitch, yaw by SciPy."""
    w, x, y, z = solution["q_nb"]
    yaw, pitch, roll = Rotation.from_quat([x, y, z, w]).as_euler("ZYX")
    return roll, pitch, yaw


def still(force, n=100, **options):
    return run(samples(np.tile(force, (n, 1))), **options)[-1]


# --- closed forms ---


@given(st.floats(-math.pi, math.pi), st.floats(-1.5, 1.5))
def test_roll_and_pitch_of_a_body_at_rest(roll, pitch):
    got = angles(still(weight(roll, pitch), n=3))
    assert abs(math.remainder(got[0] - roll, 2.0 * math.pi)) < 1e-9
    assert got[1] == pytest.approx(pitch, abs=1e-9)
    assert got[2] == pytest.approx(0.0, abs=1e-9)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda f: math.hypot(*f) > 0.1))
def test_the_papers_tilt(f):
    """acos(acc_z / acc_xyz), acc pointing up as the board reports it: its x forward, y left, z up."""
    solution = still(np.array([f[0], -f[1], -f[2]]) * G, n=3)
    vertical = Rotation.from_quat(solution["q_nb"][[1, 2, 3, 0]]).as_matrix()[2, 2]
    assert math.acos(max(-1.0, min(1.0, vertical))) == pytest.approx(math.acos(f[2] / math.hypot(*f)), abs=1e-7)


@pytest.mark.filterwarnings("ignore:Gimbal lock")
@pytest.mark.parametrize(
    ("force", "roll", "pitch"),
    [
        ((0, 0, -G), 0.0, 0.0),
        ((0, 0, G), math.pi, 0.0),
        ((0, -G, 0), math.pi / 2, 0.0),
        ((0, G, 0), -math.pi / 2, 0.0),
        ((G, 0, 0), None, math.pi / 2),
        ((-G, 0, 0), None, -math.pi / 2),
    ],
)
def test_the_six_faces(force, roll, pitch):
    solution = still(force)
    got = angles(solution)
    assert solution["status"] & ATTITUDE_VALID
    assert got[1] == pytest.approx(pitch, abs=1e-6)
    if roll is None:  # not defined, and said so
        assert solution["sigma_rpy"][0] == pytest.approx(UNIFORM)
    else:
        assert abs(math.remainder(got[0] - roll, 2.0 * math.pi)) < 1e-6
        assert solution["sigma_rpy"][0] < 0.05
    assert solution["sigma_rpy"][1] < 0.05


def test_the_step_response_is_a_first_order_low_pass():
    """A sideways force that is too small to count as motion: 1 - exp(-t / tau)."""
    force = np.tile([0.0, 0.0, -G], (400, 1))
    force[200:, 0] = 0.1
    out = run(samples(force, hz=1000.0), hz=1000.0)
    fx = np.array([math.tan(angles(row)[1]) * G for row in out[200:]])
    expected = 0.1 * (1.0 - np.exp(-np.arange(1, 201) / 1000.0 / TAU))
    assert fx == pytest.approx(expected, rel=0.01, abs=1e-5)


def test_the_running_mean_begins_with_the_first_sample():
    force = np.array([weight(0.1 * (-1) ** k, 0.0) for k in range(4)])
    assert [angles(row)[0] for row in run(samples(force, hz=1000.0), hz=1000.0)] == pytest.approx(
        [0.1, 0.0, 0.1 / 3, 0.0], abs=1e-3
    )


# --- what the sigmas are worth ---


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, -0.2), (3.0, 0.5), (0.5, 1.2), (-1.57, 0.0)])
def test_sigmas_are_those_of_a_monte_carlo(roll, pitch):
    """Units drawn from the profile: bias, scale and noise. Error over sigma has unit variance."""
    rng = np.random.default_rng(7)
    runs, ratios = 300, []
    for _ in range(runs):
        gain = 1.0 + PROFILE.accel_scale * rng.standard_normal(3)
        bias = PROFILE.accel_bias_initial * rng.standard_normal(3)
        white = PROFILE.accel_noise * math.sqrt(RATE_HZ) * rng.standard_normal((100, 3))
        solution = run(samples(weight(roll, pitch) * gain + bias + white))[-1]
        got = angles(solution)
        error = math.remainder(got[0] - roll, 2.0 * math.pi), got[1] - pitch
        ratios.append(np.array(error) / solution["sigma_rpy"][:2])
    nees = np.mean(np.square(ratios), axis=0)
    assert np.all((nees > 0.7) & (nees < 1.35)), nees  # 99 % of chi2(300)/300 lies within 0.8 and 1.22


def test_the_noise_is_estimated_from_the_first_samples():
    quiet = still(weight(0.0, 0.0), n=200)["sigma_rpy"][0]
    one = still(weight(0.0, 0.0), n=1)["sigma_rpy"][0]
    white = PROFILE.accel_noise * math.sqrt(RATE_HZ) / G
    assert one**2 - quiet**2 == pytest.approx(white**2, rel=0.15)


def test_free_fall_gives_no_tilt():
    solution = still((0.0, 0.0, 0.0))
    assert np.all(np.isfinite(solution["q_nb"]))
    assert solution["sigma_rpy"].tolist() == pytest.approx([UNIFORM] * 3)
    assert not solution["status"] & ATTITUDE_VALID


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.15, 1.3, 2.0, 7.0])
def test_sigma_grows_with_the_distance_from_gravity(factor):
    level, off = still((0.0, 0.0, -G)), still((0.0, 0.0, -G * factor))
    assert off["sigma_rpy"][0] > 2.0 * level["sigma_rpy"][0]


@pytest.mark.parametrize("acceleration", [0.5, 0.7, 1.0, 2.0])
def test_a_force_that_is_not_only_weight_is_covered_by_its_sigma(acceleration):
    """A steady sideways acceleration, in g: large enough to show, it costs no more than three sigma."""
    solution = still((acceleration * G, 0.0, -G))
    assert angles(solution)[1] == pytest.approx(math.atan(acceleration), abs=1e-6)
    assert math.atan(acceleration) < 3.0 * solution["sigma_rpy"][1]
    assert acceleration < 0.6 or not solution["status"] & ATTITUDE_VALID


@pytest.mark.parametrize("rate", [0.2, 0.5, 1.0])
def test_the_lag_of_a_steady_turn_is_covered(rate):
    roll = rate * np.arange(0.0, 4.0, 1.0 / RATE_HZ)
    out = run(samples(np.array([weight(angle, 0.0) for angle in roll])))
    error = [math.remainder(angles(row)[0] - angle, 2.0 * math.pi) for row, angle in zip(out, roll, strict=True)]
    assert error[-1] == pytest.approx(-rate * TAU, rel=0.15)
    begun = int(RATE_HZ)  # the first second shows that it turns
    assert np.all(np.abs(error[begun:]) < 2.0 * out["sigma_rpy"][begun:, 0])


def accelerated(rng, accelerations, vibration):
    """Samples of a level body that accelerates along x, m/s^2, and vibrates; the sensor has no error but noise."""
    force = np.column_stack((accelerations, np.zeros(len(accelerations)), np.full(len(accelerations), -G)))
    white = math.hypot(PROFILE.accel_noise * math.sqrt(RATE_HZ), vibration)
    return samples(force + rng.normal(0.0, white, force.shape))


@pytest.mark.parametrize("acceleration", [1.5, 2.5, -3.0])
def test_a_vehicle_that_goes_on_braking_is_covered(acceleration):
    """Its force differs by less from gravity than the sensor's errors may: only the change has shown it."""
    t = np.arange(0.0, 60.0, 1.0 / RATE_HZ)
    ramp = np.clip(np.minimum(t - 5.0, 13.0 - t), 0.0, 1.0)
    out = run(accelerated(np.random.default_rng(1), acceleration * ramp, 0.3))
    pitch = np.array([angles(row)[1] for row in out])
    assert abs(pitch[t > 6.5][0]) > math.radians(7.0)
    assert np.all(np.abs(pitch) < 4.0 * out["sigma_rpy"][:, 1])
    assert out["sigma_rpy"][-1, 1] < 1.2 * out["sigma_rpy"][t < 4.0, 1].max()


def test_a_body_that_is_only_tilted_is_known_again_in_seconds():
    """Without vibration a changed force is taken for another tilt as soon as it stays."""
    t = np.arange(0.0, 12.0, 1.0 / RATE_HZ)
    tilt = math.radians(20.0) * np.clip(t - 5.0, 0.0, 1.0)
    force = np.array([weight(0.0, angle) for angle in tilt])
    rng = np.random.default_rng(2)
    out = run(samples(force + rng.normal(0.0, PROFILE.accel_noise * math.sqrt(RATE_HZ), force.shape)))
    before, after = out["sigma_rpy"][t < 5.0, 1].max(), out["sigma_rpy"][t > 11.0, 1].max()
    assert after < 1.1 * before


# --- yaw ---


def test_without_a_gyro_yaw_is_unknown_even_if_it_was_given():
    for initial in ({}, {"yaw_deg": 90.0}):
        solution = still(weight(0.1, 0.2), **initial)
        assert angles(solution)[2] == pytest.approx(math.radians(initial.get("yaw_deg", 0.0)))
        assert solution["sigma_rpy"][2] == pytest.approx(UNIFORM)
        assert not solution["status"] & HEADING_VALID
        assert np.all(np.isnan(solution["w"]))


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, -0.4), (math.pi, 0.0)])
def test_yaw_is_the_integral_of_the_gyros_there_are(roll, pitch):
    """Turning about the vertical at 0.2 rad/s: the body's rates are the rotated (0, 0, 0.2)."""
    turn = Rotation.from_euler("ZYX", [0.0, pitch, roll]).inv().apply([0.0, 0.0, 0.2])
    rows = samples(np.tile(weight(roll, pitch), (501, 1)), turn)
    solution = run(rows, yaw_deg=30.0)[-1]
    assert angles(solution)[2] == pytest.approx(math.radians(30.0) + 2.0, abs=1e-6)
    expected = math.hypot(math.radians(1.0), 10.0 * PROFILE.gyro_bias_initial * math.cos(roll) / math.cos(pitch))
    assert solution["sigma_rpy"][2] == pytest.approx(expected, rel=0.01)


def test_a_yaw_gyro_alone_serves_a_level_vehicle():
    """Fifty degrees one way and back, yaw axis only: heading valid while given and fresh."""
    rate = np.concatenate([np.full(100, 0.4), np.full(100, -0.4)])
    rows = samples(np.tile(weight(0.0, 0.0), (200, 1)), np.stack([0 * rate, 0 * rate, rate], axis=1))
    out = run(rows, yaw_deg=170.0)
    assert angles(out[100])[2] == pytest.approx(math.remainder(math.radians(170.0) + 0.8, 2.0 * math.pi), abs=0.01)
    assert angles(out[-1])[2] == pytest.approx(math.radians(170.0), abs=0.02)
    assert out[-1]["status"] & HEADING_VALID
    assert np.isnan(out[-1]["w"]).tolist() == [True, True, False]


def test_without_a_given_heading_yaw_counts_from_the_start_and_is_not_valid():
    rows = samples(np.tile(weight(0.0, 0.0), (100, 1)), (0.0, 0.0, 0.1))
    solution = run(rows)[-1]
    assert not solution["status"] & HEADING_VALID
    assert solution["sigma_rpy"][2] < 0.1


# --- samples that are not good ---


def test_suspect_and_unfinished_samples_are_not_used():
    force = np.tile(weight(0.2, 0.1), (200, 1))
    flags = np.zeros(200, np.int64)
    force[50], flags[50] = (40.0, 0.0, 0.0), SUSPECT
    force[60] = math.nan
    out = run(samples(force, flags=flags))
    assert angles(out[-1])[:2] == pytest.approx((0.2, 0.1), abs=1e-12)
    assert np.all(out["status"] == ATTITUDE_VALID)
    assert np.all(np.isfinite(out["sigma_rpy"]))


def test_long_without_a_good_sample_nothing_is_claimed():
    flags = np.zeros(200, np.int64)
    flags[100:180] = SUSPECT
    out = run(samples(np.tile(weight(0.0, 0.0), (200, 1)), flags=flags))
    valid = out["status"] & ATTITUDE_VALID
    assert valid[148] and not valid[151:180].any() and valid[-1]


def test_a_gap_loses_the_heading_but_not_the_tilt():
    rows = samples(np.tile(weight(0.2, 0.0), (200, 1)), (0.0, 0.0, 0.1))
    rows["t_ns"][100:] += 5_000_000_000
    out = run(rows, yaw_deg=10.0)
    assert out[99]["status"] & HEADING_VALID
    assert not (out[100:]["status"] & HEADING_VALID).any()
    assert out[-1]["sigma_rpy"][2] == pytest.approx(UNIFORM)
    assert angles(out[100])[0] == pytest.approx(0.2, abs=1e-9)


def test_time_that_does_not_advance_is_ignored():
    rows = samples(np.tile(weight(0.0, 0.0), (20, 1)))
    rows["t_ns"][10] = rows["t_ns"][9]
    rows["f"][10] = (G, 0.0, 0.0)
    out = run(rows)
    assert angles(out[-1])[1] == pytest.approx(0.0, abs=1e-12)
    assert out[10]["t_ns"] == out[9]["t_ns"]


def test_saturation_is_passed_on():
    rows = samples(np.tile([0.0, 0.0, -1.75 * G], (50, 1)), flags=BEYOND_RANGE)
    solution = run(rows)[-1]
    assert solution["status"] & SATURATED
    assert not solution["status"] & ATTITUDE_VALID


def test_position_is_not_claimed():
    solution = still((0.0, 0.0, -G))
    for name in ("lat", "lon", "height", "v", "sigma_p", "sigma_v"):
        assert np.all(np.isnan(solution[name])), name


def test_local_gravity_is_used():
    """At the pole gravity is 9.832: with the latitude known, that is no acceleration even to a fine sensor."""
    rows = samples(np.tile([0.0, 0.0, -9.83219], (200, 1)))
    settings = Settings(imu=Imu(profile="m-g350"))
    sigma = {}
    for lat in (90.0, 0.0):
        out = np.zeros(len(rows), SOLUTION)
        Filter(ESTIMATOR, settings, Initial(lat_deg=lat), RATE_HZ).run(rows.copy(), out)
        sigma[lat] = out[-1]["sigma_rpy"][0]
    assert sigma[90.0] <= sigma[0.0]
    assert sigma[90.0] == pytest.approx(PROFILES["m-g350"].accel_bias_initial / 9.832, rel=0.02)


def test_it_is_an_estimator_that_needs_no_gyros():
    assert registry.by_name("tilt") is ESTIMATOR
    assert not ESTIMATOR.needs_gyros
    assert registry.by_name("attitude").needs_gyros
