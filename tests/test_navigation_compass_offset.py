"""A compass that gives the heading: whether the motion confirms it, and the test (GLR) for one that is wrong."""

import numpy as np
import pytest
from navigation_simulation import drive, received, sensed
from replay_in_process import new_filter
from test_navigation_aiding import headings
from test_navigation_stamps import RATE

from imud.batch import play
from imud.configuration.settings import Navigation, Settings
from imud.estimators.ins.state import ATTITUDE, NEVER_NS, VELOCITY
from imud.estimators.records import HEADING_VALID

D = drive(90.0)  # it rests for 10 s
SIGMA = np.radians(0.5)
FREE = Settings(navigation=Navigation(vehicle="free"))


def run(seconds, wrong=0.0, settings=FREE, begin_s=0.0):
    """(the filter's core, its solutions) after a drive with a compass that is off by `wrong`, rad, from begin_s on."""
    rng = np.random.default_rng(2)
    samples, fixes = sensed(D, rng), received(D, rng, late=0.1, sigma=1.2)
    rows = headings(D, rng, sigma=SIGMA)
    rows["value"][rows["t_ns"] * 1e-9 - 100.0 >= begin_s, 0] += wrong
    filter_ = new_filter("navigation", samples, settings)
    end_ns, blocks = int(1e9 * (100.0 + seconds)), []
    fixes, rows = fixes[fixes["arrival_ns"] < end_ns], rows[rows["arrival_ns"] < end_ns]
    samples = samples[samples["t_ns"] < end_ns]
    play(filter_, samples, fixes, lambda block: blocks.append(block.copy()), None, lambda innovations: None, rows)
    return filter_.state["core"][0, 0].copy(), np.concatenate(blocks)


def test_the_effect_of_an_offset_is_predicted():
    """Against the difference of two runs, one with a compass that is off by a thousandth of a degree."""
    off = np.radians(1e-3)
    core, changed = run(60.0)[0], run(60.0, off)[0]
    w = core["compass_offset"]["sensitivity"][:, 0]
    turned = (yaw_of(changed) - yaw_of(core)) / off
    assert -1.0 < w[ATTITUDE + 2] < -0.05
    assert w[ATTITUDE + 2] == pytest.approx(-turned, abs=0.05)
    assert w[VELOCITY : VELOCITY + 2] == pytest.approx((core["nav"]["v_n"] - changed["nav"]["v_n"])[:2] / off, abs=0.3)


def yaw_of(core):
    w, x, y, z = core["nav"]["q_nb"]
    return np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


def test_only_motion_confirms_a_heading():
    assert run(9.0)[0]["compass_offset"]["unconfirmed"] == 1
    assert run(40.0)[0]["compass_offset"]["unconfirmed"] == 0


def test_a_right_compass_is_used_to_the_end_and_its_heading_valid_from_the_first_second():
    core, out = run(88.0)
    assert core["compass_offset"]["onset_ns"] != NEVER_NS and not core["heading_aid"]["distrusted"]
    assert np.all(out["status"][2 * RATE :] & HEADING_VALID)


@pytest.mark.parametrize("deg", [10.0, 25.0, 180.0])
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
