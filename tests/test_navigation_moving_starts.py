"""A recorded drive entered at any time, under way: a wrong heading must not pass for certain, and not for long."""

from functools import cache

import numpy as np
import pytest
from navigation_runner import SHARED, euler_deg, load, navigate, settings_of

from imud.estimators.records import HEADING_VALID

ROOM = SHARED / "navigation" / "ixr-0412"
pytestmark = pytest.mark.skipif(not ROOM.exists(), reason=f"no recordings in {ROOM}")

SETTINGS = settings_of(lever=(0.0, 0.3, 0.0))
POINTS_S, LENGTH_S, RATE = range(90, 1890, 100), 300.0, 50
CONFIDENT, SMALL_DEG = 4.0, 5.0  # sigmas; below that many degrees an error is no harm


@cache
def whole(fixes):
    samples, fixes = load(ROOM, fixes)
    return samples, fixes, (samples["t_ns"] - samples["t_ns"][0]) * 1e-9


@cache
def reference_yaw_deg():
    """Of the whole drive with RTK, which began at rest; its sigma is a third of a degree."""
    samples, fixes, _ = whole("rtk")
    return euler_deg(navigate(samples, fixes, SETTINGS)[0]["q_nb"])[:, 2]


def start(fixes, at_s, bias_degps=(0.0, 0.0, 0.0)):
    """(valid, confidently wrong), per sample, of a start at `at_s` with a gyro bias added."""
    samples, fixes, t = whole(fixes)
    part = (t >= at_s) & (t < at_s + LENGTH_S)
    mine = samples[part].copy()
    mine["w"] += np.radians(bias_degps)
    inside = (fixes["t_ns"] >= mine["t_ns"][0]) & (fixes["t_ns"] <= mine["t_ns"][-1])
    out, _, _ = navigate(mine, fixes[inside], SETTINGS)
    error = np.abs((euler_deg(out["q_nb"])[:, 2] - reference_yaw_deg()[part] + 180.0) % 360.0 - 180.0)
    valid = (out["status"] & HEADING_VALID) > 0
    return valid, valid & (error > np.maximum(CONFIDENT * np.degrees(out["sigma_rpy"][:, 2]), SMALL_DEG))


@pytest.mark.parametrize(
    "fixes, bias_degps, wrong_s",
    [
        ("rtk", (0, 0, 0), 10.0),
        ("nmea_grade", (0, 0, 0), 30.0),
        ("receiver_like", (0, 0, 0), 40.0),
        ("rtk", (3, -2, 4.5), 150.0),
        ("nmea_grade", (3, -2, 4.5), 120.0),
    ],
)
def test_a_start_under_way_finds_the_heading_and_is_hardly_ever_wrong_with_confidence(fixes, bias_degps, wrong_s):
    """`wrong_s` is of 5400 s in 18 starts; so is each bound on a single start: no error goes on for ever."""
    runs = [start(fixes, at_s, bias_degps) for at_s in POINTS_S]
    wrong = np.array([w.sum() for _, w in runs]) / RATE
    found = np.array([v.any() for v, _ in runs])
    assert wrong.sum() < wrong_s
    assert wrong.max() < 75.0
    assert not any(w[-1] for _, w in runs)
    assert found.mean() > 0.85
