"""Before the heading is known: place and velocity are filtered all the same, and nothing is lost when it is found."""

import numpy as np
import pytest
from accuracy_simulated import figures
from in_c import in_c
from navigation_runner import fixes_of, navigate, samples_of
from navigation_simulation import Later, curvature, drive, errors, received, sensed
from scipy.spatial.transform import Rotation

from imud.configuration.settings import Imu, Initial, Navigation, Settings
from imud.estimators.ins import ESTIMATOR
from imud.estimators.ins.alignment.modes import transfer_lever_arm
from imud.estimators.ins.state import ATTITUDE, POSITION, STATES, TIME_OFFSET
from imud.estimators.records import AT_REST, HEADING_VALID, POSITION_N, REJECTING, VELOCITY_N
from imud.math.kalman import packed_index

transfer_lever_arm = in_c(transfer_lever_arm)

RATE = 100
PARKED = Later(drive, 120.0, rest=1e3)
UNDER_WAY = Later(drive, 60.0, rest=0.0, fast_start=True)
WINDING = Later(drive, 40.0)
CIRCLE = Later(drive, 60.0, rest=0.0, swing=0.0, fast_start=True)
LEVER = (3.0, 1.0, -1.0)


def at(seconds):
    return int(seconds * RATE)


def headed(out):
    return (out["status"] & HEADING_VALID) > 0


def silent(fixes):
    fixes["speed"] = fixes["course"] = np.nan
    return fixes


def at_antenna(d, fixes, lever):
    """The fixes as an antenna gets them that is `lever` m (body) from the sensor."""
    k = np.round((fixes["t_ns"] * 1e-9 - 100.0) * RATE).astype(int)
    arm = d.attitude[k].apply(lever)
    m, n = curvature(fixes["lat"])
    fixes["lat"] += arm[:, 0] / m
    fixes["lon"] += arm[:, 1] / (n * np.cos(fixes["lat"]))
    fixes["height"] -= arm[:, 2]
    v = d.v[k] + d.attitude[k].apply(np.cross(d.w[k], lever))
    fixes["speed"], fixes["course"] = np.hypot(v[:, 0], v[:, 1]), np.arctan2(v[:, 1], v[:, 0])
    return fixes


