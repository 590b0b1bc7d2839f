"""A heading given by a compass or the user: whether motion confirms it, and the test (GLR) for one that is wrong."""

import numpy as np
import pytest
from fault_matrix import judged, scene
from fault_matrix import settings_of as fault_matrix_settings
from navigation_runner import navigate, settings_of
from navigation_simulation import Later, drive, errors, received, sensed
from replay_in_process import new_filter, replay
from scipy.spatial.transform import Rotation
from simulated_errors import part
from test_navigation_aiding import estimated, headings
from test_navigation_time_offset_step import RATE
from vehicle_simulation import vehicle

from imud.compile.jit import interpreted
from imud.configuration.settings import Aiding, Initial, Navigation, Settings
from imud.estimators.ins.glr_tests.compass_offset import find_compass_offset, open_compass_offset
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ATTITUDE, COMPASS_FAULT, HEADING_BORESIGHT, NEVER_NS, VELOCITY
from imud.estimators.records import HEADING, HEADING_VALID

D = Later(drive, 90.0)  # it rests for 10 s
SIGMA = np.radians(0.5)
FREE = Settings(navigation=Navigation(vehicle="free"))
AT_SENSOR = Navigation(vehicle="free", lever_arm_sigma_m=0.0)  # the antenna
WIDE = Settings(navigation=AT_SENSOR, aiding=Aiding(heading_boresight_sigma_deg=3.0))
STATED = Settings(navigation=AT_SENSOR, aiding=Aiding(heading_boresight_sigma_deg=0.5))
KNOWN = Settings(navigation=AT_SENSOR, aiding=Aiding(heading_boresight_sigma_deg=0.001))


def run(seconds, wrong=0.0, settings=FREE, begin_s=0.0, in_units=1.0, reported=None, from_s=0.0):
    """(the filter's core, its solutions) after a drive with a compass that is off by `wrong`, rad, from begin_s on."""
    rng = np.random.default_rng(2)
    samples, fixes = sensed(D, rng), received(D, rng, late=0.1, sigma=1.2)
    rows = headings(D, rng, sigma=SIGMA)
    rows["value"][rows["t_ns"] * 1e-9 - 100.0 >= begin_s, 0] += wrong
    rows = rows[rows["t_ns"] * 1e-9 - 100.0 >= from_s]
    if reported is not None:
        rows["sigma"][:, 0] = np.radians(reported)
    rows["value"][:, 0] = np.mod(rows["value"][:, 0], 2.0 * np.pi) * in_units
    filter_ = new_filter("navigation", samples, settings)
    end_ns = int(1e9 * (100.0 + seconds))
    fixes, rows = fixes[fixes["arrival_ns"] < end_ns], rows[rows["arrival_ns"] < end_ns]
    samples = samples[samples["t_ns"] < end_ns]
    out, _ = replay(filter_, samples, fixes, rows)
    return filter_.state["core"][0, 0].copy(), out


@pytest.mark.parametrize("settings", [WIDE, KNOWN])
def test_the_effect_of_an_offset_on_the_boresight_is_predicted(settings):
    off = np.radians(1e-3)
    core, changed = (run(20.0, wrong, settings)[0] for wrong in (0.0, off))
    found = (changed["heading_aid"]["boresight"] - core["heading_aid"]["boresight"]) / off
    v = core["faults"]["boresight_sensitivity"][HEADING_BORESIGHT, COMPASS_FAULT]
    assert v == pytest.approx(found, abs=0.05)
    assert v > 0.5 if settings is WIDE else v < 0.01


def test_the_effect_of_an_offset_is_predicted():
    """Against the difference of two runs, one with a compass that is off by a little, which changes no decision."""
    off = np.radians(1e-4)
    core, changed = run(60.0, 0.0, KNOWN)[0], run(60.0, off, KNOWN)[0]
    v = core["faults"]["sensitivity"][:, COMPASS_FAULT]
    turned = (yaw_of(changed) - yaw_of(core)) / off
    assert 0.05 < v[ATTITUDE + 2] < 1.0
    assert v[ATTITUDE + 2] == pytest.approx(turned, abs=0.05)
    assert v[VELOCITY : VELOCITY + 2] == pytest.approx((changed["nav"]["v_n"] - core["nav"]["v_n"])[:2] / off, abs=0.3)


