"""Receivers whose stamps are late, before the heading is known: what is stated, and how the age is found."""

import numpy as np
from navigation_runner import navigate, settings_of
from navigation_simulation import errors, received, sensed
from vehicle_simulation import vehicle

from imud.estimators.records import HEADING_VALID, POSITION_VALID


def start(kind, late, seed=1, survey=True, seconds=90.0):
    """(the drive, the solutions, the filter's time offset): positions of a survey, or of a common receiver."""
    rng = np.random.default_rng([seed, 77])
    d = vehicle(kind, seed, seconds)
    samples = sensed(d, rng, bg=np.radians(rng.normal(0.0, 0.2, 3)), ba=rng.normal(0.0, 0.04, 3))
    accuracy = {"sigma": 0.02, "white": 0.01, "hdop": 0.05} if survey else {"sigma": 1.2, "white": 0.3}
    fixes = received(d, rng, late=0.1, stamp=late, **accuracy)
    if survey:
        fixes["speed"] = fixes["course"] = np.nan
    fixes["arrival_ns"] = np.maximum(fixes["arrival_ns"], fixes["t_ns"])
    out, _, state = navigate(samples, fixes, settings_of())
    return d, out, float(state["core"][0, 0]["nav"]["time_offset"])


def test_before_the_heading_is_known_the_sigma_of_the_position_has_that_of_the_time_offset():
    d, out, _ = start("motorway", 0.2, seconds=30.0)
    position, _, _ = errors(d, out)
    before = ((out["status"] & POSITION_VALID) > 0) & ((out["status"] & HEADING_VALID) == 0)
    fast = before & (np.hypot(*d.v[:, :2].T) > 8.0)
    assert fast.sum() > 100
    away = np.hypot(position[fast, 0], position[fast, 1])
    stated = np.hypot(out["sigma_p"][fast, 0], out["sigma_p"][fast, 1])
    assert away.max() > 1.5
    assert np.all(away < 3.0 * stated)
    assert np.all(stated < 1.0 + 0.21 * np.hypot(*d.v[fast, :2].T))