def test_a_parked_vehicle_is_located_better_than_by_a_fix_and_as_well_as_claimed():
    last, filtered, normalised = [], [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        fixes = received(PARKED, rng, sigma=1.8, white=1.5)
        out, _, _ = navigate(sensed(PARKED, rng), fixes)
        assert not headed(out).any()
        p = errors(PARKED, out)[0]
        m, n = curvature(PARKED.lat[0])
        north, east = (fixes["lat"] - PARKED.lat[0]) * m, (fixes["lon"] - PARKED.lon[0]) * n * np.cos(PARKED.lat[0])
        last.append(np.mean(np.column_stack([north, east])[60:] ** 2))
        filtered.append(np.mean(p[at(60.0) :, :2] ** 2))
        normalised.append(np.mean((p / out["sigma_p"])[at(60.0) :] ** 2))
    assert np.mean(filtered) < 0.4 * np.mean(last)
    assert 0.5 < np.mean(normalised) < 1.6


def test_the_position_of_a_parked_vehicle_is_never_better_than_the_correlated_receiver_error():
    d = drive(1500.0, rate=20, rest=1e4)
    rng = np.random.default_rng(1)
    out, _, _ = navigate(sensed(d, rng), received(d, rng, sigma=1.8, white=0.3))
    assert (out["sigma_p"][20 * 3 :, :2] > 0.89).all()  # half of 2 m x 0.9
    assert np.median(out["sigma_p"][20 * 600 :, 0]) < 1.0


@pytest.mark.thorough
@pytest.mark.parametrize("with_speed", [True, False], ids=["speed", "positions"])
@pytest.mark.parametrize("d", [UNDER_WAY, CIRCLE], ids=["curves", "constant speed"])
def test_under_way_position_and_velocity_are_as_good_as_claimed(d, with_speed):
    place, velocity = [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        fixes = received(d, rng, late=0.2, sigma=1.8, white=0.5, speed_sigma=0.1)
        out, rows, _ = navigate(sensed(d, rng), fixes if with_speed else silent(fixes))
        before = ~headed(out)
        before[: at(4.0)] = False
        p, v, _ = errors(d, out)
        place.append((p / out["sigma_p"])[before] ** 2)
        velocity.append((v / out["sigma_v"])[before] ** 2)
        assert (rows["kind"] == POSITION_N).any()
    assert 0.1 < np.concatenate(place).mean() < 2.0
    assert np.concatenate(velocity).mean() < 2.0


@pytest.mark.parametrize("with_speed", [True, False], ids=["speed", "positions"])
def test_a_jump_is_refused_before_the_heading_is_known(with_speed):
    rng = np.random.default_rng(1)
    fixes = received(PARKED, rng)
    jump = (fixes["t_ns"] >= 130e9) & (fixes["t_ns"] < 133e9)
    fixes["lat"][jump] += 100.0 / 6.37e6
    out, _, _ = navigate(sensed(PARKED, rng), fixes if with_speed else silent(fixes))
    p = errors(PARKED, out)[0]
    assert np.abs(p[at(10.0) :, :2]).max() < 5.0
    assert (out["status"][at(30.5) : at(32.5)] & REJECTING).all()
    assert not (out["status"][at(34.5) :] & REJECTING).any()


def test_a_given_position_is_replaced_by_the_first_fix():
    rng = np.random.default_rng(1)
    start = Initial(lat_deg=48.01, lon_deg=11.0, height_m=500.0)
    out, _, _ = navigate(sensed(PARKED, rng), received(PARKED, rng), None, start)
    assert np.abs(errors(PARKED, out)[0][at(1.2) :, :2]).max() < 5.0
    assert not (out["status"] & REJECTING).any()


def test_a_distant_position_is_accepted_in_the_end():
    rng = np.random.default_rng(1)
    fixes = received(PARKED, rng)
    fixes["lat"][fixes["t_ns"] >= 130e9] += 1000.0 / 6.37e6
    out, _, _ = navigate(sensed(PARKED, rng), fixes)
    assert np.abs(errors(PARKED, out)[0][at(45.0) :, 0] + 1000.0).max() < 6.0


def test_when_the_heading_is_found_the_position_moves_from_the_antenna_to_the_sensor():
    after = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        fixes = at_antenna(UNDER_WAY, received(UNDER_WAY, rng, sigma=0.01, white=0.02, late=0.2), LEVER)
        fixes["sigma"] = 0.03
        settings = Settings(imu=Imu(profile="consumer-mems"), navigation=Navigation(lever_arm_m=LEVER))
        out, _, _ = navigate(sensed(UNDER_WAY, rng), fixes, settings)
        p = errors(UNDER_WAY, out)[0][:, :2]
        begin = np.flatnonzero(headed(out))[0]
        before = slice(at(3.0), begin)
        assert (np.abs(p[before]) < 3.0 * out["sigma_p"][before, :2]).all()
        assert (out["sigma_p"][before, :2] > 3.3).all()  # the whole arm: its direction is not known
        after.append((p / out["sigma_p"][:, :2])[begin + at(0.5) : begin + at(5.0)] ** 2)
    assert np.concatenate(after).mean() < 2.5


@pytest.mark.parametrize("velocity", [True, False])
def test_heading_is_found_with_an_antenna_far_from_the_sensor(velocity):
    """In the curves the antenna moves against the sensor as fast as a tenth of the drive."""
    normalised = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        fixes = at_antenna(WINDING, received(WINDING, rng, every=0.2, sigma=0.01, white=0.01), (1.5, 0.5, -2.0))
        fixes["sigma"] = 0.02
        settings = Settings(navigation=Navigation(lever_arm_m=(1.5, 0.5, -2.0)))
        out, _, _ = navigate(sensed(WINDING, rng), fixes if velocity else silent(fixes), settings)
        first = np.flatnonzero(headed(out))[0]
        error = errors(WINDING, out)[2][first : first + at(5.0), 2]
        assert np.abs(error).max() < np.radians(8.0)
        normalised.append((error / out["sigma_rpy"][first : first + at(5.0), 2]) ** 2)
    assert np.mean(normalised) < 1.0


def test_a_given_position_is_that_of_the_sensor():
    known = Initial(lat_deg=48.0, lon_deg=11.0, height_m=500.0, roll_deg=0.0, pitch_deg=0.0, yaw_deg=np.degrees(0.7))
    rng = np.random.default_rng(1)
    fixes = received(PARKED, rng)[30:]
    out, _, _ = navigate(sensed(PARKED, rng), fixes, Settings(navigation=Navigation(lever_arm_m=LEVER)), known)
    assert headed(out)[: at(5.0)].all()
    assert np.abs(errors(PARKED, out)[0][: at(5.0)]).max() < 0.1


def test_who_climbs_as_the_first_fix_comes_does_so_from_then_on():
    d = drive(30.0, rest=0.0, fast_start=True)
    d.v[:, 2] -= 10.0
    d.height += 10.0 * d.t
    rng = np.random.default_rng(1)
    fixes = received(d, rng)
    fixes["v"] = d.v[np.round((fixes["t_ns"] * 1e-9 - 100.0) * RATE).astype(int)] + 0.05 * rng.standard_normal((29, 3))
    out, rows, _ = navigate(sensed(d, rng), fixes)
    assert rows["used"][rows["kind"] == VELOCITY_N + 2].all()
    assert np.abs(errors(d, out)[1][at(1.1) :, 2]).max() < 1.0


def test_from_antenna_to_sensor_and_back_changes_nothing():
    c = ESTIMATOR.start(ESTIMATOR.configure(Settings(), 100.0), Initial(lat_deg=48.0, lon_deg=11.0, height_m=500.0))[0]
    c = c["core"][0]
    c["nav"]["q_nb"] = [0.5, 0.5, -0.5, 0.5]
    c["nav"]["v_n"] = [3.0, -4.0, 1.0]
    c["nav"]["gnss_lever_arm"], c["imu"]["w"] = LEVER, [0.1, -0.2, 0.3]
    transfer_lever_arm(c, -1.0)
    assert c["nav"]["lat"] == np.radians(48.0)  # given by a user: it is the sensor's
    c["gnss"]["last_used_ns"] = 0
    C = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])  # that attitude as a matrix
    arm, v = C @ LEVER, [3.0, -4.0, 1.0] - C @ np.cross([0.1, -0.2, 0.3], LEVER)
    place, P = (float(c["nav"]["lat"]), float(c["nav"]["lon"]), float(c["nav"]["height"])), c["cov"]["P"].copy()
    transfer_lever_arm(c, 1.0)
    variance = lambda P, i: P[packed_index(STATES, i, i)]  # noqa: E731
    swung = arm[2] ** 2 * variance(P, ATTITUDE) + arm[0] ** 2 * variance(P, ATTITUDE + 2)
    gained = variance(c["cov"]["P"], POSITION + 1) - variance(P, POSITION + 1)
    assert gained == pytest.approx(v[1] ** 2 * variance(P, TIME_OFFSET) + swung)
    m, n = curvature(place[0])
    moved = [(c["nav"]["lat"] - place[0]) * (m + 500.0), (c["nav"]["lon"] - place[1]) * (n + 500.0) * np.cos(place[0])]
    assert [*moved, place[2] - c["nav"]["height"]] == pytest.approx(-arm, abs=1e-5)
    assert c["nav"]["v_n"] == pytest.approx(v)
    transfer_lever_arm(c, -1.0)
    assert (c["nav"]["lat"], c["nav"]["lon"], c["nav"]["height"]) == pytest.approx(place, abs=1e-12, rel=1e-12)
    assert c["nav"]["v_n"] == pytest.approx([3.0, -4.0, 1.0])
    assert c["cov"]["P"] == pytest.approx(P, rel=1e-9)


