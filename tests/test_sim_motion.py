"""The emulator's truth against closed forms, against numerical derivatives of ECEF positions (pymap3d), and against an
independent strapdown integration in inertial space; the sensor's errors against their data sheet."""

import math
from dataclasses import replace

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imud.firmware_sim import ellipsoid
from imud.firmware_sim.motion import Trajectory, rotation
from imud.firmware_sim.noise import DEG, IDEAL, M_G350, MILLI_G, ImuErrors
from imud.firmware_sim.scenarios import SCENARIOS
from imud.firmware_sim.timeline import Timeline

LAT, LON, HEIGHT = 35.6586, 139.7454, 60.0
RATE = 7.292115e-5  # rad/s, WGS-84
MOVING = ["turntable", "car", "figure8"]


def trajectory(name, roll=0.0, pitch=0.0, yaw=0.0, delay_s=0.0):
    return Trajectory(SCENARIOS[name](roll, pitch, yaw), LAT, LON, HEIGHT, delay_s)


def ecef(trajectory, t):
    x = trajectory.at(t)
    return np.stack(pymap3d.geodetic2ecef(np.degrees(x.lat), np.degrees(x.lon), x.height), axis=1)


def ned_axes(lat, lon):
    """Rows: north, east, down in ECEF."""
    sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([[-sl * co, -sl * so, cl], [-so, co, 0.0], [-cl * co, -cl * so, -sl]])


def somigliana(lat, height):
    """Normal gravity by Somigliana's original form, between the equator's and the pole's value."""
    a, b, ge, gp = 6378137.0, 6356752.3142, 9.7803253359, 9.8321849378
    c2, s2 = math.cos(lat) ** 2, math.sin(lat) ** 2
    surface = (a * ge * c2 + b * gp * s2) / math.sqrt(a * a * c2 + b * b * s2)
    f, m = (a - b) / a, RATE**2 * a * a * b / 3.986004418e14
    return surface * (1.0 - 2.0 / a * (1.0 + f + m - 2.0 * f * s2) * height + 3.0 * height**2 / a**2)


# --- the earth ---


@pytest.mark.parametrize("lat_deg, expected", [(0.0, 9.7803253359), (45.0, 9.8061977694), (90.0, 9.8321849378)])
def test_normal_gravity_on_the_ellipsoid(lat_deg, expected):
    assert ellipsoid.gravity(np.radians([lat_deg]), np.zeros(1))[0] == pytest.approx(expected, abs=1e-8)


@given(st.floats(-1.5, 1.5))
def test_radii_and_their_derivatives(lat):
    ell = pymap3d.Ellipsoid.from_name("wgs84")
    here = np.array([lat])
    assert ellipsoid.meridian(here)[0][0] == pytest.approx(pymap3d.rcurve.meridian(lat, ell, deg=False), rel=1e-9)
    assert ellipsoid.prime_vertical(here)[0][0] == pytest.approx(
        pymap3d.rcurve.transverse(lat, ell, deg=False), rel=1e-9
    )
    for radius in (ellipsoid.meridian, ellipsoid.prime_vertical):
        slope = (radius(here + 1e-5)[0] - radius(here - 1e-5)[0]) / 2e-5
        assert radius(here)[1][0] == pytest.approx(slope[0], abs=0.01)


# --- the timeline ---


@given(st.lists(st.tuples(st.floats(0.5, 5.0), st.floats(-3.0, 3.0)), min_size=1, max_size=5), st.floats(0.0, 60.0))
def test_timeline_derivatives_and_integral(segments, t):
    line = Timeline([(1.0, 0.5)], [*segments, (1.0, 0.5)])
    h = 1e-4
    (before, rate_before, slope_before, _), (after, rate_after, slope_after, _) = (
        line.at(np.array([x])) for x in (t, t + h)
    )
    _, rate, slope, curve = line.at(np.array([t + h / 2]))
    assert (after - before)[0] / h == pytest.approx(rate[0], abs=1e-5)
    assert (rate_after - rate_before)[0] / h == pytest.approx(slope[0], abs=1e-3)
    assert (slope_after - slope_before)[0] / h == pytest.approx(curve[0], abs=0.1)


def test_timeline_laps_add_up_and_rest_before_zero():
    line = Timeline([(2.0, 1.0)], [(3.0, 1.0), (2.0, 3.0), (2.0, 1.0)])
    lap = 3.0 + 2.0 * 2.0 + 2.0 * 2.0
    angle, rate, slope, curve = line.at(np.array([-1.0, 0.0, 2.0, 2.0 + 7.0 * 5]))
    assert angle == pytest.approx([0.0, 0.0, 1.0, 1.0 + 5 * lap])
    assert rate == pytest.approx([0.0, 0.0, 1.0, 1.0])
    assert not slope.any() and not curve.any()
    with pytest.raises(ValueError, match="must end at the rate"):
        Timeline([], [(1.0, 2.0)])


