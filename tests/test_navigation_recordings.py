"""Real drives with ground truth, each fix used when it arrived, one default profile, no start values."""

import json

import numpy as np
import pytest
from navigation_runner import (
    SHARED,
    load,
    navigate,
    outage_ends,
    scorer,
    settings_of,
    table,
    truth_of,
    without,
)

from imud.estimators.records import HEADING_VALID

ROOM = SHARED / "navigation"
pytestmark = pytest.mark.skipif(not ROOM.exists(), reason=f"no recordings in {ROOM}")

# A filter that knows how these fixes were made, and nearly the velocity, is 2.9 m off with this one, and says 1.8
UNLUCKY = ("dtu-ugv4", "receiver_like")
# recording, fixes: horizontal position m, horizontal velocity m/s, yaw deg, outage s, its median and RMS m
BOUNDS = [
    ("ixr-0412", "rtk", 0.02, 0.05, None, "60", 2.5, 5.0),
    ("ixr-0412", "nmea_grade", 2.5, 0.08, None, "30", 5.0, 8.0),
    ("ixr-0412", "receiver_like", 2.4, 0.08, None, "60", 4.0, 6.0),
    ("dtu-ugv4", "rtk", 0.09, 0.09, 1.4, "30", 7.0, 14.1),
    ("dtu-ugv4", "nmea_grade", 3.2, 0.15, 3.4, "30", 7.0, 20.0),  # two windows begin before the heading is found
    ("dtu-ugv4", "receiver_like", 3.2, 0.12, 1.8, "30", 7.0, 20.0),
]


def figures_of(name, fixes, outage):
    """Of one recording: errors and NEES with all fixes, and rows of error and NEES at the ends of outages."""
    score, folder = scorer(), ROOM / name
    meta = json.loads((folder / "meta.json").read_text())
    lever = meta["lever_frd"] if meta["truth_point"] == "antenna" else None
    settings, truth = settings_of(lever=meta["lever_frd"]), truth_of(folder)
    samples, rows = load(folder, fixes)
    est = table(navigate(samples, rows, settings)[0])
    t, d, _ = score.errors(est, truth, lever)
    m = score.steady(t, str(folder / f"gnss_{fixes}.csv")) & (t > t[0] + 100 * (name[:3] == "ixr") + 60)
    ends = []
    for windows in json.loads((folder / "outages.json").read_text())[outage]:
        cut = table(navigate(samples, without(rows, windows), settings)[0])
        ends += outage_ends(score, cut, truth, lever, windows)
    return score.stats(d[m]), score.nees(est, t[m], d[m]), np.array(ends)


@pytest.mark.thorough
@pytest.mark.parametrize("name, fixes, position, velocity, yaw, outage, median, rms", BOUNDS)
def test_errors_stay_within_what_was_reached(name, fixes, position, velocity, yaw, outage, median, rms):
    channels, nees, ends = figures_of(name, fixes, outage)
    assert channels["pH"]["rms"] < position
    assert channels["vH"]["rms"] < velocity
    assert nees["pos"]["anees"] < (2.5 if (name, fixes) == UNLUCKY else 2.0)
    if yaw is not None:
        assert channels["yaw"]["rms"] < yaw
        assert channels["roll"]["rms"] < 0.4
        assert channels["pitch"]["rms"] < 0.6
    assert np.median(ends[:, 0]) < median
    assert np.sqrt(np.mean(ends[:, 0] ** 2)) < rms
    assert np.median(ends[:, 1]) < 2.0


@pytest.mark.parametrize("fixes, stamp_s", [("receiver_like", -0.2), ("receiver_like", 0.2), ("rtk", 0.2)])
def test_wrong_stamps_do_not_make_a_wrong_heading_certain(fixes, stamp_s):
    """A slow vehicle that is jerked to and fro within a second: most of what turns its heading is a latency's work."""
    folder = ROOM / "dtu-ugv4"
    samples, rows = load(folder, fixes)
    rows["t_ns"] += int(1e9 * stamp_s)
    rows["arrival_ns"] = np.maximum(rows["arrival_ns"], rows["t_ns"])
    lever = json.loads((folder / "meta.json").read_text())["lever_frd"]
    out = navigate(samples, rows, settings_of(lever=lever))[0]
    known = table(out[(out["status"] & HEADING_VALID) > 0])
    t, errors, _ = scorer().errors(known, truth_of(folder))
    sigma = np.interp(t, known[:, 0], known[:, 18])
    assert len(errors) > 10_000
    assert (np.abs(errors[:, 8]) < np.maximum(5.0, 4.0 * sigma)).all()