def even_ride(speed, first_s):
    """A minute and a half of even motion to the north, of which a receiver sends positions alone, from `first_s` on."""
    rng, t = np.random.default_rng(3), 100.0 + np.arange(at(90.0)) / RATE
    w, f = rng.normal(0.0, 1e-3, (len(t), 3)), rng.normal((0.0, 0.0, -9.81), 0.02, (len(t), 3))
    epochs = 100.0 + np.arange(first_s, 90.0)
    m, n = curvature(np.radians(50.0))[0], len(epochs)
    north = speed * (epochs - 100.0) + rng.normal(0.0, 0.5, n)
    columns = {"t_s": epochs, "arrival_s": epochs + 0.2, "lat_deg": 50.0 + np.degrees(north / m)}
    columns |= {"lon_deg": np.full(n, 8.0), "height_m": np.full(n, 100.0), "hdop": np.ones(n)}
    out, _, _ = navigate(samples_of(t, w, f), fixes_of(columns, n))
    return out, ((out["lat"] - np.radians(50.0)) * m - speed * (t - 100.0)) / out["sigma_p"][:, 0]


@pytest.mark.parametrize("speed", [4.0, 20.0])
def test_an_even_ride_of_which_no_velocity_is_reported_is_no_rest_as_its_positions_go_on(speed):
    out, normalised = even_ride(speed, 0.0)
    assert not (out["status"] & (AT_REST | REJECTING)).any()
    assert np.abs(normalised[at(2.0) :]).max() < 3.0


