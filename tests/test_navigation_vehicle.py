"""What the filter learns of the vehicle that it rides on: the gyro's error in turns, its axis, and how it rests."""

from types import SimpleNamespace

import numpy as np
import pytest
from in_c import Module
from navigation_runner import navigate
from navigation_simulation import drive, errors, received, sensed
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Initial, Navigation, Settings
from imud.daemon.status_reporter import StatusReporter
from imud.daemon.utc import Utc
from imud.estimators.ins import rest, stationarity
from imud.estimators.ins.aiding import forward_axis_search, land_evidence, non_holonomic
from imud.estimators.ins.findings import _NO_LAND_VEHICLE, findings
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import AUTO, GYRO_SCALE, NAVIGATING, NHC_LEVER_ARM, STATES
from imud.math.kalman import unpack
from imud.process.contained import ContainedErrors

rest = Module(rest)
stationarity = Module(stationarity)
forward_axis_search = Module(forward_axis_search)
non_holonomic = Module(non_holonomic)

PARAMETERS = configure(Settings(), 100.0)[0]
LN_REST, LN_MOTION = np.log(0.0014), np.log(0.009)  # of the gyro's deviation in rad/s, a car's in Tokyo


@pytest.mark.parametrize("scale, cross", [(0.008, 0.0), (-0.006, 0.004)])
def test_what_the_gyro_shows_too_much_in_turns_is_found(scale, cross):
    rng = np.random.default_rng(1)
    d = drive(240.0)
    d.w = d.w + d.w[:, 2:] * (cross, 0.0, scale)
    _, _, s = navigate(sensed(d, rng), received(d, rng, sigma=0.5, late=0.2))
    c = s["core"][0, 0]
    sigma = np.sqrt(np.diag(unpack(c["cov"]["P"], STATES))[GYRO_SCALE + 6 : GYRO_SCALE + 9])
    assert sigma[2] < 0.003
    assert (np.abs(c["nav"]["gyro_scale"][6:] - (cross, 0.0, scale)) < 4.0 * sigma).all()
    assert c["nav"]["gyro_scale"][8] == pytest.approx(scale, abs=0.003)


@pytest.mark.parametrize("arm, swing, speed", [(1.6, 0.6, 8.0), (-0.8, 0.6, 8.0), (0.3, 2.0, 1.0), (1.6, 2.0, 4.0)])
def test_where_the_vehicle_turns_about_is_found_forwards_and_in_reverse(arm, swing, speed):
    rng = np.random.default_rng(2)
    d = drive(240.0, arm=arm, swing=swing, speed=speed)
    out, _, s = navigate(sensed(d, rng), received(d, rng, sigma=0.5, late=0.2))
    c = s["core"][0, 0]
    ahead = np.sign(c["nav"]["forward"][0])  # a vehicle that has begun in reverse has its axis the other way round
    sigma = np.sqrt(np.diag(unpack(c["cov"]["P"], STATES))[NHC_LEVER_ARM])
    assert c["nhc"]["enabled"] == 1
    assert sigma < 0.3
    assert abs(ahead * c["nav"]["nhc_lever_arm"] - arm) < 4.0 * sigma
    heading = np.degrees(errors(d, out)[2][:, 2])[-10000:]
    assert np.sqrt(np.mean(heading**2)) < 2.0


def travelled(heading_deg, velocity, speed_sigma=0.1, vehicle="auto", every_s=0.5, lateral_share=1.0, enable=True):
    """The core after windows with these headings and body velocities (forward, right, down), each with a fresh fix.

    lateral_share: of the force of turns, how much is lateral; the rest is that of a vehicle that leans. enable: the
    constraint, once the axis is found.
    """
    settings = Settings(navigation=Navigation(vehicle=vehicle))
    p = configure(settings, 100.0)
    c = start(p, Initial(lat_deg=50.0, lon_deg=8.0, yaw_deg=10.0))["core"][0, 0]
    P = np.diag([1.0] * 3 + [speed_sigma**2] * 3 + [1e-4] * 2 + [np.radians(5.0) ** 2] + [1e-4] * (STATES - 9))
    c["cov"]["P"], c["alignment"]["mode"] = P[np.triu_indices(STATES)], NAVIGATING
    for k, (heading, v) in enumerate(zip(heading_deg, velocity, strict=True)):
        attitude = Rotation.from_euler("z", heading, degrees=True)
        c["nav"]["q_nb"], c["nav"]["v_n"] = np.roll(attitude.as_quat(), 1), attitude.apply(v)
        c["nav"]["t_ns"] = c["gnss"]["last_used_ns"] = int(1e9 * every_s * k)
        c["imu"]["rate_b"][2] = np.radians(np.gradient(heading_deg)[k]) / every_s
        c["stationarity"]["mean_f"] = np.cross((0.0, 0.0, lateral_share * c["imu"]["rate_b"][2]), v) - (0.0, 0.0, 9.8)
        if forward_axis_search.find_forward_axis(p[0], c) and enable:
            non_holonomic.enable_nhc(p[0], c)
    return c