def yaw_of(core):
    w, x, y, z = core["nav"]["q_nb"]
    return np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


def sigma_of_boresight(core):
    return np.sqrt(core["cov"]["boresight_covariance"][HEADING_BORESIGHT, HEADING_BORESIGHT])


def test_only_motion_confirms_a_heading():
    assert run(9.0)[0]["compass_offset"]["unconfirmed"] == 1
    assert run(40.0)[0]["compass_offset"]["unconfirmed"] == 0


def test_a_right_compass_is_used_to_the_end_and_its_heading_valid_from_the_first_second():
    core, out = run(88.0)
    assert core["compass_offset"]["onset_ns"] != NEVER_NS and not core["heading_aid"]["distrusted"]
    assert np.all(out["status"][2 * RATE :] & HEADING_VALID)


@pytest.mark.parametrize("deg", [-4.0, 0.0, 2.0, 10.0])
def test_its_boresight_is_estimated(deg):
    """10 deg is three sigmas of what is expected of one; before the vehicle moves it is part of the yaw's sigma."""
    core, out = run(9.0, np.radians(deg), WIDE)
    aid, out = core["heading_aid"], out[-1]
    assert aid["boresight"] == pytest.approx(0.0, abs=np.radians(0.5))
    assert np.degrees(out["sigma_rpy"][2]) == pytest.approx(3.0, abs=0.3)
    core = run(88.0, np.radians(deg), WIDE)[0]
    aid, sigma = core["heading_aid"], sigma_of_boresight(core)
    assert sigma < np.radians(0.7) and not aid["distrusted"]
    assert aid["boresight"] == pytest.approx(np.radians(deg), abs=4.0 * sigma)


def standing(sigma_deg, setting="auto", seed=31):
    """(errors of the yaw, its sigmas, deg; the solutions) of a vehicle at rest with a compass; nan: it reports none."""
    d = drive(60.0, rest=100.0)
    rng = np.random.default_rng(seed)
    samples, fixes = sensed(d, rng), received(d, rng)
    rows = headings(d, rng, sigma=np.radians(0.3))
    rows["sigma"][:, 0] = np.radians(sigma_deg)
    out, _ = estimated(samples, fixes, rows, Settings(aiding=Aiding(heading_boresight_sigma_deg=setting)))
    return *(np.degrees(values) for values in yaw_error(d, out)), out


@pytest.mark.parametrize("seed", [31, 32, 33])
def test_at_rest_a_compass_of_three_tenths_of_a_degree_gives_that(seed):
    """From the second heading on after roll and pitch are known, 1.4 s after the start."""
    error, sigma, out = standing(0.3, 0.3, seed=seed)
    since = slice(round(1.5 * RATE), None)
    assert (out["status"][since] & HEADING_VALID).all()
    assert np.sqrt(np.mean(error[since] ** 2)) < 0.3 and sigma[since].max() < 0.43
    assert 0.25 < sigma[-1] < 0.4 and np.mean((error[since] / sigma[since]) ** 2) < 2.0


@pytest.mark.parametrize(
    ("sigma_deg", "setting", "prior", "sigma"),
    [
        (np.nan, "auto", 3.0, 3.0),
        (0.3, "auto", 3.0, 3.0),
        (5.0, "auto", 3.0, 3.5),
        (0.3, 0.3, 0.3, 0.37),
        (0.3, 0.1, 0.1, 0.25),
    ],
)
def test_what_is_known_of_its_boresight(sigma_deg, setting, prior, sigma):
    """By the setting; else 3 deg: what a compass reports of itself is not how it is mounted."""
    core, _ = run(9.0, settings=Settings(aiding=Aiding(heading_boresight_sigma_deg=setting)), reported=sigma_deg)
    assert np.degrees(np.sqrt(core["heading_aid"]["boresight_prior"])) == pytest.approx(prior)
    assert standing(sigma_deg, setting)[1][-1] == pytest.approx(sigma, rel=0.2)


