"""Stamps of a receiver that step by a second under way: the time offset is found again, and nothing else is bent."""

import numpy as np
import pytest
from navigation_runner import navigate
from navigation_simulation import Later, drive, errors, received, sensed
from replay_in_process import new_filter, replay

from imud.compile.jit import interpreted
from imud.configuration.settings import Initial, Navigation, Settings
from imud.estimators.ins.glr_tests.fault_sensitivity import note_energy
from imud.estimators.ins.glr_tests.time_offset_step import (
    detect_time_offset_step,
    explained_by_time_offset_step,
    reset_time_offset_step,
    residual_of_time_offset_step,
)
from imud.estimators.ins.parameters import configure
from imud.estimators.ins.setup import start
from imud.estimators.ins.state import ATTITUDE, POSITION, TIME_OFFSET, TIME_STEP_FAULT, VELOCITY
from imud.estimators.records import POSITION_VALID

RATE = 100
D = Later(drive, 200.0, speed=12.0)
STEP_AT_S = 100.0


def stepped(fixes, seconds):
    fixes = fixes.copy()
    k = fixes["t_ns"] * 1e-9 - 100.0 >= STEP_AT_S
    fixes["t_ns"][k] += int(1e9 * seconds)
    fixes["arrival_ns"] = np.maximum(fixes["arrival_ns"], fixes["t_ns"])
    return fixes


@pytest.mark.parametrize("seconds", [1.0, -1.0])
@pytest.mark.parametrize("sigma, white", [(2.0, 0.1), (0.02, 0.02)], ids=["receiver", "rtk"])
def test_a_step_of_the_stamps_is_found(seconds, sigma, white):
    rng = np.random.default_rng(3)
    samples = sensed(D, rng)
    fixes = received(D, rng, late=0.2, sigma=sigma, white=white)
    if sigma < 0.1:
        fixes["sigma"] = (0.03, 0.03, 0.05)
    out, _, state = navigate(samples, stepped(fixes, seconds))
    away, _, attitude = errors(D, out)
    distance = np.hypot(away[:, 0], away[:, 1])
    sigmas = np.hypot(away[:, 0] / out["sigma_p"][:, 0], away[:, 1] / out["sigma_p"][:, 1])
    valid = (out["status"] & POSITION_VALID) > 0
    assert not (valid & (distance > 5.0) & (sigmas > 4.0))[int(60 * RATE) :].any()
    assert distance[int((STEP_AT_S + 40) * RATE) :].max() < (6.0 if sigma > 1 else 2.0)  # 12 m, if followed
    assert np.abs(attitude[int((STEP_AT_S + 5) * RATE) :, 2]).max() < np.radians(4.0)
    assert state["core"][0, 0]["nav"]["time_offset"] == pytest.approx(seconds, abs=0.3)


@pytest.mark.parametrize("metres", [(12.0, 0.0), (0.0, -12.0)])
def test_a_jump_of_a_few_seconds_is_no_step_of_the_stamps(metres):
    rng = np.random.default_rng(4)
    samples, fixes = sensed(D, rng), received(D, rng, late=0.2, sigma=0.02, white=0.02)
    fixes["sigma"] = (0.03, 0.03, 0.05)
    t = fixes["t_ns"] * 1e-9 - 100.0
    k = (t >= STEP_AT_S) & (t < STEP_AT_S + 4.0)
    fixes["lat"][k] += metres[0] / 6.37e6
    fixes["lon"][k] += metres[1] / (6.39e6 * np.cos(fixes["lat"][k]))
    out, _, state = navigate(samples, fixes)
    assert np.abs(errors(D, out)[0][int(60 * RATE) :, :2]).max() < 3.0
    assert abs(state["core"][0, 0]["nav"]["time_offset"]) < 0.1