def test_the_axis_of_a_robot_that_turns_and_reverses_is_found_within_ten_seconds():
    k = np.arange(20)
    along = np.where(k % 8 < 4, -0.8, 0.9)
    c = travelled(4.0 * k, np.column_stack([0.2 * along, along, 0.0 * along]))
    assert c["nhc"]["enabled"] == 1
    assert np.abs(c["nav"]["forward"]) == pytest.approx(np.array([0.2, 1.0, 0.0]) / np.hypot(0.2, 1.0), abs=1e-6)


def test_a_line_over_ground_is_no_axis_of_a_vehicle():
    k = np.arange(60)
    back_and_forth = np.column_stack([0.0 * k, np.where(k % 8 < 4, -3.0, 3.0), 0.0 * k])
    assert travelled(0.5 * np.sin(k), back_and_forth)["nhc"]["enabled"] == 0
    assert travelled(0.5 * np.sin(k), back_and_forth, vehicle="land")["nhc"]["enabled"] == 1
    turning = Rotation.from_euler("z", -3.0 * k[:, None], degrees=True).apply([3.0, 0.0, 0.0])  # on the spot, in flight
    assert travelled(3.0 * k, turning)["nhc"]["enabled"] == 0


def test_a_velocity_in_every_direction_is_not_of_a_land_vehicle():
    rng = np.random.default_rng(3)
    slide = np.column_stack([4.0 + rng.standard_normal(100), 1.5 * rng.standard_normal(100), np.zeros(100)])
    assert travelled(3.0 * np.arange(100), slide)["nhc"]["enabled"] == 0


def test_a_flight_that_looks_like_a_drive_for_some_seconds_is_none():
    k = np.arange(60)
    along = np.column_stack([3.0 + 0.0 * k, 0.27 * (-1.0) ** k, 0.0 * k])  # across: 0.8 of what the doubts explain
    assert travelled(3.0 * k[:12], along[:12])["nhc"]["enabled"] == 0
    assert travelled(3.0 * k, along)["nhc"]["enabled"] == 1


@pytest.mark.parametrize("current, land", [(0.0, True), (0.1, True), (0.8, False), (1.5, False)])
def test_turns_refute_a_land_vehicle_that_a_current_carries(current, land):
    heading = 150.0 * np.sin(0.05 * np.arange(100))
    to_the_east = np.column_stack([np.sin(np.radians(heading)), np.cos(np.radians(heading)), 0.0 * heading])
    c = travelled(heading, (5.0, 0.0, 0.0) + current * to_the_east, enable=False)
    assert land_evidence.refutes_land_vehicle(PARAMETERS, c) == (not land)
    assert land_evidence.shows_land_vehicle(PARAMETERS, c) == land


@pytest.mark.parametrize("lateral_share, land", [(1.0, 1), (0.0, 0)])
def test_a_vehicle_that_leans_into_turns_is_no_land_vehicle(lateral_share, land):
    heading = 150.0 * np.sin(0.05 * np.arange(100))
    along = np.column_stack([5.0 + 0.0 * heading, 0.0 * heading, 0.0 * heading])
    assert travelled(heading, along, lateral_share=lateral_share)["nhc"]["enabled"] == land