@pytest.mark.parametrize("deg", [-4.0, 5.0, 10.0])
def test_a_boresight_that_motion_contradicts_is_estimated_as_one_of_which_nothing_was_known(deg):
    core, out = run(88.0, np.radians(deg), STATED)
    wide, of_wide = run(88.0, np.radians(deg), WIDE)
    found, expected = core["heading_aid"], wide["heading_aid"]
    assert found["boresight_prior"] == expected["boresight_prior"] and not found["distrusted"]
    sigma = sigma_of_boresight(wide)
    assert found["boresight"] == pytest.approx(expected["boresight"], abs=2.0 * sigma)
    assert sigma_of_boresight(core) == pytest.approx(sigma, rel=0.3)
    assert out["sigma_rpy"][-1, 2] == pytest.approx(of_wide["sigma_rpy"][-1, 2], rel=0.3)


def test_a_compass_that_comes_when_the_heading_is_known_is_used_though_mounted_wrong():
    """By 10 deg: its first heading is outside the gate, and its boresight then one of which nothing is known."""
    core, out = run(88.0, np.radians(10.0), from_s=45.0)
    aid = core["heading_aid"]
    assert not aid["distrusted"] and aid["last_used_ns"] > 187e9
    assert aid["boresight"] == pytest.approx(np.radians(10.0), abs=4.0 * sigma_of_boresight(core))
    assert abs(np.degrees(yaw_error(D, out)[0][-1])) < 1.5


def test_what_its_first_fixes_show_of_one_that_comes_late_is_kept():
    p = configure(FREE, 100.0).view(np.recarray)[0]
    c = start(configure(FREE, 100.0), Initial())["core"][0].view(np.recarray)[0]
    c.nav.t_ns = 500_000_000_000
    interpreted(open_compass_offset)(c, False)
    c.nav.t_ns += 1_000_000_000
    c.compass_offset.information = 2.0
    interpreted(find_compass_offset)(p, c)
    assert c.compass_offset.information == pytest.approx(2.0 * (1.0 - 1.0 / p.tuning.compass_offset_memory_s))


def test_headings_that_do_not_turn_with_the_gyros_are_found():
    """Radians for degrees, on a boat: its gyros' biases would follow the compass for minutes."""
    core, _ = run(60.0, in_units=1.0 / 57.3)
    assert core["heading_aid"]["distrusted"]
    assert not run(60.0)[0]["heading_aid"]["distrusted"]


@pytest.mark.parametrize("deg", [25.0, 180.0])
def test_a_wrong_one_is_found_within_seconds_of_motion(deg):
    core, _ = run(40.0, np.radians(deg))
    assert core["heading_aid"]["distrusted"]
    assert core["compass_offset"]["onset_ns"] == NEVER_NS


def test_an_offset_of_10_deg_is_removed_and_the_heading_stays():
    core, out = run(88.0, np.radians(10.0))
    last = out[-1]
    error = (np.degrees(yaw_of(core) - D.attitude.as_euler("ZYX")[88 * RATE - 1, 0]) + 180.0) % 360.0 - 180.0
    assert last["status"] & HEADING_VALID
    assert abs(error) < min(4.0 * np.degrees(last["sigma_rpy"][2]), 2.5)


def test_a_heading_that_its_own_compass_contradicts_before_any_motion_is_given_up():
    """For 15 s; a shorter jump is left out."""
    wrong, begin_s = np.radians(40.0), 2.0
    still = {"settings": Settings(navigation=Navigation(vehicle="free", tuning={"heading_reject_s": 3.0}))}
    assert run(4.0, wrong, begin_s=begin_s, **still)[1]["status"][-1] & HEADING_VALID
    core, out = run(7.0, wrong, begin_s=begin_s, **still)
    assert core["heading_aid"]["distrusted"] and not out["status"][-1] & HEADING_VALID


def started_with(kind, seed, off_deg, from_s=0.0):
    """(a simulated vehicle, the solutions of a filter that was given its yaw, wrong by off_deg), both from then on."""
    d, rng, first = vehicle(kind, seed), np.random.default_rng(1000 + seed), int(from_s * RATE)
    samples = sensed(d, rng, bg=rng.normal(0.0, 2e-3, 3), ba=rng.normal(0.0, 0.03, 3))[first:]
    fixes = received(d, rng, every=0.2)
    fixes = fixes[fixes["t_ns"] >= samples["t_ns"][0]]
    given = Initial(yaw_deg=float(np.degrees(d.attitude[first].as_euler("ZYX")[0])) + off_deg)
    d = part(d, slice(first, None))
    return d, navigate(samples, fixes, settings_of(profile="consumer-mems"), given)[0]


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["city", "motorway", "robot", "walk", "drone"])
def test_a_right_yaw_that_the_user_gives_is_kept(kind):
    for seed in (1, 3):
        d, out = started_with(kind, seed, 0.0)
        e, sigma = yaw_error(d, out)
        assert np.all(out["status"][2 * RATE :] & HEADING_VALID)
        assert np.all(np.abs(e) < np.maximum(4.0 * sigma, np.radians(5.0)))