# --- rest and turntable: closed forms ---


@pytest.mark.parametrize("roll_deg, pitch_deg, yaw_deg", [(0, 0, 0), (10, -5, 0), (-30, 20, 135)])
def test_at_rest_gravity_and_earth_rate_are_measured(roll_deg, pitch_deg, yaw_deg):
    roll, pitch, yaw = np.radians([roll_deg, pitch_deg, yaw_deg])
    x = trajectory("rest", roll, pitch, yaw).at(np.array([0.0, 1000.0]))
    g = somigliana(math.radians(LAT), HEIGHT)
    f = g * np.array([math.sin(pitch), -math.sin(roll) * math.cos(pitch), -math.cos(roll) * math.cos(pitch)])
    assert x.f_b == pytest.approx(np.array([f, f]), abs=1e-9)
    assert np.linalg.norm(x.w_ib_b, axis=1) == pytest.approx(RATE, abs=1e-15)
    up = -x.f_b[0] / g  # the body's down axis, measured; the earth turns about the pole, at latitude from the horizon
    assert x.w_ib_b[0] @ up == pytest.approx(-RATE * math.sin(math.radians(LAT)), abs=1e-13)
    assert not x.v_n.any() and x.rpy[1] == pytest.approx([roll, pitch, yaw])
    assert np.degrees([x.lat[1], x.lon[1]]) == pytest.approx([LAT, LON]) and x.height[1] == HEIGHT


def test_level_rest_is_minus_g_on_z():
    assert trajectory("rest").at(np.zeros(1)).f_b[0] == pytest.approx([0.0, 0.0, -9.7977], abs=1e-4)


def test_turntable_steps():
    table = trajectory("turntable")
    held = table.at(np.array([8.0, 18.0]))  # first and second step
    earth_z = -RATE * math.sin(math.radians(LAT))
    assert held.w_ib_b[:, 2] == pytest.approx([math.radians(10) + earth_z, math.radians(-10) + earth_z], abs=1e-12)
    still = table.at(np.array([4.0, 13.0, 23.0]))  # 10 deg/s for 5 s and two ramps of 1 s: 60 deg there, and back
    assert np.degrees(still.rpy[:, 2]) == pytest.approx([0.0, 60.0, 0.0], abs=1e-9)
    rates = np.degrees(table.at(np.arange(0.0, 85.0, 0.05)).w_ib_b[:, 2])
    assert rates.max() == pytest.approx(250.0, abs=0.01) and rates.min() == pytest.approx(-250.0, abs=0.01)


# --- moving on the ellipsoid: pymap3d's ECEF as judge ---


@pytest.mark.parametrize("name", MOVING)
def test_velocity_and_force_are_the_derivatives_of_position(name):
    truth, h = trajectory(name), 0.02
    for t in (7.3, 12.1, 21.7, 40.03, 66.6, 74.9):
        before, here, after = ecef(truth, np.array([t - h, t, t + h]))
        x = truth.at(np.array([t]))
        axes = ned_axes(x.lat[0], x.lon[0])
        velocity, acceleration = (after - before) / (2 * h), (after - 2 * here + before) / h**2
        assert x.v_n[0] == pytest.approx(axes @ velocity, abs=2e-4)
        coriolis = 2.0 * np.cross([0.0, 0.0, RATE], velocity)
        gravity = np.array([0.0, 0.0, somigliana(x.lat[0], x.height[0])])
        expected = axes @ (acceleration + coriolis) - gravity
        assert rotation(x.rpy)[0] @ x.f_b[0] == pytest.approx(expected, abs=3e-4)


@pytest.mark.parametrize("name", MOVING)
def test_rate_is_the_derivative_of_attitude_in_inertial_space(name):
    truth, h = trajectory(name), 1e-4
    for t in (7.3, 12.1, 21.7, 66.6, 74.9):
        x = truth.at(np.array([t - h, t, t + h]))
        c_eb = [ned_axes(x.lat[i], x.lon[i]).T @ rotation(x.rpy)[i] for i in range(3)]
        spin = c_eb[1].T @ (c_eb[2] - c_eb[0]) / (2 * h)
        w_eb_b = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        assert x.w_ib_b[1] == pytest.approx(w_eb_b + c_eb[1].T @ [0.0, 0.0, RATE], abs=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["car", "figure8"])
