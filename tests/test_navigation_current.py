"""A boat in a current that passes for a land vehicle: the constraint is withdrawn, and what it did to the heading."""

import numpy as np
import pytest
from accuracy_simulated import RECEIVERS, VEHICLES, judged, received, sensed, way
from navigation_runner import settings_of
from replay_in_process import new_filter, replay

from imud.estimators.records import NHC_LATERAL


def run(vehicle, receiver, seed):
    """(drive, solutions, seconds in which the constraint was used, final record of the test); as in
    `accuracy_simulated.figures`.
    """
    sources = list(VEHICLES).index(vehicle), list(RECEIVERS).index(receiver)
    d, rng = way(vehicle, seed), np.random.default_rng([seed, *sources, 1])
    shaken = (np.exp(rng.uniform(*np.log(span))) for span in VEHICLES[vehicle][1:])
    samples, fixes = sensed(d, rng, *shaken), received(d, rng, receiver)
    filter_ = new_filter("navigation", samples, settings_of())
    out, innovations = replay(filter_, samples, fixes)
    return d, out, 0.1 * (innovations["kind"] == NHC_LATERAL).sum(), filter_.state["core"][0, 0]["current"]


def current_of(d):
    """Mean velocity of the water, m/s, of a boat that goes ahead through it."""
    yaw = d.attitude.as_euler("ZYX")[:, 0]
    across = np.column_stack([-np.sin(yaw), np.cos(yaw)])
    return np.linalg.lstsq(across, (across * d.v[:, :2]).sum(axis=1), rcond=None)[0]


@pytest.mark.parametrize("receiver, seed", [("RTK", 201), ("5 Hz", 201), ("5 Hz", 211)])
def test_a_current_that_passed_for_no_slip_is_found_and_what_it_did_is_undone(receiver, seed):
    d, out, used, test = run("boat", receiver, seed)
    assert 5.0 < used < 40.0
    assert judged(d, out, 0)["yaw s"] == 0.0
    nn, ne, ee = test["information"]
    wrong = np.linalg.solve([[nn, ne], [ne, ee]], test["vector"]) - current_of(d)
    assert wrong @ [[nn, ne], [ne, ee]] @ wrong < 14.0


def test_a_car_keeps_the_constraint_and_its_heading_stays_sure():
    _, _, used, test = run("city", "5 Hz", 200)
    assert used > 120.0
    assert 0.0 < np.sqrt(test["heading_variance"]) < np.radians(0.05)