@pytest.mark.thorough
@pytest.mark.parametrize("off_deg", [60.0, 180.0])
@pytest.mark.parametrize("kind", ["city", "motorway", "drone"])
def test_a_wrong_yaw_that_the_user_gives_is_found_when_the_vehicle_moves(kind, off_deg):
    """Its effect on the time offset, and so on the position, ends with it. They rest for 8 s."""
    for seed in (1, 3):
        d, out = started_with(kind, seed, off_deg)
        e, sigma = yaw_error(d, out)
        sure = (np.abs(e) > np.maximum(4.0 * sigma, np.radians(5.0))) & (out["status"] & HEADING_VALID != 0)
        assert not np.any(sure[12 * RATE :])
        last = slice(-10 * RATE, None)
        assert np.all(out["status"][last] & HEADING_VALID) and np.all(np.abs(e[last]) < np.radians(5.0))
        assert np.all(np.hypot(*errors(d, out)[0][last, :2].T) < 10.0)


@pytest.mark.parametrize(("kind", "seed", "off_deg"), [("motorway", 1, 90.0), ("motorway", 3, 130.0)])
def test_biases_and_noise_that_a_wrong_yaw_has_made_end_with_it(kind, seed, off_deg):
    """Started at speed, when neither tilt nor biases are known: all but the heading was explained by them for good."""
    d, out = started_with(kind, seed, off_deg, from_s=20.0)
    e, sigma = yaw_error(d, out)
    valid = out["status"] & HEADING_VALID != 0
    tilt = np.hypot(*errors(d, out)[2][:, :2].T)
    tilt_is_sure = tilt > np.maximum(4.0 * out["sigma_rpy"][:, :2].max(axis=1), np.radians(2.0))
    assert tilt_is_sure.sum() < 10.0 * RATE
    assert (valid & (np.abs(e) > np.maximum(4.0 * sigma, np.radians(5.0)))).sum() < 25.0 * RATE
    assert (valid & (np.abs(e) < np.radians(5.0))).sum() > 45.0 * RATE


def yaw_error(d, out):
    """(error of the yaw, rad; its sigma)"""
    q = Rotation.from_quat(out["q_nb"], scalar_first=True)
    e = q.as_euler("ZYX")[:, 0] - d.attitude.as_euler("ZYX")[: len(out), 0]
    return (e + np.pi) % (2.0 * np.pi) - np.pi, out["sigma_rpy"][:, 2]


@pytest.mark.parametrize(("where", "deg"), [("city", 20.0), ("boat", -25.0), ("drone", 20.0)])
def test_a_compass_that_is_turned_under_way_is_used_again_with_another_boresight(where, deg):
    """The fixes show the heading meanwhile. At the end, without fixes, the yaw is as good as with a right compass."""
    d, samples, fixes = scene(61, where)
    rms = []
    for turned in (0.0, deg):
        rows = headings(d, np.random.default_rng(61), sigma=np.radians(0.5))
        rows["value"][rows["t_ns"] > 150e9, 0] += np.radians(turned)
        filter_ = new_filter("navigation", samples, fault_matrix_settings(None, where))
        out, innovations = replay(filter_, samples, fixes, rows)
        found, core = judged(d, out), filter_.state["core"][0, 0]
        rms.append(found.rms["yaw"])
        assert found.sure_s == 0.0, found.worst
    of_compass = innovations[innovations["kind"] == HEADING]
    assert not of_compass["used"][(of_compass["t_ns"] > 151e9) & (of_compass["t_ns"] < 160e9)].any()
    assert of_compass["used"][of_compass["t_ns"] > 170e9].mean() > 0.98
    boresight = np.degrees(core["heading_aid"]["boresight"])
    assert abs(boresight - deg) < 4.0 * np.degrees(sigma_of_boresight(core)) + 0.5
    assert rms[1] < 1.3 * rms[0] + 0.3
