"""The age of a source's measurements is learned from the filter's own motion; one that is right has none."""

from itertools import pairwise

import numpy as np
import pytest
from fault_matrix import BEGIN_S, SOURCES, cell, harm, judged, late, own_clock, scene
from navigation_simulation import drive, errors, received, sensed

from imud.batch import play
from imud.configuration.settings import Initial, Settings
from imud.daemon.status_tables import add_estimates
from imud.estimators import registry
from imud.estimators.ins import sources
from imud.estimators.records import GNSS_FIX, ODOMETER_SOURCE, SOLUTION, SOURCE_KINDS
from imud.pipeline import Filter, innovation_buffer
from imud.smoothing.two_filter import Forward, smooth


def ages(drive_, samples, fixes, rows, end_s):
    """(solutions, age and sigma of the source after each of its measurements, its probabilities at the end)."""
    filter_, samples = Filter(registry.by_name("navigation"), Settings(), Initial(), 100.0), samples.copy()
    samples = samples[samples["t_ns"] < (100.0 + end_s) * 1e9]
    out, found = np.zeros(len(samples), SOLUTION), []
    rows = rows[np.argsort(rows["arrival_ns"], kind="stable")]
    places = np.searchsorted(samples["t_ns"], fixes["arrival_ns"]).astype(np.int64)
    aided = np.searchsorted(samples["t_ns"], rows["arrival_ns"])
    for start, stop in pairwise(np.unique([0, *aided[aided < len(samples)], len(samples)])):
        filter_.aid(rows[aided == start])
        due = slice(*np.searchsorted(places, [start, stop]))
        filter_.feed(
            samples[start:stop], out[start:stop], fixes[due], places[due] - start, innovation_buffer(len(fixes[due]))
        )
        learned = filter_.state["source_ages"][0][rows["kind"][0]]
        found.append((start / 100.0, learned["age"], np.sqrt(learned["variance"])))
    return out, np.array(found), filter_


def faulty(name, fault, seed):
    d, samples, fixes = scene(seed)
    rows = SOURCES[name](d, np.random.default_rng(100 + seed)).copy()
    if fault is not None:
        rows = fault(name, rows, rows["t_ns"] * 1e-9 - 100.0)
    return d, samples, fixes, rows


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("name", "fault", "age", "within"),
    [
        ("odometer", late, 0.82, 0.12),
        ("odometer", own_clock, -0.35, 0.25),  # the estimate follows wheels that are early by a third of a second
        ("pose", late, 0.97, 0.15),  # 0.02 to 0.32 s of transmission, besides
        ("pose", own_clock, -0.35, 0.25),
        ("body_velocity", late, 0.97, 0.15),
        ("heading", late, 0.8, 0.15),
    ],
)
def test_an_age_is_found_in_half_a_minute_of_changing_speed(name, fault, age, within, seed):
    found = ages(*faulty(name, fault, seed), BEGIN_S + 35.0)[1]
    before, after = found[found[:, 0] < BEGIN_S], found[-20:]
    assert np.all(before[:, 1] == 0.0)
    assert np.all(after[:, 1] != 0.0) and np.abs(after[:, 1] - age).max() < within


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", ["odometer", "pose"])
def test_one_that_is_late_from_the_first_on_is_found_and_misleads_little(name, seed):
    d, samples, fixes, rows = faulty(name, None, seed)
    rows["arrival_ns"] += 800_000_000
    rows["t_ns"] = rows["arrival_ns"]
    out, found, _ = ages(d, samples, fixes, rows, 130.0)
    judgement = judged(d, out)
    assert found[-1, 1] == pytest.approx(0.82 if name == "odometer" else 0.97, abs=0.2)
    assert judgement.sure_s == 0.0 and harm(judgement, cell(seed))[0] < 1.8


@pytest.mark.parametrize("name", ["odometer", "pose", "velocity", "body_velocity", "heading"])
def test_a_source_that_is_right_has_no_age(name):
    found = ages(*faulty(name, None, 3), BEGIN_S + 70.0)[1]
    assert np.all(found[:, 1] == 0.0) and found[-1, 2] < 0.03


def test_a_constant_velocity_tells_nothing():
    rng = np.random.default_rng(5)
    d = drive(80.0, speed=8.0, swing=0.0, straight_s=0.0)
    samples, fixes = sensed(d, rng), received(d, rng)
    rows = SOURCES["odometer"](d, rng)
    under_way = rows["t_ns"] * 1e-9 - 100.0 > 40.0  # until then it accelerates
    rows = rows[under_way]
    late_rows = late("odometer", rows.copy(), rows["t_ns"] * 1e-9 - 100.0)
    out, found, _ = ages(d, samples, fixes, late_rows, 80.0)
    assert np.all(found[:, 1] == 0.0) and found[-1, 2] > 0.03  # it may still be of any age
    assert np.abs(errors(d, out)[1][4000:7800]).max() < 0.3


def test_slips_and_jumps_are_no_age():
    d, samples, fixes, rows = faulty("odometer", None, 4)
    t = rows["t_ns"] * 1e-9
    for begin in np.arange(120.0, 220.0, 11.0):
        rows["value"][(t > begin) & (t < begin + 2.5), 0] *= 0.6 if begin % 2 else 1.4
    found = ages(d, samples, fixes, rows, 129.0)[1]
    assert np.all(found[:, 1] == 0.0)


def test_status_reports_it():
    _, found, filter_ = ages(*faulty("odometer", late, 1), BEGIN_S + 40.0)
    tables = {"odometer": {"age_s": 0.1}, "barometer": {"age_s": 0.1}}
    add_estimates(tables, filter_)
    assert tables["odometer"]["late_s"] == round(found[-1, 1], 2) and "late_s" not in tables["barometer"]
    assert abs(tables["odometer"]["scale"] - 1.01) < 3.0 * tables["odometer"]["sscale"] < 0.03


def test_smoothing_takes_measurements_at_the_age_that_was_found():
    d, samples, fixes, rows = faulty("odometer", late, 1)
    rows = rows[rows["t_ns"] * 1e-9 - 100.0 > BEGIN_S]  # late from the first one on
    filter_, blocks = Filter(registry.by_name("navigation"), Settings(), Initial(), 100.0), []
    forward = Forward(filter_)
    play(filter_, samples.copy(), fixes, forward.take, aiding=rows)
    shifted = forward.at_their_ages(rows)
    assert 1e-9 * np.median(rows["t_ns"] - shifted["t_ns"]) == pytest.approx(0.82, abs=0.1)
    smooth(forward, samples, fixes, rows, lambda block: blocks.append(block.copy()))
    assert np.abs(errors(d, np.concatenate(blocks))[1][7000:11000, :2]).max() < 0.5


def test_it_is_kept_over_a_restart():
    _, found, filter_ = ages(*faulty("odometer", late, 1), BEGIN_S + 40.0)
    estimator = registry.by_name("navigation")
    again = Filter(estimator, Settings(), Initial(), 100.0)
    estimator.resume(again.state, estimator.checkpoint(filter_.state))
    assert again.state["source_ages"][0]["age"][ODOMETER_SOURCE] == found[-1, 1] > 0.7


def test_every_source_has_an_element_of_the_arrays_by_source():
    assert sorted(source.kind for source in sources.SOURCES) == list(range(GNSS_FIX + 1, SOURCE_KINDS))
