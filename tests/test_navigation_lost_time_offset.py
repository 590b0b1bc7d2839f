"""A time offset beyond the fusion horizon would reject all fixes for ever: it is wrong, and found anew."""

import numpy as np
import pytest
from navigation_runner import settings_of
from navigation_simulation import drive, errors, received, sensed
from replay_in_process import new_filter, replay

from imud.estimators.records import COASTING, HEADING_VALID, POSITION_N

RATE, BEGIN_S, OFFSET_S = 100, 60.0, 3.7


@pytest.mark.parametrize(("least_s", "is_given_up"), [(1.5, True), (100.0, False)])
def test_a_time_offset_that_no_receiver_has_is_given_up_and_the_fixes_are_used_again(least_s, is_given_up):
    rng, d = np.random.default_rng(3), drive(120.0)
    samples, fixes = sensed(d, rng), received(d, rng, every=0.2, late=0.1, sigma=0.5)
    later, begin_ns = samples["t_ns"] >= (100.0 + BEGIN_S) * 1e9, (100.0 + BEGIN_S) * 1e9
    filter_ = new_filter("navigation", samples, settings_of(tuning={"lost_time_offset_s": least_s}))
    before, _ = replay(filter_, samples[~later], fixes[fixes["arrival_ns"] < begin_ns])
    s = filter_.state
    s["last_time_offset"] = s["core"]["nav"]["time_offset"] = OFFSET_S
    s["last_fusion_ns"] -= round(OFFSET_S * 1e9)
    out, innovations = replay(filter_, samples[later], fixes[fixes["arrival_ns"] >= begin_ns])
    used = innovations["used"][innovations["kind"] == POSITION_N]
    assert used.mean() > 0.9 if is_given_up else not used.any()
    assert (abs(float(s["core"]["nav"]["time_offset"][0, 0])) < 0.1) == is_given_up
    last = slice(int((BEGIN_S + 50.0) * RATE), None)
    assert ((out["status"][-10 * RATE :] & COASTING > 0).all()) != is_given_up
    if is_given_up:
        assert (out["status"][-10 * RATE :] & HEADING_VALID > 0).all()
        assert np.hypot(*errors(d, np.concatenate([before, out]))[0][last, :2].T).max() < 2.0