@pytest.mark.parametrize("speed", [4.0, 20.0])
def test_an_even_ride_is_no_rest_twenty_seconds_after_the_first_fix(speed):
    out, normalised = even_ride(speed, 25.0)
    assert (out["status"][: at(25.0)] & AT_REST).any()
    assert not (out["status"][at(45.0) :] & (AT_REST | REJECTING)).any()
    assert np.abs(normalised[at(45.0) :]).max() < 3.0


@pytest.mark.parametrize("angle_deg", [25.0, 40.0])
def test_a_tilt_that_a_slip_makes_wrong_before_the_heading_is_stated(angle_deg):
    """The sensor slips in its mount under way: a level force of 4 or 6 m/s^2 is no acceleration of a car.

    That of 25 degrees was never stated while an acceleration was as new in each mean force.
    """
    d = drive(60.0, speed=3.0)
    rng = np.random.default_rng(12)
    samples, fixes = sensed(d, rng), received(d, rng, late=0.1)
    fixes["speed"] = fixes["course"] = np.nan
    slipped, at_s = Rotation.from_euler("x", angle_deg, degrees=True), 12.5
    for name in ("w", "f"):
        samples[name][at(at_s) :] = slipped.inv().apply(samples[name][at(at_s) :])
    out = navigate(samples, fixes)[0]
    since = slice(at(at_s + 8.0), None)
    down = np.array([0.0, 0.0, 1.0])
    estimated = Rotation.from_quat(out["q_nb"][since][:, [1, 2, 3, 0]]).inv().apply(down)
    right = (d.attitude[since] * slipped).inv().apply(down)
    tilt = np.degrees(np.arccos(np.clip(np.sum(estimated * right, axis=1), -1.0, 1.0)))
    assert (tilt < 4.0 * np.degrees(out["sigma_rpy"][since, :2]).max(axis=1)).all()
    assert tilt[at(4.0) :].max() < 10.0


@pytest.mark.parametrize("seed", [2902, 2903])
def test_a_departure_without_a_jerk_is_no_rest(seed):
    """A tram whose force grows by less from window to window than at rest, but by more since the rest began."""
    assert figures("tram", "5 Hz", 0.0, seed)["tilt s"] == 0.0  # 5 and 9 s, 11 deg off