@pytest.mark.parametrize("lateral, enabled", [(0.05, 1), (1.5, 0)])
def test_a_land_vehicle_by_the_settings_that_keeps_sliding_is_none(lateral, enabled):
    p = configure(Settings(navigation=Navigation(vehicle="land")), 100.0)
    state = start(p, Initial(lat_deg=50.0, lon_deg=8.0, yaw_deg=0.0))
    c = state["core"][0, 0]
    known = np.diag([1.0] * 3 + [0.01] * 3 + [1e-4] * (STATES - 6))[np.triu_indices(STATES)]
    c["cov"]["P"], c["alignment"]["mode"] = known, NAVIGATING
    c["nhc"]["down_sum"], c["nhc"]["principal_axis"] = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    non_holonomic.enable_nhc(p[0], c)
    for k in range(20 * int(p["tuning"]["nhc_sum_length"][0])):
        c["nav"]["t_ns"] = c["gnss"]["last_used_ns"] = k * 100_000_000
        c["nav"]["v_n"], c["nav"]["q_nb"], c["cov"]["P"] = (5.0, lateral, 0.0), (1.0, 0.0, 0.0, 0.0), known
        if c["nhc"]["enabled"]:
            non_holonomic.fuse_nhc(p[0], c)
    assert c["nhc"]["enabled"] == enabled
    assert c["nhc"]["disable_count"] == 1 - enabled
    assert findings(p, state) == (() if enabled else (_NO_LAND_VEHICLE,))
    p["vehicle"] = AUTO
    assert findings(p, state) == ()


def test_the_log_says_that_the_setting_is_not_used_and_when_it_is_again():
    found = (_NO_LAND_VEHICLE,)
    inertial = SimpleNamespace(pipeline=SimpleNamespace(filter=SimpleNamespace(findings=lambda: found)))
    in_use = SimpleNamespace(by_kind=dict, imu=None, gnss=None, aiding_sensors={}, receivers=list)
    devices = SimpleNamespace(
        selection=SimpleNamespace(inertial=inertial), in_use=in_use, spares=SimpleNamespace(sensors={})
    )
    reporter, lines = StatusReporter(devices, ContainedErrors(), Utc()), []
    reporter._change_logger._log = SimpleNamespace(warning=lines.append, info=lines.append)
    for second in range(6):
        found = (_NO_LAND_VEHICLE,) if second < 3 else ()
        reporter._check_all(second * 10**9)
    assert lines == [_NO_LAND_VEHICLE, f"has ended: {_NO_LAND_VEHICLE}"]


@pytest.mark.parametrize("millimetres, hertz, heaves", [(20.0, 1.8, True), (2.0, 4.0, False), (0.0, 1.0, False)])
def test_steps_heave_and_wheels_do_not(millimetres, hertz, heaves):
    p = configure(Settings(), 100.0)
    c = start(p, Initial())["core"][0, 0]
    for t in 0.1 * np.arange(300):
        vertical = 1e-3 * millimetres * 2.0 * np.pi * hertz * np.cos(2.0 * np.pi * hertz * t)
        land_evidence.add_heave(p[0], c, vertical, 1.2, 0.1)
    assert land_evidence.heaves(c) == heaves
    assert land_evidence.refutes_land_vehicle(p[0], c) == heaves


@pytest.mark.parametrize("gap_s", [3.0, 60.0])
def test_a_gap_between_updates_is_no_heave(gap_s):
    """The sensor was not read, or the constraint had to wait: what happened meanwhile is not known."""
    p = configure(Settings(), 100.0)
    c = start(p, Initial())["core"][0, 0]
    for dt, vertical in (*[(0.1, 0.0)] * 50, (gap_s, 0.03), *[(0.1, 0.03)] * 50):
        land_evidence.add_heave(p[0], c, vertical, 8.0, dt)
    assert not land_evidence.heaves(c)