def test_strapdown_in_inertial_space_follows_the_truth(name):
    """1 kHz over 60 s: quaternion and position integrated in ECI; nothing shared with the truth's NED equations."""
    truth, h, n = trajectory(name), 1e-3, 60_000
    middle = truth.imu((np.arange(n) + 0.5) * h)
    ends = truth.at(np.array([0.0, n * h]))
    position, velocity, c_start = inertial_start(truth, ends)
    q = [1.0, 0.0, 0.0, 0.0]  # body against its axes at the start
    for w, f in zip(middle[:, :3].tolist(), middle[:, 3:].tolist(), strict=True):
        half = turn(q, [x * h / 2 for x in w])
        force = (c_start @ rotate(half, f)).tolist()
        guess = [p + v * h / 2 for p, v in zip(position, velocity, strict=True)]
        a = [x + y for x, y in zip(force, gravitation(guess), strict=True)]
        position = [p + v * h + x * h * h / 2 for p, v, x in zip(position, velocity, a, strict=True)]
        velocity = [v + x * h for v, x in zip(velocity, a, strict=True)]
        q = turn(half, [x * h / 2 for x in w])
    back = spin_matrix(-RATE * n * h)
    end = ecef(truth, np.array([n * h]))[0]
    axes = ned_axes(ends.lat[1], ends.lon[1])
    v_e = back @ velocity - np.cross([0.0, 0.0, RATE], back @ position)
    assert axes @ (back @ position - end) == pytest.approx(np.zeros(3), abs=1e-4)
    assert axes @ v_e == pytest.approx(ends.v_n[1], abs=1e-5)
    c_ib = c_start @ np.array([rotate(q, list(axis)) for axis in np.eye(3)]).T
    error = (axes @ back @ c_ib) @ rotation(ends.rpy)[1].T - np.eye(3)
    assert np.abs(error).max() < 1e-7


def inertial_start(truth, ends):
    position = ecef(truth, np.zeros(1))[0]
    axes = ned_axes(ends.lat[0], ends.lon[0])
    velocity = axes.T @ ends.v_n[0] + np.cross([0.0, 0.0, RATE], position)
    return position.tolist(), velocity.tolist(), axes.T @ rotation(ends.rpy)[0]


def turn(q, angle):
    """Quaternion times that of a rotation vector."""
    size = math.sqrt(sum(x * x for x in angle))
    s = math.sin(size / 2) / size if size > 1e-12 else 0.5
    w, (x, y, z) = math.cos(size / 2), (s * part for part in angle)
    a, b, c, d = q
    return [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]


def rotate(q, v):
    w, x, y, z = q
    a, b, c = v
    tx, ty, tz = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx]


def spin_matrix(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def gravitation(r):
    """Normal gravity without its centrifugal part, at an inertial position; latitude by Bowring's formula."""
    a, b = 6378137.0, 6356752.3142
    x, y, z = r
    p = math.hypot(x, y)
    e2 = 1 - b * b / (a * a)
    beta = math.atan2(z * a, p * b)
    lat = math.atan2(z + e2 * a * a / b * math.sin(beta) ** 3, p - e2 * a * math.cos(beta) ** 3)
    height = p / math.cos(lat) - a / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    g = somigliana(lat, height)
    inward = g * math.cos(lat) / p + RATE**2
    return [-inward * x, -inward * y, -g * math.sin(lat)]


@pytest.mark.parametrize("name", MOVING)
def test_measured_rates_and_forces_are_continuous(name):
    feels = trajectory(name).imu(np.arange(0.0, 110.0, 1e-3))
    steps = np.abs(np.diff(feels, axis=0)).max(axis=0)
    assert steps[:3].max() < math.radians(0.5)  # at most 470 deg/s^2 in the fastest ramp of the turntable
    assert steps[3:].max() < 0.02  # m/s^2 per millisecond


def test_the_car_rests_five_seconds_and_then_drives_off():
    x = trajectory("car").at(np.array([0.0, 4.99, 10.0]))
    assert np.abs(x.v_n[:2]).max() < 1e-6
    assert 6.0 < np.linalg.norm(x.v_n[2]) < 15.0
    lap = trajectory("car").at(np.arange(0.0, 300.0, 0.1))
    speed = np.linalg.norm(lap.v_n, axis=1)
    assert 12.0 < speed.max() < 15.5 and (speed[600:] < 0.01).any()
    tilt = np.degrees(np.abs(lap.rpy[:, :2]).max(axis=0))
    assert 1.0 < tilt[0] < 4.0 and 1.0 < tilt[1] < 4.0
    ahead = rotation(lap.rpy)[:, :2, 0]
    fast = speed > 1.0
    slip = lap.v_n[fast, 0] * ahead[fast, 1] - lap.v_n[fast, 1] * ahead[fast, 0]
    assert np.abs(slip).max() < 1e-3  # no side slip: the heading is the course


def test_the_car_rolls_outwards_in_curves_and_pitches_up_when_accelerating():
    x = trajectory("car").at(np.arange(5.5, 60.0, 0.1))
    right_turn = x.w_ib_b[:, 2] > math.radians(15)
    assert right_turn.any() and (x.rpy[right_turn, 0] < 0.0).all()
    level = rotation(x.rpy)
    acceleration = np.einsum("nij,nj->ni", level, x.f_b) + np.array([0.0, 0.0, 9.8])
    forward = np.einsum("ni,ni->n", level[:, :, 0], acceleration)
    speeding, braking = forward > 1.5, forward < -1.5
    assert x.rpy[speeding, 1].mean() > x.rpy[braking, 1].mean() + math.radians(1.0)


def test_start_delay_only_shifts_the_motion():
    t = np.array([8.0, 30.0])
    early, late = trajectory("car").at(t), trajectory("car", delay_s=7.0).at(t + 7.0)
    assert late.f_b == pytest.approx(early.f_b) and late.lat == pytest.approx(early.lat, abs=1e-15)
    assert not trajectory("car", delay_s=7.0).at(np.array([6.0])).v_n.any()


# --- errors of the sensor ---

STILL = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -9.8], (200, 1))