def test_the_effect_of_a_step_is_predicted():
    """Against the difference of two runs of a free vehicle, one with a time offset that is changed by hand.

    The receiver's noise is not learned, as it would be from what the step does.
    """
    tuning = {"time_offset_step_onset_chi2": 0.0, "excluded_step_sigmas": 1e6, "warm_up_share": 0.0, "noise_gain": 0.0}
    settings = Settings(navigation=Navigation(vehicle="free", tuning=tuning))
    rng = np.random.default_rng(3)
    samples, fixes = sensed(D, rng), received(D, rng, sigma=0.1)
    first, last, change = int(40.5 * RATE), int(70.5 * RATE), 1e-4
    t = fixes["t_ns"] * 1e-9 - 100.0
    runs = []
    for offset in (0.0, change):
        filter_ = new_filter("navigation", samples, settings)
        replay(filter_, samples[:first], fixes[t < 40.5])
        core = filter_.state["core"][0, 0]
        core["nav"]["time_offset"] += offset
        filter_.state["last_time_offset"] += offset
        core["faults"]["sensitivity"][:, TIME_STEP_FAULT] = 0.0
        core["faults"]["sensitivity"][TIME_OFFSET, TIME_STEP_FAULT] = -1.0
        replay(filter_, samples[first:last], fixes[(t > 40.5) & (t < 70.5)])
        runs.append(filter_.state["core"][0, 0].copy())
    w = -runs[0]["faults"]["sensitivity"][:, TIME_STEP_FAULT]
    nav, changed = runs[0]["nav"], runs[1]["nav"]
    assert 0.01 < abs(w[TIME_OFFSET]) < 0.9
    assert w[TIME_OFFSET] == pytest.approx((changed["time_offset"] - nav["time_offset"]) / change, abs=0.03)
    assert w[POSITION] == pytest.approx((changed["lat"] - nav["lat"]) * 6.37e6 / change, rel=0.15)
    assert w[VELOCITY : VELOCITY + 2] == pytest.approx((changed["v_n"] - nav["v_n"])[:2] / change, abs=0.15)
    assert np.abs(w[ATTITUDE : ATTITUDE + 3]).max() < 0.2


@pytest.mark.parametrize(("sigma_s", "renewed"), [(0.02, True), (0.2, False)])
def test_an_onset_since_which_a_step_is_excluded_is_renewed(sigma_s, renewed):
    """What it knows of the time before a step would hide the step; 3 sigma of what looks like a small step."""
    p = configure(Settings(), 100.0).view(np.recarray)[0]
    c = start(configure(Settings(), 100.0), Initial())["core"][0].view(np.recarray)[0]
    g, d = c.time_offset_step, 3.0 * sigma_s
    c.nav.t_ns, g.onset_ns = 400_000_000_000, 16_000_000_000
    g.information, g.vector, g.count = sigma_s**-2, d * sigma_s**-2, 300
    g.energy = d * g.vector + 300.0
    assert not interpreted(detect_time_offset_step)(p, c, 0.0)
    assert (g.onset_ns == c.nav.t_ns) == renewed


@pytest.mark.parametrize(("explained_otherwise", "detected"), [(0.0, True), (99.0, True), (101.0, False)])
def test_a_step_has_to_explain_more_than_another_cause(explained_otherwise, detected):
    """One of 1 +- 0.1 s explains 100."""
    p = configure(Settings(), 100.0).view(np.recarray)[0]
    c = start(configure(Settings(), 100.0), Initial())["core"][0].view(np.recarray)[0]
    g = c.time_offset_step
    c.nav.t_ns, g.onset_ns = 400_000_000_000, 16_000_000_000
    g.information, g.vector, g.count, g.energy = 100.0, 100.0, 300, 400.0
    assert interpreted(detect_time_offset_step)(p, c, explained_otherwise) == detected


def test_what_was_summed_before_an_estimate_began_anew_explains_nothing():
    c = start(configure(Settings(), 100.0), Initial())["core"][0].view(np.recarray)[0]
    g = c.time_offset_step
    g.onset_ns, g.information, g.vector, g.count, g.energy = 16_000_000_000, 100.0, 100.0, 300, 900.0
    assert interpreted(explained_by_time_offset_step)(c) == 100.0
    assert interpreted(residual_of_time_offset_step)(c) > 2.0
    interpreted(reset_time_offset_step)(c)
    g.information = g.vector = 50.0  # of fixes since, before the next onset
    assert interpreted(explained_by_time_offset_step)(c) == 0.0
    assert interpreted(residual_of_time_offset_step)(c) == 0.0


@pytest.mark.parametrize(("of_two", "detected"), [((392.0, 8.0), False), ((300.0, 100.0), True)])
def test_an_outlier_is_no_step(of_two, detected):
    """A position 26 m off, before others that are right, was one (a simulated motorcycle, centimetre accuracy)."""
    p = configure(Settings(), 100.0).view(np.recarray)[0]
    c = start(configure(Settings(), 100.0), Initial())["core"][0].view(np.recarray)[0]
    g = c.time_offset_step
    c.nav.t_ns, g.onset_ns = 400_000_000_000, 16_000_000_000
    g.information, g.vector, g.count, g.energy = 100.0, 100.0, 300, 400.0
    for k, energy in enumerate(of_two):
        for part in (0.5, 0.5):  # north and east
            interpreted(note_energy)(g, 17_000_000_000 + k, part * energy)
    assert interpreted(detect_time_offset_step)(p, c, 0.0) == detected