def test_velocities_from_before_the_heading_was_known_rotate_with_it():
    """The axis found in a level frame of arbitrary heading, then turned to north, is that of one gathered in north."""
    k = np.arange(12)
    along = np.column_stack([0.3 + 0.0 * k, 0.9 + 0.0 * k, 0.1 * np.sin(k)])
    straight = travelled(2.0 * k, along)
    psi = np.radians(70.0)
    v, q, spread = (
        straight["nav"]["v_n"].copy(),
        straight["nav"]["q_nb"].copy(),
        straight["nhc"]["velocity_scatter"].copy(),
    )
    back = Rotation.from_rotvec([0.0, 0.0, -psi])
    straight["nav"]["q_nb"] = np.roll((back * Rotation.from_quat(np.roll(q, -1))).as_quat(), 1)
    forward_axis_search.rotate_scatter(straight, -psi)  # as if the heading had been wrong by psi all the time
    assert np.abs(straight["nhc"]["velocity_scatter"] - spread).max() > 0.1 * np.abs(spread).max()
    forward_axis_search.rotate_scatter(straight, psi)
    assert straight["nhc"]["velocity_scatter"] == pytest.approx(spread)
    turned = Rotation.from_quat(np.roll(q, -1)).inv().apply(v)  # the last velocity, in the body
    matrix = np.zeros((3, 3))
    matrix[np.triu_indices(3)] = spread
    main = np.linalg.eigh(matrix + np.triu(matrix, 1).T)[1][:, -1]
    assert abs(main @ turned) / np.linalg.norm(turned) > 0.98


def core():
    """A navigating core, without a fix for a minute, whose velocity has drifted to 1.2 +- 0.6 m/s."""
    s = start(configure(Settings(), 100.0), Initial(lat_deg=50.0, lon_deg=8.0, yaw_deg=10.0))
    c = s["core"][0, 0]
    c["alignment"]["mode"], c["gnss"]["fix_count"], c["gnss"]["last_used_ns"], c["nav"]["t_ns"] = (
        NAVIGATING,
        100,
        0,
        60_000_000_000,
    )
    c["nav"]["v_n"], c["stationarity"]["low_motion_count"], c["stationarity"]["sample_count"] = (1.2, 0.0, 0.0), 12, 50
    P = np.diag([25.0] * 2 + [1.0] + [0.36] * 3 + [1e-6] * 3 + [1e-10] * 3 + [1e-4] * 3 + [1.0] * (STATES - 15))
    c["cov"]["P"] = P[np.triu_indices(STATES)]
    c["stationarity"]["duration"], c["stationarity"]["delta_v"] = 0.5, 0.5 * np.array([0.02, 0.0, -9.81])
    return s, c


def learned(c, at_rest, in_motion, spread):
    rng = np.random.default_rng(0)
    for _ in range(200):
        stationarity.learn_class(PARAMETERS, c["stationarity"]["rest_class"], at_rest + spread * rng.standard_normal())
        stationarity.learn_class(
            PARAMETERS, c["stationarity"]["slow_motion_class"], in_motion + spread * rng.standard_normal()
        )


def test_rest_is_detected_in_an_outage_though_the_velocity_has_drifted():
    _, c = core()
    assert not rest.detect_rest(PARAMETERS, c)
    learned(c, LN_REST, LN_MOTION, 0.4)
    for _ in range(5):
        stationarity.update_evidence(PARAMETERS, c, LN_REST)
    assert not rest.detect_rest(PARAMETERS, c)  # too soon to be sure
    for _ in range(5):
        stationarity.update_evidence(PARAMETERS, c, LN_REST)
    assert rest.detect_rest(PARAMETERS, c)


def test_motion_braking_and_speed_are_no_rest():
    for spoil in ("motion", "braking", "speed"):
        _, c = core()
        learned(c, LN_REST, LN_MOTION, 0.4)
        for _ in range(20):
            stationarity.update_evidence(PARAMETERS, c, LN_MOTION if spoil == "motion" else LN_REST)
        if spoil == "braking":
            c["stationarity"]["delta_v"][0] = 0.5 * 0.8
        if spoil == "speed":
            c["nav"]["v_n"][0] = 5.0
        assert not rest.detect_rest(PARAMETERS, c), spoil


def test_a_car_as_smooth_in_motion_as_at_rest_is_never_taken_for_resting():
    _, c = core()
    learned(c, LN_REST, LN_REST + 0.1, 0.4)
    for _ in range(60):
        stationarity.update_evidence(PARAMETERS, c, LN_REST)
    assert not rest.detect_rest(PARAMETERS, c)