def errors(grade=M_G350, seed=1, **bias):
    return ImuErrors(grade, np.random.default_rng(seed), 2000.0, **bias)


def test_noise_has_the_random_walk_of_the_data_sheet():
    one = errors()
    values = np.vstack([one.corrupt(STILL) for _ in range(1000)])  # 100 s
    seconds = values.reshape(100, 2000, 6).mean(axis=1)  # mean over 1 s: sigma is the random walk
    walk = np.std(np.diff(seconds, axis=0), axis=0) / math.sqrt(2.0)
    assert walk[:3] == pytest.approx(0.2 * DEG / 60.0, rel=0.25)  # 0.2 deg/sqrt(h)
    assert walk[3:] == pytest.approx(0.04 / 60.0, rel=0.25)  # 0.04 (m/s)/sqrt(h)


def test_turn_on_bias_and_gain_are_drawn_from_the_data_sheet():
    population = [errors(seed=i) for i in range(400)]
    bias = np.array([one.bias for one in population])
    assert np.std(bias[:, :3]) == pytest.approx(0.5 * DEG, rel=0.1)
    assert np.std(bias[:, 3:]) == pytest.approx(8.0 * MILLI_G, rel=0.1)
    gain = np.array([one.gain for one in population])
    scale = np.einsum("nii->ni", gain) - 1.0
    assert 0.0045 < np.abs(scale).max() <= 0.005
    assert np.std(gain[:, 0, 1:3]) == pytest.approx(0.1 * DEG, rel=0.15)
    assert np.std(gain[:, 3, 4:]) == pytest.approx(0.03 * DEG, rel=0.15)
    assert not gain[:, :3, 3:].any()


def test_in_run_bias_varies_with_its_sigma():
    grade = replace(IDEAL, in_run=M_G350.in_run, correlation_s=1.0)
    population = [errors(grade, seed) for seed in range(200)]
    late = np.array([[one.corrupt(STILL) for _ in range(50)][-1][-1] for one in population]) - STILL[0]
    assert np.std(late[:, :3]) == pytest.approx(6.0 * DEG / 3600.0, rel=0.1)
    assert np.std(late[:, 3:]) == pytest.approx(0.1 * MILLI_G, rel=0.1)


def test_seed_repeats_and_differs():
    assert (errors(seed=3).corrupt(STILL) == errors(seed=3).corrupt(STILL)).all()
    assert (errors(seed=3).corrupt(STILL) != errors(seed=4).corrupt(STILL)).all()


def test_bias_is_taken_from_the_user_and_ideal_is_exact():
    given_bias = errors(gyro_bias=(0.1, -0.2, 0.3), accel_bias=(1.0, 2.0, 3.0))
    assert given_bias.bias == pytest.approx([0.1, -0.2, 0.3, 1.0, 2.0, 3.0])
    assert (errors(IDEAL).corrupt(STILL) == STILL).all()
    assert errors(IDEAL).temperature(100.0) == 25.0


def test_the_range_ends_at_300_dps_and_3_g():
    fast = errors(IDEAL).corrupt(np.array([[9.0, -9.0, 0.0, 99.0, -99.0, 0.0]]))
    assert fast[0] == pytest.approx([300 * DEG, -300 * DEG, 0.0, 3 * 9.80665, -3 * 9.80665, 0.0])
